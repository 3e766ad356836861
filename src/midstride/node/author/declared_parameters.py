"""Parameters of a component: declared before it starts, readable at any time, set by the manager."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

from midstride.errors import NodeError
from midstride.model.component import ParameterValue, same_value

_SCALARS = (bool, int, float, str)


class Parameter:
    """Made by ``Component.parameter``; ``value`` is its current value.

    ``declared`` is the value that it was started with. ``changed`` is called on the data thread when it has been set.
    ``closed`` says why it cannot be set any more.
    """

    def __init__(self, name: str, default: ParameterValue, on_change: Callable[[Any], None] | None) -> None:
        self.name = name
        self.default = default
        self.on_change = on_change
        self.declared: Any = default
        self.changed: Callable[[], object] = lambda: None
        self.closed = ""
        self._value: Any = default

    @property
    def value(self) -> Any:
        """The current value, of the type of the default."""
        return self._value

    def begin_with(self, value: Any) -> None:
        """The value it starts with, from the platform. Raises NodeError where it is of another type."""
        self.declared = self._value = self.fitted(value)

    def keep(self, value: Any) -> None:
        """The value that was set while its predecessor ran. Raises NodeError where it is of another type."""
        self._value = self.fitted(value)

    def change(self, value: Any) -> None:
        """Called on the data thread when it is set. If the author's function raises, the value stays as it was.

        Raises NodeError for another value where there is no such function: code that reads it once would not notice;
        and in place of SystemExit, which is one of the function's errors.
        """
        fitted = self.fitted(value)
        if self.closed:
            raise NodeError(f"parameter {self.name} cannot be set any more: {self.closed}")
        if self.on_change is None:
            if same_value(fitted, self._value):
                return
            raise NodeError(
                f"parameter {self.name} keeps the value that the component was started with: replace the component, or "
                "give the parameter an on_change="
            )
        before, self._value = self._value, fitted
        try:
            self.on_change(fitted)
        except BaseException as error:
            self._value = before
            if isinstance(error, SystemExit):
                raise NodeError(f"on_change of parameter {self.name} raised SystemExit: {error}") from error
            raise
        self.changed()

    def fitted(self, value: Any) -> Any:
        """``value`` as a value of this parameter: of the default's type; an integer also fits a float."""
        fitted = fitted_to(value, self.default)
        if fitted is None:
            kind = type(self.default).__name__
            raise NodeError(f"parameter {self.name} takes a value like {self.default!r} ({kind}), not {value!r}")
        return fitted


def check_parameter(name: object, value: object) -> None:
    """Raises NodeError where ROS allows no such name or value, or where the name is reserved."""
    if not isinstance(name, str) or not name or name.startswith("midstride."):
        raise NodeError(
            f"parameter(): {name!r} cannot be the name of a parameter; write a name that does not start with midstride."
        )
    members = value if isinstance(value, list) else [value]
    kinds = {type(member) for member in members}
    if not all(isinstance(member, _SCALARS) for member in members) or len(kinds) > 1:
        raise NodeError(
            f"parameter {name}: {value!r} cannot be the value of a ROS parameter; write a boolean, a number, a string, "
            "or a list of one of these types"
        )


def fitted_to(value: Any, like: Any) -> Any:
    """``value`` as a parameter's value of the type of ``like``: an integer as a float, say; None if it does not fit."""
    if isinstance(like, list):
        if not isinstance(value, (list, tuple, array)):  # rclpy has numbers in an array
            return None
        members = [fitted_to(member, like[0]) if like else member for member in value]
        return None if any(member is None for member in members) else members
    if isinstance(like, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value if type(value) is type(like) else None

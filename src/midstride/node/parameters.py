"""Parameters of a component: declared before it starts, readable at any time, set by the manager."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from midstride.errors import NodeError
from midstride.model.component import ParameterValue

_SCALARS = (bool, int, float, str)


class Parameter:
    """Made by ``Component.parameter``; ``value`` is what it stands at."""

    def __init__(self, name: str, default: ParameterValue, on_change: Callable[[Any], None] | None) -> None:
        self.name = name
        self.default = default
        self.on_change = on_change
        self._value: Any = default

    @property
    def value(self) -> Any:
        return self._value

    def begin_with(self, value: Any) -> None:
        """The value it starts with, as the platform says. Raises NodeError where that is of another type."""
        self._value = self.fitted(value)

    def change(self, value: Any) -> None:
        """Called on the data side when it is set. What the author's function raises leaves it as it was.

        Raises NodeError where there is no such function: whoever reads the value once would not notice.
        """
        if self.on_change is None:
            raise NodeError(
                f"parameter {self.name} keeps the value that the component was started with: replace the component, or "
                f"give the parameter an on_change="
            )
        before, self._value = self._value, self.fitted(value)
        try:
            self.on_change(self._value)
        except BaseException:
            self._value = before
            raise

    def fitted(self, value: Any) -> Any:
        """``value`` as a value of this parameter: of the default's type, a whole number serving as a real one."""
        fitted = _fitted(value, self.default)
        if fitted is None:
            kind = type(self.default).__name__
            raise NodeError(f"parameter {self.name} takes a value like {self.default!r} ({kind}), not {value!r}")
        return fitted


def check_parameter(name: object, value: object) -> None:
    """Raises NodeError where ROS has no parameter of such a name or value, or where the name is ours."""
    if not isinstance(name, str) or not name or name.startswith("midstride."):
        raise NodeError(f"parameter(): {name!r} cannot be the name of a parameter of yours")
    members = value if isinstance(value, list) else [value]
    kinds = {type(member) for member in members}
    if not all(isinstance(member, _SCALARS) for member in members) or len(kinds) > 1:
        raise NodeError(
            f"parameter {name}: {value!r} is no value of a ROS parameter; write a boolean, a number, words, "
            "or a list of one of these"
        )
    if any(isinstance(member, float) and not math.isfinite(member) for member in members):
        raise NodeError(f"parameter {name}: {value!r} is not finite")


def _fitted(value: Any, like: Any) -> Any:
    if isinstance(like, list):
        if not isinstance(value, (list, tuple)):
            return None
        members = [_fitted(member, like[0]) if like else member for member in value]
        return None if any(member is None for member in members) else members
    if isinstance(like, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value if type(value) is type(like) else None

"""A functionality as its author declares it: a chain of modes, best first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from midstride.errors import NodeError
from midstride.node.modes import Approximate, DeclaredMode, Function, ModeFunction, Promise, declare_mode
from midstride.node.ports import AnyOf, Input, Output


class Functionality:
    """A chain of modes, best first (docs/semantics.md section 2). Made by ``Component.create_functionality``.

    The normal mode is the best, and the degraded one assumes nothing (M1); every better mode guarantees what a worse
    one guarantees (M2). It starts in the degraded mode. The manager changes modes; only where a function raises does
    the functionality go to its degraded mode by itself.
    """

    def __init__(
        self,
        name: str,
        inputs: tuple[Input, ...],
        outputs: tuple[Output, ...],
        weight: float,
        changeable: Callable[[str], None],
    ) -> None:
        self.name = name
        self.inputs = inputs
        self.outputs = outputs
        self.weight = weight
        self._current_mode: Callable[[], str] | None = None
        self._changeable = changeable
        self._normal: DeclaredMode | None = None
        self._between: list[DeclaredMode] = []
        self._degraded: DeclaredMode | None = None

    def set_normal_mode(
        self,
        fn: ModeFunction,
        rate: float | None = None,
        inputs: Sequence[Input | AnyOf] = (),
        outputs: Sequence[Output] = (),
        guarantees: Mapping[Output, Promise] | None = None,
        *,
        sync: Approximate | None = None,
        name: str = "normal",
    ) -> None:
        """The best mode.

        With ``rate`` (Hz), ``fn()`` is called at that rate, and that is the guarantee of its ``outputs``. Without,
        ``fn(message)`` is called for every message of its one input; with several, ``fn`` maps inputs to functions, or
        ``sync=approximate(…)`` calls it with one message of each. Without either, ``fn()`` is called once, on entry. An
        ``async`` function counts as running until it returns; it may await what the platform supports: rclpy's futures
        on ROS 2, asyncio's on ROS 1.

        ``inputs`` names what the mode assumes; ``any_of(left, right)`` for alternatives. ``outputs`` are those it
        writes: an output that is not among them is guaranteed nothing. ``guarantees`` states rates (Hz) or fields of
        outputs beyond what follows from ``rate``. ``name`` is the mode's name in the specification. Raises NodeError.
        """
        if self._normal is not None:
            raise self._declared_twice("set_normal_mode")
        self._normal = self._declare(name, fn, rate, inputs, outputs, guarantees, sync)

    def set_mode(
        self,
        name: str,
        fn: ModeFunction,
        rate: float | None = None,
        inputs: Sequence[Input | AnyOf] = (),
        outputs: Sequence[Output] = (),
        guarantees: Mapping[Output, Promise] | None = None,
        *,
        sync: Approximate | None = None,
    ) -> None:
        """A mode between the normal and the degraded one; call it for the better ones first.

        The arguments are those of ``set_normal_mode``. Raises NodeError.
        """
        self._between.append(self._declare(name, fn, rate, inputs, outputs, guarantees, sync))

    def set_degraded_mode(
        self,
        fn: Function,
        rate: float | None = None,
        outputs: Sequence[Output] = (),
        *,
        guarantees: Mapping[Output, Promise] | None = None,
        name: str = "degraded",
        inputs: Sequence[Input | AnyOf] = (),
    ) -> None:
        """The last mode: what to do when no input can be relied on. It assumes nothing (M1).

        With ``rate`` (Hz), ``fn()`` is called at that rate; without, once, on entry. Raises NodeError.
        """
        if self._degraded is not None:
            raise self._declared_twice("set_degraded_mode")
        if inputs:
            raise NodeError(
                f"functionality {self.name}: the degraded mode may assume nothing, so it takes no inputs=; "
                f'write set_mode("name", …) for a mode that does, and a degraded one without'
            )
        self._degraded = self._declare(name, fn, rate, (), outputs, guarantees, None)

    @property
    def mode(self) -> str | None:
        """The name of the mode it is in; None before the component has started."""
        return None if self._current_mode is None else self._current_mode()

    def start(self, current_mode: Callable[[], str]) -> None:
        """The component has started; ``current_mode`` gives the name of the mode from now on."""
        self._current_mode = current_mode

    def chain(self) -> tuple[DeclaredMode, ...]:
        """All modes, best first. Raises NodeError where the normal or the degraded one is missing."""
        if self._normal is None:
            raise NodeError(f"functionality {self.name} has no normal mode; write {self.name}.set_normal_mode(fn, …)")
        if self._degraded is None:
            raise NodeError(
                f"functionality {self.name} has no degraded mode; write {self.name}.set_degraded_mode(fn): "
                "what it does when no input can be relied on, which may be nothing"
            )
        return (self._normal, *self._between, self._degraded)

    def _declared_twice(self, method: str) -> NodeError:
        return NodeError(
            f"functionality {self.name}: {method}() has been called already; for a mode in between write "
            f'set_mode("name", …)'
        )

    def _declare(self, name: str, *arguments: Any) -> DeclaredMode:
        where = f"functionality {self.name}"
        self._changeable(f"a mode of {where}")
        mode = declare_mode(where, (self.inputs, self.outputs), name, *arguments)
        declared = [self._normal, *self._between, self._degraded]
        if any(other is not None and other.name == mode.name for other in declared):
            raise NodeError(f"{where} already has a mode {mode.name}; give this one another name")
        return mode

    def __repr__(self) -> str:
        return f"<functionality {self.name}>"

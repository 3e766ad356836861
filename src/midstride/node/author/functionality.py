"""A functionality as its author declares it: a chain of modes, best first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from midstride.errors import NodeError
from midstride.node.author.modes import Approximate, DeclaredMode, Function, ModeFunction, Promise, declare_mode
from midstride.node.author.ports import AnyOf, Input, Output


class Functionality:
    """A chain of modes, best first (docs/semantics.md section 2). Created by ``Component.create_functionality``.

    It has a normal mode, which is the best, and a degraded mode, which assumes nothing (rule M1). A better mode
    guarantees at least what a worse one guarantees (rule M2). A functionality starts in its degraded mode, and the
    manager changes the mode. If a function raises, its functionality goes to its degraded mode at once, without the
    manager.
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
        """The best mode, and what it calls.

        - With ``rate`` (Hz), ``fn()`` is called at that rate, which is then the guaranteed rate of ``outputs``.
        - Without a rate but with one input, ``fn(message)`` is called for each message.
        - With several inputs, ``fn`` maps inputs to functions, ``{left: on_left, right: on_right}``, or
          ``sync=approximate(0.05)`` calls ``fn(left, right)`` with one message of each.
        - Without a rate and without inputs, ``fn()`` is called once, when the mode is entered.

        An ``async`` function counts as running until it returns. It may await rclpy's futures on ROS 2 and asyncio's on
        ROS 1. ``comp.clock.sleep`` works on both, and in the simulator.

        ``inputs`` are those that the mode assumes; ``any_of(left, right)`` stands for alternatives. ``outputs`` are
        those that it writes; the mode guarantees nothing for any other output. ``guarantees`` adds rates (Hz) or fields
        to what follows from ``rate``: ``{out: 20}`` or ``{out: guarantee(where=…)}``. ``name`` is the mode's name in
        the specification. Raises NodeError.
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
        """A mode between the normal and the degraded one. Declare better ones first.

        The other arguments are those of ``set_normal_mode``. Raises NodeError.
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
        """The last mode: what to do when no input can be relied on. It assumes nothing (rule M1), so it has no inputs.

        With ``rate`` (Hz), ``fn()`` is called at that rate; without, once, when the mode is entered. Raises NodeError,
        also for ``inputs``.
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
        """The name of the current mode; None before ``start()``."""
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

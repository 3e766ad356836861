"""The order in which a change takes the rounds of its plan: as the plan has them, but for what waits or was left out.

Whatever steps are done at a time, the configuration is valid, as long as those before them are that they depend on
(:mod:`midstride.plan.overlap`). So a process that takes long to start delays only the steps that need it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field


@dataclass(slots=True)
class StepOrder:
    """The rounds that are left. ``dependencies``: for each step, the earlier ones that it waits for, if asked.

    ``last``: the steps that are taken after all others, also after those that are late, and only where no other is
    skipped.
    """

    rounds: list[tuple[int, ...]]
    dependencies: Callable[[], Sequence[Collection[int]]]
    last: frozenset[int] = frozenset()
    late: list[int] = field(default_factory=list)  # the steps that wait, in their order
    _left_out: set[int] = field(default_factory=set)
    _blocked: frozenset[int] = frozenset()

    def next(self) -> tuple[int, ...] | None:
        """The steps of the next round that neither are late nor depend on one that is; None if there are none."""
        for place, indices in enumerate(self.rounds):
            free = tuple(index for index in indices if index not in self._blocked)
            if free:
                rest = tuple(index for index in indices if index in self._blocked)
                self.rounds[place : place + 1] = [rest] if rest else []
                return free
        return None

    @property
    def ended(self) -> bool:
        """Return whether no step is left that can be taken, now or later."""
        skipped = self._waiting(self._left_out, ())
        return not self.late and all(index in skipped for indices in self.rounds for index in indices)

    def leaves(self, indices: Collection[int]) -> bool:
        """Return whether steps are left that need not wait for these, now or later."""
        waiting = self._waiting({*indices, *self._left_out}, indices)
        return any(index not in waiting for some in self.rounds for index in some)

    def postpone(self, index: int) -> None:
        """Take a step later, and those that depend on it."""
        self.late = sorted([*self.late, index])
        self.rounds = sorted([*self.rounds, (index,)])
        self._block()

    def resume(self, index: int) -> None:
        """Take a step now that was late."""
        self.late.remove(index)
        self._block()

    def leave_out(self, indices: Iterable[int]) -> None:
        """Never take these steps, or those that depend on them."""
        self._left_out.update(indices)
        self._block()

    def is_blocked(self, index: int) -> bool:
        """Return whether a step is late, or depends on one that is, or is left out."""
        return index in self._blocked

    def _block(self) -> None:
        self._blocked = self._waiting({*self.late, *self._left_out}, self.late)

    def _waiting(self, found: Collection[int], late: Collection[int]) -> frozenset[int]:
        """The steps that are among ``found`` or depend on one of them; the last, where others do or are ``late``."""
        waiting = self._dependents(found) if found else frozenset[int]()
        others = {*waiting - {*found}, *late}
        return waiting if self.last.issuperset(others) else waiting | self.last

    def _dependents(self, found: Collection[int]) -> frozenset[int]:
        blocked = set(found)
        for index, waits in enumerate(self.dependencies()):
            if not blocked.isdisjoint(waits):
                blocked.add(index)
        return frozenset(blocked)

"""Messages against the field constraints of a contract (docs/semantics.md section 1), by sampling.

Every message is checked up to 60 Hz or so, and of more, about 100 a second: a check costs a microsecond, and nothing at
1 kHz must notice it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, Final

from midstride.model.contract import ValueSet
from midstride.node.legible import legible
from midstride.wire.state import FieldSamples

# How long after a check the next message is checked, at least: between these (ns). It varies, so that the checks do not
# fall in step with a publisher that alternates.
SHORTEST: Final = 5_000_000
LONGEST: Final = 15_000_000
_FACTOR, _PRIME = 7_919, 9_999_991


class _Constraint:
    """One field with the values that it may have, and what the checks have found."""

    def __init__(self, path: str, values: ValueSet) -> None:
        self.path = path
        self.values = values
        self.checked = self.violations = self.run = 0
        self.last: Any = None
        self._read = attrgetter(path)

    def check(self, message: Any) -> bool:
        self.checked += 1
        try:
            value = self._read(message)
        except AttributeError:
            value = None
        met = value in self.values
        if met:
            self.run = 0
        else:
            self.violations += 1
            self.run += 1
            self.last = value
        return met

    def samples(self) -> FieldSamples:
        last = self.last
        plain = last if last is None or isinstance(last, (bool, int, float)) else legible(str(last))
        return FieldSamples(
            constraint=str(self.values), checked=self.checked, violations=self.violations, run=self.run, last=plain
        )


class FieldChecks:
    """The constraints that are in force for one port or attachment. Samples on the data thread; read on any.

    ``active``: there are any. ``violated``: the last message that was checked did not meet them all. ``decode``: of
    messages that come as bytes, those that are checked are read by it.
    """

    __slots__ = ("_constraints", "_due", "active", "decode", "violated")

    def __init__(
        self, required: Sequence[tuple[str, ValueSet]] = (), decode: Callable[[Any], Any] | None = None
    ) -> None:
        self.decode = decode
        self._constraints: tuple[_Constraint, ...] = ()
        self._due = 0
        self.require(required)

    def require(self, required: Sequence[tuple[str, ValueSet]]) -> None:
        """The constraints from now on. The counts of those that were in force already go on."""
        known = {(each.path, each.values): each for each in self._constraints}
        self._constraints = tuple(known.get(pair) or _Constraint(*pair) for pair in required)
        self.active = bool(self._constraints)
        self.violated = False

    def sample(self, message: Any, now: int) -> None:
        """A message comes or goes at ``now`` (ns): it is checked unless another one has just been."""
        if self._due - LONGEST <= now < self._due:  # earlier than that, the clock has jumped back
            return
        self._due = now + SHORTEST + now * _FACTOR % _PRIME
        self.check(message)

    def check(self, message: Any) -> None:
        """Check ``message``, however short it came after the one before."""
        if self.decode is not None:
            message = self.decode(message)
        met = [constraint.check(message) for constraint in self._constraints]
        self.violated = not all(met)

    def samples(self) -> dict[str, FieldSamples]:
        """The findings of the checks, by field."""
        return {each.path: each.samples() for each in self._constraints}

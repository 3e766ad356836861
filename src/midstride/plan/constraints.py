"""The user's demands on every plan: ``keep``, ``limit`` and ``order`` (docs/semantics.md section 6)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final, TypeVar

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.configuration import Configuration
from midstride.model.specification import Constraint, Keep, Limit, Order
from midstride.plan.change import Change
from midstride.plan.disruption import DisruptionMeter, Levels, follow
from midstride.plan.step import Step

# Up to this many constraints, a smallest conflicting set is searched for; beyond, one that contains no smaller one.
_ENUMERABLE: Final = 6

_EPSILON: Final = 1e-9

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Breach:
    """A constraint that a plan does not meet, and why."""

    constraint: Constraint
    because: str

    def __str__(self) -> str:
        return f"`{self.constraint}`: {self.because}"


def in_force(change: Change) -> tuple[Constraint, ...]:
    """The target's constraints, and the start's orders that name a role which the target does not have."""
    target = change.target
    kept = [
        constraint
        for constraint in change.specification.constraints
        if isinstance(constraint, Order)
        and constraint not in target.constraints
        and not (constraint.first in target.nodes and constraint.then in target.nodes)
    ]
    return (*target.constraints, *kept)


def breaches(steps: Sequence[Step], levels: Levels, constraints: Iterable[Constraint]) -> list[Breach]:
    """The constraints that a plan of these steps does not meet, in the order given.

    A functionality that is already below its ``keep`` when the plan begins may stay there, but not degrade further.
    A ``limit`` counts every step during which the functionality is below its baseline.
    """
    asked = tuple(constraints)
    if not asked:
        return []
    monitor, track = ConstraintMonitor.of(levels, asked), list(follow(levels, steps))
    for number, step in enumerate(steps, start=1):
        monitor = monitor.after(number, step, track[number][0])
    found: dict[Constraint, str] = dict(monitor.broken)
    for constraint in asked:
        if isinstance(constraint, Limit):
            if _exceeds(constraint, track[-1][1]):
                seconds = track[-1][1].seconds(constraint.functionality)
                found[constraint] = f"it would be below its baseline for {seconds:.3g} s"
        elif isinstance(constraint, Order):
            late = _out_of_order(constraint, steps)
            if late is not None:
                found[constraint] = late
    return [Breach(constraint, found[constraint]) for constraint in asked if constraint in found]


@dataclass(frozen=True, slots=True)
class ConstraintMonitor:
    """The ``keep`` constraints that the steps of a plan so far have broken, and by which step. An immutable value.

    A broken constraint stays broken, so a planner can abandon a plan as soon as it :meth:`is_doomed`.
    """

    levels: Levels
    keeps: tuple[tuple[Keep, str, int], ...]  # with the role concerned and the worst level allowed
    limits: tuple[Limit, ...]
    broken: Map[Constraint, str] = field(default_factory=Map)

    @classmethod
    def of(cls, levels: Levels, constraints: Iterable[Constraint]) -> ConstraintMonitor:
        """The monitor before the first step. Raises PlanRefused for a ``keep`` at a mode that does not exist."""
        keeps: list[tuple[Keep, str, int]] = []
        limits: list[Limit] = []
        for constraint in constraints:
            if isinstance(constraint, Limit):
                limits.append(constraint)
            elif isinstance(constraint, Keep) and levels.find(ref := constraint.functionality) is not None:
                chain = levels.change.target.component_of(ref.instance).functionalities[ref.functionality]
                try:
                    asked = chain.mode_index(constraint.mode)
                except KeyError:
                    names = ", ".join(mode.name for mode in chain.modes)
                    because = f"{ref} has no mode {constraint.mode}; it has {names}"
                    raise PlanRefused(f"the constraint `{constraint}`: {because}") from None
                keeps.append((constraint, ref.instance, max(asked, levels.level(levels.change.start, ref))))
        return cls(levels, tuple(keeps), tuple(limits))

    def after(self, number: int, step: Step, configuration: Configuration) -> ConstraintMonitor:
        """The monitor after step ``number`` (from 1), which leads to ``configuration``."""
        broken = self.broken
        for keep, role, threshold in self.keeps:
            if role not in step.roles or keep in broken:
                continue
            if self.levels.level(configuration, keep.functionality) > threshold:
                broken = broken.set(keep, f"step {number} ({step.describe()}) takes it below that mode")
        return self if broken is self.broken else replace(self, broken=broken)

    def is_doomed(self, meter: DisruptionMeter) -> bool:
        """Return whether no plan that begins like this meets every ``keep`` and ``limit``; ``meter`` has the same
        steps.
        """
        return bool(self.broken) or any(_exceeds(limit, meter) for limit in self.limits)


def _exceeds(limit: Limit, meter: DisruptionMeter) -> bool:
    return meter.seconds(limit.functionality) > limit.seconds + _EPSILON


def _out_of_order(order: Order, steps: Sequence[Step]) -> str | None:
    """The steps that break an order, in words; a hand-over from one of its roles to the other is of both at once."""
    begun: str | None = None
    for number, step in enumerate(steps, start=1):
        if not step.is_structural:
            continue
        if order.first != order.then and {order.first, order.then} <= {*step.roles}:
            return f"step {number} ({step.describe()}) belongs to both"
        if order.first in step.roles and begun is not None:
            return f"step {number} ({step.describe()}) comes after {begun}"
        if order.then in step.roles:
            begun = f"step {number} ({step.describe()})"
    return None


def layers(roles: Iterable[str], constraints: Iterable[Constraint]) -> list[list[str]] | None:
    """The roles in the order that the ``order`` constraints ask for; None for a cycle."""
    left = sorted(set(roles))
    orders = [c for c in constraints if isinstance(c, Order) and c.first != c.then]
    found: list[list[str]] = []
    while left:
        waiting = {order.then for order in orders if order.first in left}
        ready = [role for role in left if role not in waiting]
        if not ready:
            return None
        found.append(ready)
        left = [role for role in left if role in waiting]
    return found


def conflict(constraints: Sequence[T], can_meet: Callable[[tuple[T, ...]], bool]) -> tuple[T, ...]:
    """A smallest set of ``constraints`` that cannot be met together, given that all of them cannot."""
    if len(constraints) <= _ENUMERABLE:
        for size in range(1, len(constraints)):
            for some in combinations(constraints, size):
                if not can_meet(some):
                    return some
        return tuple(constraints)
    left = list(constraints)
    for constraint in constraints:
        rest = tuple(other for other in left if other != constraint)
        if not can_meet(rest):
            left = list(rest)
    return tuple(left)


def refusal(conflicting: Sequence[Constraint], breaches: Iterable[Breach], scarce: Iterable[str] = ()) -> PlanRefused:
    """The refusal: the constraints in conflict, how the best plan found breaks them, and which resources are scarce."""
    reasons = {breach.constraint: breach.because for breach in breaches}
    words = [f"`{c}`" + (f" ({reasons[c]})" if c in reasons else "") for c in conflicting]
    which = f"the constraint {words[0]}" if len(words) == 1 else f"these constraints together: {'; '.join(words)}"
    because = "".join(f"; {why}" for why in scarce)
    return PlanRefused(f"no plan was found that meets {which}{because}")

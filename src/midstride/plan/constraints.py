"""What the user asks of every plan: ``keep``, ``limit`` and ``order`` (semantics.md section 6)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Constraint, Keep, Limit, Order
from midstride.plan.change import Change
from midstride.plan.disruption import DisruptionMeter, Levels
from midstride.plan.step import Step

# Up to this many constraints, a smallest conflicting set is looked for; beyond, one that has no smaller one in it.
_ENUMERABLE: Final = 6

_EPSILON: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Breach:
    """A constraint that a plan does not meet, and where and how it does not."""

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


def breaches(change: Change, steps: Sequence[Step], levels: Levels, constraints: Iterable[Constraint]) -> list[Breach]:
    """The constraints that a plan of these steps does not meet, in the order given.

    A plan is not blamed for a functionality that stands below its ``keep`` when the plan begins,
    only for taking it lower than it stood. A ``limit`` counts every step during which the functionality is
    below its baseline.
    """
    asked = tuple(constraints)
    if not asked:
        return []
    meter, watch, configuration = DisruptionMeter(levels), ConstraintMonitor(change, levels, asked), change.start
    for step in steps:
        configuration = step.action.effect(configuration)
        meter.step(step.action, step.seconds, configuration)
        watch.note(step, configuration)
    first_breach = dict(watch.broken)
    for constraint in asked:
        if isinstance(constraint, Limit):
            if _exceeds(constraint, meter):
                seconds = meter.seconds(constraint.functionality)
                first_breach[constraint] = f"it would be below its baseline for {seconds:g} s"
        elif isinstance(constraint, Order):
            late = _out_of_order(constraint, steps)
            if late is not None:
                first_breach[constraint] = late
    return [Breach(constraint, first_breach[constraint]) for constraint in asked if constraint in first_breach]


class ConstraintMonitor:
    """Follows a plan in the making, step by step: which ``keep`` is ``broken``, and by which step.

    What is broken stays broken, so that a planner may give up a plan as soon as it :meth:`is_doomed`.
    """

    __slots__ = ("_count", "_keeps", "_levels", "_limits", "broken")

    def __init__(self, change: Change, levels: Levels, constraints: Iterable[Constraint]) -> None:
        asked = tuple(constraints)
        self._levels = levels
        self._keeps = _watched(change, levels, [constraint for constraint in asked if isinstance(constraint, Keep)])
        self._limits = [constraint for constraint in asked if isinstance(constraint, Limit)]
        self._count = 0
        self.broken: dict[Constraint, str] = {}

    def copy(self) -> ConstraintMonitor:
        twin = ConstraintMonitor.__new__(ConstraintMonitor)
        twin._levels, twin._keeps, twin._limits = self._levels, self._keeps, self._limits
        twin._count, twin.broken = self._count, dict(self.broken)
        return twin

    def note(self, step: Step, after: Configuration) -> None:
        """Take note of the next step, which has led to ``after``."""
        self._count += 1
        for keep, role, threshold in self._keeps:
            concerned = role in step.roles and keep not in self.broken
            if concerned and self._levels.level(after, keep.functionality) > threshold:
                self.broken[keep] = f"step {self._count} ({step.describe()}) takes it below"

    def is_doomed(self, meter: DisruptionMeter) -> bool:
        """Whether no plan that begins like this meets each ``keep`` and ``limit``; ``meter`` has followed it too."""
        return bool(self.broken) or any(_exceeds(limit, meter) for limit in self._limits)


def _exceeds(limit: Limit, meter: DisruptionMeter) -> bool:
    return meter.seconds(limit.functionality) > limit.seconds + _EPSILON


def _watched(change: Change, levels: Levels, keeps: Iterable[Keep]) -> list[tuple[Keep, str, int]]:
    watched = []
    for keep in keeps:
        ref = keep.functionality
        if levels.find(ref) is None:
            continue
        chain = change.target.component_of(ref.instance).functionalities[ref.functionality]
        try:
            asked = chain.mode_index(keep.mode)
        except KeyError:
            names = ", ".join(mode.name for mode in chain.modes)
            raise PlanRefused(f"the constraint `{keep}`: {ref} has no mode {keep.mode}; it has {names}") from None
        watched.append((keep, ref.instance, max(asked, levels.level(change.start, ref))))
    return watched


def _out_of_order(order: Order, steps: Sequence[Step]) -> str | None:
    begun: str | None = None
    for number, step in enumerate(steps, start=1):
        if not step.is_structural:
            continue
        if order.first in step.roles and begun is not None:
            return f"step {number} ({step.describe()}) comes after {begun}"
        if order.then in step.roles:
            begun = f"step {number} ({step.describe()})"
    return None


def layers(roles: Iterable[str], constraints: Iterable[Constraint]) -> list[list[str]] | None:
    """The roles in the order that ``order`` constraints ask for, those of one layer in none; None for a cycle."""
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


def conflict(
    constraints: Sequence[Constraint], can_meet: Callable[[tuple[Constraint, ...]], bool]
) -> tuple[Constraint, ...]:
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
    """The refusal that names the constraints in conflict, how the best plan found breaks them, and what is scarce."""
    told = {breach.constraint: breach.because for breach in breaches}
    words = [f"`{c}`" + (f" ({told[c]})" if c in told else "") for c in conflicting]
    which = f"the constraint {words[0]}" if len(words) == 1 else f"these constraints together: {'; '.join(words)}"
    because = "".join(f"; {why}" for why in scarce)
    return PlanRefused(f"no plan was found that meets {which}{because}")


def roles_of(constraint: Constraint) -> tuple[str, ...]:
    """The roles that a constraint names."""
    if isinstance(constraint, Order):
        return (constraint.first, constraint.then)
    ref: FunctionalityRef = constraint.functionality
    return (ref.instance,)

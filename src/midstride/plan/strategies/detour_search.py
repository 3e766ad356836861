"""Strategy ``minimal`` with detours: the best plan of the change itself and of each change with detours.

What a plan with certain detours loses at least, and a plan that loses no more, are found as for any other change. The
bound on all plans is the least of these bounds (docs/decisions/detours.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf
from typing import Final

from midstride.errors import PlanRefused
from midstride.model.specification import Constraint
from midstride.plan.change import Change, Detour
from midstride.plan.constraints import in_force
from midstride.plan.core.core_plan import Budget, search_core
from midstride.plan.core.detours import MOST, describe, further, with_detours
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.minimal import Key, cheapest_along, minimal

# How many states of all the changes with detours together are searched; as many as a change costs in any case.
_STATES: Final = 100_000
_CHANGE: Final = 200
_EPSILON: Final = 1e-6


def minimal_with_detours(change: Change, budget: Budget | None = None) -> Plan:
    """The best plan found, with detours where they make it cheaper; its bound holds for plans with detours too.

    ``budget``: as for :func:`.minimal.minimal`. Raises PlanRefused as that does, unless a detour helps.
    """
    best, refusal = None, None
    try:
        best = minimal(change, budget)
    except PlanRefused as error:
        refusal = error
    least, bound = (inf, inf) if best is None else (best.disruption, best.lower_bound)
    key: Key | None = None
    budget, constraints = budget or Budget(_STATES), in_force(change)
    for changed in _changes(change, constraints) if least else ():
        is_first = len(changed.detours) == 1
        if not (least or is_first):
            break
        if budget.is_used_up(_CHANGE):
            bound = 0.0
            break
        levels = Levels(changed)
        # Of plans with one detour that lose as little, the one that is best otherwise.
        core = search_core(levels, constraints, budget, most=least + (2 * _EPSILON if is_first and key else 0.0))
        bound = min(bound, core.lower_bound)
        found = cheapest_along(core, levels, constraints)
        if found is None or found.breaches:
            continue
        if found.disruption < least - _EPSILON or (is_first and key and found.key < key):
            least, key = found.disruption, found.key
            best = Plan.of("minimal", found.steps, levels, 0.0, found.makespan)
    if best is None:
        assert refusal is not None
        raise refusal
    plan = Plan.of("minimal", best.steps, Levels(best.change), bound, best.makespan)
    return replace(plan, proof_space="detours", remarks=(*describe(best.change), *plan.remarks))


def _changes(change: Change, constraints: Sequence[Constraint]) -> Iterator[Change]:
    """The change with each set of detours that may make it cheaper, those with fewer first."""
    layer, seen = [change], set[frozenset[Detour]]()
    for _ in range(MOST):
        following = []
        for each in layer:
            for detour in further(each, constraints):
                chosen = frozenset((*each.detours, detour))
                if chosen not in seen:
                    seen.add(chosen)
                    following.append(with_detours(each, [detour]))
                    yield following[-1]
        layer = following

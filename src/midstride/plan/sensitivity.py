"""The sensitivity of a plan: is it the best one only if steps take as long as is expected?

Durations are estimates with a spread. With another duration, another order of steps may cost less.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from immutables import Map

from midstride.errors import PlanRefused
from midstride.plan.change import Change
from midstride.plan.core.core_plan import Budget
from midstride.plan.disruption import Levels
from midstride.plan.estimate import Estimate
from midstride.plan.plan import Plan
from midstride.plan.strategies.minimal import minimal

# So many uncertain durations are tried, those with the widest spread first.
TRIED: Final = 4
# Plans that differ by less (as a share of the disruption) are equally good.
_SHARE: Final = 0.01


def sensitivity(plan: Plan) -> str | None:
    """The durations with which another plan would be better, in words; None if none was found.

    Each measured duration that matters is tried at its shortest and its longest, the others as expected.
    """
    if plan.disruption == 0 or plan.strategy != "minimal":
        return None
    budget = Budget()  # for all variations together: a change waits for them
    for what, seconds, estimate, change in _variations(plan):
        try:
            other = minimal(change, budget)
        except PlanRefused:  # with this duration, no plan meets the constraints
            continue
        steps = [replace(step, seconds=change.estimate_of(step.action).seconds) for step in plan.steps]
        own = Plan.of(plan.strategy, steps, Levels(change)).disruption
        if own - other.disruption > _SHARE * own:
            return (
                f"This plan is the best one if `{what}` takes {estimate.seconds:.3g} s, as expected. It has taken "
                f"{seconds:.3g} s: then the disruption would be {own:.3g}, and that of another plan "
                f"{other.disruption:.3g}."
            )
    return None


def _variations(plan: Plan) -> Iterator[tuple[str, float, Estimate, Change]]:
    """Each uncertain duration of a creation or a removal, the value that it has once had, and the change with it."""
    change, keys = plan.change, dict[str, Estimate]()
    for step in plan.steps:
        if step.between is not None and step.action.kind in ("create", "remove"):
            key = f"{step.action.kind} {change.component_of(*step.action.instances()).name}"
            if key in change.measured:
                keys[key] = change.measured[key]
    widest = sorted(keys, key=lambda key: (keys[key].shortest - keys[key].longest, key))
    for key in widest[:TRIED]:
        for seconds in (keys[key].shortest, keys[key].longest):
            measured: Map[str, Estimate] = change.measured.set(key, Estimate.exactly(seconds))
            yield key, seconds, keys[key], replace(change, measured=measured)

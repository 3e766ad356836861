"""The costs of keeping what a plan degrades (docs/semantics.md section 6).

For each functionality that falls, the best plan is sought in which it does not: the same change with one more
constraint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Final

from midstride.codec.form import Form, field
from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Keep
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.registry import planner

# For so many functionalities at most, those that are below for longest first: each takes a search.
TRIED: Final = 8


class Alternative(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """The best plan in which one functionality does not fall below its baseline, or why there is none."""

    functionality: str
    kept_at: Annotated[str, field("a mode", "that of its baseline")]
    disruption: float | None
    degraded: Annotated[list[str], field("a list of functionalities", "that degrade instead")]
    impossible: Annotated[str | None, field("a text", "why no plan keeps it; null where one does")]


def alternatives(plan: Plan) -> list[Alternative]:
    """One for each functionality that falls in a plan of strategy ``minimal``."""
    return list(_alternatives(plan)) if plan.strategy == "minimal" else []


def _alternatives(plan: Plan) -> Iterator[Alternative]:
    levels, change = Levels(plan.change), plan.change.direct or plan.change
    longest = {each.functionality: None for each in sorted(plan.degradations, key=lambda each: -each.seconds)}
    for name in list(longest)[:TRIED]:
        ref = FunctionalityRef.parse(name)
        counted = levels.find(ref)
        modes = change.target.component_of(ref.instance).functionalities[ref.functionality].modes
        if counted is None or counted.baseline >= len(modes):
            continue
        mode = modes[counted.baseline].name
        target = replace(change.target, constraints=(*change.target.constraints, Keep(ref, mode)))
        try:
            plans = planner(plan.strategy, detours=plan.proof_space == "detours")
            other = plans(replace(change, target=target))
        except PlanRefused as error:
            yield Alternative(name, mode, None, [], str(error))
        else:
            yield Alternative(name, mode, other.disruption, [str(each) for each in other.degraded], None)

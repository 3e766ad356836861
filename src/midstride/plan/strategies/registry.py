"""The strategies by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import inf
from typing import Final, TypeAlias

from immutables import Map

from midstride.errors import PlanRefused
from midstride.plan.change import Change
from midstride.plan.core.core_plan import Budget
from midstride.plan.plan import Plan
from midstride.plan.request import require
from midstride.plan.strategies.detour_search import minimal_with_detours
from midstride.plan.strategies.minimal import minimal
from midstride.plan.strategies.paper import paper
from midstride.plan.strategies.quiesce import quiesce
from midstride.plan.strategies.stop import stop

Planner: TypeAlias = Callable[[Change], Plan]

# The tests replay plans of every planner listed here.
STRATEGIES: Final[Mapping[str, Planner]] = Map({"minimal": minimal, "paper": paper, "quiesce": quiesce, "stop": stop})


def planner(name: str = "minimal", within: float | None = None, *, detours: bool = False) -> Planner:
    """The planner of that name. Raises PlanRefused for an unknown one, or one that makes no ``detours``.

    ``within`` is for ``minimal`` alone: from now on, how many seconds it may search for the proof.
    """
    require("strategy", name, STRATEGIES)
    if name != "minimal":
        if detours:
            raise PlanRefused(f"the strategy {name} makes no detours; minimal does")
        return STRATEGIES[name]
    chosen = minimal_with_detours if detours else minimal
    return chosen if within is None else partial(chosen, budget=Budget(inf, within))

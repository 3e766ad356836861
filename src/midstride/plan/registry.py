"""The strategies by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.diagnostics import suggestion
from midstride.plan.change import Change
from midstride.plan.minimal import minimal
from midstride.plan.paper import paper
from midstride.plan.plan import Plan
from midstride.plan.quiesce import quiesce

Planner: TypeAlias = Callable[[Change], Plan]

# A planner that is here is covered by the tests that replay every plan of every strategy.
STRATEGIES: Final[Mapping[str, Planner]] = Map({"minimal": minimal, "paper": paper, "quiesce": quiesce})

DEFAULT: Final = "minimal"


def planner(name: str = DEFAULT) -> Planner:
    """The planner of that name. Raises PlanRefused, naming those there are."""
    found = STRATEGIES.get(name)
    if found is None:
        raise PlanRefused(f"there is no strategy {name}; {suggestion(name, STRATEGIES)}")
    return found

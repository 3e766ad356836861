"""The systems and plans that the tests of `verify` judge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from midstride.lang import load
from midstride.model.specification import Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import planner

EXAMPLES = Path(__file__).parents[2] / "examples"
ROVER = Path(__file__).parent / "rover.stride"
TALKER = EXAMPLES / "talker" / "talker.stride"
# It has a service and a ROS action.
MAPPING = Path(__file__).parents[1] / "lang" / "seeds" / "mapping.stride"

Document = dict[str, Any]


def specification(path: Path) -> Specification:
    return load(path).require()


def plan(start: Specification, strategy: str = "paper", /, **components: str | None) -> Plan:
    """The plan that replaces the roles named by the components they are given, and removes those given none."""
    request = PlanRequest(
        replace=tuple((role, name) for role, name in components.items() if name is not None),
        remove=tuple(role for role, name in components.items() if name is None),
    )
    return planner(strategy)(change_between(initial(start), start, request.target(start)))


def loop(renewed: tuple[str, ...]) -> Plan:
    """Autoware's control loop, with new versions of some of its components."""
    start = specification(EXAMPLES / "autoware_control" / "autoware_control.stride")
    components, roles = start.components, {}
    for role in renewed:
        known = start.component_of(role)
        new = replace(known, name=f"New{known.name}", run="python3 new.py")
        components, roles[role] = components.set(new.name, new), new.name
    return plan(replace(start, components=components), **roles)

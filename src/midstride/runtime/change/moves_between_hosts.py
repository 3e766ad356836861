"""Nodes that a change would move to another host."""

from __future__ import annotations

from midstride.errors import PlanRefused
from midstride.model.action import Create, Handover
from midstride.model.configuration import Configuration
from midstride.model.hosts import host_in_words
from midstride.plan.plan import Plan


def require_no_moves(plan: Plan, configuration: Configuration) -> None:
    """Raises PlanRefused where the outputs or the state of a node would go over to an instance on another host."""
    created = {
        step.action.instance.name: step.action.instance for step in plan.steps if isinstance(step.action, Create)
    }
    instances = {**dict(configuration.instances), **created}
    for step in plan.steps:
        if not isinstance(step.action, Handover):
            continue
        for swap in step.action.swaps:
            old, new = instances[swap.old.instance], instances[swap.new.instance]
            if old.host != new.host:
                raise PlanRefused(
                    f"{old.role} would move from {host_in_words(old.host)} to {host_in_words(new.host)} by a "
                    "hand-over, which is not possible between hosts yet: remove it and add it there, with the gap that "
                    "this has"
                )

"""The time that the removal of a node may take that continues the goals of its ROS actions.

Its successor runs beside it meanwhile (docs/protocols/services.md).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from midstride.model.action import Create, Remove
from midstride.model.component import CANCELLING, ComponentSpec
from midstride.plan.plan import Plan


def with_time_for_goals(plan: Plan, serving: Collection[str] = ()) -> Plan:
    """``plan`` with the longest time of each removal that goals in progress may delay.

    ``serving``: the running instances that are known to serve ROS actions, besides those that declare it.
    """
    change, created, steps = plan.change, set[str](), list(plan.steps)
    for index, step in enumerate(steps):
        match step.action:
            case Create(instance):
                created.add(instance.name)
            case Remove(name) if (new := change.replaced.get(name)) in created:
                old = change.component_of(name)
                serves = name in serving or any(old.kind_of(port) == "action" for port in old.outputs)
                after = change.component_of(new)
                one_kind = (old.preloads and after.preloads) or (old.has_agent and after.has_agent)
                if serves and one_kind:
                    found = change.estimate_of(step.action).at_most(_longest(old))
                    steps[index] = replace(step, between=found.between)
    return replace(plan, steps=tuple(steps))


def _longest(component: ComponentSpec) -> float:
    """The longest time until it has ended (s): its goals and their results, its pending answers, and its process."""
    stop = component.stop_times
    return stop.patience + 3 * CANCELLING + stop.drain + stop.longest

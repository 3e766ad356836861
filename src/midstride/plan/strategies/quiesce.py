"""Strategy ``quiesce``: Kramer and Magee's discipline, for comparison (docs/semantics.md section 6).

As ``paper``, but first everything that the change can reach is degraded to its last mode: every functionality of what
changes, then along output, topic and input every functionality that uses them, and so on.
"""

from __future__ import annotations

from midstride.model.component import FunctionalityRef
from midstride.plan.change import Change
from midstride.plan.plan import Plan
from midstride.plan.strategies.paper import six_steps


def quiesce(change: Change) -> Plan:
    """The quiescent plan. Raises PlanRefused where it does not meet the user's constraints."""
    return six_steps("quiesce", change, reachable(change))


def reachable(change: Change) -> list[FunctionalityRef]:
    """The functionalities live at the start that the change can reach, sorted."""
    configuration = change.start
    found: dict[FunctionalityRef, None] = {}
    for name in change.leaving:
        found.update(dict.fromkeys(configuration.instances[name].functionality_refs()))
    for port, connector in (*change.detached, *change.attached):
        component = change.component_of(port.instance)
        if port.instance in configuration.instances:
            owners = component.users(port.port) if port.port in component.inputs else [component.owner(port.port)]
            found.update(dict.fromkeys(FunctionalityRef(port.instance, owner.name) for owner in owners))
        if component.has_output(port.port):
            found.update(dict.fromkeys(configuration.consumers(connector)))
    pending = list(found)
    while pending:
        ref = pending.pop()
        for consumer in configuration.downstream(ref):
            if consumer not in found:
                found[consumer] = None
                pending.append(consumer)
    return sorted(found)

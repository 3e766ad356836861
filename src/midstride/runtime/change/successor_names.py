"""The name of a replacement's ROS node, and for how long its services are gone, as plan and report say it.

A replacement has the name of the node that it replaces where one of the two answers while both run, or the old one ends
first (docs/protocols/foreign.md). Where neither is so, what knows the old node by its name no longer reaches anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from midstride.model.action import Create, Remove
from midstride.model.configuration import Instance
from midstride.model.instance_names import full_name
from midstride.plan.expected_losses import planned_instances
from midstride.plan.plan import Plan
from midstride.runtime.backend_protocol import RELAY_SUFFIX
from midstride.runtime.instance_life import LatestState
from midstride.runtime.records.reports import StepTime
from midstride.verdicts import change_facts
from midstride.verdicts.assessment import Assessment
from midstride.wire.state import ComponentState


def names_after(plan: Plan, states: Mapping[str, LatestState]) -> Iterator[Assessment]:
    """Assess which names of nodes ``plan`` changes. ``states``: the last reports of the nodes that it removes."""
    created, removed = steps_of_instances(plan)
    for old, new, state in _pairs(plan, states):
        old_first = removed[old.name] < created[new.name]
        changed = _another_name(old, new, state, old_first=old_first, planned=True)
        if changed is not None:
            yield changed
        elif old_first:
            seconds = sum(step.seconds for step in plan.steps[removed[old.name] : created[new.name] + 1])
            yield change_facts.unanswered_meanwhile(
                old.name, _node_of(old, state), new.name, seconds, planned=True, serves=_serves_at_once(new)
            )


def names_now(plan: Plan, states: Mapping[str, LatestState], times: Mapping[int, StepTime]) -> Iterator[Assessment]:
    """Assess what became of the names of nodes in a change that is done.

    ``times``: by step, from 1, when it was carried out.
    """
    created, removed = steps_of_instances(plan)
    for old, new, state in _pairs(plan, states):
        up, end = (times.get(steps[name] + 1) for steps, name in ((created, new.name), (removed, old.name)))
        if up is None or end is None:
            continue
        old_first = removed[old.name] < created[new.name]
        changed = _another_name(old, new, state, old_first=old_first, planned=False)
        if changed is not None:
            yield changed
        elif old_first:
            seconds = up.began + up.seconds - end.began
            yield change_facts.unanswered_meanwhile(
                old.name, _node_of(old, state), new.name, seconds, planned=False, serves=_serves_at_once(new)
            )


def steps_of_instances(plan: Plan) -> tuple[dict[str, int], dict[str, int]]:
    """By instance, the index of the step that creates it, and of the one that removes it."""
    created, removed = dict[str, int](), dict[str, int]()
    for index, step in enumerate(plan.steps):
        match step.action:
            case Create(instance):
                created[instance.name] = index
            case Remove(name):
                removed[name] = index
    return created, removed


def _pairs(plan: Plan, states: Mapping[str, LatestState]) -> Iterator[tuple[Instance, Instance, ComponentState]]:
    """The instances that are exchanged, one of which has no API, with what the old one has reported last."""
    created, removed = steps_of_instances(plan)
    instances = planned_instances(plan)
    for name, successor in sorted(plan.change.replaced.items()):
        if name not in removed or successor not in created or (latest := states.get(name)) is None:
            continue
        old, new = instances[name], instances[successor]
        if latest.state.node and any(each.component.gate is not None for each in (old, new)):
            yield old, new, latest.state


def _serves_at_once(new: Instance) -> bool:
    """Return whether its services are there once it is started: its endpoints, or its lifecycle state, are waited for.

    Of any other node it is only known that its process runs.
    """
    return bool(new.component.ports()) and (new.component.counts_messages or new.component.has_lifecycle)


def _node_of(instance: Instance, state: ComponentState) -> str:
    """The full name of its node; behind a relay, of that of its program, which has the name of the instance."""
    node = state.node or full_name(instance.name)
    return node.removesuffix(RELAY_SUFFIX) if instance.component.gate == "relay" else node


def _another_name(
    old: Instance, new: Instance, state: ComponentState, *, old_first: bool, planned: bool
) -> Assessment | None:
    """Assess a replacement of another name; None where it has the name of the old one, or names its node itself.

    A component with the API has the name of its role.
    """
    before, after = _node_of(old, state), full_name(new.role)
    both = old.component.loads_library and new.component.loads_library
    inside = bool(old.process) and old.process == new.process  # where no two nodes have one name
    if not old_first and both and state.keeps_name and not inside:
        return None
    if new.component.unnamed:
        return None if old_first else change_facts.another_name(old.name, before, None, planned=planned)
    if new.component.gate == "relay" or (not old_first and before == after and new.component.gate is not None):
        after = full_name(new.name)
    return None if before == after else change_facts.another_name(old.name, before, after, planned=planned)

"""Whatever ends, or is written twice, with an instance that is ended: its services, its calls, its topics without a
port.

Of a node without the API, the graph shows these; a component with the API has named them when it registered.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

from immutables import Map
from msgspec import structs

from midstride.model.action import Create, Remove
from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration
from midstride.plan.expected_losses import planned_instances
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LatestState
from midstride.runtime.process.launcher import LastKnown
from midstride.verdicts import assessment, change_facts
from midstride.verdicts.assessment import Assessment
from midstride.wire.state import NOT_WELCOMED, ComponentState, Endpoint

# How the words for a ROS action begin.
ACTION: Final = "ROS action "


def lost_endpoints(
    plan: Plan,
    states: Mapping[str, LatestState],
    endpoints: Mapping[str, Sequence[Endpoint]],
    unseen: str = "it had just been started",
) -> Iterator[Assessment]:
    """Assess which services, calls and topics ``plan`` is expected to end.

    ``states``: the last reports of the nodes that it removes; ``endpoints``: what they have besides ports. ``unseen``:
    why the graph has shown nothing of a node.
    """
    created: dict[str, ComponentSpec] = {}
    for step in plan.steps:
        match step.action:
            case Create(instance):
                created[instance.role] = instance.component
            case Remove(name):
                found, role = plan.change.instance(name), plan.change.role_of(name)
                known = LastKnown(states.get(name), endpoints.get(name, ()))
                beside = created.get(role)
                yield from _goals_of_ports(plan, name, found.component, beside)
                yield from what_ended(name, found.component, known, planned=True, new=unseen, beside=beside)
                if beside is not None:
                    yield from two_writers(role, known, found.component, beside)


def _goals_of_ports(
    plan: Plan, name: str, component: ComponentSpec, beside: ComponentSpec | None
) -> Iterator[Assessment]:
    """The ROS actions whose servers are ports of the instance ``name``, where both have the API, or a relay.

    A stand-in, which the plan itself creates, has accepted none when it is planned.
    """
    start = plan.change.start
    if name in start.instances and component.has_agent and beside is not None and beside.has_agent:
        attached = start.attached_ports(name)
        kinds = {port: component.kind_of(port) for port in component.outputs}
        if actions := sorted(f"{ACTION}{served}" for port, served in attached if kinds.get(port.port) == "action"):
            yield change_facts.goals_go_on(name, actions, component.stop_times.patience)


def unseen_endpoints(plan: Plan) -> Iterator[Assessment]:
    """Assess what ``plan`` may end of a system that does not run: only the graph shows what a node has besides its
    ports.
    """
    yield from lost_endpoints(plan, {}, {}, "its services, ROS actions and calls are known once it runs")
    for step in plan.steps:
        if isinstance(step.action, Remove):
            component = plan.change.instance(step.action.instance).component
            if allowed := [f"{each.kind} {each.name}" for each in component.allows if each.kind != "topic"]:
                words = f"it may have {assessment.listed(allowed)}, which nothing hands over"
                yield change_facts.not_looked_at(step.action.instance, words)


def endpoints_that_ended(
    plan: Plan,
    ended_instances: Mapping[str, LastKnown],
    states: Mapping[str, LatestState],
    together: Mapping[str, float],
    offers: Mapping[str, Collection[str]] = Map(),
) -> Iterator[Assessment]:
    """Assess what has ended with ``ended_instances`` while ``plan`` was carried out, also with those that it had
    created.

    ``states``: what was known when it began; ``together``: for how long both instances of a role ran (s), by role;
    ``offers``: the services and ROS actions of those that run now (in words), by instance, where they are known.
    """
    instances = [step.action.instance for step in plan.steps if isinstance(step.action, Create)]
    created = {instance.role: instance.component for instance in instances}
    seen = {instance.role: offers.get(instance.name) for instance in instances}
    for name, instance in planned_instances(plan).items():
        if (known := ended_instances.get(name)) is None:
            continue
        start = plan.change.start
        spare = name not in start.instances and bool(start.instances_of(instance.role)) and not _accepted(known)
        beside = created.get(instance.role) if instance.role in together else None
        known_now = _as_planned(known, states.get(name))
        found = seen.get(instance.role)
        yield from what_ended(
            name, instance.component, known_now, planned=False, beside=beside, offers=found, spare=spare
        )
        if instance.role in created and instance.role in together:
            old, new = instance.component, created[instance.role]
            yield from two_writers(instance.role, known, old, new, together[instance.role])


def _as_planned(known: LastKnown, before: LatestState | None) -> LastKnown:
    """``known`` without what the plan itself has started: it was known before whether another one manages the node."""
    if known.latest is None or before is None:
        return known
    state = known.latest.state
    starting = [name for name in state.starting if name in before.state.starting]
    return replace(known, latest=LatestState(structs.replace(state, starting=starting), known.latest.at))


def _accepted(known: LastKnown) -> bool:
    """Return whether a manager has accepted an instance, as far as is known."""
    return known.latest is not None and known.latest.state.waiting != NOT_WELCOMED


def what_ended(
    name: str,
    component: ComponentSpec,
    known: LastKnown,
    *,
    planned: bool,
    new: str = "it had just been started",
    beside: ComponentSpec | None = None,
    offers: Collection[str] | None = None,
    spare: bool = False,
) -> Iterator[Assessment]:
    """Assess what ends, or has ended, with the instance ``name``, of which no more than ``known`` is known.

    ``new``: why the graph has shown nothing of it yet. ``beside``: that of its successor, where that ran beside it. Of
    two nodes with the library in their processes, the successor takes over each service and ROS action; where it has
    another name, not with those below the old one. Where one of the two has the API, it takes over each service. Of
    these, those count that it ``offers``, in words; None: that is not known. The old one finishes the goals that it
    has accepted, as does a component with the API beside another one. ``spare``: no manager has accepted it, and
    another instance of its role runs: that answers, as long as something holds this one back, so it ends with no more
    than what it has called.
    """
    own, state = known.endpoints, None if known.latest is None else known.latest.state
    called = [f"{each.kind} {each.name}" for each in own if each.kind != "topic" and not each.serves]
    if spare and (component.gate is None or component.preloads):
        if called := [*called, *(() if state is None else state.calls)]:
            yield change_facts.calls_end_with(name, called, planned=planned)
        return
    if component.gate == "relay":  # which answers for its program, and not of it
        because = "it is behind a relay, which passes on its messages and the requests to its declared servers alone"
        if beside is not None:
            verb, may = ("answers", "may be") if planned else ("answered", "may have been")
            because += f"; each of the two {verb} the other services that both have, so a request {may} handled twice"
        yield change_facts.not_looked_at(name, because)
    elif component.gate is not None and not component.once and (state is None or not state.looked):
        yield change_facts.not_looked_at(name, new)
    if goals := [f"ROS action {each.name}" for each in own if each.kind == "ROS action" and each.serves]:
        if component.gate is not None or beside is None or beside.gate is not None:
            yield change_facts.goals_end_with(name, goals, planned=planned)
        elif planned:
            yield change_facts.goals_go_on(name, goals, component.stop_times.patience)
    both = [f"service {each.name}" for each in own if each.kind == "service" and each.serves]
    if both and beside is not None and component.gate is None and beside.gate is not None:
        if beside.preloads:
            yield from _gone_on_with(name, both, offers, planned=planned)
        else:
            yield change_facts.answered_by_both(name, both, planned=planned)
    if state is not None:
        if state.starting:
            yield change_facts.management_unknown(name, state.starting, planned=planned)
        shared = [] if beside is None else shared_services(state)
        hands_over = _hands_over(state, component, beside)
        actions = [] if beside is None or beside.gate is None else shared_actions(state)
        goes_on = [*shared, *actions] if hands_over else []
        if shared and not goes_on and component.gate is not None:
            yield change_facts.answered_by_both(name, shared, planned=planned)
        if goes_on and actions and planned:
            yield change_facts.goals_go_on(name, actions, component.stop_times.patience)
        ending = [each.words for each in state.serves if each.words not in goes_on]
        keeps = hands_over and state.keeps_name and beside is not None and beside.loads_library
        if state.lifecycle_callers and not keeps:
            ending.append(f"each of its lifecycle services (called by {assessment.listed(state.lifecycle_callers)})")
        if ending:
            yield change_facts.ends_with(name, ending, planned=planned)
        if goes_on and beside is not None and beside.name != component.name:
            yield from _gone_on_with(name, goes_on, offers, planned=planned)
        called += state.calls
    if called:
        yield change_facts.calls_end_with(name, called, planned=planned)


def _gone_on_with(
    name: str, served: Sequence[str], offers: Collection[str] | None, *, planned: bool
) -> Iterator[Assessment]:
    """Assess what a successor takes over: what it lacks, where it is known what it ``offers``."""
    if offers is None:
        yield change_facts.answered_if_offered(name, served, planned=planned)
    elif lacking := [each for each in served if each not in offers]:
        yield change_facts.not_offered(name, lacking)


def _hands_over(state: ComponentState, old: ComponentSpec, new: ComponentSpec | None) -> bool:
    """Return whether the library hands over the requests of a node in ``state`` to its successor.

    The successor has the library too, or the API. Where the library is loaded for the services alone, a node runs also
    if its program is one that it has no effect on.
    """
    shares = new is not None and (new.loads_library or new.gate is None)
    return shares and old.loads_library and (old.preloads or state.keeps_name)


def offered(states: Mapping[str, LatestState], configuration: Configuration) -> dict[str, list[str]]:
    """Return, by instance, the services and ROS actions of the nodes with the library, in words, as the graph has shown
    them.

    ``states``: their last reports. Of a node of which the graph has shown nothing they are not known. A component with
    the API says which ones it has as it registers, not later.
    """
    return {
        name: [each.words for each in latest.state.serves]
        for name, latest in states.items()
        if (instance := configuration.instances.get(name)) and instance.component.loads_library
        if latest.state.looked and latest.state.shown
    }


def shared_services(state: ComponentState) -> list[str]:
    """Return the services of a node (in words) that its replacement may have: all, or those without its name."""
    return [each.words for each in _shared(state) if each.kind == "service"]


def shared_actions(state: ComponentState) -> list[str]:
    """Return the ROS actions of a node (in words) that its replacement may have, as its services."""
    return [each.words for each in _shared(state) if each.kind == "ROS action"]


def _shared(state: ComponentState) -> list[Endpoint]:
    return [each for each in state.serves if state.keeps_name or not each.name.startswith(f"{state.node}/")]


def with_goals(states: Mapping[str, LatestState], endpoints: Mapping[str, Sequence[Endpoint]]) -> set[str]:
    """Return the instances whose goals of ROS actions go on beside their replacement.

    ``states``: their last reports; ``endpoints``: what they have besides ports.
    """
    own = {name for name, found in endpoints.items() if any(e.kind == "ROS action" and e.serves for e in found)}
    return own | {name for name, latest in states.items() if shared_actions(latest.state)}


def answered_in_turn(plan: Plan, states: Mapping[str, LatestState]) -> Iterator[str]:
    """The moment at which the replacement of a node with the library begins to answer requests, in words.

    ``states``: the last reports of the nodes that ``plan`` removes.
    """
    for old, new in plan.change.replaced.items():
        before, after = plan.change.component_of(old), plan.change.component_of(new)
        latest = states.get(old)
        if latest is None or not _hands_over(latest.state, before, after):
            continue
        if shared := shared_services(latest.state):
            drain = before.stop_times.drain
            yield (
                f"{new} answers {assessment.listed(shared)} once {old} has answered the requests that it has taken, "
                f"after {drain:g} s (`drain`) at the latest"
            )


def messages_in_turn(plan: Plan, states: Mapping[str, LatestState]) -> Iterator[str]:
    """The way in which the messages that a plain node answers are shared with its replacement, in words.

    ``states``: the last reports of the nodes that ``plan`` removes.
    """
    for old, new in plan.change.replaced.items():
        before, after = plan.change.component_of(old), plan.change.component_of(new)
        latest = states.get(old)
        if latest is None or not (before.preloads and after.preloads):
            continue
        if latest.state.keeps_state:  # neither publishes while it moves
            continue
        links = [
            link
            for port, attached in latest.state.ports.items()
            if before.has_output(port) and (owner := before.find_owner(port)) is not None and owner.inputs
            for link in attached.values()
            if link.by_input is not None and link.count
        ]
        if not links:
            continue
        if all(link.by_input for link in links):
            yield (
                f"each message that {old} answers is answered by one of {old} and {new}, if {new} is seen to answer "
                "each as well, behind its gate"
            )
        else:
            yield (
                f"a message may be answered by both {old} and {new}, or by neither: {old} is not seen to publish one "
                "message for each that it takes, in the thread that has taken it"
            )


def two_writers(
    role: str, known: LastKnown, old: ComponentSpec, new: ComponentSpec, together: float | None = None
) -> Iterator[Assessment]:
    """The topics without a port on which two instances of ``role`` write, or could, while both run.

    Where both have the preloaded library, these are what it does not hand over. A component with the API hands over its
    own topics to none without it, and does not say which of them it writes on.
    """
    if old.gate is None and new.gate is not None and (own := [e.name for e in known.endpoints if e.kind == "topic"]):
        yield change_facts.two_writers(role, own, together, publishes=False)
    if known.latest is None:
        return
    state, handed_over = known.latest.state, old.preloads and new.preloads
    written = [each.topic for each in state.undeclared if each.output and not (each.handed_over and handed_over)]
    one_name = state.keeps_name and old.loads_library and new.loads_library
    if shared := [topic for topic in written if one_name or not topic.startswith(f"{state.node}/")]:
        yield change_facts.two_writers(role, shared, together)

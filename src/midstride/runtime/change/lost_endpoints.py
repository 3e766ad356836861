"""What ends, or is written twice, with a node that a plan removes: its services, its goals, its topics without a port.

Of a node without the API, the graph shows these; a component with the API has named them when it registered.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from midstride import verdicts
from midstride.model.action import Create, Remove
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LatestState
from midstride.wire.state import Endpoint


def lost_endpoints(
    plan: Plan,
    states: Mapping[str, LatestState],
    endpoints: Mapping[str, Sequence[Endpoint]],
    together: Mapping[str, float] | None = None,
) -> Iterator[verdicts.Assessment]:
    """``states``: the last reports of the nodes that ``plan`` removes; ``endpoints``: what they have besides ports.

    ``together``: for how long both instances of a role ran (s), by role, once the plan was carried out.
    """
    created: set[str] = set()
    planned = together is None
    for step in plan.steps:
        match step.action:
            case Create(instance):
                created.add(instance.role)
            case Remove(name):
                own = endpoints.get(name, ())
                if plan.change.instance(name).component.gate == "relay":  # which answers for its program, and not of it
                    yield verdicts.not_looked_at(name, "it is behind a relay")
                if goals := [f"ROS action {each.name}" for each in own if each.kind == "ROS action" and each.serves]:
                    yield verdicts.goals_end_with(name, goals, planned=planned)
                called = [f"ROS action {each.name}" for each in own if each.kind == "ROS action" and not each.serves]
                latest, role = states.get(name), plan.change.role_of(name)
                if latest is not None:
                    called += latest.state.calls
                    yield from _of_foreign(latest, role if role in created else None, together)
                if called:
                    yield verdicts.results_end_with(name, called, planned=planned)


def _of_foreign(
    latest: LatestState, role: str | None, together: Mapping[str, float] | None
) -> Iterator[verdicts.Assessment]:
    """``role``: that of a node which is replaced; None if it only ends."""
    state = latest.state
    if not state.looked:
        yield verdicts.not_looked_at(state.instance, "it had just been started")
    if state.serves:
        yield verdicts.ends_with(state.instance, state.serves, planned=together is None)
    written = [each.topic for each in state.undeclared if each.output]
    if role is not None and (shared := [topic for topic in written if not topic.startswith(f"{state.node}/")]):
        yield verdicts.two_writers(role, shared, None if together is None else together.get(role))

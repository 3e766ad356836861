"""What ends, or is written twice, with a node without the API that a plan replaces: as the graph shows the node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from midstride import verdicts
from midstride.model.action import Create, Remove
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LatestState

_PUBLISHES = "publishes on "


def foreign_losses(
    plan: Plan, states: Mapping[str, LatestState], together: Mapping[str, float] | None = None
) -> Iterator[verdicts.Assessment]:
    """``states``: the last reports of the nodes that ``plan`` removes.

    ``together``: for how long both instances of a role ran (s), by role, once the plan was carried out.
    """
    created: set[str] = set()
    for step in plan.steps:
        match step.action:
            case Create(instance):
                created.add(instance.role)
            case Remove(name):
                latest, role = states.get(name), plan.change.role_of(name)
                if latest is None:
                    continue
                if latest.state.serves:
                    yield verdicts.ends_with(name, latest.state.serves, planned=together is None)
                own = f"{latest.state.node}/"
                written = [
                    words.removeprefix(_PUBLISHES).split()[0]
                    for words in latest.state.undeclared
                    if words.startswith(_PUBLISHES)
                ]
                if role in created and (shared := [topic for topic in written if not topic.startswith(own)]):
                    yield verdicts.two_writers(role, shared, None if together is None else together.get(role))

"""The services and ROS actions that the services in ROS's graph belong to: an action has three of them, and topics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from midstride.foreign.graph_check import NamedServer

# Between the name of a ROS action and those of its services.
ACTION: Final = "/_action/"
# What the type of the service that takes the goals of a ROS action ends with.
_SEND_GOAL: Final = "_SendGoal"


def named_servers(listed: Iterable[tuple[str, Sequence[str]]]) -> set[NamedServer]:
    """The services and ROS actions of these services, which the graph lists by full name with their types."""
    found: set[NamedServer] = set()
    for name, types in listed:
        action, _, part = name.partition(ACTION)
        if not part:
            found.update(NamedServer("service", name, type_) for type_ in types)
            continue
        goals = (type_ for type_ in types if type_.endswith(_SEND_GOAL))
        found.update(NamedServer("action", action, type_.removesuffix(_SEND_GOAL)) for type_ in goals)
    return found

"""Which topics are ROS's own: nearly every node has them, and they belong to no port."""

from __future__ import annotations

from typing import Final

_EVERYWHERE: Final = frozenset({"/rosout", "/parameter_events"})
_OF_LIFECYCLE: Final = "/transition_event"


def is_infrastructure(topic: str, *, output: bool) -> bool:
    """Whether a publisher (``output``) or a subscription of ``topic`` (a full name) is for logs, parameters, the clock,
    lifecycle or ROS actions."""
    clock = topic == "/clock" and not output
    return "/_" in topic or clock or topic in _EVERYWHERE or topic.endswith(_OF_LIFECYCLE)

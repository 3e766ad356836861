"""Names of topics and services in ROS's graph: in full, and which topics are ROS's own, so that no port has them."""

from __future__ import annotations

from typing import Final

_EVERYWHERE: Final = frozenset({"/rosout", "/parameter_events"})
_OF_LIFECYCLE: Final = "/transition_event"
# What lifecycle managers and their nodes say on it is that each other runs (Nav2, bond).
_BOND: Final = "/bond"


def is_infrastructure(topic: str, *, output: bool) -> bool:
    """Whether a publisher (``output``) or a subscription of ``topic`` (a full name) is for logs, parameters, the clock,
    lifecycle, the bonds of lifecycle managers or ROS actions."""
    clock = topic == "/clock" and not output
    return "/_" in topic or clock or topic in _EVERYWHERE or topic.endswith((_OF_LIFECYCLE, _BOND))


def resolved(name: str, node: str) -> str:
    """The full name of a topic or service that ``node`` names.

    ``~/reset`` of the node ``/detector`` is ``/detector/reset``; a relative name is in the node's namespace.
    """
    node = node if node.startswith("/") else f"/{node}"
    if name.startswith("~"):
        return f"{node}/{name.lstrip('~/')}"
    return name if name.startswith("/") else f"{node.rpartition('/')[0]}/{name}"

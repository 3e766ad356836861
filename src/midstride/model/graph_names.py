"""Names of topics and services in ROS's graph: in full, and which of them are ROS's own, so that no port has them."""

from __future__ import annotations

from typing import Final

_EVERYWHERE: Final = frozenset({"/rosout", "/parameter_events"})
_OF_LIFECYCLE: Final = "/transition_event"
# What lifecycle managers and their nodes say on it is that each other runs (Nav2, bond).
_BOND: Final = "/bond"
# The packages of the services that ROS itself gives nodes: parameters, lifecycle, types, log levels.
OF_PARAMETERS: Final = "rcl_interfaces/"
_OF_EVERY_NODE: Final = (OF_PARAMETERS, "lifecycle_msgs/", "type_description_interfaces/", "logging_interfaces/")


def is_infrastructure(topic: str, *, output: bool) -> bool:
    """Return whether a publisher (``output``) or a subscription of ``topic`` (a full name) belongs to ROS itself.

    That is for logs, parameters, the clock, lifecycle, the bonds of lifecycle managers or ROS actions.
    """
    clock = topic == "/clock" and not output
    return "/_" in topic or clock or topic in _EVERYWHERE or topic.endswith((_OF_LIFECYCLE, _BOND))


def is_of_every_node(service: str, type_: str, node: str | None = None) -> bool:
    """Return whether ROS itself gives ``node`` a service (a full name): for its parameters, lifecycle, types or log
    levels.

    Without ``node``, of any node: then the service has the name that ROS gives it, which is that of its type.
    """
    if node is None:
        own = service.rpartition("/")[2].replace("_", "") == type_.rpartition("/")[2].lower()
    else:
        own = service.startswith(f"{node}/")
    return own and type_.startswith(_OF_EVERY_NODE)


def resolved(name: str, node: str) -> str:
    """The full name of a topic or service that ``node`` names.

    ``~/reset`` of the node ``/detector`` is ``/detector/reset``; a relative name is in the node's namespace.
    """
    node = node if node.startswith("/") else f"/{node}"
    if name.startswith("~"):
        return f"{node}/{name.lstrip('~/')}"
    return name if name.startswith("/") else f"{node.rpartition('/')[0]}/{name}"

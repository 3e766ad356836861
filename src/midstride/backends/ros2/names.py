"""Names of nodes, topics and parameters."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

PARAMETER_EVENTS: Final = "/parameter_events"
# Topics that every node has, and that belong to no port.
OF_EVERY_NODE: Final = frozenset({PARAMETER_EVENTS, "/rosout"})
# What a component's state is shown under, and its parameter with the whole of it, as JSON.
PREFIX: Final = "midstride."
STATE: Final = PREFIX + "state"


_CONTROL: Final = re.compile(r"(.*/)_(\w+?)_control(?:_([0-9a-f]{8})_of_(\w+))?\Z")


class InstanceNode(NamedTuple):
    """The full names of an instance and of its node. ``system`` is empty where it was started by hand."""

    instance: str
    node: str
    system: str


def system_tag(token: str) -> str:
    """The mark that distinguishes the instances of one system from those of others; the token itself is not public."""
    return hashlib.sha256(token.encode()).hexdigest()[:8] if token else ""


def control(instance: str, node: str, system: str) -> str:
    """The hidden node beside ``node``, in the process of ``instance``: the one name there that is the instance's."""
    return f"_{instance}_control" + (f"_{system}_of_{node}" if system else "")


def controlled(full_name: str) -> InstanceNode | None:
    """The instance whose control node has that full name; None for any other node."""
    if (found := _CONTROL.match(full_name)) is None:
        return None
    inside, instance, system, node = found.groups()
    return InstanceNode(inside + instance, inside + (node or instance), system or "")


def instances_of(node: str, in_graph: Iterable[str], system: str) -> int:
    """Count the instances of the role with the node ``node`` among the nodes of the graph; one of them answers.

    One that was started by hand may belong to any system, as may all if ``system`` is empty. One that has ended may
    still be in the graph beside another of its name: each has a node ``node``, so each counts.
    """
    found = [seen for name in in_graph if (seen := controlled(name)) is not None and seen.node == node]
    return sum(not system or each.system in ("", system) for each in found)


def enclave_of(tag: str, instance: str) -> str:
    """The enclave of the process of an instance; ``tag`` is that of its system (:func:`system_tag`)."""
    return f"{_enclaves(tag)}{instance.strip('/')}"


def _enclaves(tag: str) -> str:
    return f"/midstride/s{tag}/"


def outside(node: str, in_graph: Iterable[tuple[str, str]], system: str) -> int:
    """Count the nodes of the graph, each with its enclave, that have that name and are not started by ``system``.

    A node without Midstride's API whose program names it itself has an enclave of the system.
    """
    return sum(name == node and not (system and inside.startswith(_enclaves(system))) for name, inside in in_graph)


def is_hidden(full_name: str) -> bool:
    """Return whether ROS's tools leave the node out: a part of its name starts with an underscore."""
    return "/_" in full_name


def service_name(node: Any, service: Any) -> str:
    """The full name of a server or client of ``node``, remappings applied, which rclpy of Humble does not keep."""
    name = getattr(service, "service_name", None)
    return str(name) if name else str(node.resolve_service_name(service.srv_name))

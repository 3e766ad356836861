"""Names of nodes and topics, the same on either ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from midstride.model.component import ComponentSpec
from midstride.model.graph_names import resolved

# Where ROS's tools expect diagnostics.
DIAGNOSTICS: Final = "/diagnostics"


def split(instance: str, namespace: str = "") -> tuple[str, str]:
    """The name and the namespace of an instance's node; ``namespace`` counts where ``instance`` states none."""
    own, _, name = instance.strip("/").rpartition("/")
    inside = (own or namespace).strip("/")
    return name, f"/{inside}" if inside else "/"


def full(instance: str, namespace: str = "") -> str:
    """The full name of an instance's node: ``/front/camera``."""
    name, inside = split(instance, namespace)
    return f"{inside.rstrip('/')}/{name}"


def topics_of(component: ComponentSpec, node: str, attached: Mapping[str, str]) -> dict[str, str]:
    """By port, the full name of the topic that a program without Midstride's API uses; ``attached``: of those that are.

    ``node`` is the full name of its node.
    """
    return {port: attached.get(port) or resolved(component.topic_of(port), node) for port in component.ports()}

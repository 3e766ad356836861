"""Names of topics, the same on either ROS. Those of nodes are in :mod:`midstride.model.instance_names`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from midstride.model.component import ComponentSpec
from midstride.model.graph_names import resolved

# Where ROS's tools expect diagnostics.
DIAGNOSTICS: Final = "/diagnostics"


def topics_of(component: ComponentSpec, node: str, attached: Mapping[str, str]) -> dict[str, str]:
    """By port, the full name of the topic that a program without Midstride's API uses; ``attached``: of those that are.

    ``node`` is the full name of its node.
    """
    return {port: attached.get(port) or resolved(component.topic_of(port), node) for port in component.ports()}

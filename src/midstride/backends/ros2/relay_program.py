"""The process of a relay on ROS 2 (:mod:`midstride.foreign.relay`); its argument is the file of its order."""

from __future__ import annotations

import sys
from pathlib import Path

from midstride.backends.ros2.endpoints import message_class, serialized
from midstride.backends.ros2.graph import Graph
from midstride.errors import NodeError
from midstride.foreign.relay import RelayOrder, run_relay


def type_of(name: str) -> type:
    """Raises NodeError where the message type is not installed."""
    try:
        return serialized(message_class(name))
    except (ImportError, AttributeError):
        raise NodeError(f"the message type {name} is not installed for {sys.executable}") from None


def main() -> None:
    order = RelayOrder.read(Path(sys.argv[1]))
    run_relay(order, type_of, lambda host: Graph(host.ros_node).of_process(order.node))


if __name__ == "__main__":
    main()

"""Joining ROS 2 before the component is known, as a spare does: a context with a hidden node, which keeps it joined.

A second node of a process that has joined is found by others within 15 ms or so; a process that has yet to join, after
0.3 s and more, the more the others are.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

_node: Node | None = None


def hidden_node(name: str, make: Callable[..., Node] = Node, **options: Any) -> Any:
    """A node without parameters, services and topics, made by ``make`` with further ``options``."""
    return make(
        name,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
        **options,
    )


def join() -> None:
    """Not as the default context, which the program may want to initialize itself."""
    global _node
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    _node = hidden_node(f"_midstride_spare_{os.getpid()}", context=context)


def become_default() -> bool:
    """Make the context that has joined, if there is one, rclpy's default one; returns whether there is one."""
    if _node is None:
        return False
    rclpy.utilities.g_default_context = _node.context
    return True


def leave() -> None:
    """Remove the hidden node: another node of the context keeps it joined. A context that is not used ends."""
    global _node
    if _node is None:
        return
    node, _node = _node, None
    context: Any = node.context
    node.destroy_node()
    if context is not rclpy.utilities.get_default_context():
        context.try_shutdown()

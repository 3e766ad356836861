"""Midstride: replace the components of a running ROS system, with the least functionality lost on the way.

A node author needs what is named here and nothing else::

    from midstride import Component

The names are imported when they are first used, so that the command line, which needs none of them,
does not wait for them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from midstride.errors import MidstrideError, NodeError, Unanswered
    from midstride.model.contract import QoS
    from midstride.node.author.client_ports import ActionClientPort, ClientPort
    from midstride.node.author.component_class import Component
    from midstride.node.author.declared_contracts import at_least, at_most, between, guarantee
    from midstride.node.author.declared_parameters import Parameter
    from midstride.node.author.functionality import Functionality
    from midstride.node.author.modes import approximate
    from midstride.node.author.ports import Input, Output, any_of
    from midstride.node.author.server_ports import ActionServerPort, ServerPort
    from midstride.wire.state import Measured

    __version__: str

__all__ = [
    "ActionClientPort",
    "ActionServerPort",
    "ClientPort",
    "Component",
    "Functionality",
    "Input",
    "Measured",
    "MidstrideError",
    "NodeError",
    "Output",
    "Parameter",
    "QoS",
    "ServerPort",
    "Unanswered",
    "__version__",
    "any_of",
    "approximate",
    "at_least",
    "at_most",
    "between",
    "guarantee",
]

_HOMES = {
    "ActionClientPort": "midstride.node.author.client_ports",
    "ActionServerPort": "midstride.node.author.server_ports",
    "ClientPort": "midstride.node.author.client_ports",
    "Component": "midstride.node.author.component_class",
    "Functionality": "midstride.node.author.functionality",
    "Input": "midstride.node.author.ports",
    "Measured": "midstride.wire.state",
    "MidstrideError": "midstride.errors",
    "NodeError": "midstride.errors",
    "Output": "midstride.node.author.ports",
    "Parameter": "midstride.node.author.declared_parameters",
    "QoS": "midstride.model.contract",
    "ServerPort": "midstride.node.author.server_ports",
    "Unanswered": "midstride.errors",
    "any_of": "midstride.node.author.ports",
    "approximate": "midstride.node.author.modes",
    "at_least": "midstride.node.author.declared_contracts",
    "at_most": "midstride.node.author.declared_contracts",
    "between": "midstride.node.author.declared_contracts",
    "guarantee": "midstride.node.author.declared_contracts",
}


def __getattr__(name: str) -> Any:
    value: Any
    if name == "__version__":
        from importlib.metadata import version

        value = version("midstride")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'midstride' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

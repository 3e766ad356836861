"""Midstride: replace the components of a running ROS system, with the least functionality lost on the way.

A node author needs what is named here and nothing else::

    from midstride import Component
"""

from __future__ import annotations

from midstride.errors import MidstrideError, NodeError
from midstride.model.contract import QoS
from midstride.node.component import Component
from midstride.node.contracts import at_least, at_most, between, guarantee
from midstride.node.functionality import Functionality
from midstride.node.modes import approximate
from midstride.node.parameters import Parameter
from midstride.node.ports import Input, Output, any_of

__version__ = "0.1.0"

__all__ = [
    "Component",
    "Functionality",
    "Input",
    "MidstrideError",
    "NodeError",
    "Output",
    "Parameter",
    "QoS",
    "__version__",
    "any_of",
    "approximate",
    "at_least",
    "at_most",
    "between",
    "guarantee",
]

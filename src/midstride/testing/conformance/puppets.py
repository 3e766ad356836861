"""Descriptions of the puppets that the checks run."""

from __future__ import annotations

import json
from typing import Any, Final

STRING: Final = "std_msgs/msg/String"

Description = dict[str, Any]


def talker(rate: float = 20, mode: Description | None = None, **more: Any) -> Description:
    """Writes at ``rate`` in its normal mode, and nothing in its degraded one."""
    modes = {"normal": {"guarantees": {"out": {"type": STRING, "rate": rate}}}, "degraded": {}}
    return {
        "component": {
            "name": "talker",
            "outputs": ["out"],
            "functionalities": {"talk": {"produces": ["out"], "modes": modes}},
        },
        "modes": {"talk.normal": mode or {}},
        **more,
    }


def latch(**more: Any) -> Description:
    """Writes once, on entry, on a transient-local topic."""
    description = talker(1, **more)
    qos = {"durability": "transient_local", "depth": 1}
    functionality = description["component"]["functionalities"]["talk"]
    functionality["modes"]["normal"] = {"guarantees": {"out": {"type": STRING, "qos": qos}}}
    return description


def relay(mode: Description | None = None, **more: Any) -> Description:
    """Answers every message with the same words."""
    qos = {"depth": 100}
    modes = {"normal": {"assumes": ["in"], "guarantees": {"out": {"type": STRING, "qos": qos}}}, "degraded": {}}
    return {
        "component": {
            "name": "relay",
            "inputs": {"in": {"type": STRING, "qos": qos}},
            "outputs": ["out"],
            "functionalities": {"answer": {"uses": ["in"], "produces": ["out"], "modes": modes}},
        },
        "modes": {"answer.normal": mode or {}},
        **more,
    }


def sink(durability: str = "volatile", **more: Any) -> Description:
    """Receives; what it has received is in its exported state."""
    qos = {"durability": durability, "depth": 200}
    modes = {"normal": {"assumes": ["in"]}, "degraded": {}}
    return {
        "component": {
            "name": "sink",
            "inputs": {"in": {"type": STRING, "qos": qos}},
            "functionalities": {"hear": {"uses": ["in"], "modes": modes}},
        },
        **more,
    }


def steady(**parameters: Any) -> Description:
    """Has changeable parameters, and does nothing."""
    return {
        "component": {
            "name": "steady",
            "parameters": {name: {"value": value, "changeable": True} for name, value in parameters.items()},
            "functionalities": {"rest": {"modes": {"normal": {}, "degraded": {}}}},
        },
        "refuse": {"speed": [13]},
    }


def command_of(python: str, description: Description) -> tuple[str, ...]:
    """The command line that runs it."""
    return (python, "-m", "midstride.testing.puppet", json.dumps(description))

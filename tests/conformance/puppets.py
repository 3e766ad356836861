"""Descriptions of the puppets that the checks run."""

from __future__ import annotations

import json
from typing import Any, Final

STRING: Final = "std_msgs/msg/String"
TRIGGER: Final = "std_srvs/srv/Trigger"
FIBONACCI: Final = "test_msgs/action/Fibonacci"

Description = dict[str, Any]


def _of_one(name: str, functionality: str, normal: Description, ports: Description, **more: Any) -> Description:
    """A component of one functionality, which uses and produces all of its ports in its normal mode."""
    modes = {"normal": normal, "degraded": {}}
    uses, produces = list(ports.get("inputs", ())), list(ports.get("outputs", ()))
    functionalities = {functionality: {"uses": uses, "produces": produces, "modes": modes}}
    return {"component": {"name": name, **ports, "functionalities": functionalities}, **more}


def talker(rate: float = 20, mode: Description | None = None, **more: Any) -> Description:
    """Writes at ``rate`` in its normal mode, and nothing in its degraded one."""
    normal = {"guarantees": {"out": {"type": STRING, "rate": rate}}}
    return _of_one("talker", "talk", normal, {"outputs": ["out"]}, modes={"talk.normal": mode or {}}, **more)


def latch(**more: Any) -> Description:
    """Writes once, on entry, on a transient-local topic."""
    qos = {"durability": "transient_local", "depth": 1}
    normal = {"guarantees": {"out": {"type": STRING, "qos": qos}}}
    return _of_one("talker", "talk", normal, {"outputs": ["out"]}, **more)


def relay(mode: Description | None = None, **more: Any) -> Description:
    """Answers every message with the same words."""
    topic = {"type": STRING, "qos": {"depth": 100}}
    normal = {"assumes": ["in"], "guarantees": {"out": topic}}
    ports = {"inputs": {"in": topic}, "outputs": ["out"]}
    return _of_one("relay", "answer", normal, ports, modes={"answer.normal": mode or {}}, **more)


def sink(durability: str = "volatile", **more: Any) -> Description:
    """Receives; what it has received is in its exported state."""
    topic = {"type": STRING, "qos": {"durability": durability, "depth": 200}}
    return _of_one("sink", "hear", {"assumes": ["in"]}, {"inputs": {"in": topic}}, **more)


def server(mode: Description | None = None, kind: str = TRIGGER, **more: Any) -> Description:
    """Serves `answer` in its normal mode, and not in its degraded one."""
    normal = {"guarantees": {"answer": {"type": kind, "within_seconds": 0.5}}}
    return _of_one("server", "serve", normal, {"outputs": ["answer"]}, modes={"serve.normal": mode or {}}, **more)


def asker(kind: str = TRIGGER, rate: float = 20, **more: Any) -> Description:
    """Sends requests by `ask`, at ``rate`` in its normal mode."""
    ports = {"inputs": {"ask": {"type": kind, "within_seconds": 1.0}}}
    return _of_one("asker", "ask", {"assumes": ["ask"]}, ports, modes={"ask.normal": {"rate": rate}}, **more)


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
    return (python, "-m", "midstride.simulation.puppet", json.dumps(description))

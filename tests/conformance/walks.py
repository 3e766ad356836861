"""Random sequences of commands, compared after each step with a small and obvious model.

Every back end is compared with the same model, so back ends that pass agree with each other.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from midstride.runtime.backend_protocol import Backend
from tests.conformance.lab import CHECKS, SERVICE_CHECKS, Check, Lab, settled
from tests.conformance.puppets import FIBONACCI, STRING, TRIGGER, Description

STEPS: Final = 60
TOPICS: Final = ("/a", "/b", "/c")


def walker() -> Description:
    """Two functionalities, one with three modes; a parameter that refuses 13."""
    return {
        "component": {
            "name": "walker",
            "parameters": {"speed": {"value": 1, "changeable": True}, "name": {"value": "w", "changeable": True}},
            "inputs": {"in": {"type": STRING}},
            "outputs": ["out", "log"],
            "functionalities": {
                "work": {
                    "uses": ["in"],
                    "produces": ["out"],
                    "modes": {
                        "normal": {"assumes": ["in"], "guarantees": {"out": {"type": STRING}}},
                        "slow": {"guarantees": {"out": {"type": STRING}}},
                        "degraded": {},
                    },
                },
                "tell": {
                    "produces": ["log"],
                    "modes": {"normal": {"guarantees": {"log": {"type": STRING, "rate": 20}}}, "degraded": {}},
                },
            },
        },
        "refuse": {"speed": [13]},
    }


def serving_walker() -> Description:
    """The same with a server, a client and the same of a ROS action. No mode relies on a client: it would degrade."""
    description = walker()
    component = description["component"]
    component["inputs"] |= {"ask": {"type": TRIGGER}, "seek": {"type": FIBONACCI}}
    component["outputs"] += ["answer", "act"]
    work = component["functionalities"]["work"]
    work["uses"] += ["ask", "seek"]
    work["produces"] += ["answer", "act"]
    for mode in ("normal", "slow"):
        work["modes"][mode]["guarantees"] |= {"answer": {"type": TRIGGER}, "act": {"type": FIBONACCI}}
    return description


CLIENTS: Final = ("ask", "seek")
SERVERS: Final = ("answer", "act")


@dataclass
class ExpectedComponent:
    """What the state of one walker should be."""

    revision: int
    modes: dict[str, str] = field(default_factory=lambda: {"work": "degraded", "tell": "degraded"})
    gates: dict[str, dict[str, str | None]] = field(default_factory=lambda: {"out": {}, "log": {}, "in": {}})
    parameters: dict[str, Any] = field(default_factory=lambda: {"speed": 1, "name": "w"})

    def apply(self, op: str, values: dict[str, Any]) -> bool:
        """Apply the command. Returns whether it is carried out."""
        done: bool = getattr(self, f"_{op}")(**values)
        self.revision += done
        return done

    def settled(self) -> dict[str, Any]:
        return {"revision": self.revision, "modes": self.modes, "gates": self.gates, "parameters": self.parameters}

    def _attach(self, port: str, topic: str, gate: str) -> bool:
        if port not in self.gates or topic in self.gates[port]:
            return False
        self.gates[port][topic] = None if port in ("in", *CLIENTS) else gate
        return True

    def _detach(self, port: str, topic: str) -> bool:
        return port in self.gates and self.gates[port].pop(topic, "absent") != "absent"

    def _gate(self, port: str, topic: str, gate: str) -> bool:
        if port in ("in", *CLIENTS) or topic not in self.gates.get(port, {}):
            return False
        self.gates[port][topic] = gate
        return True

    def _modes(self, modes: dict[str, str]) -> bool:
        known = {"work": ("normal", "slow", "degraded"), "tell": ("normal", "degraded")}
        if any(mode not in known.get(name, ()) for name, mode in modes.items()):
            return False
        self.modes.update(modes)
        return True

    def _set(self, parameters: dict[str, Any]) -> bool:
        if parameters.get("speed") == 13 or not set(parameters) <= set(self.parameters):
            return False
        self.parameters.update(parameters)
        return True


def command(chance: random.Random, ports: Sequence[str] = ()) -> tuple[str, dict[str, Any]]:
    """Any command, sometimes an invalid one; also for these ``ports``."""
    port = chance.choice(("out", "out", "log", "in", "in", "nowhere", *ports))
    topic, gate = chance.choice(TOPICS), chance.choice(("open", "closed"))
    return chance.choice(
        (
            ("attach", {"port": port, "topic": topic, "gate": gate}),
            ("attach", {"port": port, "topic": topic, "gate": gate}),
            ("detach", {"port": port, "topic": topic}),
            ("gate", {"port": port, "topic": topic, "gate": gate}),
            ("modes", {"modes": {"work": chance.choice(("normal", "slow", "degraded", "fast"))}}),
            ("modes", {"modes": {"work": "normal", "tell": chance.choice(("normal", "degraded"))}}),
            ("set", {"parameters": {"speed": chance.choice((1, 2, 13)), "name": chance.choice("abc")}}),
            ("set", {"parameters": {chance.choice(("name", "colour")): "d"}}),
        )
    )


async def walk(backend: Backend, workspace: Path, seed: int, services: bool = False) -> None:
    """Send two components random commands, valid or not: each answer and state must be as expected.

    ``services``: they have servers and clients, too.
    """
    chance, ports = random.Random(seed), (*SERVERS, *SERVERS, *CLIENTS) if services else ()
    async with Lab(backend, workspace) as lab:
        accounts: dict[str, ExpectedComponent] = {}
        for name in ("one", "two"):
            await lab.start(name, serving_walker() if services else walker())
            account = accounts[name] = ExpectedComponent((await lab.read(name, "observe"))["revision"])
            account.gates |= {port: {} for port in ports}
        for step in range(STEPS):
            name = chance.choice(("one", "two"))
            op, values = command(chance, ports)
            expected = accounts[name].apply(op, values)
            reply = await lab.reply(name, op, True, **values)
            where = f"seed {seed}, step {step}: {name} {op} {values} -> {reply}"
            assert reply.ok == expected, where
            for other, account in accounts.items():
                state = await lab.read(other, "observe")
                assert settled(state) == account.settled(), f"{where}\n{other} is {settled(state)}"
        await lab.eventually("the graph shows what is attached", lambda: _graph_agrees(lab, accounts))


async def _graph_agrees(lab: Lab, accounts: dict[str, ExpectedComponent]) -> bool:
    graph = await lab.backend.endpoints()

    def expected(*ports: str) -> set[tuple[str, str]]:
        return {(f"/{name}", topic) for name, account in accounts.items() for p in ports for topic in account.gates[p]}

    publishers, subscribers = (
        {pair for pair in of if pair[1] in TOPICS} for of in (graph.publishers, graph.subscribers)
    )
    return publishers == expected("out", "log") and subscribers == expected("in")


def _seeded(seed: int, services: bool = False) -> Check:
    async def check(backend: Backend, workspace: Path) -> None:
        await walk(backend, workspace, seed, services)

    check.__name__ = f"walks_at_random_{'with_services_' if services else ''}{seed}"
    return check


CHECKS.extend(_seeded(seed) for seed in range(1, 4))
SERVICE_CHECKS.extend(_seeded(seed, services=True) for seed in range(1, 3))

"""A lifecycle node behind a relay that another program manages: what the relay says of it, and how it follows."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from midstride.errors import NodeError
from midstride.foreign import relayed_lifecycle
from midstride.foreign.graph_check import NamedServer, Served
from midstride.foreign.lifecycle_managers import LifecycleManager
from midstride.foreign.lifecycle_transitions import ACTIVE, INACTIVE, UNCONFIGURED
from midstride.foreign.relayed_lifecycle import RelayedLifecycle, followed
from midstride.foreign.services import NodeServices
from midstride.model.component import ComponentSpec
from tests.foreign.simulated import SimulatedNode

MANAGER = LifecycleManager("/manager", asks=True)
COMPONENT = ComponentSpec.of("Life", run="life", gate="relay")


class Program:
    """The lifecycle node `/life`, and a manager with these parameters."""

    def __init__(self, **parameters: Any) -> None:
        self.events: list[str] = []
        self.node = SimulatedNode("life", self.events)
        self.manager = SimulatedNode("manager", self.events, values=parameters)
        self.served = Served((), has_lifecycle=True, managers=(MANAGER,))
        self.connected: list[str] = []
        self.lifecycle = RelayedLifecycle(lambda: "/life", lambda: self.served, self.connect)

    async def connect(self, name: str) -> NodeServices:
        self.connected.append(name)
        return {"/life": self.node, "/manager": self.manager}[name]

    def look(self) -> bool:
        return asyncio.run(self.lifecycle.look())


def test_what_a_manager_would_notice_is_a_reason_to_stay_as_long_as_it_runs() -> None:
    program = Program(node_names=["life"], bond_timeout=4.0)
    assert program.look()
    (words,) = program.lifecycle.managed
    assert words.startswith("lifecycle manager /manager has a bond of 4 s with /life")
    program.served = Served((), has_lifecycle=True)
    assert program.look() and program.lifecycle.managed == []
    assert not program.look(), "nothing has changed"
    assert program.connected == ["/life", "/manager"], "a client for each, once"
    unbonded = Program(node_names=["life"], bond_timeout=0.0)
    unbonded.look()
    assert unbonded.lifecycle.managed == []


def test_a_node_that_was_active_and_is_no_more_is_named() -> None:
    program = Program()
    program.look()
    assert program.lifecycle.faults == [], "it has never been active"
    program.node.state = ACTIVE
    program.look()
    assert program.lifecycle.faults == []
    program.node.state = INACTIVE
    assert program.look()
    assert program.lifecycle.faults == ["lifecycle node /life is inactive, and was active before"]


def test_a_program_that_is_no_lifecycle_node_is_not_asked() -> None:
    program = Program()
    program.served = Served((NamedServer("service", "/save", "std_srvs/srv/Trigger"),))
    assert not program.look() and program.connected == []


@pytest.mark.parametrize(
    ("before", "events"),
    [(ACTIVE, ["life_2 configure", "life_2 activate"]), (INACTIVE, ["life_2 configure"]), (UNCONFIGURED, [])],
)
def test_the_new_node_is_taken_to_the_state_of_the_old_one(before: str, events: list[str]) -> None:
    seen: list[str] = []
    old, new = SimulatedNode("life", seen), SimulatedNode("life_2", seen)
    old.state = before
    state = asyncio.run(followed("life_2", COMPONENT, old, new, lambda: True))
    assert (state, seen, new.state) == (before if events else None, events, before)


def test_what_has_no_lifecycle_is_left_alone_and_what_refuses_does_not_start() -> None:
    seen: list[str] = []
    old, new = SimulatedNode("life", seen), SimulatedNode("life_2", seen, refuses={"activate"})
    old.state = ACTIVE
    assert asyncio.run(followed("life_2", COMPONENT, old, new, lambda: False)) is None
    assert seen == []
    with pytest.raises(NodeError, match="life_2 has answered `activate` with a failure; it is inactive"):
        asyncio.run(followed("life_2", COMPONENT, old, new, lambda: True))


def test_an_old_node_that_does_not_answer_is_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relayed_lifecycle, "_JOINED", 0.0)

    old = SimulatedNode("life", [], hung=True)
    assert asyncio.run(followed("life_2", COMPONENT, old, SimulatedNode("life_2", []), lambda: True)) is None

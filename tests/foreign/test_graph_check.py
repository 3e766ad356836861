"""What a node without Midstride's API has in the graph, beside what is declared."""

from __future__ import annotations

import asyncio
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CommandRefused
from midstride.foreign import gated_agent as agent_module
from midstride.foreign import graph_check
from midstride.foreign.gated_agent import ForeignAgent
from midstride.foreign.gates import Gates
from midstride.foreign.graph_check import DeclaredEndpoints, GraphEndpoint, Served
from midstride.foreign.lifecycle_managers import LifecycleManagers
from midstride.foreign.page import Page
from midstride.foreign.record import ForeignRecord
from midstride.foreign.services import NoAnswer
from midstride.lang.load import load
from midstride.model.component import ComponentSpec
from midstride.model.contract import QoS
from midstride.runtime.manager_clock import SystemClock
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire import commands
from midstride.wire.sockets import SocketFolder
from tests.foreign.test_agent import TALKER, TOKEN, Nodes

TEXT = """system chat
topic /chat : std_msgs/msg/String
component Thing {
  run "node" gate preload
  input in : sensor_msgs/Image qos(reliability = best_effort) as image
  output out as chatter
  functionality work {
    uses in
    produces out
    mode normal { assume in  guarantee out : std_msgs/msg/String @ 10 Hz qos(durability = transient_local) }
    mode degraded { }
  }
}
node thing : Thing { out -> /chat }
"""
TOPICS = {"in": "/image", "out": "/chat"}
LATCHED = QoS(reliability="reliable", durability="transient_local", liveliness="automatic")
LOOSE = QoS(reliability="best_effort", durability="volatile", liveliness="automatic")
OUT = GraphEndpoint(True, "/chat", "std_msgs/msg/String", LATCHED)
IN = GraphEndpoint(False, "/image", "sensor_msgs/msg/Image", LOOSE)


@pytest.fixture
def component(tmp_path: Path) -> ComponentSpec:
    (tmp_path / "chat.stride").write_text(TEXT, encoding="utf-8")
    return load(tmp_path / "chat.stride").require().components["Thing"]


def test_what_is_declared_is_accepted(component: ComponentSpec) -> None:
    declared = DeclaredEndpoints(component, TOPICS, "/node")
    stronger = GraphEndpoint(True, "/chat", "std_msgs/msg/String", replace(LATCHED, deadline=0.1))
    for found in ([OUT, IN], [stronger, IN]):
        assert declared.shown(found)
        assert declared.differences(found) == []
    assert not declared.shown([OUT, GraphEndpoint(True, "/image", IN.type, LOOSE)])


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (
            GraphEndpoint(True, "/chat", "std_msgs/msg/Int32", LATCHED),
            "node /node publishes std_msgs/msg/Int32 on /chat, and output out of Thing is declared as "
            "std_msgs/msg/String",
        ),
        (
            GraphEndpoint(True, "/chat", "std_msgs/msg/String", LOOSE),
            "node /node publishes on /chat with best_effort, volatile, and output out of Thing is declared with "
            "reliable, transient_local (reliability: best_effort is offered, reliable is needed, durability: volatile "
            "is offered, transient_local is needed)",
        ),
        (
            GraphEndpoint(False, "/image", "sensor_msgs/msg/CompressedImage", LOOSE),
            "node /node subscribes to /image as sensor_msgs/msg/CompressedImage, and input in of Thing is declared as "
            "sensor_msgs/msg/Image",
        ),
        (
            GraphEndpoint(False, "/image", "sensor_msgs/msg/Image", LATCHED),
            "node /node subscribes to /image with reliable, transient_local, and input in of Thing is declared with "
            "best_effort, volatile (reliability: best_effort is offered, reliable is needed, durability: volatile is "
            "offered, transient_local is needed)",
        ),
    ],
    ids=["type", "QoS", "type of an input", "QoS of an input"],
)
def test_what_differs_is_named(component: ComponentSpec, found: GraphEndpoint, words: str) -> None:
    others = [IN if found.output else OUT]
    assert DeclaredEndpoints(component, TOPICS, "/node").differences([*others, found]) == [words]


LACKING = "node /robot/node has no publisher on /chat, the topic of output out of Thing"
CHATTER = GraphEndpoint(True, "/robot/chat_out", OUT.type, LATCHED)
ROSOUT = GraphEndpoint(True, "/rosout", "rcl_interfaces/msg/Log", LATCHED)
NUMBER = GraphEndpoint(True, "/number", "std_msgs/msg/Int32", LATCHED)


@pytest.mark.parametrize(
    ("found", "instead"),
    [
        (
            [CHATTER, ROSOUT],
            "; it publishes on /robot/chat_out (std_msgs/msg/String); did you mean `output out … as chat_out`?",
        ),
        ([NUMBER], "; it publishes on /number (std_msgs/msg/Int32)"),
        ([], ""),
        (
            [replace(CHATTER, topic="/chater"), replace(CHATTER, topic="/a")],
            "; it publishes on /a (std_msgs/msg/String), /chater (std_msgs/msg/String); did you mean `output out … as "
            "/chater`?",
        ),
        # The remapping that the declaration asks for has no effect.
        ([replace(CHATTER, topic="/robot/chatter")], "; it publishes on /robot/chatter (std_msgs/msg/String)"),
    ],
    ids=["another name", "another type", "nothing", "a similar name", "the name that is declared"],
)
def test_what_is_lacking_is_named_with_what_there_is_instead(
    component: ComponentSpec, found: list[GraphEndpoint], instead: str
) -> None:
    declared = DeclaredEndpoints(component, TOPICS, "/robot/node")
    assert declared.lacking([IN, *found], ["out"]) == [LACKING + instead]


def test_what_is_lacking_is_named_with_how_long_it_was_waited_and_what_to_state(component: ComponentSpec) -> None:
    late = "if it takes longer to start, state `takes 40 s` after its `run` command"
    declared = DeclaredEndpoints(component, TOPICS, "/robot/node")
    lazy = "; if the topic exists only while something subscribes to it, state `output out lazy`"
    assert declared.lacking([IN], ["out"], 20.0) == [f"{LACKING}, 20 s after its start; {late}{lazy}"]
    assert declared.lacking([OUT], ["in"], 20.0) == [
        f"node /robot/node has no subscription to /image, the topic of input in of Thing, 20 s after its start; {late}"
    ]
    # Where the topic has another name, no time helps.
    assert declared.lacking([IN, CHATTER], ["out"], 20.0) == declared.lacking([IN, CHATTER], ["out"])


def test_what_is_lazy_need_not_be_shown(component: ComponentSpec) -> None:
    declared = DeclaredEndpoints(component, TOPICS, "/node")
    assert not declared.shown([IN])
    lazy = replace(declared, component=replace(component, lazy=frozenset({"out"})))
    assert lazy.shown([IN]) and not lazy.shown([OUT])


def test_topics_that_are_no_ports_are_listed(component: ComponentSpec) -> None:
    clock = GraphEndpoint(False, "/clock", "rosgraph_msgs/msg/Clock", LOOSE)
    heard = GraphEndpoint(False, "/chat", OUT.type, LATCHED)  # its own output
    declared = DeclaredEndpoints(component, TOPICS, "/node")
    assert declared.undeclared([IN, heard, NUMBER, ROSOUT, clock, OUT]) == [NUMBER, heard]


class Services:
    """A node that answers requests or does not."""

    def __init__(self, answers: bool) -> None:
        self.answers = answers
        self.asked: int = 0

    async def parameters(self, timeout: float) -> dict[str, Any]:
        self.asked += 1
        if not self.answers:
            raise NoAnswer("no answer")
        return {}

    def offers_parameters(self) -> bool:
        return True

    def settings_in(self, request: bytes) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        pass


@pytest.mark.parametrize("answers", [True, False])
def test_a_wrong_topic_is_refused_as_soon_as_the_node_has_settled(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch, answers: bool
) -> None:
    """One that does not answer may still be creating publishers: it is waited for."""
    refused = "did you mean `output out … as chatter`"
    asked = refuses(tmp_path, gate_library, monkeypatch, replace(OUT, topic="/chatter"), answers, refused)
    assert asked == 1 if answers else asked > 1


def test_a_node_that_publishes_without_rcl_is_refused_as_soon_as_it_has_settled(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gate sees nothing of it, and the graph does. Such a node need not answer requests."""
    monkeypatch.setattr(agent_module, "GRAPH_TIMEOUT", 0.0)
    refused = "node /node publishes on /chat, and the library of `gate preload` does not see it.* with `gate relay`$"
    assert refuses(tmp_path, gate_library, monkeypatch, OUT, False, refused, patience=1e9) == 0


def test_a_process_that_has_made_no_node_is_refused_as_such(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node of its name may run, with the endpoints that are declared: the one that it is to replace."""
    late = r"\d s after its start; if it takes longer to start, state `takes \d s` after its `run` command$"
    refused = f"the graph shows no node /node of its process, {late}"
    refuses(tmp_path, gate_library, monkeypatch, None, False, refused)


def recorded(component: ComponentSpec, index: int | None = None, **more: Any) -> ForeignRecord:
    """The record of a node of this process that has just been started."""
    declaration = NamedComponentForm.of(component)
    values: dict[str, Any] = {"topics": {}, "modes": {}, "pid": os.getpid(), **more}
    return ForeignRecord(
        instance="node", node="/node", token=TOKEN, uuid="", started=0, declaration=declaration, index=index, **values
    )


def refuses(
    tmp_path: Path,
    gate_library: Path,
    monkeypatch: pytest.MonkeyPatch,
    found: GraphEndpoint | None,
    answers: bool,
    words: str,
    patience: float = 0.5,
) -> int:
    """A node that the gate sees nothing of, and the graph ``found``, is refused; how often it was asked meanwhile.

    None: the graph shows no node.
    """
    monkeypatch.setattr(agent_module, "GRAPH_UNCHANGED", 0.0)
    monkeypatch.setattr(agent_module, "HEARTBEAT", 0.01)
    monkeypatch.setattr(graph_check, "ENDPOINTS_TIMEOUT", 1e9 if answers else patience)
    page = Page(tmp_path / "page", gate_library)
    gates = Gates(page, page.allocate("node"), TALKER)
    gates.prepare({"out": "/chat"})
    record = recorded(TALKER, gates.index, topics={"out": "/chat"}, modes={"talk": "degraded"})
    services: Any = Services(answers)

    async def scenario() -> None:
        transport = SocketFolder(tmp_path / "components")
        agent = ForeignAgent(record, tmp_path, gates, services, graph=lambda: [] if found is None else [found])
        client = ComponentClient(transport, SystemClock(), TOKEN)
        try:
            await agent.open(transport)
            await client.registered("node")
            with pytest.raises(CommandRefused, match=words):
                await client.change("node", commands.WelcomeCommand(manager="a test"))
        finally:
            client.close()
            await agent.close()

    asyncio.run(scenario())
    asked: int = services.asked
    return asked


def test_a_node_that_differs_is_not_accepted(tmp_path: Path, programs: Path, gate_library: Path) -> None:
    """And one that differs later says so in its state."""
    graph = [GraphEndpoint(True, "/chat", "std_msgs/msg/Int32", LATCHED)]

    async def scenario() -> None:
        system = Nodes(tmp_path, programs, gate_library, lambda: graph)
        try:
            with pytest.raises(CommandRefused, match="/old publishes std_msgs/msg/Int32 on /chat, and output out"):
                await system.start("old")
            graph[0] = OUT
            await system.start("new")
            assert (await system.client.observe("new")).differences == []
            graph[0] = GraphEndpoint(True, "/chat", OUT.type, LOOSE)
            graph.append(NUMBER)
            while not (found := (await system.client.observe("new")).differences):
                await asyncio.sleep(0.05)
            assert "with best_effort" in found[0]
            [other] = (await system.client.observe("new")).undeclared
            assert other.words == "publishes on /number (std_msgs/msg/Int32)"
        finally:
            system.client.close()
            for agent in system.agents.values():
                await agent.close()
            system.lab.close()

    asyncio.run(scenario())


@pytest.mark.parametrize("shown", [True, False])
def test_a_node_without_ports_registers_once_the_graph_shows_it_or_after_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shown: bool
) -> None:
    monkeypatch.setattr(agent_module, "GRAPH_UNCHANGED", 1e9 if shown else 0.0)
    monkeypatch.setattr(agent_module, "WATCH", 0.01)
    bare = ComponentSpec.of("Talker", run="talker", gate="none")
    record = recorded(bare)
    looks: list[list[GraphEndpoint]] = []

    def graph() -> list[GraphEndpoint]:
        looks.append([OUT] if shown and len(looks) >= 3 else [])
        return looks[-1]

    async def scenario() -> None:
        transport = SocketFolder(tmp_path / "components")
        agent = ForeignAgent(record, tmp_path, None, graph=graph)
        client = ComponentClient(transport, SystemClock(), TOKEN)
        try:
            await agent.open(transport)
            await client.registered("node")
            assert bool(looks[-1]) is shown and len(looks) >= (4 if shown else 1)
            await client.change("node", commands.WelcomeCommand(manager="a test"))
        finally:
            client.close()
            await agent.close()

    asyncio.run(scenario())


def test_a_node_that_runs_is_known_to_be_no_lifecycle_node_by_what_its_library_or_the_graph_shows(
    tmp_path: Path, gate_library: Path, component: ComponentSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else what replaces it would wait for its lifecycle state, for two seconds, before it starts to take over."""
    page = Page(tmp_path / "page", gate_library)
    index = page.allocate("node")
    gates = Gates(page, index, component)
    gates.prepare(TOPICS)
    managers, shown, served, seen = LifecycleManagers(lambda _: None), [OUT], Served(), set[str]()
    monkeypatch.setattr(Gates, "seen_services", lambda *_: seen)
    record = recorded(component, index, welcomed=True)
    agent = ForeignAgent(record, tmp_path, gates, graph=lambda: shown, served=lambda: served, managers=managers)
    managers.starting["node"] = "node"
    assert not agent.has_no_lifecycle(), "it may still make its services"
    seen.add("/node/get_parameters")
    assert not agent.has_no_lifecycle(), "it has not made its endpoints"
    for port in ("in", "out"):
        gates.entry(port).endpoints = 1
    assert agent.has_no_lifecycle()
    seen.add("/node/get_state")
    assert not agent.has_no_lifecycle()
    seen.clear()
    assert not agent.has_no_lifecycle(), "a library that sees no services, as with Humble, tells nothing"
    managers.starting.clear()
    assert agent.has_no_lifecycle(), "the graph shows nothing new of it"
    served = Served(has_lifecycle=True)
    assert not agent.has_no_lifecycle()
    served = Served()
    shown.clear()
    assert not agent.has_no_lifecycle(), "the graph does not show it"

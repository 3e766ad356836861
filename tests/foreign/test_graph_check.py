"""What a node without Midstride's API has in the graph, beside what is declared."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from midstride.errors import CommandRefused
from midstride.foreign.graph_check import GraphEndpoint, differences, lacking, shown
from midstride.lang.load import load
from midstride.model.component import ComponentSpec
from midstride.model.contract import QoS
from tests.foreign.test_agent import Nodes

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
    stronger = GraphEndpoint(True, "/chat", "std_msgs/msg/String", replace(LATCHED, deadline=0.1))
    for found in ([OUT, IN], [stronger, IN]):
        assert shown(component, TOPICS, found)
        assert differences(component, TOPICS, "/node", found) == []
    assert not shown(component, TOPICS, [OUT, GraphEndpoint(True, "/image", IN.type, LOOSE)])


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
    assert differences(component, TOPICS, "/node", [*others, found]) == [words]


def test_what_is_lacking_is_named_with_what_there_is_instead(component: ComponentSpec) -> None:
    found = [IN, GraphEndpoint(True, "/chatter", OUT.type, LATCHED), GraphEndpoint(True, "/rosout", "Log", LATCHED)]
    words = "node /node has no publisher on /chat, the topic of output out of Thing"
    assert lacking(component, TOPICS, "/node", found, ["out"]) == [
        f"{words}; it publishes on /chatter (std_msgs/msg/String)"
    ]
    assert lacking(component, TOPICS, "/node", [IN], ["out"]) == [words]


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
            while not (found := (await system.client.observe("new")).differences):
                await asyncio.sleep(0.05)
            assert "with best_effort" in found[0]
        finally:
            system.client.close()
            for agent in system.agents.values():
                await agent.close()
            system.lab.close()

    asyncio.run(scenario())

"""`midstride capture`, on a graph that is made up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from midstride.backends import ros2
from midstride.capture.observed import ObservedGraph
from midstride.cli import main
from tests.capture.simulated import SimulatedGraph

FILE = """system chat

component Talker {
  run "talker" gate preload
}

node talker : Talker
node gone   : Talker
"""


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ObservedGraph:
    monkeypatch.chdir(tmp_path)
    simulated = SimulatedGraph()
    simulated.publisher("/talker", "/chatter", "std_msgs/msg/String", rate=50.0)
    graph = simulated.observed()
    monkeypatch.setattr(ros2, "observe", lambda seconds, nodes: graph)
    Path("chat.stride").write_text(FILE)
    return graph


def test_ports_are_added_to_a_file(graph: ObservedGraph, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "--into", "chat.stride", "--rates"]) == 0
    assert capsys.readouterr().err.splitlines() == [
        "/gone: nothing added: it is not in the graph, or has no topics",
        "1 node in chat.stride with 1 port",
    ]
    text = Path("chat.stride").read_text()
    assert "guarantee chatter : std_msgs/msg/String @ 44 Hz  # measured " in text
    assert "node talker : Talker { chatter -> /chatter }" in text
    assert main(["check", "chat.stride"]) == 0


def test_a_draft_is_printed(graph: ObservedGraph, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture"]) == 0
    assert capsys.readouterr().out.endswith("node talker : Talker { chatter -> /chatter }\n")
    assert main(["capture", "-o", "chat.stride"]) == 1
    assert Path("chat.stride").read_text() == FILE
    assert main(["capture", "-o", "draft.stride", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["nodes"] == ["/talker"] and document["file"] == "draft.stride" and document["ports"] == 1


def test_an_empty_graph_is_an_error(graph: ObservedGraph, capsys: pytest.CaptureFixture[str]) -> None:
    graph.endpoints.clear()
    assert main(["capture", "--into", "chat.stride"]) == 1
    assert "no node with topics was seen" in capsys.readouterr().err
    assert Path("chat.stride").read_text() == FILE

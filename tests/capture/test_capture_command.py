"""`midstride capture`, on a graph that is made up."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from midstride.backends import ros2
from midstride.backends.ros2.manager import probed_page
from midstride.capture.observed import ObservedGraph
from midstride.capture.probe import Count, ProbedPort
from midstride.cli import main
from midstride.cli.client import Client
from midstride.cli.commands import capture
from midstride.errors import ManagerError
from midstride.runtime.workspace import Workspace
from tests.capture.simulated import SimulatedGraph
from tests.planting import plant

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
    plant(monkeypatch, ros2, "observe", lambda seconds, nodes=(), gates=None: graph)
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


UNNAMED = """system chat

component Talker {
  run "talker" gate preload unnamed
}

node driver : Talker
node other  : Talker
"""


def test_a_node_that_its_program_names_is_found_by_the_name_that_it_has_under_midstride(
    graph: ObservedGraph,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    Path("chat.stride").write_text(UNNAMED)
    found = SimpleNamespace(instances=[SimpleNamespace(role="driver", node="/talker")])
    plant(monkeypatch, Client, "answers", lambda self, timeout=2.0: True)
    plant(monkeypatch, Client, "status", lambda self: found)
    assert main(["capture", "--into", "chat.stride"]) == 0
    assert "/talker: nothing added: it is not in this file" in capsys.readouterr().err  # it does not run here
    monkeypatch.setattr(Workspace, "all", lambda: [Workspace(tmp_path / "chat")])
    assert main(["capture", "--into", "chat.stride"]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("/other: nothing added: its program gives its node another name")
    assert said[1:] == ["1 node in chat.stride with 1 port"]
    assert "node driver : Talker { chatter -> /chatter }" in Path("chat.stride").read_text()


def test_a_manager_that_does_not_say_its_status_keeps_nothing_from_being_captured(
    graph: ObservedGraph, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    asked = list[str]()

    def status(self: Client) -> None:
        asked.append("status")
        raise ManagerError("it ends")

    plant(monkeypatch, Client, "answers", lambda self, timeout=2.0: True)
    plant(monkeypatch, Client, "status", status)
    monkeypatch.setattr(Workspace, "all", lambda: [Workspace(tmp_path / "chat")])
    assert main(["capture", "--into", "chat.stride"]) == 0
    assert asked == []  # each node of the file has the name that it has there
    Path("chat.stride").write_text(UNNAMED)
    assert main(["capture", "--into", "chat.stride"]) == 0
    assert asked == ["status"]
    assert "/driver: nothing added" in capsys.readouterr().err


def test_what_is_subscribed_to_and_what_a_file_does_not_have_together_are_named(
    graph: ObservedGraph, capsys: pytest.CaptureFixture[str]
) -> None:
    graph.subscribed.add("/chatter")
    graph.processes |= {"/box": "1", "/talker": "1", "/gone": "1"}
    graph.containers.add("/box")
    together = "/gone, /talker are in the process of the container /box, and chat.stride does not have them in one "
    assert main(["capture", "--into", "chat.stride", "-o", "new.stride", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["lifecycle"], document["not_together"]) == ([], [f"{together}container"])
    assert main(["capture", "--into", "chat.stride"]) == 0
    said = capsys.readouterr().err.splitlines()
    assert f"{together}container" in said
    assert any(
        each.startswith(
            "subscribed to 1 topic to measure rates, as the library of the gate does not see each message of a "
            "publisher there: /chatter; a publisher"
        )
        for each in said
    )


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
    assert "no node with topics or services was seen" in capsys.readouterr().err
    assert Path("chat.stride").read_text() == FILE


RELAY = """system chat

component Relay {
  run "relay" gate preload
}

node relay : Relay
"""
IN, OUT = ProbedPort("/relay", "/in", False), ProbedPort("/relay", "/out", True)


class Gates:
    """Those of a node that publishes a message for each one it receives."""

    def __init__(self, *ports: ProbedPort) -> None:
        self._ports = ports
        self.closed: list[ProbedPort] = []

    def ports(self) -> tuple[ProbedPort, ...]:
        return self._ports

    def watch(self, closed: ProbedPort | None, settling: float, counting: float) -> dict[ProbedPort, Count]:
        if closed is None:
            return {port: Count(10) for port in self._ports}
        self.closed.append(closed)
        return {IN: Count(0, 10), OUT: Count(0)}


@pytest.fixture
def relay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Gates:
    """The gates of a system that runs."""
    monkeypatch.chdir(tmp_path)
    simulated = SimulatedGraph()
    simulated.publisher("/source", "/in", "std_msgs/msg/String", rate=10.0)
    simulated.subscription("/relay", "/in", "std_msgs/msg/String")
    simulated.publisher("/relay", "/out", "std_msgs/msg/String", rate=10.0)
    graph = simulated.observed()
    gates = Gates(IN, OUT, ProbedPort("/relay", "/rosout", True))
    plant(monkeypatch, ros2, "observe", lambda seconds, nodes=(), gates=None: graph)
    plant(monkeypatch, probed_page, "probing", lambda folder: nullcontext(gates))
    plant(monkeypatch, capture, "find_workspace", lambda system: Workspace(tmp_path))
    Path("chat.stride").write_text(RELAY)
    return gates


def test_what_a_probe_finds_is_proposed(relay: Gates, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["capture", "--probe", "--yes", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["probed"] == [
        {
            "node": "/relay",
            "input": "/in",
            "output": "/out",
            "verdict": "depends",
            "evidence": "4.17 Hz, and 0 Hz while it was closed, 20 messages held back",
        }
    ]
    assert "assume in  # probed: out depends on it (4.17 Hz" in document["specification"].replace("in_in", "in")
    assert relay.closed == [IN, IN]
    assert main(["capture", "--into", "chat.stride", "--probe", "--yes"]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith(
        "Probing closes 1 input of running nodes, one after another, 2 times for 3 s each (15 s in all), or up to 6 "
    )
    assert said[1] == "  round 1: /in is closed at /relay"
    assert main(["check", "chat.stride"]) == 0


def test_topics_that_a_gate_does_not_have_are_named(
    relay: Gates, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plant(monkeypatch, probed_page, "probing", lambda folder: nullcontext(Gates(OUT)))
    assert main(["capture", "--probe", "--yes"]) == 0
    assert capsys.readouterr().err.splitlines()[:2] == [
        "/source: not probed: it has no gate",
        "/relay: not probed on /in: its gate has no port there",
    ]


def test_nothing_is_closed_without_confirmation(
    relay: Gates, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "--probe", "--into", "chat.stride"]) == 2
    assert "not a terminal; pass --yes" in capsys.readouterr().err
    monkeypatch.setattr(capture, "is_interactive", lambda: True)
    monkeypatch.setattr(click, "confirm", lambda *_, **__: False)
    assert main(["capture", "--probe", "--into", "chat.stride"]) == 1
    assert "Nothing was closed, and nothing was written." in capsys.readouterr().err
    assert relay.closed == [] and Path("chat.stride").read_text() == RELAY


def test_where_no_node_has_a_gate_a_probe_is_refused(
    relay: Gates, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(relay, "_ports", ())
    assert main(["capture", "--probe", "--yes", "--into", "chat.stride"]) == 1
    assert "none of these nodes has a gate" in capsys.readouterr().err
    assert Path("chat.stride").read_text() == RELAY

"""Lifecycle nodes in a captured graph: Midstride manages those that nothing manages, and a manager's where asked to."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.capture.graph_draft import draft
from midstride.capture.insertion import Insertion, insert, nodes_without_ports
from midstride.capture.observed import ObservedGraph
from midstride.capture.taken_over import note_managers, words_on
from midstride.errors import SpecificationError
from midstride.model.lifecycle_management import Management
from midstride.model.specification import Order, Specification
from tests.capture.simulated import SimulatedGraph
from tests.capture.test_capture import STRING, checked

FILE = """system robot

component Life {
  run "life" gate preload
}

component Camera {
  run "camera" takes 3 s stop sigterm 9 s gate none
}

component Plain {
  run "plain" gate preload
}

component Manager {
  run "manage" gate preload
  parameters {
    autostart = true
    node_names = ["life_a", "life_b"]
  }
}

node life_a  : Life
node life_b  : Life
node camera  : Camera
node plain   : Plain
node manager : Manager {
  respawn
  respawn_max_retries unlimited
}

order /life_a before /manager
order /plain before /life_a
"""


def robot(managed: set[str]) -> ObservedGraph:
    graph = SimulatedGraph()
    for node in ("/life_a", "/life_b", "/camera", "/plain", "/manager"):
        graph.publisher(node, f"/from{node}", STRING)
        graph.publisher(node, "/bond", "bond/msg/Status")
        graph.subscription(node, "/bond", "bond/msg/Status")
    found = graph.observed()
    found.lifecycle |= {"/life_a", "/life_b", "/camera"}
    if managed:
        found.managers["/manager"] = managed
    return found


def gates(system: Specification) -> dict[str, str | None]:
    return {role: system.component_of(role).gate for role in system.nodes}


def captured(management: Management | None, managed: set[str], folder: Path) -> tuple[Insertion, Specification]:
    found = insert(FILE, "robot.stride", robot(managed), management=management)
    return found, checked(found.text, folder)


def test_lifecycle_nodes_that_nothing_manages_get_the_gate_by_which_midstride_does(tmp_path: Path) -> None:
    text = FILE.replace("    autostart = true\n", "")  # which is no manager, and none runs
    found = insert(text, "robot.stride", robot(set()))
    system = checked(found.text, tmp_path)
    assert gates(system) == {
        "life_a": "lifecycle preload",
        "life_b": "lifecycle preload",
        "camera": "lifecycle",
        "plain": "preload",
        "manager": "preload",
    }
    assert found.lifecycle == [
        "/camera, /life_a, /life_b: managed by nothing, so Midstride manages the lifecycle from now on"
    ]
    assert 'run "camera" takes 3 s stop sigterm 9 s gate lifecycle\n' in found.text
    assert insert(found.text, "robot.stride", robot(set())).lifecycle == []
    assert not any("bond" in port for role in system.nodes for port in system.component_of(role).ports())


@pytest.mark.parametrize("management", [None, "manager"])
def test_those_of_a_manager_stay_with_it_unless_midstride_is_asked_for(
    tmp_path: Path, management: Management | None
) -> None:
    found, system = captured(management, {"/life_a", "/life_b"}, tmp_path)
    camera = "lifecycle" if management is None else "none"
    assert gates(system) == {
        "life_a": "preload",
        "life_b": "preload",
        "camera": camera,
        "plain": "preload",
        "manager": "preload",
    }
    assert found.lifecycle[0].startswith("/manager manages the lifecycle of /life_a, /life_b, and goes on with it")
    assert "with `--lifecycle midstride`, Midstride manages them, without it" in found.lifecycle[0]


def test_where_midstride_is_asked_for_the_manager_is_left_out(tmp_path: Path) -> None:
    found, system = captured("midstride", {"/life_a", "/life_b"}, tmp_path)
    assert gates(system) == {
        "life_a": "lifecycle preload",
        "life_b": "lifecycle preload",
        "camera": "lifecycle",
        "plain": "preload",
    }
    assert [(each.first, each.then) for each in system.constraints if isinstance(each, Order)] == [("plain", "life_a")]
    assert "# /manager is left out: Midstride manages the lifecycle of its nodes" in found.text
    assert found.lifecycle[0] == (
        "/manager managed the lifecycle of /life_a, /life_b; Midstride does from now on: it is left out of the file"
    )
    # A second look, at nodes that state their ports, changes the gates as well; the manager's topic stays declared.
    first, _ = captured("manager", {"/life_a", "/life_b"}, tmp_path)
    second = insert(first.text, "robot.stride", robot({"/life_a", "/life_b"}), management="midstride")
    assert gates(checked(second.text, tmp_path, "W031")) == gates(system) and second.added == []


def test_a_manager_that_does_not_run_is_recognised_by_its_parameters(tmp_path: Path) -> None:
    graph = robot(set())
    note_managers(graph, checked(FILE, tmp_path))
    assert graph.managers == {"/manager": {"/life_a", "/life_b"}}
    assert 'run "life" gate preload\n' in insert(FILE, "robot.stride", graph).text


def test_programs_that_end_get_no_ports_and_are_not_waited_for() -> None:
    text = FILE.replace('run "plain" gate preload', 'run "plain" once')
    assert "/plain" not in nodes_without_ports(text, "robot.stride") and "/camera" in nodes_without_ports(text, "r")
    found = insert(text, "robot.stride", robot(set()))
    assert found.left["/plain"] == "its program ends when it has done its work (`once`)"


def test_midstride_does_not_take_over_a_part_of_the_nodes_of_a_manager() -> None:
    graph = robot({"/life_a", "/life_b", "/elsewhere"})
    graph.lifecycle.add("/elsewhere")
    with pytest.raises(SpecificationError, match=r"/manager manages the lifecycle of /elsewhere as well, not in robot"):
        insert(FILE, "robot.stride", graph, management="midstride")


def test_a_manager_outside_the_file_must_not_run_beside_the_system() -> None:
    text = FILE[: FILE.index("node manager")]
    found = insert(text, "robot.stride", robot({"/life_a", "/life_b"}), management="midstride")
    assert "it must not run beside `midstride up`" in found.lifecycle[0]
    assert "left out" not in found.text


def test_a_draft_says_which_gate_to_write() -> None:
    graph = robot({"/life_a", "/life_b"})
    text = draft("robot", graph)
    assert text.count("# A lifecycle node that /manager manages: `gate preload`.") == 2
    assert text.count("# A lifecycle node: `gate lifecycle preload`, so that Midstride manages its lifecycle.") == 1
    assert draft("robot", graph, management="midstride").count("so that Midstride manages its lifecycle.") == 3
    assert words_on(graph, None, []) == []

"""The processes of a captured graph: component containers, and nodes of one program."""

from __future__ import annotations

from midstride.capture.graph_draft import draft
from midstride.capture.observed import ObservedGraph
from midstride.capture.observed_processes import ObservedProcess, not_stated, observed_processes
from midstride.lang import format_text
from midstride.lang.load import load_text
from tests.capture.simulated import SimulatedGraph
from tests.capture.test_capture import STRING

FILE = """system robot
container box
component Part {{ run component "demo::Part" package "demo" gate preload }}
namespace front {{ node camera : Part{camera} }}
node rectify : Part{rectify}
"""


def robot() -> ObservedGraph:
    graph = SimulatedGraph()
    for node in ("/front/camera", "/rectify", "/one", "/other", "/alone"):
        graph.publisher(node, f"/from{node}", STRING)
    found = graph.observed()
    found.processes |= {"/box": "1", "/front/camera": "1", "/rectify": "1", "/one": "2", "/other": "2", "/alone": "3"}
    found.containers.add("/box")
    return found


def test_nodes_of_one_process_are_known() -> None:
    graph = robot()
    assert observed_processes(graph) == [
        ObservedProcess(("/front/camera", "/rectify"), "/box"),
        ObservedProcess(("/one", "/other")),
    ]
    text = draft("robot", graph)
    specification = load_text(text).require()
    assert format_text(text).text == text
    assert list(specification.containers) == ["box"]
    assert "# /front/camera, /rectify are in the process of the container /box: state their classes" in text
    assert "# /one, /other are in one process: one program, which `run` starts, has them all.\n" in text
    assert "/alone are" not in text
    assert observed_processes(graph.renamed({"/rectify": "/a"}))[0].nodes == ("/a", "/front/camera")


def test_the_program_of_a_container_is_stated_where_its_process_shows_it() -> None:
    graph = robot()
    graph.programs["/box"] = "component_container_isolated --use_multi_threaded_executor", "rclcpp_components"
    text = draft("robot", graph)
    (container,) = load_text(text).require().containers.values()
    assert (container.run, container.package) == graph.programs["/box"]
    assert "write `in /box` after their components.\n" in text
    for given in ("-p thread_num:=2", "--params-file /tmp/launch_params_1"):
        graph.programs["/box"] = f"component_container_mt --ros-args {given}", "rclcpp_components"
        text = draft("robot", graph)
        (container,) = load_text(text).require().containers.values()
        assert (container.run, container.package) == graph.programs["/box"]
        assert ("# Its program reads a file of parameters" in text) == ("file" in given)
    graph.programs["/box"] = 'odd "name"', "rclcpp_components"
    assert "Its program is not in the graph" in draft("robot", graph)
    assert graph.renamed({"/box": "/other"}).programs == {"/other": ('odd "name"', "rclcpp_components")}


def test_what_a_file_does_not_have_together_is_named() -> None:
    graph = robot()

    def found(camera: str, rectify: str) -> list[ObservedProcess]:
        return not_stated(graph, load_text(FILE.format(camera=camera, rectify=rectify)).require())

    (named,) = found("", "")
    assert named.words == "/front/camera, /rectify are in the process of the container /box"
    assert found(" in /box", "") == [named]
    assert found(" in /box", " in box") == []

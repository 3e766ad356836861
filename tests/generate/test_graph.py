"""The component-and-connector view: its contents, and that Graphviz accepts it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given

from midstride.generate.drawing import to_dot, to_mermaid
from midstride.generate.drawn_system import Edge, view
from midstride.generate.layout import layout
from midstride.lang import load, load_text
from midstride.model.specification import Specification
from tests.strategies.systems import specifications

SAMPLE = load(Path(__file__).parents[1] / "lang" / "seeds" / "patrol.stride").require()


def fleet(groups: int, each: int) -> Specification:
    """Chains of nodes in namespaces, each fed by the last topic of the one before."""
    text = [
        "system fleet\ncontract D = std_msgs/msg/String\n",
        "environment { guarantee s on /source : D }\ntopic /source : D\n",
        "component C { input in : D   output out   functionality f { uses in   produces out\n",
        "mode normal { assume in   guarantee out : D }   mode off { } } }\n",
    ]
    last = "/source"
    for group in range(groups):
        text.append(f"namespace g{group} {{\n")
        for number in range(each):
            text.append(f"topic t{number} : D\nnode n{number} : C {{ in <- {last}   out -> t{number} }}\n")
            last = f"/g{group}/t{number}"
        text.append("}\n")
    return load_text("".join(text)).require()


def test_the_papers_figure_1() -> None:
    """Boxes for components with their ports, a connector for each topic, the environment beside them."""
    drawn = view(SAMPLE)
    boxes = {box.title: box for box in drawn.boxes}
    assert set(boxes) == {
        "lidar",
        "detector : ObstacleDetector",
        "controller : MotorController",
        "camera_device",
        "localization",
    }
    detector = boxes["detector : ObstacleDetector"]
    assert [port.name for port in detector.inputs] == ["scan"]
    assert [port.name for port in detector.outputs] == ["out"]
    assert detector.lines == ("detect",)
    assert {topic.name for topic in drawn.topics} == {"/scan", "/obstacles", "/cmd_vel", "/odom"}
    assert Edge("node detector", "topic /obstacles", start_port="out") in drawn.edges
    assert Edge("topic /obstacles", "node controller", end_port="obstacles") in drawn.edges
    assert Edge("environment camera_device", "node detector", assumed=True) in drawn.edges
    assert Edge("environment localization", "topic /odom") in drawn.edges
    assert len(drawn.edges) == 7


def test_the_papers_figure_3_has_contracts() -> None:
    drawn = view(SAMPLE, annotate=True)
    boxes = {box.id: box for box in drawn.boxes}
    assert boxes["node controller"].inputs[0].note == "sensor_msgs/Range @ 5 Hz"
    assert "  stop: guarantees cmd : geometry_msgs/Twist @ 20 Hz" in boxes["node controller"].lines
    assert {topic.name: topic.note for topic in drawn.topics}[
        "/cmd_vel"
    ] == "geometry_msgs/Twist @ 10 Hz, at most 1 publisher"


def test_many_nodes_are_drawn_by_namespace() -> None:
    drawn = view(fleet(10, 15))
    groups = [box for box in drawn.boxes if box.kind == "group"]
    assert [box.title for box in groups] == [f"g{n}" for n in range(10)]
    assert groups[0].lines == ("15 nodes", "14 internal topics")
    assert groups[9].lines == ("15 nodes", "15 internal topics")
    assert {topic.name for topic in drawn.topics} == {"/source", *(f"/g{n}/t14" for n in range(9))}
    assert len(view(fleet(10, 15), collapse=False).boxes) == 151
    assert len(view(fleet(2, 3)).boxes) == 7


def test_a_namespace_around_everything_is_no_group() -> None:
    """Inside a robot's namespace, nodes are grouped by the namespaces within it."""
    text = ["system fleet\ncontract D = std_msgs/msg/String\n"]
    text += [
        "component S { output out   functionality f { produces out   mode on { guarantee out : D }   mode off { } } }\n"
    ]
    nodes = [f"topic /t{n} : D\nnamespace g{n % 3} {{ node n{n} : S {{ out -> /t{n} }} }}\n" for n in range(90)]
    drawn = view(load_text("".join([*text, "namespace robot1 {\n", *nodes, "}\n"])).require())
    assert [box.title for box in drawn.boxes] == ["robot1/g0", "robot1/g1", "robot1/g2"]
    flat = [f"topic /t{n} : D\nnode n{n} : S {{ out -> /t{n} }}\n" for n in range(90)]
    assert len(view(load_text("".join([*text, "namespace robot1 {\n", *flat, "}\n"])).require()).boxes) == 90


SERVING = """system mapping
contract Map = nav_msgs/srv/GetMap responds within 50 ms
topic /scan : sensor_msgs/msg/LaserScan @ 10 Hz
service /map : Map
action /dock : nav2_msgs/action/DockRobot
component MapServer {
  output scan
  server map
  functionality serve {
    produces map, scan
    mode on { guarantee map : Map  guarantee scan : sensor_msgs/msg/LaserScan @ 10 Hz }
    mode off { }
  }
}
component Docking {
  client map : nav_msgs/srv/GetMap
  input scan : sensor_msgs/msg/LaserScan
  action server dock
  functionality docking {
    uses map, scan   produces dock
    mode on { assume map  assume scan  guarantee dock : nav2_msgs/action/DockRobot }
    mode off { }
  }
}
component Mission {
  action client dock : nav2_msgs/action/DockRobot
  functionality drive { uses dock  mode on { assume dock }  mode off { } }
}
namespace map {
  node map_server : MapServer { map -> /map  scan -> /scan }
  node docking : Docking { map <- /map  dock -> /dock  scan <- /scan }
}
node mission : Mission { dock <- /dock }
"""


def test_services_differ_from_topics_and_their_arrows_point_at_the_server() -> None:
    drawn = view(load_text(SERVING).require(), annotate=True)
    assert {topic.name: topic.kind for topic in drawn.topics} == {
        "/scan": "topic",
        "/map": "service",
        "/dock": "action",
    }
    assert not any("publisher" in topic.note for topic in drawn.topics)  # at most one server is no choice
    dot = to_dot(drawn).splitlines()
    number = {
        name: next(line.split()[0] for line in dot if f">{name}<br/>" in line.replace("label=<", ">"))
        for name in ("/scan", "service /map", "ROS action /dock")
    }
    shapes = {name: next(line for line in dot if line.startswith(f"  {id} [")) for name, id in number.items()}
    for name, shape in (("/scan", "ellipse"), ("service /map", "hexagon"), ("ROS action /dock", "octagon")):
        assert f"shape={shape}," in shapes[name]
    edges = {
        name: [line for line in dot if "->" in line and f" {id} " in f" {line.strip(' ;')} "]
        for name, id in number.items()
    }
    assert [len(found) for found in edges.values()] == [2, 2, 2]
    assert not any("dir=back" in edge or "dotted" in edge for edge in edges["/scan"])
    for name in ("service /map", "ROS action /dock"):
        server, client = sorted(edges[name], key=lambda edge: edge.strip().startswith(f"{number[name]} "))
        assert '"out ' in server and '"in ' in client  # what relies on another node is drawn behind it
        assert all("[dir=back, style=dotted]" in edge for edge in (server, client))

    mermaid = to_mermaid(drawn)
    ids = {
        line.split('"')[1].split("<br/>")[0]: re.split(r"[\[{(]", line.strip())[0]
        for line in mermaid.splitlines()
        if ":::" in line
    }
    box = {title.split(" ")[0].removeprefix("#60;b#62;"): id for title, id in ids.items()}
    assert f"  {box['<b>map/docking']} -->|map| {ids['service /map']}\n" in mermaid
    assert f"  {ids['service /map']} -->|map| {box['<b>map/map_server']}\n" in mermaid
    assert "server map: nav_msgs/srv/GetMap" in mermaid and "client map: nav_msgs/srv/GetMap" in mermaid


def test_a_collapsed_namespace_counts_its_services_apart() -> None:
    drawn = view(load_text(SERVING).require(), collapse=True)
    (group,) = (box for box in drawn.boxes if box.kind == "group")
    assert group.lines == ("2 nodes", "1 internal topics", "1 internal services")


def loop(length: int) -> Specification:
    """A control loop of so many nodes, each fed by a sensor outside the loop."""
    text = ["system loop\ncontract D = std_msgs/msg/String\n"]
    text += [
        "component C { input in : D   input fed : D   output out   functionality f { uses in, fed   produces out\n"
    ]
    text += ["mode normal { assume in   assume fed   guarantee out : D }   mode off { } } }\n"]
    text += [
        "component S { output out   functionality f { produces out   mode on { guarantee out : D }   mode off { } } }\n"
    ]
    for n in range(length):
        text.append(f"topic /t{n} : D\ntopic /s{n} : D\nnode s{n} : S {{ out -> /s{n} }}\n")
        text.append(f"node n{n} : C {{ in <- /t{n}   fed <- /s{n}   out -> /t{(n + 1) % length} }}\n")
    return load_text("".join(text)).require()


def test_one_arrow_of_a_loop_goes_back_and_long_ones_go_down_the_page() -> None:
    short, long = layout(view(loop(3))), layout(view(loop(9)))
    assert (len(short.back), short.down) == (1, False)
    assert (len(long.back), long.down) == (1, True)
    assert not layout(view(SAMPLE)).down
    assert layout(view(SAMPLE, annotate=True)).down  # with the contracts beside them the boxes are wide
    assert "rankdir=TB" in to_dot(view(loop(9)))
    assert to_mermaid(view(loop(9))).startswith("flowchart TB\n")
    assert to_dot(view(loop(9))).count("dir=back") == 1


@given(specifications())
def test_back_edges_are_the_edges_against_the_order(specification: Specification) -> None:
    drawn = view(specification)
    laid = layout(drawn)
    assert sorted(laid.order) == sorted([*(box.id for box in drawn.boxes), *(topic.id for topic in drawn.topics)])
    rank = {id: index for index, id in enumerate(laid.order)}
    assert laid.back == {edge for edge in drawn.edges if rank[edge.start] > rank[edge.end]}
    pairs = {(edge.start, edge.end) for edge in drawn.edges}
    assert 2 * len({(edge.start, edge.end) for edge in laid.back}) <= len(pairs)
    assert layout(view(specification)) == laid


def test_names_of_any_kind_are_quoted() -> None:
    """No name is taken for a keyword of the drawing language."""
    drawn = view(load_text("system graph\nresource r\ncomponent end { }\nnode subgraph : end").require())
    text = to_dot(drawn)
    assert text.startswith('digraph "graph" {\n')
    assert "<b>subgraph : end</b>" in text
    bare = re.sub(r'label=<.*>|"[^"]*"', "", text)
    assert set(re.findall(r"\w+", bare)) & {"end", "subgraph", "n0"} == {"n0"}
    bare = re.sub(r'"[^"]*"', "", to_mermaid(drawn))
    assert set(re.findall(r"\w+", bare)) & {"end", "subgraph", "n0"} == {"n0"}


@pytest.mark.graphviz
@pytest.mark.parametrize("annotate", [False, True])
def test_graphviz_draws_it(annotate: bool) -> None:
    for specification in (SAMPLE, load_text(SERVING).require(), loop(3), loop(9), fleet(3, 4), fleet(10, 15)):
        drawn = view(specification, annotate=annotate)
        done = subprocess.run(["dot", "-Tsvg"], input=to_dot(drawn).encode(), capture_output=True, check=True)
        assert done.stderr == b""
        svg = ElementTree.fromstring(done.stdout)
        shown = {element.text for element in svg.iter("{http://www.w3.org/2000/svg}text")}
        words = {"topic": "", "service": "service ", "action": "ROS action "}
        assert {words[topic.kind] + topic.name for topic in drawn.topics} <= shown
        assert len(re.findall(rb'class="edge"', done.stdout)) == len(drawn.edges)


def test_mermaid_has_every_box_and_edge() -> None:
    drawn = view(SAMPLE)
    text = to_mermaid(drawn)
    assert text.startswith("flowchart LR\n")
    assert len(re.findall(r"-->|-\.->", text)) == len(drawn.edges)
    assert text.count(":::") == len(drawn.boxes) + len(drawn.topics)


@given(specifications())
def test_any_system_can_be_drawn(specification: Specification) -> None:
    for annotate in (False, True):
        drawn = view(specification, annotate=annotate)
        ends = {box.id for box in drawn.boxes} | {topic.id for topic in drawn.topics}
        assert all({edge.start, edge.end} <= ends for edge in drawn.edges)
        count = len(drawn.boxes) + len(drawn.topics)
        dot, mermaid = to_dot(drawn), to_mermaid(drawn)
        assert len(re.findall(r"^  n\d+ \[", dot, re.MULTILINE)) == mermaid.count(":::") == count
        assert len(re.findall(r"^  n\d.* -> n\d", dot, re.MULTILINE)) == len(drawn.edges)
        assert len(re.findall(r"-->|-\.->", mermaid)) == len(drawn.edges)

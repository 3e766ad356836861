"""Servers and clients that a graph shows: those that rely on each other become ports, and comments name the others."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.capture.graph_draft import draft
from midstride.capture.insertion import Insertion, insert
from midstride.capture.observed import ObservedGraph
from midstride.capture.response_times import FEWEST, measured_answers
from midstride.lang import format_text
from midstride.model.specification import Specification
from tests.capture.simulated import SimulatedGraph
from tests.capture.test_capture import STRING, checked

MAP, RESET = "nav_msgs/srv/GetMap", "std_srvs/srv/Empty"
DOCK = "nav2_msgs/action/DockRobot"
FILE = """system robot

component Maps { run "maps" gate preload }
component Docking { run "docking --ros-args -r get_map:=/maps/map" gate preload }
component Mission { run "mission" gate preload }

node maps : Maps
node docking : Docking
node mission : Mission
"""


def robot() -> SimulatedGraph:
    """A map server, a docking server that calls it and publishes, and a mission that has goals for the latter."""
    graph = SimulatedGraph()
    graph.server("/maps", "/maps/map", MAP)
    graph.server("/maps", "/maps/reset", RESET)
    for node in ("/maps", "/docking", "/mission"):
        graph.server(node, f"{node}/get_parameters", "rcl_interfaces/srv/GetParameters")
        graph.server(node, f"{node}/get_logger_levels", "rcl_interfaces/srv/GetLoggerLevels")
        graph.server(node, f"{node}/get_type_description", "type_description_interfaces/srv/GetTypeDescription")
        graph.server(node, f"{node}/change_state", "lifecycle_msgs/srv/ChangeState")
        graph.client("/_ros2cli_1", f"{node}/get_parameters", "rcl_interfaces/srv/GetParameters")
    graph.client("/mission", "/docking/get_parameters", "rcl_interfaces/srv/GetParameters")
    graph.client("/mission", "/docking/change_state", "lifecycle_msgs/srv/ChangeState")
    graph.client("/docking", "/maps/map", MAP)
    graph.publisher("/docking", "/cmd_vel", STRING, rate=10.0)
    graph.server("/docking", "/dock", DOCK)
    graph.client("/mission", "/dock", DOCK)
    graph.client("/mission", "/weather", RESET)
    graph.client("/_ros2cli_1", "/maps/reset", RESET)
    return graph


def attached(system: Specification) -> dict[str, set[str]]:
    """What is attached to each service and ROS action: its server first, after an arrow what calls it."""
    found: dict[str, set[str]] = {}
    for node in system.nodes.values():
        component = system.components[node.component]
        for port, names in node.attachments.items():
            if component.is_service(port):
                arrow = "->" if component.has_output(port) else "<-"
                found.setdefault(names[0], set()).add(f"{node.role}.{port} {arrow}")
    return found


RELIANCE = {"/maps/map": {"maps.map ->", "docking.map <-"}, "/dock": {"docking.dock ->", "mission.dock <-"}}


def inserted(graph: ObservedGraph, text: str = FILE) -> Insertion:
    formatted = format_text(text).text
    assert formatted is not None
    return insert(formatted, "robot.stride", graph)


def test_a_draft_has_the_services_that_nodes_rely_on(tmp_path: Path) -> None:
    text = draft("robot", robot().observed())
    system = checked(text, tmp_path)
    assert attached(system) == RELIANCE
    kinds = {name: connector.kind for name, connector in system.connectors.items()}
    assert kinds == {"/cmd_vel": "topic", "/maps/map": "service", "/dock": "action"}
    declared = [line.split() for line in text.splitlines() if line.startswith(("topic ", "service ", "action "))]
    assert declared == [
        ["topic", "/cmd_vel", ":", STRING],
        ["service", "/maps/map", ":", MAP],
        ["action", "/dock", ":", DOCK],
    ]


def test_the_bound_of_a_server_is_what_its_process_has_shown(tmp_path: Path) -> None:
    """Twice the longest response, rounded up; of one that was not asked often enough, or has no gate, it is said."""
    graph = robot().observed()

    def guarantees(rates: bool) -> list[str]:
        text = draft("robot", graph, rates)
        checked(text, tmp_path)
        found = [line.strip() for line in text.splitlines() if "guarantee map" in line or "guarantee dock " in line]
        return sorted(found, reverse=True)

    without = "# no bound: what it takes to answer is seen with a gate inside, under `midstride up`"
    assert guarantees(rates=True) == [f"guarantee map : {MAP}  {without}", f"guarantee dock : {DOCK}  {without}"]
    graph.took = {("/maps", "/maps/map"): [0.001, 0.002, 0.012, 0.002, 0.003], ("/docking", "/dock"): [0.4] * 4}
    note = "# answered 5 requests: median 2 ms, longest 12 ms; proposed: within 30 ms"
    few = f"guarantee dock : {DOCK}  # no bound: 4 requests answered in 10 s"
    assert guarantees(rates=False) == [f"guarantee map : {MAP}  {note}", few]
    assert guarantees(rates=True) == [f"guarantee map : {MAP} responds within 30 ms  {note}", few]
    graph.took["/docking", "/dock"] = [0.4] * 5
    assert f"guarantee dock : {DOCK} accepts within 800 ms  # answered 5" in guarantees(rates=True)[1]


@pytest.mark.parametrize(("longest", "bound"), [(0.0, 0.01), (0.012, 0.03), (0.05, 0.1), (0.5, 1.0), (3.1, 7.0)])
def test_a_proposed_bound_is_rounded_up(longest: float, bound: float) -> None:
    found = measured_answers([longest] * FEWEST)
    assert found is not None and found.bound == bound
    assert measured_answers([longest] * (FEWEST - 1)) is None


def test_a_file_gets_them_as_its_programs_call_them(tmp_path: Path) -> None:
    found = inserted(robot().observed())
    assert (found.added, found.left, found.ports) == (["/maps", "/docking", "/mission"], {}, 5)
    system = checked(found.text, tmp_path)
    assert attached(system) == RELIANCE
    docking = system.components["Docking"]
    assert docking.topic_of("map") == "get_map" and docking.run == "docking"
    assert system.components["Maps"].topic_of("map") == "~/map"
    assert inserted(robot().observed(), found.text).text == found.text


def test_the_loss_of_a_server_closes_no_output(tmp_path: Path) -> None:
    """What needs it is not in the graph, so `main` neither needs it nor takes the other server with it."""
    docking = checked(inserted(robot().observed()).text, tmp_path).components["Docking"]
    found = {each.name: (each.inputs, each.outputs) for each in docking}
    assert found == {"main": ((), ("cmd_vel",)), "serve": ((), ("dock",)), "call": (("map",), ())}
    assert len(docking.functionalities["call"].modes[0].assumptions) == 1


def test_others_are_named_with_the_reason(tmp_path: Path) -> None:
    text = inserted(robot().observed()).text
    comments = [line.strip() for line in text.splitlines() if "no port" in line]
    assert comments == [
        "# no port for service /maps/reset: no other node here calls it",
        "# no port for service /weather: no other node here states that it serves it",
    ]
    checked(text, tmp_path)


@pytest.mark.parametrize(
    ("node", "name", "type_", "output", "why"),
    [
        ("/other", "/maps/map", MAP, True, "/maps and /other serve it"),
        ("/other", "/maps/map", STRING, True, "a topic has the name"),
        ("/other", "/maps/map", DOCK, False, "a service and a ROS action have the name"),
    ],
)
def test_what_a_specification_cannot_state_is_left_out(
    tmp_path: Path, node: str, name: str, type_: str, output: bool, why: str
) -> None:
    graph = robot()
    if type_ == STRING:
        graph.publisher(node, name, type_)
    else:
        (graph.server if output else graph.client)(node, name, type_)
    text = inserted(graph.observed()).text
    assert attached(checked(text, tmp_path)) == {"/dock": RELIANCE["/dock"]}
    assert f"# no port for service /maps/map: {why}\n" in text


def test_a_client_of_another_type_and_a_call_to_itself_rely_on_nothing(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.server("/maps", "/map", MAP)
    graph.client("/docking", "/map", RESET)
    graph.client("/maps", "/map", MAP)
    for node in ("/maps", "/docking", "/mission"):
        graph.publisher(node, f"{node}/out", STRING)
    text = inserted(graph.observed()).text
    assert attached(checked(text, tmp_path)) == {}
    assert f"# no port for service /map: the type that is served is {MAP}\n" in text
    assert "# no port for service /map: the node calls itself\n" in text


@pytest.mark.parametrize("gate", ["gate relay", "gate none", "gate lifecycle", ""])
def test_without_the_library_a_node_gets_its_topics_alone(tmp_path: Path, gate: str) -> None:
    """Nothing would hand its requests over, or E027 refuses them, or more than one functionality."""
    text = FILE.replace('run "docking --ros-args -r get_map:=/maps/map" gate preload', f'run "docking" {gate}')
    found = inserted(robot().observed(), text)
    system = checked(found.text, tmp_path)
    assert attached(system) == {"/maps/map": {"maps.map ->"}}  # which it calls
    assert found.left == {"/mission": "it has no topics, and its services get no ports"}


def test_a_client_joins_a_service_that_the_file_states(tmp_path: Path) -> None:
    stated = FILE.replace(
        'component Maps { run "maps" gate preload }',
        f"""service /maps/map : {MAP}
component Maps {{
  run "maps" gate preload
  server chart as ~/map
  functionality f {{ produces chart  mode normal {{ guarantee chart : {MAP} }}  mode off {{ }} }}
}}""",
    ).replace("node maps : Maps", "node maps : Maps { chart -> /maps/map }")
    graph = robot().observed()
    text = inserted(graph, stated).text
    assert text.count("service /maps/map :") == 1
    (tmp_path / "robot.stride").write_text(text)
    assert "assume map" in text and "node docking : Docking { cmd_vel -> /cmd_vel" in text


def test_nodes_that_share_a_component_have_the_same_servers(tmp_path: Path) -> None:
    """Also where only one of them is called: a component for each would be one too many."""
    graph = SimulatedGraph()
    for side in ("left", "right"):
        graph.publisher(f"/{side}/camera", f"/{side}/image", STRING)
        graph.server(f"/{side}/camera", f"/{side}/camera/reset", RESET)
        graph.client(f"/{side}/camera", f"/{side}/light", RESET)
    graph.server("/light", "/left/light", RESET)
    graph.client("/light", "/left/camera/reset", RESET)
    text = 'system cameras\n\ncomponent Camera {\n  run "camera" gate preload\n}\n'
    text += 'component Light {\n  run "light" gate preload\n}\n\nnode light : Light\n'
    text += "\n".join(f"namespace {side} {{\n  node camera : Camera\n}}\n" for side in ("left", "right"))
    system = checked(inserted(graph.observed(), text).text, tmp_path, "W031")  # nothing serves /right/light
    assert set(system.components) == {"Camera", "Light"}
    assert attached(system) == {
        "/left/camera/reset": {"left/camera.reset ->", "light.reset <-"},
        "/right/camera/reset": {"right/camera.reset ->"},
        "/left/light": {"left/camera.light <-", "light.light ->"},
        "/right/light": {"right/camera.light <-"},
    }
    assert not system.components["Camera"].functionalities["call"].modes[0].assumptions


def test_a_node_with_services_alone_is_in_a_draft_if_it_is_called(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.server("/maps", "/map", MAP)
    graph.client("/user", "/map", MAP)
    graph.server("/idle", "/idle/reset", RESET)
    system = checked(draft("s", graph.observed()), tmp_path)
    assert set(system.nodes) == {"maps", "user"}

"""What a graph proposes: ports, types and QoS are exact, rates within 5 %; a file keeps what it states."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.capture.graph_draft import draft
from midstride.capture.insertion import insert, without_remaps
from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.capture.probe import Dependence, ProbeVerdict
from midstride.capture.rates import measured
from midstride.errors import SpecificationError
from midstride.lang import format_text, load
from midstride.launch_files.launch_import import import_launch_file
from midstride.model.component import ComponentSpec
from midstride.model.specification import Specification
from tests.capture.simulated import SENSOR, SimulatedGraph, twenty

STRING = "std_msgs/msg/String"


def checked(text: str, folder: Path, *warnings: str) -> Specification:
    """The specification, in which there is no problem besides these warnings, and which is formatted."""
    file = folder / "captured.stride"
    file.write_text(text, encoding="utf-8")
    loaded = load(file)
    assert [each.code for each in loaded.diagnostics] == list(warnings), [str(each) for each in loaded.diagnostics]
    assert format_text(text).text == text
    return loaded.require()


def ports(system: Specification) -> set[tuple[str, str, str, bool, bool, bool]]:
    """Node, topic, type, whether it is an output, reliable, transient local: of every attached port."""
    found = set()
    for node in system.nodes.values():
        component = system.components[node.component]
        for port, topics in node.attachments.items():
            if component.has_output(port):
                mode = component.owner(port).modes[0]
                contract = mode.guarantees[port]
            else:
                contract = component.inputs[port]
            qos = contract.qos
            (topic,) = topics
            found.add(
                (
                    f"/{node.role}",
                    topic,
                    contract.type.replace("std_msgs/String", "std_msgs/msg/String"),
                    component.has_output(port),
                    qos.is_reliable,
                    qos.is_transient_local,
                )
            )
    return found


def of(endpoint: ObservedEndpoint) -> tuple[str, str, str, bool, bool, bool]:
    qos = endpoint.qos
    return endpoint.node, endpoint.topic, endpoint.type, endpoint.output, qos.is_reliable, qos.is_transient_local


def launch(graph: ObservedGraph, folder: Path) -> str:
    """The import of a launch file that starts the nodes of a graph."""
    lines = []
    for number, node in enumerate(graph.nodes()):
        namespace, _, name = node.rpartition("/")
        remap = '<remap from="out" to="/cmd_vel"/>' if name == "planner" else ""
        lines.append(f'<node exec="p{number}" name="{name}" namespace="{namespace}">{remap}</node>')
    file = folder / "all.launch.xml"
    file.write_text("<launch>\n" + "\n".join(lines) + "\n</launch>\n")
    return import_launch_file(file, {}, {}, folder).text


def test_twenty_nodes_are_captured_exactly(tmp_path: Path) -> None:
    graph = twenty().observed()
    imported = launch(graph, tmp_path)
    found = insert(imported, "all.stride", graph, rates=True)
    assert len(found.added) == 20 and found.left == {}
    system = checked(found.text, tmp_path, "W031")  # nothing publishes /joy
    assert ports(system) == {of(endpoint) for endpoint in graph.endpoints.values()}
    assert len(graph.endpoints) == 10 * 2 + 9 * 2 + 9 + 3
    rates = {
        f"/{node.role}": guarantee.rate
        for node in system.nodes.values()
        for port, guarantee in system.components[node.component].functionalities["main"].modes[0].guarantees.items()
        if guarantee.rate is not None
    }
    assert len(rates) == 20
    for number in range(10):
        stated = rates[f"/robot{number % 3}/sensor{number}"]
        assert 0.8 * 5.0 * (number + 1) <= stated <= 5.0 * (number + 1)
    # An input is assumed where a node of the file publishes its topic.
    assert "# no node here publishes what `joy` receives" in found.text and "assume filtered3" in found.text


def test_rates_are_within_five_per_cent() -> None:
    simulated = twenty()
    for names_publishers in (True, False):
        simulated.names_publishers = names_publishers
        graph = simulated.observed()
        for endpoint in graph.endpoints.values():
            rate = simulated.rates.get(endpoint.identity, 0.0)
            if rate:
                found = measured(graph.times(endpoint) or [])
                assert found is not None and abs(found.mean / rate - 1) < 0.05
                assert found.bound <= rate


def test_publishers_of_one_topic_are_measured_apart_only_where_messages_name_them() -> None:
    graph = SimulatedGraph()
    graph.publisher("/a", "/t", STRING, rate=10.0)
    graph.publisher("/b", "/t", STRING, rate=20.0)
    seen = graph.observed()
    rates = [measured(seen.times(each) or []) for each in seen.publishers("/t")]
    assert [round(rate.mean) for rate in rates if rate is not None] == [10, 20]
    graph.names_publishers = False
    text = draft("s", graph.observed())
    assert text.count("rate not measured: several nodes publish on the topic") == 2


def test_a_bound_is_below_what_was_measured_and_has_two_digits() -> None:
    regular = measured([number / 50 for number in range(500)])
    assert regular is not None and regular.bound == 47.0 and regular.mean == pytest.approx(50.0)
    assert str(regular) == ("measured 50 Hz; gaps: median 20 ms, 95 % 20 ms, longest 20 ms; proposed: @ 47 Hz")
    assert "gaps: median 1 s, 95 % 1 s, longest 1 s;" in str(measured([0.9997 * number for number in range(10)]))
    slow = measured([3.0 * number for number in range(10)])
    assert slow is not None and slow.bound == 0.31
    bursts = measured([number // 2 + 0.01 * (number % 2) for number in range(100)])
    assert bursts is not None and bursts.bound < 1.0 < bursts.mean
    assert measured([0.0, 1.0, 2.0]) is None and measured([1.0] * 10) is None and measured([]) is None


def test_without_rates_they_are_comments(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.publisher("/talker", "/chat", STRING, rate=50.0)
    graph.subscription("/ear", "/chat", STRING, SENSOR)
    text = draft("s", graph.observed())
    system = checked(text, tmp_path)
    guarantee = system.components["Talker"].functionalities["main"].modes[0].guarantees["chat"]
    assert guarantee.rate is None and "proposed: @ " in text


def test_with_rates_topics_state_what_all_of_their_publishers_offer(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.publisher("/fast", "/chat", STRING, rate=50.0)
    graph.publisher("/slow", "/chat", STRING, rate=10.0)
    graph.publisher("/slow", "/both", STRING, SENSOR, rate=10.0)
    graph.publisher("/once", "/both", STRING, SENSOR)
    system = checked(draft("s", graph.observed(), rates=True), tmp_path)
    offered = {connector.topic: connector.guarantee for connector in system.connectors.values()}
    assert offered["/chat"].rate == system.components["Slow"].functionalities["main"].modes[0].guarantees["chat"].rate
    assert offered["/both"].rate is None


FILE = """system chat  # ours

# The one that talks.
component Talker {
  run "ros2 run demo talker --ros-args -r topic:=/chat -r other:=/unused" gate preload
  parameters { rate = 50 }  # Hz
}

component Done { run "./done" gate preload
  output out
  functionality f {
    produces out
    mode normal { guarantee out : std_msgs/msg/String }
    mode degraded { }
  }
}

topic /done : std_msgs/msg/String

node talker : Talker {
  respawn
}
node done : Done { out -> /done }
node gone : Talker
"""


def test_the_rest_of_the_file_stays(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.publisher("/talker", "/chat", STRING, rate=50.0)
    graph.publisher("/talker", "/talker/state", STRING)
    graph.subscription("/talker", "/chat", STRING)
    graph.publisher("/done", "/done", STRING)
    graph.publisher("/other", "/done", STRING)
    found = insert(FILE, "chat.stride", graph.observed())
    assert found.added == ["/talker"]
    assert found.left == {
        "/done": "its component states its ports",
        "/gone": "it is not in the graph, or has no topics",
        "/other": "it is not in this file",
    }
    old, new = FILE.splitlines(), found.text.splitlines()
    lost = [line for line in old if line not in new]
    assert lost == ['  run "ros2 run demo talker --ros-args -r topic:=/chat -r other:=/unused" gate preload']
    assert '  run "ros2 run demo talker --ros-args -r other:=/unused" gate preload' in new
    for line in ("output chat_out as /topic", "output state as ~/state", "topic /chat : std_msgs/msg/String"):
        assert line in [each.strip() for each in new]
    (tmp_path / "chat.stride").write_text(found.text)
    loaded = load(tmp_path / "chat.stride")
    assert [each.code for each in loaded.diagnostics if each.severity == "error"] == []
    again = insert(found.text, "chat.stride", graph.observed())
    assert again.text == found.text and again.added == []


def test_nodes_that_share_a_component_share_its_ports(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    for side in ("left", "right"):
        graph.publisher(f"/{side}/camera", f"/{side}/image", "sensor_msgs/msg/Image", SENSOR, rate=10.0)
    text = """system cameras

component Camera {
  run "camera" gate preload
}

namespace left {
  node camera : Camera
}
namespace right {
  node camera : Camera
}
"""
    found = insert(text, "cameras.stride", graph.observed())
    system = checked(found.text, tmp_path)
    assert {dict(node.attachments)["image"] for node in system.nodes.values()} == {("/left/image",), ("/right/image",)}
    assert "as " not in found.text.replace("has", "")  # `image` in the namespace is what the program says


@pytest.mark.parametrize(("slow", "stated"), [(2.0, 1.9), (0.1, None)])
def test_nodes_that_share_a_component_state_the_rate_of_the_slowest(
    tmp_path: Path, slow: float, stated: float | None
) -> None:
    """Else the others would break its guarantee from the beginning. Of the slower one, one message says nothing."""
    graph = SimulatedGraph(jitter=0.0)
    for side, rate in (("left", 10.0), ("right", slow)):
        graph.publisher(f"/{side}/camera", f"/{side}/image", STRING, rate=rate)
    text = 'system cameras\n\ncomponent Camera {\n  run "camera" gate preload\n}\n\n'
    text += "\n".join(f"namespace {side} {{\n  node camera : Camera\n}}\n" for side in ("left", "right"))
    system = checked(insert(text, "cameras.stride", graph.observed(), rates=True).text, tmp_path)
    guarantee = system.components["Camera"].functionalities["main"].modes[0].guarantees["image"]
    topics = {connector.guarantee.rate for connector in system.connectors.values()}
    assert (guarantee.rate, topics) == (stated, {stated})


def test_an_output_that_has_gone_with_its_last_subscription_is_lazy(tmp_path: Path) -> None:
    """Also where only one of the nodes of a component has shown it."""
    graph = SimulatedGraph()
    for side in ("left", "right"):
        graph.publisher(f"/{side}/camera", f"/{side}/image", STRING)
        graph.publisher(f"/{side}/camera", f"/{side}/info", STRING)
    observed = graph.observed()
    observed.lazy.add(("/left/camera", "/left/image"))
    text = 'system cameras\n\ncomponent Camera {\n  run "camera" gate preload\n}\n\n'
    text += "\n".join(f"namespace {side} {{\n  node camera : Camera\n}}\n" for side in ("left", "right"))
    found = insert(text, "cameras.stride", observed).text
    assert "output image lazy" in found and "output info\n" in found
    assert checked(found, tmp_path).components["Camera"].lazy == {"image"}
    # A draft does not know what starts a node: the user adds it with the gate.
    drafted = draft("cameras", observed, rates=True)
    assert "# with a gate: `output image lazy`" in drafted and "output image\n" in drafted


def test_an_input_is_assumed_where_every_node_of_the_component_has_a_publisher(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.publisher("/left/lidar", "/left/scan", STRING)
    for side in ("left", "right"):
        graph.subscription(f"/{side}/driver", f"/{side}/scan", STRING)
    text = 'system s\n\ncomponent Lidar {\n  run "lidar" gate preload\n}\n\n'
    text += 'component Driver {\n  run "driver" gate preload\n}\n\n'
    text += "namespace left {\n  node lidar  : Lidar\n  node driver : Driver\n}\n\n"
    text += "namespace right {\n  node driver : Driver\n}\n"
    system = checked(insert(text, "s.stride", graph.observed()).text, tmp_path, "W031")  # nothing publishes /right/scan
    assert system.components["Driver"].functionalities["main"].modes[0].assumptions == ()


def test_a_topic_below_the_name_of_its_node_has_two_names_in_the_program(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    graph.publisher("/field/imu", "/field/imu/data", STRING)
    graph.publisher("/field/imu", "/field/state", STRING)
    text = 'system s\n\ncomponent Imu {\n  run "imu" gate preload\n}\n\nnamespace field {\n  node imu : Imu\n}\n'
    captured = insert(text, "s.stride", graph.observed()).text
    assert "  # `~/data`, or `imu/data`: see what the program calls it\n  output data as ~/data\n" in captured
    assert captured.count("see what") == 1
    checked(captured, tmp_path)


def test_names_of_ports_are_words_that_the_language_leaves_free() -> None:
    graph = SimulatedGraph()
    for topic in ("/mode", "/a/scan", "/b/scan", "/input", "/x/3d"):
        graph.publisher("/system/node1", topic, STRING)
    assert load_text(draft("s", graph.observed())) == []


def test_names_of_nodes_in_a_draft_are_each_their_own_and_no_words_of_the_language(tmp_path: Path) -> None:
    graph = SimulatedGraph()
    for node in ("/front_camera", "/front/camera", "/a/mode", "/a/mode_2"):
        graph.publisher(node, f"{node}/out", STRING)
    system = checked(draft("s", graph.observed()), tmp_path)
    assert {node.role: node.component for node in system.nodes.values()} == {
        "front_camera": "FrontCamera2",
        "front/camera": "FrontCamera",
        "a/mode_3": "AMode",
        "a/mode_2": "AMode2",
    }


def load_text(text: str) -> list[str]:
    return [str(each) for each in format_text(text).diagnostics]


def test_remaps_that_no_port_states_stay() -> None:
    command = "env A=b ros2 run p e --x --ros-args -r a:=/b -r c:=/d -p k:=1"
    assert without_remaps(command, {"a"}) == "env A=b ros2 run p e --x --ros-args -r c:=/d -p k:=1"
    assert without_remaps("./e --ros-args -r a:=/b", {"a"}) == "./e"
    assert without_remaps("./e  'x y'", {"a"}) == "./e  'x y'"


def test_a_command_without_its_closing_quotation_does_not_lose_what_was_captured() -> None:
    graph = SimulatedGraph()
    graph.publisher("/a", "/t", STRING)
    text = 'system s\n\ncomponent A {\n  run "python3 it\'s.py --ros-args -r x:=/t" gate preload\n}\n\nnode a : A\n'
    found = insert(text, "s.stride", graph.observed())
    assert 'run "python3 it\'s.py --ros-args -r x:=/t" gate preload' in found.text
    assert "node a : A { t -> /t }" in found.text


def test_a_file_with_errors_is_refused() -> None:
    with pytest.raises(SpecificationError, match=r"bad\.stride"):
        insert("system s\ncomponent {", "bad.stride", SimulatedGraph().observed())


def probed(verdicts: dict[tuple[str, str], ProbeVerdict]) -> dict[tuple[str, str, str], Dependence]:
    """Dependences of `/mixer`, by topics of an input and an output."""
    return {("/mixer", *topics): Dependence(verdict, f"seen {verdict}") for topics, verdict in verdicts.items()}


def mixer(folder: Path, verdicts: dict[tuple[str, str], ProbeVerdict]) -> tuple[str, ComponentSpec]:
    """The draft of a node with two inputs and two outputs of which this was found, and its component."""
    graph = SimulatedGraph()
    for topic in ("/a", "/b"):
        graph.publisher("/source", topic, STRING, rate=10.0)
        graph.subscription("/mixer", topic, STRING)
    for topic in ("/x", "/y"):
        graph.publisher("/mixer", topic, STRING, rate=10.0)
    text = draft("s", graph.observed(), findings=probed(verdicts))
    return text, checked(text, folder).components["Mixer"]


def needs(component: ComponentSpec) -> dict[str, tuple[tuple[str, ...], int, tuple[str, ...]]]:
    """By functionality: the inputs that it uses, how many it assumes, and its outputs."""
    return {each.name: (each.inputs, len(each.modes[0].assumptions), each.outputs) for each in component}


def test_what_was_probed_decides_what_is_assumed(tmp_path: Path) -> None:
    text, component = mixer(
        tmp_path,
        {("/a", "/x"): "depends", ("/a", "/y"): "undecided", ("/b", "/x"): "independent", ("/b", "/y"): "indirect"},
    )
    assert needs(component) == {"main": (("a", "b"), 1, ("x", "y"))}
    assert "assume a  # probed: x depends on it (seen depends); y is not decided (seen undecided)\n" in text
    assert "# `b` is not assumed: x does not depend on it (seen independent); y depends on it (seen indirect)\n" in text


def test_outputs_that_depend_on_other_inputs_are_in_a_functionality_of_their_own(tmp_path: Path) -> None:
    _, component = mixer(
        tmp_path,
        {("/a", "/x"): "depends", ("/a", "/y"): "independent", ("/b", "/x"): "independent", ("/b", "/y"): "depends"},
    )
    assert needs(component) == {"make_x": (("a",), 1, ("x",)), "make_y": (("b",), 1, ("y",))}
    _, component = mixer(
        tmp_path,
        {
            ("/a", "/x"): "independent",
            ("/a", "/y"): "depends",
            ("/b", "/x"): "independent",
            ("/b", "/y"): "independent",
        },
    )
    assert needs(component) == {"make_x": (("b",), 0, ("x",)), "make_y": (("a",), 1, ("y",))}


def test_without_a_finding_an_input_is_assumed_as_before(tmp_path: Path) -> None:
    text, component = mixer(tmp_path, {("/a", "/x"): "independent", ("/a", "/y"): "independent"})
    assert needs(component) == {"main": (("a", "b"), 1, ("x", "y"))}
    assert "assume b\n" in text


def test_a_component_depends_on_what_one_of_its_nodes_depends_on() -> None:
    graph, findings = SimulatedGraph(), {}
    text = 'system cameras\n\ncomponent Filter {\n  run "filter" gate preload\n}\n'
    verdicts: dict[str, ProbeVerdict] = {"left": "independent", "right": "depends"}
    for side, verdict in verdicts.items():
        graph.publisher("/camera", f"/{side}/image", STRING, SENSOR, rate=10.0)
        graph.subscription(f"/{side}/filter", f"/{side}/image", STRING, SENSOR)
        graph.publisher(f"/{side}/filter", f"/{side}/edges", STRING, rate=10.0)
        findings[f"/{side}/filter", f"/{side}/image", f"/{side}/edges"] = Dependence(verdict, "seen")
        text += f"namespace {side} {{\n  node filter : Filter\n}}\n"
    text += 'component Camera { run "camera" gate preload }\nnode camera : Camera\n'
    assert (
        "assume image  # probed: edges depends on it (seen)"
        in insert(text, "c", graph.observed(), False, findings).text
    )
    del findings["/right/filter", "/right/image", "/right/edges"]
    assert "`image` is not assumed" in insert(text, "c", graph.observed(), False, findings).text

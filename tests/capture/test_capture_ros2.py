"""A planted system of twenty plain rclpy nodes is captured from the live graph, and its specification is clean."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from midstride.capture.graph_draft import draft
from midstride.capture.insertion import insert
from midstride.capture.observed import ObservedGraph
from midstride.capture.rates import measured
from midstride.launch_files.launch_import import import_launch_file
from midstride.model.contract import QoS
from tests.capture.test_capture import checked, of, ports
from tests.test_ament_index import planted as planted_program

LIFECYCLE = {"change_state": "ChangeState", "get_state": "GetState"}
RATES = {f"/robot{number % 3}/sensor{number}": 2.0 + number for number in range(10)}


@pytest.fixture
def planted() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, str(Path(__file__).with_name("planted.py"))])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def launch_file(folder: Path) -> Path:
    sensors = [f'<node exec="planted" name="{node[8:]}" namespace="{node[1:7]}"/>' for node in RATES]
    filters = [f'<node exec="planted" name="filter{number}"/>' for number in range(9)]
    file = folder / "planted.launch.xml"
    file.write_text("<launch>" + "\n".join([*sensors, *filters, '<node exec="planted" name="planner"/>']) + "</launch>")
    return file


@pytest.mark.ros2
@pytest.mark.full
def test_a_planted_system_is_captured_exactly(tmp_path: Path, planted: None) -> None:
    from midstride.backends.ros2.manager.observer import observe

    def done(graph: ObservedGraph) -> bool:
        """Every endpoint has been seen, and every sensor has been heard for a while."""
        sensors = [each for each in graph.endpoints.values() if each.node in RATES and each.output]
        return len(graph.endpoints) == 48 and all(len(graph.times(each) or []) > 20 for each in sensors)

    graph = observe(100.0, list(RATES), done)
    assert len(graph.endpoints) == 48  # 10 sensors with 2, 9 filters with 2, the planner with 10
    latched = {each.node for each in graph.endpoints.values() if each.qos.is_transient_local}
    assert latched == {*RATES, "/planner"}
    best_effort = [each for each in graph.endpoints.values() if not each.qos.is_reliable]
    assert {each.topic.rpartition("/")[2] for each in best_effort} == {"scan"} and len(best_effort) == 19
    assert {each.qos for each in best_effort} == {
        QoS(reliability="best_effort", durability="volatile", liveliness="automatic")
    }

    imported = import_launch_file(launch_file(tmp_path), {}, {}, tmp_path)
    assert imported.nodes == 20 and len(imported.findings) == 0
    found = insert(imported.text, "planted.stride", graph)
    assert len(found.added) == 20 and found.left == {}
    system = checked(found.text, tmp_path)
    assert ports(system) == {of(endpoint) for endpoint in graph.endpoints.values()}

    for endpoint in graph.endpoints.values():
        if endpoint.output and endpoint.node in RATES:
            rate = measured(graph.times(endpoint) or [])
            assert rate is not None
            print(endpoint.node, RATES[endpoint.node], rate)
            assert 0.5 * RATES[endpoint.node] < rate.mean < 1.2 * RATES[endpoint.node]


@pytest.mark.ros2
def test_the_node_of_launch_is_no_lifecycle_manager() -> None:
    from midstride.backends.ros2.manager.observer import _look_at_services

    served = [(f"/camera/{service}", [f"lifecycle_msgs/srv/{type_}"]) for service, type_ in LIFECYCLE.items()]
    callers = ("launch_ros_4711", "lifecycle_manager", "launch_ros_tool")
    node = SimpleNamespace(
        get_node_names_and_namespaces=lambda: [(name, "/") for name in ("camera", *callers)],
        get_service_names_and_types_by_node=lambda name, _: served if name == "camera" else [],
        get_client_names_and_types_by_node=lambda name, _: served if name in callers else [],
    )
    graph = ObservedGraph()
    _look_at_services(node, graph)
    assert graph.lifecycle == {"/camera"}
    assert graph.managers_of("/camera") == ["/launch_ros_tool", "/lifecycle_manager"]


# Two nodes in a process, of which one has the service by which a container loads nodes.
CONTAINER = f"""#!{sys.executable}
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String
from std_srvs.srv import Trigger

rclpy.init()
box, talker = rclpy.create_node("box"), rclpy.create_node("talker", use_global_arguments=False)
box.create_service(Trigger, "~/_container/load_node", lambda _, response: response)
publisher = talker.create_publisher(String, "chatter", 10)
talker.create_timer(0.1, lambda: publisher.publish(String(data="x")))
executor = SingleThreadedExecutor()
executor.add_node(box)
executor.add_node(talker)
executor.spin()
"""


@pytest.mark.ros2
@pytest.mark.long
def test_the_program_of_a_container_is_in_the_draft(tmp_path: Path) -> None:
    from midstride.backends.ros2.manager.observer import observe
    from midstride.backends.ros2.middleware import of_this_process

    program = Path(planted_program(tmp_path, "own_containers", "own_container")) / "lib/own_containers/own_container"
    program.write_text(CONTAINER, encoding="utf-8")
    command = [str(program), "--ros-args", "-r", "__ns:=/front"]
    with subprocess.Popen(command) as process:
        try:
            graph = observe(60.0, ["/talker"], lambda graph: {"/talker", "/front/box"} <= {*graph.processes})
            for _ in range(20):
                if graph.containers:
                    break
                graph = observe(1.0, ["/talker"])
        finally:
            process.kill()
    known = {"/front/box": ("own_container", "own_containers")} if of_this_process().fast_dds else {}
    assert (graph.containers, graph.programs) == ({"/front/box"}, known)
    stated = ' { run "own_container" package "own_containers" }' if known else ""
    assert f"container /front/box{stated}\n" in draft("robot", graph)

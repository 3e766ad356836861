"""The graph as the manager's node sees it."""

from __future__ import annotations

from contextlib import ExitStack
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2 import middleware, names
from midstride.backends.ros2.names import InstanceNode
from tests.backends.ros2_support import Bare, run

pytestmark = pytest.mark.ros2


def test_the_endpoints_of_every_node_of_a_name_are_found() -> None:
    """A node that has ended stays for a while, beside its replacement. What rclpy lists by name is of one of them."""
    from std_msgs.msg import String

    from midstride.backends.ros2.manager.graph import Graph

    async def scenario() -> None:
        with ExitStack() as nodes:
            watching = nodes.enter_context(Bare("watching"))
            for topic in ("/old", "/new"):
                talker = nodes.enter_context(Bare("talker"))
                talker.node.create_publisher(String, topic, 10)
                talker.node.create_subscription(String, f"{topic}/answers", lambda _: None, 10)
            graph = Graph(watching.node)
            expected = {(True, "/old"), (True, "/new"), (False, "/old/answers"), (False, "/new/answers")}

            def found() -> bool:
                return {(each.output, each.topic) for each in graph.of_process("/talker")} >= expected

            await watching.until(found)
            assert graph.of_process("/no_such_node") == []

    run(scenario())


def test_what_a_node_calls_is_named_without_its_own_services() -> None:
    from rcl_interfaces.srv import GetParameters, SetParameters
    from std_srvs.srv import Trigger

    from midstride.backends.ros2.manager.graph import Graph

    async def scenario() -> None:
        with Bare("watching") as watching, Bare("caller") as caller:
            caller.node.create_client(Trigger, "/map/save")
            caller.node.create_client(Trigger, "/caller/reset")  # its own
            caller.node.create_client(GetParameters, "/nav/planner/get_parameters")
            caller.node.create_client(SetParameters, "/nav/planner/set_parameters")
            for part in ("send_goal", "get_result", "cancel_goal"):
                caller.node.create_client(Trigger, f"/dock/_action/{part}")
            graph = Graph(watching.node)
            expected = ("ROS action /dock", "service /map/save", "the parameters of /nav/planner")
            await watching.until(lambda: graph.served_by("/caller").calls == expected)
            assert graph.served_by("/no_such_node").calls == ()

    run(scenario())


@pytest.mark.parametrize("shown", [True, False])
def test_the_type_of_a_server_is_that_of_its_own_process(shown: bool) -> None:
    """During a replacement the graph lists both types; without request readers it cannot tell whose they are."""
    from midstride.backends.ros2.manager.graph import Graph
    from midstride.backends.ros2.middleware import RmwImplementation

    both = ["nav_msgs/srv/GetMap", "nav_msgs/srv/GetPlan"]
    readers = {
        "rq/planRequest": [
            SimpleNamespace(endpoint_gid=bytes([process] * 16), topic_type=f"nav_msgs::srv::dds_::{type_}_Request_")
            for process, type_ in ((1, "GetPlan"), (2, "GetMap"))
        ]
    }
    node = SimpleNamespace(
        get_service_names_and_types=lambda: [("/plan", both)],
        get_subscriptions_info_by_topic=lambda topic, no_mangle: readers[topic] if shown and no_mangle else [],
        get_client_names_and_types_by_node=lambda *_: [],
    )
    graph = Graph(node, RmwImplementation("one", participant=12))

    def types(process: int | None) -> list[str]:
        mark = None if process is None else bytes([process] * 16)
        return sorted(each.type for each in graph.served_by("/planner", {"/plan"}, mark).servers)

    assert types(None) == both
    assert types(1) == (["nav_msgs/srv/GetPlan"] if shown else both)
    assert types(2) == (["nav_msgs/srv/GetMap"] if shown else both)
    assert types(3) == ([] if shown else both), "its reader is not in the graph yet"


class ListedGraph:
    """What rclpy's node tells of a graph that is drawn: processes with nodes, some of one name, with endpoints."""

    TOPICS = ("/parameter_events", "/a", "/b")

    def __init__(self, rng: Random) -> None:
        self.nodes: list[tuple[str, str]] = []
        # By topic and whether they publish.
        self.infos: dict[tuple[str, bool], list[Any]] = {
            (topic, out): [] for topic in self.TOPICS for out in (True, False)
        }
        for process in range(rng.randint(1, 5)):
            role = rng.choice("pq")
            control = names.control(f"{role}_{process}", role, rng.choice(("", "0123abcd")))
            for name in [role, control] if rng.random() < 0.7 else [rng.choice([role, f"{role}_{process}"])]:
                self.nodes.append((name, "/"))
                if rng.random() < 0.8:  # else it is one that is gone: its name stays for a while
                    self._add(name, process, rng)

    def _add(self, name: str, process: int, rng: Random) -> None:
        places = rng.sample(sorted(self.infos), 2)
        if rng.random() < 0.8 or names.controlled(f"/{name}"):  # not every foreign node publishes there
            places.append(("/parameter_events", True))
        for topic, out in places:
            gid = bytes([process] * 12 + [sum(map(len, self.infos.values()))] * 4)
            info = SimpleNamespace(node_name=name, node_namespace="/", endpoint_gid=list(gid))
            self.infos[topic, out].append(info)

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return self.nodes

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(topic, []) for topic in self.TOPICS]

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return self.infos[topic, True]

    def get_subscriptions_info_by_topic(self, topic: str) -> list[Any]:
        return self.infos[topic, False]

    def _by_node(self, node: tuple[str, str], out: bool) -> list[tuple[str, list[str]]]:
        """The topics of the first of that name, as of a process that rclpy happens to find first."""
        from rclpy.node import NodeNameNonExistentError

        if node not in self.nodes:
            raise NodeNameNonExistentError(node[0])
        own = [(topic, info) for topic in self.TOPICS for info in self.infos[topic, out] if info.node_name == node[0]]
        first = min((info.endpoint_gid[0] for _, info in own), default=None)
        return [(topic, []) for topic, info in own if info.endpoint_gid[0] == first]

    def get_publisher_names_and_types_by_node(self, name: str, inside: str) -> list[tuple[str, list[str]]]:
        return self._by_node((name, inside), True)

    def get_subscriber_names_and_types_by_node(self, name: str, inside: str) -> list[tuple[str, list[str]]]:
        return self._by_node((name, inside), False)


@pytest.mark.parametrize(
    ("nodes", "others"),
    [((), False), (("p", "_p_control_0123abcd_of_p"), False), (("p",), True), (("p", "p", "_p_control"), True)],
)
def test_nodes_of_a_name_that_no_instance_has_are_told_from_instances(nodes: tuple[str, ...], others: bool) -> None:
    from midstride.backends.ros2.manager.graph import Graph

    infos = [SimpleNamespace(node_name=name, node_namespace="/") for name in nodes]
    node = SimpleNamespace(
        get_node_names_and_namespaces=lambda: [(name, "/") for name in (*nodes, "q")],
        get_publishers_info_by_topic=lambda topic: infos,
    )
    assert Graph(node).shows_others("/p") is others


def test_processes_of_a_name_that_have_ended_are_not_listed() -> None:
    """They stay in the graph until their leases are over, beside the process that has the name now."""
    from midstride.backends.ros2.manager.graph import Graph

    listed = ListedGraph(Random(0))
    listed.nodes = [(name, "/") for name in ("p", "_p_control_0123abcd_of_p") for _ in range(3)]
    listed.infos = {place: [] for place in listed.infos}
    graph = Graph(listed)

    def starts(process: int) -> None:
        graph.starts("/p")
        for name in ("p", "_p_control_0123abcd_of_p"):
            gid = [process] * 12 + [len(name)] * 4
            listed.infos["/parameter_events", True].append(
                SimpleNamespace(node_name=name, node_namespace="/", endpoint_gid=gid)
            )

    for process in (1, 2, 3):
        starts(process)
        keys = {found.key[0] for _, found in graph.processes()}
        assert keys == {process}
        graph.died("/p")


def test_a_node_that_no_instance_has_any_more_does_not_live() -> None:
    """Its container goes on, and the graph shows it still; nor does one that comes later take the place of another."""
    from midstride.backends.ros2.manager.graph import Graph

    listed = ListedGraph(Random(0))
    listed.nodes, listed.infos = [], {place: [] for place in listed.infos}
    mark = bytes([7] * 12)
    marked = [(mark, InstanceNode("/p_2", "/p", "0123abcd"))]

    def comes(name: str) -> None:
        listed.nodes.append((name, "/"))
        gid = [7] * 12 + [len(name), ord(name[0])] * 2
        info = SimpleNamespace(node_name=name, node_namespace="/", endpoint_gid=gid)
        listed.infos["/a", True].append(info)

    graph = Graph(listed, middleware.RmwImplementation("rmw_fastrtps_cpp", participant=12), marked=lambda: marked)
    for name in ("p", "q"):
        comes(name)
    assert graph.has("/q") and [found.instance for found in graph.of_name("/q") if found] == ["/p_2"]
    marked.append((mark, InstanceNode("", "/q", "0123abcd")))
    assert not graph.has("/q") and graph.of_name("/q") == set()
    assert [found.instance for found in graph.of_name("/p") if found] == ["/p_2"]
    assert graph.endpoints(["/a"]).nodes == {"/p_2"}
    marked[1:] = [(mark, InstanceNode("/q_3", "/q", "0123abcd")), (mark, InstanceNode("", "/q", "0123abcd"))]
    assert [found.instance for found in graph.of_name("/q") if found] == ["/q_3"]
    assert graph.endpoints(["/a"]).nodes == {"/p_2", "/q_3"}


def test_what_is_looked_up_by_name_is_what_a_look_at_every_endpoint_finds() -> None:
    from midstride.backends.ros2.manager.graph import Graph

    found = 0
    for seed in range(300):
        rng = Random(seed)
        listed = ListedGraph(rng)
        graph, dead, died = Graph(listed), set(), set(rng.sample(["/p", "/q", "/p_0", "/q_1"], 1))
        known = {f"/{name}" for name in "pq"} | {f"/{role}_{number}" for role in "pq" for number in range(5)}
        instances = {
            bytes(info.endpoint_gid[:12]): control
            for info in listed.infos["/parameter_events", True]
            if (control := names.controlled(f"/{info.node_name}")) is not None
        }

        def shown(info: Any, instances: Any = instances) -> tuple[str, Any]:
            """The name that an endpoint is shown under, and the instance that it belongs to."""
            node, instance = f"/{info.node_name}", instances.get(bytes(info.endpoint_gid[:12]))
            return (instance.instance if instance is not None and instance.node == node else node), instance

        every = [info for infos in listed.infos.values() for info in infos]
        for name in rng.sample(sorted(known), 3):
            if rng.random() < 0.5:
                graph.ignore(name)
                dead |= {bytes(info.endpoint_gid) for info in every if shown(info)[0] == name}
        for name in died:
            graph.died(name)
        living = [info for info in every if bytes(info.endpoint_gid) not in dead and shown(info)[0] not in died]
        for name in sorted(known):
            assert graph.has(name) == any(shown(info)[0] == name for info in living), (seed, name)
            expected = {shown(info)[1] for info in living if f"/{info.node_name}" == name}
            assert graph.of_name(name) == expected, (seed, name)
            found += len(expected)
    assert found > 300

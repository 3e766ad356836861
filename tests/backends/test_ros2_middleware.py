"""What an implementation of rmw can tell: the one in use, and others as their sources say that they answer."""

from __future__ import annotations

import hashlib
import socket
from contextlib import ExitStack
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2 import dds_profiles, distributions, middleware, names, zenoh_router
from midstride.backends.ros2.middleware import of_identifier
from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.model.contract import QoS
from tests.backends.ros2_support import Bare, run
from tests.backends.test_ros2_graph import ListedGraph

FAST_DDS, CYCLONE_DDS, ZENOH, OTHER = map(
    of_identifier, ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp", "rmw_zenoh_cpp", "rmw_of_tomorrow")
)
INFO = {"source_timestamp": 7, "publication_sequence_number": 3, "publisher_gid": {"data": bytes(range(24))}}


def test_of_an_implementation_that_is_not_known_nothing_is_said() -> None:
    info = SimpleNamespace(endpoint_gid=[1] * 16)
    assert OTHER.process_of(info) is None
    assert (OTHER.acknowledges, OTHER.names_writers, OTHER.message_info(INFO).number) == (False, False, None)
    assert len(list(OTHER.limits())) == 3


@pytest.mark.parametrize(
    ("rmw", "unknown"),
    [(FAST_DDS, []), (CYCLONE_DDS, ["sequence numbers"]), (ZENOH, ["processes", "acknowledgements"])],
)
def test_status_says_what_the_middleware_does_not_tell(rmw: middleware.RmwImplementation, unknown: list[str]) -> None:
    settings = dds_profiles.choose({}, rmw.identifier, 3)
    notes = settings.described({}, settings.warnings).notes
    assert [note.partition(":")[0] for note in notes if not note.startswith("discovery")] == unknown
    assert all(rmw.identifier in note for note in notes)


@pytest.mark.ros2
@pytest.mark.parametrize(("stated", "domain"), [(None, "0"), ("", "0"), (" 07", "7"), ("43", "43")])
def test_what_a_manager_reaches_is_by_the_implementation_that_is_loaded_and_its_domain(
    stated: str | None, domain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever way the implementation was chosen: there may be one only, or the variable may name the default."""
    import rclpy

    from midstride.backends.ros2 import create_backend

    if stated is None:
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    else:
        monkeypatch.setenv("ROS_DOMAIN_ID", stated)
    backend, loaded = create_backend(tmp_path / "components"), rclpy.get_rmw_implementation_identifier()
    assert backend.reach() == {"ROS_DOMAIN_ID": domain, "RMW_IMPLEMENTATION": loaded}
    monkeypatch.setattr(rclpy, "get_rmw_implementation_identifier", lambda: "rmw_cyclonedds_cpp")
    assert backend.reach() == {"ROS_DOMAIN_ID": domain, "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}


@pytest.mark.parametrize(
    ("rmw", "number", "expected"),
    [(FAST_DDS, 3, 3), (CYCLONE_DDS, 2**64 - 1, None), (ZENOH, 3, 3), (FAST_DDS, 2**64 - 1, None), (OTHER, 0, None)],
)
def test_a_number_that_is_not_one_is_unknown(
    rmw: middleware.RmwImplementation, number: int, expected: int | None
) -> None:
    found = rmw.message_info({**INFO, "publication_sequence_number": number})
    writer = bytes(range(16)).hex()
    shared = writer if rmw in (FAST_DDS, ZENOH) else None
    assert (found.source, found.number, found.publisher) == (7, expected, shared)
    assert found.distinct_writer == writer
    assert rmw.message_info(None) == rmw.message_info({})


OVERRIDE = "ZENOH_CONFIG_OVERRIDE"


@pytest.mark.parametrize(
    ("environment", "routers"),
    [
        ({}, [("localhost", 7447)]),
        ({OVERRIDE: 'mode="client"'}, [("localhost", 7447)]),
        ({OVERRIDE: 'mode="client";connect/endpoints=["tcp/10.0.0.2:7448"]'}, [("10.0.0.2", 7448)]),
        (
            {OVERRIDE: 'connect/endpoints=["tcp/[fe80::1]:1#iface=eth0", "tcp/base:2"];connect/timeout_ms=5'},
            [("fe80::1", 1), ("base", 2)],
        ),
        ({OVERRIDE: 'connect/endpoints=["tcp/base:2"]', "ZENOH_SESSION_CONFIG_URI": "own.json5"}, [("base", 2)]),
        ({"ZENOH_SESSION_CONFIG_URI": "own.json5"}, []),
        ({OVERRIDE: 'connect/endpoints=["tcp/base:2", "tls/base:7447"]'}, []),
        ({OVERRIDE: "connect/endpoints=['tcp/base:2']"}, []),
        ({OVERRIDE: 'connect/endpoints={"peer": ["tcp/base:2"]}'}, []),
        ({OVERRIDE: 'connect={"endpoints": []}'}, []),
        ({OVERRIDE: "connect/endpoints=[]"}, []),
        ({OVERRIDE: "connect/endpoints=[7]"}, []),
    ],
)
def test_where_a_router_of_zenoh_is_looked_for_is_as_the_environment_has_it_else_unknown(
    environment: dict[str, str], routers: list[tuple[str, int]]
) -> None:
    assert zenoh_router.routers(environment) == routers
    asked = list[tuple[str, int]]()

    def unanswered(address: tuple[str, int]) -> bool:
        asked.append(address)
        return False

    said = zenoh_router.problem("rmw_zenoh_cpp", environment, unanswered)
    assert asked == routers and bool(said) == bool(routers), "where it is not known, nothing is said"
    assert zenoh_router.problem("rmw_zenoh_cpp", environment, lambda _: True) == ""
    assert zenoh_router.problem("rmw_fastrtps_cpp", environment, unanswered) == ""


def test_a_router_that_does_not_answer_is_named() -> None:
    environment = {OVERRIDE: 'connect/endpoints=["tcp/[::1]:1","tcp/base:2"]'}
    said = zenoh_router.problem("rmw_zenoh_cpp", environment, lambda _: False)
    assert said.startswith("no Zenoh router answers at tcp/[::1]:1 or tcp/base:2: the nodes do not find each other")
    assert not zenoh_router.answers(("localhost", 99_999)), "there is no such port"


def test_a_router_answers_where_it_accepts_a_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as router:
        address = router.getsockname()
        assert zenoh_router.answers(address)
    assert not zenoh_router.answers(address)


@pytest.mark.ros2
def test_the_distribution_is_that_which_is_sourced_else_that_of_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = distributions.of_this_process()
    assert installed in ("jazzy", "kilted")
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert distributions.of_this_process() == installed
    monkeypatch.setenv("ROS_DISTRO", "lyrical")
    assert distributions.of_this_process() == "lyrical"


@pytest.mark.ros2
@pytest.mark.parametrize(("rmw", "expected"), [(FAST_DDS, True), (CYCLONE_DDS, True), (ZENOH, None), (OTHER, None)])
def test_an_acknowledgement_that_nothing_checks_is_unknown(
    rmw: middleware.RmwImplementation, expected: bool | None
) -> None:
    from midstride.backends.ros2.component.port_endpoints import RosPublisher

    class Unchecked:
        """Answers as rmw_zenoh does: at once that everything has arrived."""

        topic_name = "/chatter"

        def publish(self, message: Any) -> None: ...

        def wait_for_all_acked(self, timeout: Any) -> bool:
            return True

    reader = SimpleNamespace(endpoint_gid=[1] * 16)
    publisher = RosPublisher(Unchecked(), QoS(), rmw, lambda _: None, lambda _: [reader])
    assert run(publisher.acknowledged(1.0)) is expected
    assert publisher.reader_ids() == (frozenset() if rmw is OTHER else {"01" * 16})


def hashed(listed: ListedGraph) -> dict[bytes, int]:
    """Give every endpoint a gid as rmw_zenoh does, and return the process that each has in truth."""
    processes: dict[bytes, int] = {}
    for infos in listed.infos.values():
        for info in infos:
            gid = hashlib.blake2b(bytes(info.endpoint_gid), digest_size=16).digest()
            processes[gid] = info.endpoint_gid[0]
            info.endpoint_gid = list(gid)
    return processes


@pytest.mark.ros2
def test_where_processes_are_unknown_an_unmodified_node_of_the_system_is_no_foreign_one() -> None:
    """They are counted: with one more of that name, one is foreign, whichever that is."""
    from midstride.backends.ros2.manager.graph import Graph

    listed = ListedGraph(Random(0))
    listed.infos = {place: [] for place in listed.infos}
    own = names.InstanceNode("/talker_1", "/talker", "0123abcd")
    graph = Graph(listed, ZENOH, lambda: [(b"", own), (b"", names.InstanceNode("", "/left", "0123abcd"))])
    for nodes, expected in (
        (["talker"], {own}),
        (["talker", "talker"], {own, None}),
        (["left"], set()),
        (["left", "left"], {None}),
    ):
        listed.nodes = [(node, "/") for node in nodes]
        assert graph.of_name(f"/{nodes[0]}") == expected


@pytest.mark.ros2
def test_where_processes_are_unknown_no_endpoint_is_shown_as_an_instance_that_it_may_not_be_of() -> None:
    from midstride.backends.ros2.manager.graph import Graph

    told_apart = left = foreign = 0
    for seed in range(600):
        listed = ListedGraph(Random(seed))
        processes = hashed(listed)
        graph = Graph(listed, ZENOH)
        instances = {
            processes[bytes(info.endpoint_gid)]: found
            for info in listed.infos["/parameter_events", True]
            if (found := names.controlled(f"/{info.node_name}")) is not None
        }
        for out in (True, False):
            for topic in ("/a", "/b"):
                ends = graph.endpoints()
                shown = [name for name, on in (ends.publishers if out else ends.subscribers) if on == topic]
                expected = []
                for info in listed.infos[topic, out]:
                    node, true = f"/{info.node_name}", instances.get(processes[bytes(info.endpoint_gid)])
                    alone = listed.nodes.count((info.node_name, "/")) == 1
                    instance = true.instance if true is not None and true.node == node and alone else node
                    if not names.is_hidden(node):
                        expected.append(instance)
                        told_apart += instance != node
                        left += true is not None and true.node == node and not alone
                assert sorted(shown) == sorted(expected), seed
        for node in ("/p", "/q"):
            named = graph.of_name(node)
            own = {instance for instance in instances.values() if instance.node == node}
            others = listed.nodes.count((node[1:], "/")) > len(own)
            assert named == {*own, *([None] if others else [])}, seed
            foreign += others
    assert told_apart > 100 and left > 100 and foreign > 20


@pytest.mark.ros2
@pytest.mark.parametrize("rmw", [FAST_DDS, CYCLONE_DDS])
def test_a_message_is_no_endpoints_where_its_writer_is_unknown(
    rmw: middleware.RmwImplementation, monkeypatch: pytest.MonkeyPatch
) -> None:
    from midstride.backends.ros2.manager import observer

    class Listening:
        def create_subscription(self, type_: type, topic: str, callback: Any, *_: object, **__: object) -> None:
            self.heard = callback

    monkeypatch.setattr(middleware, "of_this_process", lambda: rmw)
    writers = [
        ObservedEndpoint(
            f"/talker_{number}", "/chatter", "std_msgs/msg/String", True, QoS(), bytes([number] * 16).hex()
        )
        for number in range(2)
    ]
    graph, node = ObservedGraph(), Listening()
    graph.saw(writers)
    observer._subscribe(node, graph, writers)
    node.heard(b"", {**INFO, "publisher_gid": bytes([1] * 16)})
    assert [graph.times(each) for each in writers] == ([[], [7e-9]] if rmw is FAST_DDS else [None, None])


@pytest.mark.ros2
def test_the_middleware_in_use_tells_what_is_said_of_it() -> None:
    from std_msgs.msg import String

    from midstride.backends.ros2.component.port_endpoints import for_rclpy

    async def scenario() -> None:
        rmw = middleware.of_this_process()
        with ExitStack() as nodes:
            watching, talker = nodes.enter_context(Bare("watching")), nodes.enter_context(Bare("talker"))
            heard: list[Any] = []
            watching.node.create_subscription(
                String, "/chatter", for_rclpy(lambda _, info: heard.append(rmw.message_info(info))), 10
            )
            publisher = talker.node.create_publisher(String, "/chatter", 10)
            await watching.until(lambda: publisher.get_subscription_count() == 1)
            await watching.until(lambda: len(watching.node.get_publishers_info_by_topic("/chatter")) == 1)
            for _ in range(3):
                publisher.publish(String(data="word"))
            await watching.until(lambda: len(heard) == 3)
            assert [each.number for each in heard] == ([1, 2, 3] if rmw.numbers_messages else [None] * 3)
            (end,) = watching.node.get_publishers_info_by_topic("/chatter")
            known = {each.publisher for each in heard} - {None}  # rclpy passes it on since kilted
            assert {each[:32] for each in known} == ({bytes(end.endpoint_gid).hex()[:32]} if known else set())
            assert rmw.names_writers or not known
            ends = watching.node.get_publishers_info_by_topic
            talker.node.create_publisher(String, "/more", 10)
            watching.node.create_publisher(String, "/more", 10)
            await watching.until(lambda: {info.node_name for info in ends("/more")} == {"talker", "watching"})
            by_node = {info.node_name: rmw.process_of(info) for info in ends("/more")}
            assert rmw.process_of(end) == by_node["talker"] != by_node["watching"]

    run(scenario())

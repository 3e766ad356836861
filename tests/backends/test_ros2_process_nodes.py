"""Which nodes end with an instance, from what the library, the graph and /proc tell of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from midstride.backends.ros2 import names
from midstride.backends.ros2.middleware import PIDS, NodeProcess, RmwImplementation, of_identifier
from midstride.foreign.graph_check import NamedServer, Served
from midstride.runtime.backend_protocol import OtherNode, OtherNodes

pytestmark = pytest.mark.ros2

HERE, ELSEWHERE = b"here", b"away"
FAST, CYCLONE, ZENOH = map(of_identifier, ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp", "rmw_zenoh_cpp"))


def fast(pid: int, host: bytes = HERE, random: bytes = b"r") -> NodeProcess:
    return NodeProcess(host + pid.to_bytes(4, "little") + random, host, pid % PIDS)


@dataclass
class DrawnGraph:
    """What the graph shows: nodes with their processes."""

    rmw: RmwImplementation
    shown: list[tuple[str, NodeProcess]] = field(default_factory=list)
    own_name: str = "/_manager"

    def processes(self) -> list[tuple[str, NodeProcess]]:
        return [*self.shown, (self.own_name, fast(1))]

    def published_by(self, node: str) -> list[str]:
        return [f"{node}/said"]

    def served_by(self, node: str) -> Served:
        return Served((NamedServer("service", f"{node}/save", "std_srvs/srv/Trigger"),))


def found(graph: DrawnGraph, asked: Sequence[Any], families: dict[str, set[int]] | None = None) -> dict[str, Any]:
    """The names of the other nodes of each instance that has any, or why they are not known."""
    from midstride.backends.ros2.manager.process_nodes import other_nodes

    answer = other_nodes(cast("Any", graph), asked, lambda: families or {})
    return {name: each.unknown or each.names for name, each in answer.items()}


def test_those_of_its_process_and_of_what_it_has_started_are_found_and_no_others() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess, other_nodes

    graph = DrawnGraph(
        FAST,
        [
            ("/box", fast(10)),
            ("/camera", fast(10)),
            ("/_hidden", fast(10)),
            ("/started", fast(11)),
            ("/box", fast(10, ELSEWHERE)),  # another robot's, in its own process 10
            ("/camera_there", fast(10, ELSEWHERE)),
            ("/rviz", fast(12)),
            ("/talker", fast(13)),
            (f"/{names.control('talker', 'talker', '0123abcd')}", fast(13)),
            ("/listener", fast(14)),
        ],
    )
    asked = [AskedProcess("box", "/box"), AskedProcess("talker"), AskedProcess("listener", "/listener")]
    families = {"box": {10, 11}, "talker": {13}, "listener": {14}}
    assert found(graph, asked, families) == {"box": ["/camera", "/started"]}
    described = other_nodes(cast("Any", graph), asked, lambda: families)["box"]
    assert described.nodes[0] == OtherNode("/camera", ("/camera/said",), ("service /camera/save",))


def test_the_low_bits_of_a_number_alone_do_not_make_a_process_its_own() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess

    graph = DrawnGraph(FAST, [("/box", fast(10)), ("/far", fast(10 + PIDS))])
    assert found(graph, [AskedProcess("box", "/box")], {"box": {10}}) == {}


def test_what_runs_in_a_container_is_known_by_the_name_of_its_node() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess

    graph = DrawnGraph(FAST, [("/box", fast(1, ELSEWHERE)), ("/camera", fast(1, ELSEWHERE)), ("/rviz", fast(12))])
    assert found(graph, [AskedProcess("box", "/box")], {"box": {10}}) == {"box": ["/camera"]}


def test_two_nodes_of_its_name_are_one_other() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess, other_nodes

    graph = DrawnGraph(FAST, [("/box", fast(10)), ("/box", fast(10))])
    answer = other_nodes(cast("Any", graph), [AskedProcess("box", "/box")], lambda: {"box": {10}})
    assert answer == {"box": OtherNodes((OtherNode("/box", namesake=True),))}


def test_one_of_its_name_that_was_killed_is_no_other() -> None:
    """The graph shows it until the lease of the middleware is over."""
    from midstride.backends.ros2.manager.process_nodes import AskedProcess

    control = f"/{names.control('talker', 'talker', '0123abcd')}"
    shown = [(name, fast(pid)) for pid in (13, 15) for name in ("/talker", control)]
    graph = DrawnGraph(FAST, [*shown, ("/box", fast(20)), ("/box", fast(21))])
    asked = [AskedProcess("talker"), AskedProcess("box", "/box")]
    assert found(graph, asked, {"talker": {15}, "box": {21}}) == {}


def test_a_process_without_a_node_of_the_name_that_is_meant_says_so() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess, other_nodes

    graph = DrawnGraph(FAST, [("/camera", fast(10))])
    families = {"box": {10}}
    (box,) = other_nodes(cast("Any", graph), [AskedProcess("box", "/box")], lambda: families).values()
    assert box.without_own and box.names == ["/camera"]
    listed = AskedProcess("box", "/box", listed=["/box"])
    assert not other_nodes(cast("Any", graph), [listed], lambda: families)["box"].without_own
    assert not other_nodes(cast("Any", graph), [AskedProcess("talker")], lambda: {"talker": {10}})["talker"].without_own


def test_what_the_library_lists_counts_with_every_middleware() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess

    asked = [AskedProcess("box", "/box", listed=["/_tf", "/box", "/camera"])]
    for rmw in (FAST, CYCLONE, ZENOH):
        assert found(DrawnGraph(rmw), asked, {"box": {10, 11}}) == {"box": ["/camera"]}


def test_what_is_not_known_is_said() -> None:
    from midstride.backends.ros2.manager.process_nodes import AskedProcess

    asked = [AskedProcess("box", "/box"), AskedProcess("relayed", "/behind", programs=2), AskedProcess("talker")]
    why = "rmw_zenoh_cpp does not tell which process a node belongs to"
    assert found(DrawnGraph(ZENOH), asked) == {"box": why, "relayed": why}
    process = NodeProcess(b"participant.")
    graph = DrawnGraph(CYCLONE, [("/box", process), ("/camera", process), ("/rviz", NodeProcess(b"another one."))])
    assert found(graph, asked, {"box": {10}, "relayed": {20, 21}}) == {"box": ["/camera"]}
    why = "it has started other processes, and rmw_cyclonedds_cpp does not tell which nodes these have"
    assert found(graph, asked[1:], {"relayed": {20, 21, 22}}) == {"relayed": why}

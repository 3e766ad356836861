"""Looks at a live ROS 2 graph: its endpoints and services, and the times of messages on its topics, of any type."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Any, Final

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from midstride.ament_index import installed_program
from midstride.backends.common_messages import message_class
from midstride.backends.ros2 import middleware, names
from midstride.backends.ros2.component.port_endpoints import for_rclpy, qos_of, seconds_of
from midstride.backends.ros2.manager.named_servers import named_servers
from midstride.backends.ros2.manager.node_owner import pids_of
from midstride.backends.ros2.manager.seen_writes import EVERY as LOOK
from midstride.backends.ros2.manager.seen_writes import SeenWrites
from midstride.backends.ros2.middleware import NodeProcess, identity_of
from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.errors import NodeError
from midstride.model.contract import DEFAULT_QOS
from midstride.model.instance_names import full_name

# How often the graph is read (s): nodes and topics appear one after another.
EVERY: Final = 0.5
# How long nodes that are expected may take to appear (s).
PATIENCE: Final = 10.0
# A node that has shown no topic for so long since it appeared (s) is not waited for any more: it may have none.
WITHOUT_TOPICS: Final = 2.0
# How long a publisher that exists only while something subscribes may take to go (s).
LEAVES: Final = 1.5
_DEPTH: Final = 1000
_CHANGE_STATE: Final = "change_state"
_CHANGES_STATE: Final = "lifecycle_msgs/srv/ChangeState"
_LOAD_NODE: Final = "_container/load_node"
_NODE: Final = "_midstride_capture"
# The node of `ros2 launch` itself, with the number of its process: it takes lifecycle nodes through the transitions
# that a launch file states, and does not manage them afterwards.
_LAUNCH: Final = re.compile(r"launch_ros_\d+")


def observe(
    seconds: float,
    nodes: Collection[str] = (),
    done: Callable[[ObservedGraph], bool] = lambda graph: False,
    writes: SeenWrites | None = None,
) -> ObservedGraph:
    """Observe the graph by a hidden node for ``seconds``, or until ``done`` holds.

    It subscribes to the topics of which ``writes`` does not show when all their publishers publish. The time counts
    from when each of ``nodes`` (full names) has been seen, or PATIENCE later.
    """
    context = Context()
    rclpy.init(context=context)
    node = Node(_NODE, context=context, start_parameter_services=False, enable_rosout=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    graph = ObservedGraph()
    begun = start = looked = time.monotonic()
    missing, appeared = set(nodes), dict[str, float]()
    try:
        while (now := time.monotonic()) - start < seconds and not done(graph):
            missing.difference_update(
                each.node for among in (graph.endpoints, graph.services) for each in among.values()
            )
            missing -= {name for name, at in appeared.items() if now - at >= WITHOUT_TOPICS}
            if missing and now - begun < PATIENCE:
                start = now
            if now >= looked:
                looked = now + EVERY
                _look(node, graph, writes)
                for name in (full_name(*found) for found in node.get_node_names_and_namespaces()):
                    appeared.setdefault(name, now)
                graph.seconds = now - start
            executor.spin_once(timeout_sec=0.05 if writes is None else LOOK)
            if writes is not None:
                writes.look()
        _look(node, graph, writes)
        graph.seconds = time.monotonic() - start
        _note_counted(graph, writes)
        _note_programs(node, graph)
        _find_lazy(node, graph, writes)
        return graph
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def _look(node: Any, graph: ObservedGraph, writes: SeenWrites | None) -> None:
    for topic, _ in node.get_topic_names_and_types():
        written, read = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
        _look_at_processes(graph, (*written, *read))
        publishers = [_endpoint(info, topic, True) for info in written]
        graph.saw(publishers)
        graph.saw(_endpoint(info, topic, False) for info in read)
        wanted = [each for each in publishers if not each.is_infrastructure]
        if not wanted or topic in graph.subscribed:
            continue
        if writes is None or not all(writes.counts(each.node, topic) for each in wanted):
            graph.subscribed.add(topic)
            _subscribe(node, graph, wanted)
    _look_at_services(node, graph)


def _look_at_services(node: Any, graph: ObservedGraph) -> None:
    """Note the servers and clients of nodes, but for ROS's tools and a manager of Midstride.

    Which nodes serve `change_state`, and which call it, says what manages lifecycle nodes.
    """
    for own, namespace in node.get_node_names_and_namespaces():
        if own.startswith("_"):
            continue
        name = full_name(own, namespace)
        try:
            served = node.get_service_names_and_types_by_node(own, namespace)
            called = node.get_client_names_and_types_by_node(own, namespace)
        except NodeNameNonExistentError:  # it has ended meanwhile
            continue
        for output, listed in ((True, served), (False, called)):
            graph.saw(
                ObservedEndpoint(name, each.name, each.type, output, DEFAULT_QOS, "") for each in named_servers(listed)
            )
        if any(service == f"{name}/{_LOAD_NODE}" for service, _ in served):
            graph.containers.add(name)
        if any(service == f"{name}/{_CHANGE_STATE}" and _CHANGES_STATE in types for service, types in served):
            graph.lifecycle.add(name)
        managed = {
            service.removesuffix(f"/{_CHANGE_STATE}")
            for service, types in called
            if service.endswith(f"/{_CHANGE_STATE}") and _CHANGES_STATE in types
        }
        if managed - {name} and not _LAUNCH.fullmatch(own):
            graph.managers.setdefault(name, set()).update(managed - {name})


def _look_at_processes(graph: ObservedGraph, infos: Iterable[Any]) -> None:
    """Note which process has the nodes of these publishers and subscriptions."""
    rmw = middleware.of_this_process()
    for info in infos:
        if not info.node_name.startswith("_") and (process := rmw.node_process(info)) is not None:
            graph.processes[full_name(info.node_name, info.node_namespace)] = process.key.hex()


def _note_programs(node: Any, graph: ObservedGraph) -> None:
    """Note which program each container of this computer is, as far as the middleware names its process."""
    rmw, shown = middleware.of_this_process(), dict[str, NodeProcess]()
    for info in node.get_publishers_info_by_topic(names.PARAMETER_EVENTS):
        if (process := rmw.node_process(info)) is not None:
            shown[full_name(info.node_name, info.node_namespace)] = process
    own = shown.get(full_name(_NODE))
    here = None if own is None else own.host
    for container in graph.containers & {*shown}:
        found = {installed_program(pid) for pid in pids_of(shown[container], here)}
        if len(found) == 1 and (program := found.pop()) is not None:
            graph.programs[container] = program


def _note_counted(graph: ObservedGraph, writes: SeenWrites | None) -> None:
    """Note when outputs were written of which ``writes`` shows that."""
    for node, topic, output in graph.endpoints:
        times = writes.times(node, topic) if output and writes is not None else None
        if times is not None:
            graph.counted[node, topic] = times


def _find_lazy(node: Any, graph: ObservedGraph, writes: SeenWrites | None) -> None:
    """Note the publishers that go when the last subscription to their topic does, which may be that of this node.

    Those that ``writes`` shows are not kept by a subscription of this node, and may have gone before.
    """
    there = {(each.node, each.topic) for topic in graph.topics() for each in _published(node, topic)}
    for subscription in list(node.subscriptions):
        node.destroy_subscription(subscription)
    time.sleep(LEAVES if there else 0.0)
    running = {full_name(name, namespace) for name, namespace in node.get_node_names_and_namespaces()}
    for owner, topic in there:
        gone = not any(each.node == owner for each in _published(node, topic))
        if gone and owner in running and node.count_subscribers(topic) == 0:
            graph.lazy.add((owner, topic))
    for owner, topic, output in graph.endpoints:
        closed = output and writes is not None and writes.has_closed(owner, topic)
        if closed and node.count_subscribers(topic) == 0:
            graph.lazy.add((owner, topic))


def _published(node: Any, topic: str) -> list[ObservedEndpoint]:
    found = (_endpoint(info, topic, True) for info in node.get_publishers_info_by_topic(topic))
    return [each for each in found if not each.is_infrastructure]


def _subscribe(node: Any, graph: ObservedGraph, publishers: list[ObservedEndpoint]) -> None:
    topic, type_ = publishers[0].topic, publishers[0].type
    try:
        message_type = message_class(type_)
    except NodeError:
        graph.unreadable.add(type_)
        return

    rmw = middleware.of_this_process()

    def heard(_: bytes, info: Any) -> None:
        known = rmw.message_info(info)
        written = known.source / 1e9 if known.source else time.monotonic()
        graph.heard(topic, known.publisher, written)

    reliable = all(each.qos.is_reliable for each in publishers)
    profile = QoSProfile(
        depth=_DEPTH,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )
    node.create_subscription(message_type, topic, for_rclpy(heard), profile, raw=True)


def _endpoint(info: Any, topic: str, output: bool) -> ObservedEndpoint:
    profile, process = info.qos_profile, middleware.of_this_process().node_process(info)
    return ObservedEndpoint(
        node=full_name(info.node_name, info.node_namespace),
        topic=topic,
        type=info.topic_type,
        output=output,
        # The depth and the history of an endpoint are its own business, and discovery does not tell them.
        qos=replace(qos_of(profile), lifespan=seconds_of(profile.lifespan)),
        identity=identity_of(info),
        process=b"" if process is None else process.key,
    )

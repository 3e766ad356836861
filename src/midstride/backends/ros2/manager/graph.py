"""The graph as the manager's node sees it, without what the manager knows to be dead.

The instances of a role have one node name. So an endpoint is shown under the name of its instance, which the control
node of its process tells (:func:`..names.controlled`), or the mark of a process with a gate inside; any other foreign
node is shown under its own name.

A process that was killed stays in the graph until its lease runs out. Its exit is known at once, so everything under
its name is ignored from then on. Once another process of that name is about to start, what the graph shows under the
name is remembered by endpoint instead. A node that this manager did not start is alive as long as it has an endpoint:
every node has one, and the graph may keep the name of one that is gone, for good.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeAlias

from rclpy.node import NodeNameNonExistentError

from midstride.backends.ros2 import middleware, names
from midstride.backends.ros2.component import port_endpoints
from midstride.backends.ros2.manager.named_servers import ACTION, named_servers
from midstride.backends.ros2.middleware import NodeProcess, RmwImplementation
from midstride.backends.ros2.names import InstanceNode
from midstride.foreign.graph_check import GraphEndpoint, Served
from midstride.foreign.lifecycle_managers import LifecycleManager
from midstride.model.graph_names import OF_PARAMETERS, is_infrastructure, is_of_every_node
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import Endpoints

_GET_STATE: Final = "lifecycle_msgs/srv/GetState"

# The instances by process, and by process and node, as several may be in one. Where processes are unknown, by the name
# of their node; None where several nodes have it.
_Instances: TypeAlias = Mapping[bytes | str | tuple[bytes, str], InstanceNode | None]


class Graph:
    """To be used on one thread. ``node`` is rclpy's; ``rmw`` is what the middleware can tell.

    ``marked``: each instance whose process is known by the identity of an endpoint of it, with that. One without a name
    is a node that no instance has any more, in a process that goes on: it does not live.
    """

    def __init__(
        self,
        node: Any,
        rmw: RmwImplementation | None = None,
        marked: Callable[[], Iterable[tuple[bytes, InstanceNode]]] = tuple,
    ) -> None:
        self._node = node
        self._marked = marked
        self._ended: dict[bytes, float] = {}  # by process
        self.rmw = middleware.of_this_process() if rmw is None else rmw
        self._died: dict[str, float] = {}
        self._dead_endpoints: dict[bytes, float] = {}
        self._known: dict[bytes | str | tuple[bytes, str], InstanceNode | None] = {}

    def died(self, full_name: str) -> None:
        """The process of a node has ended."""
        self._died[full_name] = time.monotonic()

    def ended(self, mark: bytes) -> bool:
        """The process with the endpoint of that identity has ended; whether the graph tells what belongs to it."""
        if self.rmw.participant is not None:
            self._ended[mark[: self.rmw.participant]] = time.monotonic()
        return self.rmw.participant is not None

    def starts(self, full_name: str) -> None:
        """A process is about to start under the name of a node that is free."""
        if self._died.pop(full_name, None) is not None:
            self.ignore(full_name)

    def ignore(self, full_name: str) -> None:
        """Ignore what the graph shows under a name now, and nothing that appears there later."""
        now = time.monotonic()
        self._dead_endpoints = {gid: at for gid, at in self._dead_endpoints.items() if now - at < self.rmw.linger}
        controls = (info for info, found in self._controls() if found.instance == full_name)
        self._dead_endpoints.update((_gid(info), now) for info in (*self._under(full_name), *controls))

    def _lives(self, info: Any, name: str) -> bool:
        died = self._died.get(name)
        return (
            name != "" and (died is None or time.monotonic() - died > self.rmw.linger) and not self._is_known_dead(info)
        )

    def _is_known_dead(self, info: Any) -> bool:
        """Return whether an endpoint is known by its identity to be of a process that has ended."""
        ended = self._ended.get(self.rmw.process_of(info) or b"")
        return (ended is not None and time.monotonic() - ended <= self.rmw.linger) or _gid(info) in self._dead_endpoints

    def has(self, full_name: str) -> bool:
        """Return whether a living instance, or a foreign node, of that name is in the graph."""
        return any(self._lives(info, full_name) for info in self._under(full_name))

    def has_instance(self, full_name: str) -> bool:
        """Return whether a living instance of that name is in the graph. The name of its node is that of its role."""
        return any(found.instance == full_name and self._lives(info, full_name) for info, found in self._controls())

    def of_name(self, node: str) -> set[InstanceNode | None]:
        """The living instances whose node has that name; None among them is a foreign node."""
        listed = self._node_names().count(node)
        if self.rmw.participant is None:  # counted: an instance has one node of that name, and a control node or a gate
            own = [(info, found) for info, found in self._controls() if found.node == node]
            gated = {found for _, found in self._marked() if found.node == node}
            alive = {found for info, found in own if self._lives(info, found.instance)}
            alive |= {found for found in gated if found.instance}
            return {*alive, *([None] if listed > len({found for _, found in own} | gated) else [])}
        living: dict[bytes | str, InstanceNode | None] = {}
        for _, _, info in self._of_node(node):
            process = self._process(info)
            instances = self._instances_of([process])
            if self._lives(info, self._name(info, instances)):
                living[process] = _found(instances, process, node)
            if len(living) == listed:  # each is in another process
                break
        return set(living.values())

    def shows_others(self, node: str) -> bool:
        """Return whether the graph shows nodes of that name, living or not, that no instance with the API has."""
        return self._node_names().count(node) > sum(found.node == node for _, found in self._controls())

    def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        """The endpoints on ``topics``, by default on every topic, and the nodes that have them."""
        instances = self._instances()
        nodes: set[str] = set()
        publishers: list[tuple[str, str]] = []
        subscribers: list[tuple[str, str]] = []
        for topic in self._topics() if topics is None else topics:
            writers, readers = (
                self._visible(infos, instances) for infos in (self._publishers(topic), self._subscriptions(topic))
            )
            nodes.update(writers, readers)
            if topic not in names.OF_EVERY_NODE:
                publishers += [(name, topic) for name in writers]
                subscribers += [(name, topic) for name in readers]
        return Endpoints(frozenset(nodes), tuple(sorted(publishers)), tuple(sorted(subscribers)))

    def of_enclave(self, enclave: str) -> list[str]:
        """The full names of the nodes in it."""
        listed = self._node.get_node_names_and_namespaces_with_enclaves()
        return [full_name(name, inside) for name, inside, found in listed if found == enclave]

    def of_process(self, node: str, mark: bytes | None = None) -> list[GraphEndpoint]:
        """The endpoints of a node that no component has, by its full name.

        Of several of that name, it is the one of the process with the ``mark``, or of none that has one.
        """
        instances, process = self._instances(), None if mark is None else mark[: self.rmw.participant]

        def belongs(info: Any) -> bool:
            found = self._process(info)
            if self.rmw.participant is not None and process is not None:
                return found == process
            return found not in instances

        return [
            GraphEndpoint(output, topic, info.topic_type, port_endpoints.qos_of(info.qos_profile))
            for output, topic, info in self._of_node(node)
            if self._lives(info, self._name(info, instances)) and belongs(info)
        ]

    @property
    def own_name(self) -> str:
        """The full name of the manager's node."""
        return str(self._node.get_fully_qualified_name())

    def processes(self) -> list[tuple[str, NodeProcess]]:
        """Every node that the graph shows, by its full name, with its process; none where the middleware names none.

        Those of a process that has ended, and whose name another one has since, are left out.
        Each ROS node has its own publisher on ``/parameter_events``, unless its program has chosen otherwise.
        """
        infos = [info for info in self._publishers(names.PARAMETER_EVENTS) if not self._is_known_dead(info)]
        found = [(_node(info), self.rmw.node_process(info)) for info in infos]
        seen = {node for node, _ in found}
        for node in sorted(set(self._node_names()) - seen):
            living = (info for _, _, info in self._of_node(node) if not self._is_known_dead(info))
            found += dict.fromkeys((node, self.rmw.node_process(info)) for info in living)
        return [(node, process) for node, process in found if process is not None]

    def published_by(self, node: str) -> list[str]:
        """The topics that a node publishes on, without those of every node."""
        return sorted(topic for topic in self._topics_of(node, True) if not is_infrastructure(topic, output=True))

    def served_by(self, node: str, services: Collection[str] | None = None, mark: bytes | None = None) -> Served:
        """The services and ROS actions of a node that others may rely on, and whether it is a lifecycle node.

        ``services``: the full names of all that it has, where they are known: of several nodes of one name, the graph
        lists those of one. ``mark``: the identity of an endpoint of its process, which tells the types that this
        process serves from those of others.
        """
        try:
            if services is None:
                found = self._node.get_service_names_and_types_by_node(*split_name(node))
            else:
                shown = self._node.get_service_names_and_types()
                found = [
                    (name, self._served_types(node, name, types, mark)) for name, types in shown if name in services
                ]
        except NodeNameNonExistentError:
            return Served()
        servers = named_servers(found)
        has_lifecycle = any(name == f"{node}/get_state" and _GET_STATE in types for name, types in found)
        managers = tuple(self._managers(node)) if has_lifecycle else ()
        own = {server for server in servers if not is_of_every_node(server.name, server.type, node)}
        return Served(tuple(sorted(own)), has_lifecycle, managers, tuple(sorted(self._calls(node))), frozenset(servers))

    def _served_types(self, node: str, service: str, types: Sequence[str], mark: bytes | None) -> list[str]:
        """The types with which the process with the ``mark`` serves a service, of those that any process does.

        All of them where that is not known. ROS's own services have one type each.
        """
        if mark is None or self.rmw.participant is None or all(is_of_every_node(service, each, node) for each in types):
            return [*types]
        readers = self._node.get_subscriptions_info_by_topic(f"rq{service}Request", no_mangle=True)
        process = mark[: self.rmw.participant]
        served = {reader.topic_type for reader in readers if self.rmw.process_of(reader) == process}
        return [each for each in types if _request_type(each) in served] if readers else [*types]

    def _calls(self, node: str) -> set[str]:
        """The services and ROS actions of other nodes that a node may call, in words."""
        found = set()
        for name, types in self._clients(node):
            action, _, part = name.partition(ACTION)
            owner = name.rpartition("/")[0]
            if part:
                found.add(f"ROS action {action}")
            elif owner != node:
                of_parameters = any(type_.startswith(OF_PARAMETERS) for type_ in types)  # a client of them has six
                found.add(f"the parameters of {owner}" if of_parameters else f"service {name}")
        return found

    def _managers(self, node: str) -> Iterator[LifecycleManager]:
        """The nodes that change its lifecycle state, but for hidden ones: those of ROS's tools and of Midstride."""
        service = f"{node}/change_state"
        if hasattr(self._node, "count_clients") and not self._node.count_clients(service):  # not that of Humble
            return
        written = {topic for topic in self._topics_of(node, output=True) if topic.endswith("/bond")}
        for name in sorted({*self._node_names()} - {node}):
            if not names.is_hidden(name) and service in (called := self._called_by(name)) and self.has(name):
                bond = not written.isdisjoint(self._topics_of(name, output=False))
                yield LifecycleManager(name, asks=f"{node}/get_state" in called, bond=bond)

    def _called_by(self, node: str) -> set[str]:
        """The services that a node calls."""
        return {name for name, _ in self._clients(node)}

    def _clients(self, node: str) -> list[tuple[str, list[str]]]:
        """The services that a node calls, each with its types."""
        try:
            return list(self._node.get_client_names_and_types_by_node(*split_name(node)))
        except NodeNameNonExistentError:
            return []

    def _under(self, full_name: str) -> Iterator[Any]:
        """The endpoints that are shown under that name."""
        seen = set(self._node_names())
        controlled = filter(None, map(names.controlled, seen))
        nodes = seen & {full_name, *(found.node for found in controlled if found.instance == full_name)}
        infos = [info for node in nodes for _, _, info in self._of_node(node)]
        return (info for info, name in self._named(infos) if name == full_name)

    def _of_node(self, node: str) -> Iterator[tuple[bool, str, Any]]:
        """Each endpoint of every node of that name: whether it is an output, its topic, and the endpoint itself.

        Only their topics are looked at, first those that not every node has: rclpy takes 0.07 ms for each endpoint.
        """
        several = self._node_names().count(node) > 1
        places = [
            (topic in names.OF_EVERY_NODE, output, topic)
            for output in (True, False)
            # Of several nodes of one name, rclpy lists the topics of one.
            for topic in (self._topics() if several else self._topics_of(node, output))
        ]
        for _, output, topic in sorted(places):
            infos = self._publishers(topic) if output else self._subscriptions(topic)
            yield from ((output, topic, info) for info in infos if _node(info) == node)

    def _node_names(self) -> list[str]:
        """The full names of all nodes. One that has ended stays for a while, without endpoints."""
        return [full_name(name, inside) for name, inside in self._node.get_node_names_and_namespaces()]

    def _topics_of(self, node: str, output: bool) -> list[str]:
        by_node = self._node.get_publisher_names_and_types_by_node
        try:
            listed = (by_node if output else self._node.get_subscriber_names_and_types_by_node)(*split_name(node))
        except NodeNameNonExistentError:
            return []
        return [topic for topic, _ in listed]

    def lingering_readers(self, topic: str) -> int:
        """The number of subscriptions of dead processes that the graph still shows on ``topic``."""
        return sum(not self._lives(info, name) for info, name in self._named(self._subscriptions(topic)))

    def publisher_ids(self, topic: str, instance: str) -> frozenset[str] | None:
        """The identities of the publishers of a living instance; None where they cannot be told from another's.

        ``instance``: its full name.
        """
        if self.rmw.participant is None or not self.rmw.shares_identities:
            return None
        named = self._named(self._publishers(topic))
        own = (info for info, name in named if name == instance and self._lives(info, name))
        return frozenset(map(middleware.identity_of, own))

    def living_publishers(self, topic: str) -> list[Any]:
        """The publishers on ``topic`` whose process is not known to be dead."""
        return [info for info, name in self._named(self._publishers(topic)) if self._lives(info, name)]

    def _named(self, infos: Sequence[Any]) -> list[tuple[Any, str]]:
        """Each endpoint with the name that it is shown under."""
        instances = self._instances_of(map(self._process, infos))
        return [(info, self._name(info, instances)) for info in infos]

    def _visible(self, infos: list[Any], instances: _Instances) -> list[str]:
        named = [(info, self._name(info, instances)) for info in infos if not names.is_hidden(_node(info))]
        return [name for info, name in named if self._lives(info, name)]

    def _process(self, info: Any) -> bytes | str:
        """The process to which an endpoint belongs; the name of its node if that is unknown."""
        return self.rmw.process_of(info) or _node(info)

    def _name(self, info: Any, instances: _Instances) -> str:
        """The name that an endpoint is shown under: of its instance, else of its node."""
        node = _node(info)
        found = _found(instances, self._process(info), node)
        return node if found is None or node != found.node else found.instance

    def _instances_of(self, processes: Iterable[bytes | str]) -> _Instances:
        """The instances of these processes, if they have any. Which one a process is changes in a container alone."""
        if self.rmw.participant is None:
            return self._instances()
        marked = self._of_marks(self.rmw.participant)
        if not {*marked, *self._known} >= {*processes}:
            self._known = self._of_controls()
        return marked | self._known

    def _instances(self) -> _Instances:
        if self.rmw.participant is not None:
            return self._of_marks(self.rmw.participant) | self._of_controls()
        listed = Counter(self._node_names())
        return {found.node: found if listed[found.node] == 1 else None for _, found in self._controls()}

    def _of_controls(self) -> dict[bytes | str | tuple[bytes, str], InstanceNode | None]:
        return {self._process(info): found for info, found in self._controls()}

    def _of_marks(self, length: int) -> dict[bytes | str | tuple[bytes, str], InstanceNode | None]:
        """``length``: of the part of an identity that is that of the process."""
        found: dict[bytes | str | tuple[bytes, str], InstanceNode | None] = {}
        for mark, instance in self._marked():
            found.setdefault(mark[:length], instance)
            found.setdefault((mark[:length], instance.node), instance)
        return found

    def _controls(self) -> list[tuple[Any, InstanceNode]]:
        """An endpoint of each instance's control node."""
        infos = self._publishers(names.PARAMETER_EVENTS)
        return [(info, found) for info in infos if (found := names.controlled(_node(info))) is not None]

    def _topics(self) -> Iterator[str]:
        return (topic for topic, _ in self._node.get_topic_names_and_types())

    def _publishers(self, topic: str) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(topic))

    def _subscriptions(self, topic: str) -> list[Any]:
        return list(self._node.get_subscriptions_info_by_topic(topic))


def _found(instances: _Instances, process: bytes | str, node: str) -> InstanceNode | None:
    """The instance of that process, and of that node where several are in it."""
    own = instances.get((process, node)) if isinstance(process, bytes) else None
    return instances.get(process) if own is None else own


def _request_type(service_type: str) -> str:
    """Return how the middleware calls the type of the requests to a service."""
    return f"{service_type.replace('/', '::', 1).replace('/', '::dds_::', 1)}_Request_"


def _node(info: Any) -> str:
    return full_name(info.node_name, info.node_namespace)


def _gid(info: Any) -> bytes:
    return bytes(info.endpoint_gid)

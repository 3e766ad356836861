"""A graph that is made up, with messages in virtual time."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.model.contract import DEFAULT_QOS, QoS

RELIABLE = QoS(reliability="reliable", durability="volatile", liveliness="automatic")
SENSOR = QoS(reliability="best_effort", durability="volatile", liveliness="automatic")
LATCHED = QoS(reliability="reliable", durability="transient_local", liveliness="automatic")


@dataclass
class SimulatedGraph:
    """Endpoints, and the rates (Hz) of publishers; ``names_publishers``: whether messages name their publisher."""

    names_publishers: bool = True
    jitter: float = 0.05
    endpoints: list[ObservedEndpoint] = field(default_factory=list)
    rates: dict[str, float] = field(default_factory=dict)

    def publisher(self, node: str, topic: str, type_: str, qos: QoS = RELIABLE, rate: float = 0.0) -> None:
        self._add(node, topic, type_, True, qos)
        self.rates[self.endpoints[-1].identity] = rate

    def subscription(self, node: str, topic: str, type_: str, qos: QoS = RELIABLE) -> None:
        self._add(node, topic, type_, False, qos)

    def server(self, node: str, name: str, type_: str) -> None:
        self._add(node, name, type_, True, DEFAULT_QOS)

    def client(self, node: str, name: str, type_: str) -> None:
        self._add(node, name, type_, False, DEFAULT_QOS)

    def _add(self, node: str, topic: str, type_: str, output: bool, qos: QoS) -> None:
        identity = f"{len(self.endpoints):032x}"
        self.endpoints.append(ObservedEndpoint(node, topic, type_, output, qos, identity))

    def observed(self, seconds: float = 10.0) -> ObservedGraph:
        """What is seen within ``seconds`` of virtual time. Each gap has up to ``jitter`` of its length as noise."""
        noise = random.Random(14)
        graph = ObservedGraph(seconds)
        graph.saw(self.endpoints)
        for endpoint in self.endpoints:
            if rate := self.rates.get(endpoint.identity, 0.0):
                for number in range(int(seconds * rate)):
                    time = (number + noise.uniform(-self.jitter, self.jitter)) / rate
                    graph.heard(endpoint.topic, endpoint.identity if self.names_publishers else None, time)
        return graph


def twenty() -> SimulatedGraph:
    """Twenty nodes: ten sensors in namespaces, nine filters behind them, one behind these."""
    graph = SimulatedGraph()
    for number in range(10):
        node, topic = f"/robot{number % 3}/sensor{number}", f"/robot{number % 3}/sensor{number}/scan"
        graph.publisher(node, topic, "sensor_msgs/msg/LaserScan", SENSOR, rate=5.0 * (number + 1))
        graph.subscription(node, "/mode", "std_msgs/msg/String", LATCHED)
        for infrastructure in ("/rosout", "/parameter_events"):
            graph.publisher(node, infrastructure, "rcl_interfaces/msg/Log")
        graph.subscription(node, "/clock", "rosgraph_msgs/msg/Clock", SENSOR)
        graph.publisher(node, f"{node}/_action/status", "action_msgs/msg/GoalStatusArray")
        graph.publisher(node, f"{node}/transition_event", "lifecycle_msgs/msg/TransitionEvent")
    for number in range(9):
        node = f"/filter{number}"
        graph.subscription(node, f"/robot{number % 3}/sensor{number}/scan", "sensor_msgs/msg/LaserScan", SENSOR)
        graph.publisher(node, f"/filtered{number}", "sensor_msgs/msg/LaserScan", rate=5.0 * (number + 1))
    for number in range(9):
        graph.subscription("/planner", f"/filtered{number}", "sensor_msgs/msg/LaserScan")
    graph.publisher("/planner", "/mode", "std_msgs/msg/String", LATCHED)
    graph.publisher("/planner", "/cmd_vel", "geometry_msgs/msg/Twist", rate=20.0)
    graph.subscription("/planner", "/joy", "sensor_msgs/msg/Joy")
    return graph

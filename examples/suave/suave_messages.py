"""What several nodes do with messages: diagnostics as SUAVE writes them, servo parameters, and positions."""

from collections.abc import Iterator

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter, ParameterEvent

from midstride import Component

# The height of the sea bed, where the pipeline lies (m).
SEA_BED = -20.0


def diagnostics(comp: Component, message: str, key: str, *values: str) -> DiagnosticArray:
    array, status = DiagnosticArray(), DiagnosticStatus(name=comp.name, message=message)
    comp.clock.stamp(array.header.stamp)
    status.values = [KeyValue(key=key, value=value) for value in values]
    array.status = [status]
    return array


def values(array: DiagnosticArray) -> Iterator[tuple[str, str]]:
    """The keys and values of all statuses."""
    for status in array.status:
        for pair in status.values:
            yield pair.key, pair.value


def seconds(stamp) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


def parameter(comp: Component, node: str, name: str, value: float) -> ParameterEvent:
    event, changed = ParameterEvent(node=node), Parameter(name=name)
    comp.clock.stamp(event.stamp)
    changed.value.type, changed.value.double_value = 3, float(value)
    event.changed_parameters = [changed]
    return event


def setpoint(comp: Component, x: float, y: float, altitude: float) -> PoseStamped:
    goal = PoseStamped()
    comp.clock.stamp(goal.header.stamp)
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = x, y, SEA_BED + altitude
    return goal


def reached(position: PoseStamped | None, goal: PoseStamped, tolerance: float, axes: str) -> bool:
    if position is None:
        return False
    here, there = position.pose.position, goal.pose.position
    return all(abs(getattr(here, axis) - getattr(there, axis)) <= tolerance for axis in axes)

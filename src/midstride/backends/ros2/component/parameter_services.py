"""The parameter services of a component's node, with the component's state as read-only parameters.

Every ROS tool reads a component's state as parameters under ``midstride.``, and its changes on ``/parameter_events``.
Nothing sets them: commands travel over the control socket. The node's own parameters are read at once, and set on the
data thread, since that runs the author's callbacks.

The services have the data node's name, and belong to the hidden control node, which another executor spins: a reply to
a reading request never waits for user code.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any, Final

import msgspec
from rcl_interfaces import srv
from rcl_interfaces.msg import ListParametersResult, ParameterDescriptor, ParameterEvent, SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rclpy.parameter import Parameter
from rclpy.task import Future

from midstride.backends.ros2.names import PARAMETER_EVENTS, PREFIX, STATE
from midstride.codec.parameter import json_value
from midstride.node.data.functionality_runner import CAUGHT
from midstride.node.legible import legible
from midstride.wire.state import ComponentState

SERVICES: Final = {
    "describe_parameters": srv.DescribeParameters,
    "get_parameters": srv.GetParameters,
    "get_parameter_types": srv.GetParameterTypes,
    "list_parameters": srv.ListParameters,
    "set_parameters": srv.SetParameters,
    "set_parameters_atomically": srv.SetParametersAtomically,
}


class ParameterServices:
    """Serves the parameter services of ``data_node`` on ``control_node``, each spun by its executor."""

    def __init__(self, control_node: Any, control_executor: Any, data_node: Any, data_executor: Any) -> None:
        self._node = data_node
        self._control_executor = control_executor
        self._data_executor = data_executor
        self._values: Mapping[str, Any] = {}
        self._published: Mapping[str, Any] = {}
        self._full_name = data_node.get_fully_qualified_name()
        # rclpy makes one for each node. One more endpoint would cost every other process of the graph its discovery.
        self._events = next(each for each in control_node.publishers if each.topic_name == PARAMETER_EVENTS)
        group = ReentrantCallbackGroup()
        for name, type_ in SERVICES.items():
            serve = getattr(self, f"_{name}")
            control_node.create_service(type_, f"{self._full_name}/{name}", serve, callback_group=group)

    def show(self, values: Mapping[str, Any], now: int, publish: bool) -> None:
        """The values of all parameters under ``midstride.`` from now (ns) on.

        With ``publish``, what has changed since the last publication is published: under the node's name one instance
        does so at a time.
        """
        self._values = values
        if not publish:
            self._published = {}
            return
        before, self._published = self._published, values
        event = ParameterEvent(node=self._full_name)
        event.stamp.sec, event.stamp.nanosec = divmod(now, 1_000_000_000)
        event.changed_parameters = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in values.items()
            if before.get(name) != value
        ]
        self._events.publish(event)

    # -- reading, on the control executor -----------------------------------------------------------

    def _describe_parameters(self, request: Any, response: Any) -> Any:
        own = self._values
        for name in request.names:
            if name in own:
                described = ParameterDescriptor(name=name, read_only=True, dynamic_typing=False)
                described.type = _value(name, own[name]).type
                described.description = "state of a Midstride component; read only"
            elif self._node.has_parameter(name):
                described = self._node.describe_parameter(name)
            else:
                response.descriptors = []
                return response
            response.descriptors.append(described)
        return response

    def _get_parameters(self, request: Any, response: Any) -> Any:
        response.values = self._read(request.names)
        return response

    def _get_parameter_types(self, request: Any, response: Any) -> Any:
        response.types = [value.type for value in self._read(request.names)]
        return response

    def _read(self, names: list[str]) -> list[Any]:
        """The values of all of them, or of none where one is missing: ROS 2's rule."""
        own = self._values
        try:
            return [
                _value(name, own[name]) if name in own else self._node.get_parameter(name).get_parameter_value()
                for name in names
            ]
        except (ParameterNotDeclaredException, ParameterUninitializedException):
            return []

    def _list_parameters(self, request: Any, response: Any) -> Any:
        names = [*self._node.get_parameters_by_prefix(""), *self._values]
        found = [name for name in names if _listed(name, request.prefixes, request.depth)]
        prefixes = {name.rpartition(".")[0] for name in found if "." in name}
        response.result = ListParametersResult(names=found, prefixes=sorted(prefixes))
        return response

    # -- setting: answered late ----------------------------------------------------------------------

    async def _set_parameters(self, request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            response.results.append(await self._set([parameter]))
        return response

    async def _set_parameters_atomically(self, request: Any, response: Any) -> Any:
        response.result = await self._set(list(request.parameters))
        return response

    async def _set(self, parameters: list[Any]) -> Any:
        ours = [parameter.name for parameter in parameters if parameter.name.startswith(PREFIX)]
        if ours:
            return _refused(
                f"{ours[0]} shows the state of a Midstride component and cannot be set: use `midstride` to change it"
            )
        read = [Parameter.from_parameter_msg(one) for one in parameters]
        future = Future(executor=self._control_executor)

        def work() -> None:
            try:
                result = self._node.set_from_outside(read)
            except ParameterNotDeclaredException as error:
                result = _refused(str(error))
            except CAUGHT as error:
                result = _refused(legible(f"{type(error).__name__}: {error}"))
            future.set_result(result)
            self._control_executor.wake()

        self._data_executor.create_task(work)
        return await future


def _value(name: str, value: Any) -> Any:
    return Parameter(name, value=value).get_parameter_value()


def as_json(value: Any) -> Any:
    """The form of a parameter's value in JSON; None where it has none: of bytes, or where it is not set."""
    if isinstance(value, (list, tuple, array)):
        members = [as_json(member) for member in value]
        return None if None in members else members
    if isinstance(value, float):
        return json_value(value)
    return value if isinstance(value, (bool, int, str)) and not isinstance(value, Parameter.Type) else None


def _refused(reason: str) -> Any:
    return SetParametersResult(successful=False, reason=reason)


def _listed(name: str, prefixes: list[str], depth: int) -> bool:
    """ROS 2's rule: ``depth`` counts the parts of a name below a prefix; 0 means any."""
    if not prefixes:
        return depth == 0 or name.count(".") < depth
    return any(
        name == prefix or (name.startswith(f"{prefix}.") and (depth == 0 or name[len(prefix) + 1 :].count(".") < depth))
        for prefix in prefixes
    )


def parameters_of(state: ComponentState) -> dict[str, Any]:
    """The component's state as parameters: the whole as JSON, and what people look for by name."""
    shown: dict[str, Any] = {
        STATE: msgspec.json.encode(state).decode(),
        f"{PREFIX}revision": state.revision,
        f"{PREFIX}waiting": state.waiting or "",
    }
    for name, functionality in state.functionalities.items():
        shown[f"{PREFIX}mode.{name}"] = functionality.mode
        shown[f"{PREFIX}because.{name}"] = functionality.because
    for port, topics in state.ports.items():
        gates = [f"{topic}: {link.gate or 'attached'}" for topic, link in topics.items()]
        shown[f"{PREFIX}gate.{port}"] = ", ".join(gates)
    return shown

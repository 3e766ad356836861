"""The component's side of the control plane: its node's parameter services, served by hand.

Every ROS tool reads a component's state as parameters under ``midstride.``. They are changed by one
thing alone: a command, which is the parameter ``midstride.command`` of a SetParametersAtomically
request, answered late, when it has been carried out. Anything else under ``midstride.`` is refused
with the reason. The node's own parameters are read at once, and set on the data side, since that
runs the author's callbacks.

The services bear the data node's name, and belong to a hidden node that another executor spins: a
reply never waits for user code.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any, Final

from rcl_interfaces import srv
from rcl_interfaces.msg import ListParametersResult, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rclpy.parameter import Parameter
from rclpy.task import Future

from midstride.backends.ros2.names import COMMAND, PREFIX, STANDARD, STATE
from midstride.errors import CommandRefused
from midstride.wire.messages import Command, Reply

_TYPES: Final = (
    srv.DescribeParameters,
    srv.GetParameters,
    srv.GetParameterTypes,
    srv.ListParameters,
    srv.SetParameters,
    srv.SetParametersAtomically,
)
# A reply is on its way for a moment after it was given to the middleware (s).
_ON_ITS_WAY: Final = 0.1


class ParameterServices:
    """Serves the parameter services of ``data_node`` on ``control_node``; to be made on the control loop."""

    def __init__(
        self,
        control_node: Any,
        data_node: Any,
        group: Any,
        executor: Any,
        serve: Callable[[Command], Awaitable[Reply]],
        on_data: Callable[[Callable[[], Any]], Awaitable[Any]],
    ) -> None:
        self._node = data_node
        self._executor = executor
        self._serve = serve
        self._on_data = on_data
        self._loop = asyncio.get_running_loop()
        self._values: Mapping[str, Any] = {}
        self._pending = 0
        self._answered = 0.0
        full_name = data_node.get_fully_qualified_name()
        for name, type_ in zip(STANDARD, _TYPES, strict=True):
            control_node.create_service(type_, f"{full_name}/{name}", getattr(self, f"_{name}"), callback_group=group)

    def show(self, values: Mapping[str, Any]) -> None:
        """The values of all parameters under ``midstride.`` from now on."""
        self._values = values

    async def answered(self, timeout: float) -> None:
        """Wait until what was asked has been answered, and the answers are on their way."""
        deadline = time.monotonic() + timeout
        while self._pending and time.monotonic() < deadline:
            await asyncio.sleep(0.002)
        await asyncio.sleep(max(0.0, self._answered + _ON_ITS_WAY - time.monotonic()))

    # -- reading, on the control executor ------------------------------------------------------------

    def _describe_parameters(self, request: Any, response: Any) -> Any:
        own = self._values
        for name in request.names:
            if name in own:
                described = ParameterDescriptor(name=name, read_only=True, dynamic_typing=False)
                described.type = _value(name, own[name]).type
                described.description = "state of a Midstride component, changed by its manager's commands alone"
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
        """The values of all of them, or of none where one is not there: ROS 2's rule."""
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
        if ours == [COMMAND] and len(parameters) == 1:
            return await self._from_loop(self._carry_out(parameters[0].value.string_value))
        if COMMAND in ours:
            return _refused(f"{COMMAND} must be set alone")
        if ours:
            return _refused(
                f"{ours[0]} shows the state of a Midstride component and cannot be set: its manager changes it by "
                f"commands ({COMMAND}, with the system's token and the expected revision)"
            )
        return await self._from_loop(self._set_on_data([Parameter.from_parameter_msg(one) for one in parameters]))

    async def _carry_out(self, text: str) -> Any:
        try:
            command = Command.from_json(text)
        except CommandRefused as error:
            return _refused(str(error))
        reply = await self._serve(command)
        return SetParametersResult(successful=reply.ok, reason=reply.to_json())

    async def _set_on_data(self, parameters: list[Any]) -> Any:
        try:
            return await self._on_data(lambda: self._node.set_parameters_atomically(parameters))
        except ParameterNotDeclaredException as error:
            return _refused(str(error))

    def _from_loop(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        """What ``coroutine`` comes to on the control loop, to be awaited on the control executor."""
        future = Future(executor=self._executor)
        self._pending += 1

        async def run() -> None:
            try:
                result = await coroutine
            except Exception as error:
                result = _refused(f"{type(error).__name__}: {error}")
            future.set_result(result)
            self._executor.wake()

        async def awaited() -> Any:
            try:
                return await future
            finally:
                self._answered = time.monotonic()
                self._pending -= 1

        asyncio.run_coroutine_threadsafe(run(), self._loop)
        return awaited()


def _value(name: str, value: Any) -> Any:
    return Parameter(name, value=value).get_parameter_value()


def _refused(reason: str) -> Any:
    return SetParametersResult(successful=False, reason=reason)


def _listed(name: str, prefixes: list[str], depth: int) -> bool:
    """ROS 2's rule: ``depth`` counts the parts of a name below a prefix; 0 stands for any."""
    if not prefixes:
        return depth == 0 or name.count(".") < depth
    for prefix in prefixes:
        if name == prefix:
            return True
        if name.startswith(f"{prefix}.") and (depth == 0 or name[len(prefix) + 1 :].count(".") < depth):
            return True
    return False


def parameters_of(state: dict[str, Any]) -> dict[str, Any]:
    """The component's state as parameters: the whole as JSON, and what people look for by name."""
    shown: dict[str, Any] = {
        STATE: json.dumps(state),
        f"{PREFIX}revision": int(state.get("revision", 0)),
        f"{PREFIX}waiting": str(state.get("waiting") or ""),
    }
    for name, functionality in state.get("functionalities", {}).items():
        shown[f"{PREFIX}mode.{name}"] = str(functionality["mode"])
        shown[f"{PREFIX}because.{name}"] = str(functionality.get("because") or "")
    for port, topics in state.get("ports", {}).items():
        told = [f"{topic}: {view['gate'] or 'attached'}" for topic, view in topics.items()]
        shown[f"{PREFIX}gate.{port}"] = ", ".join(told)
    return shown

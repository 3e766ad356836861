"""The lifecycle, parameter and state services of another node, called from the manager's loop without a thread."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias

from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces import srv as parameter_srv
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.exceptions import InvalidHandle
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.serialization import deserialize_message

from midstride.backends.ros2.component.parameter_services import as_json
from midstride.errors import BackendError
from midstride.foreign.foreign_state import EXPORT_STATE, IMPORT_STATE, STATE
from midstride.foreign.services import NoAnswer
from midstride.model.instance_names import split_name

# How often it looks for a service, or for an answer (s).
INTERVAL: Final = 0.002
# After how long without an answer a request is sent again (s): discovery may have shown a server whose process had just
# ended, or the new one before it could answer. A request that changes nothing is sent again sooner at first, and each
# time after twice as long.
AGAIN: Final = 1.0
SOON: Final = 0.1
Lost: TypeAlias = Callable[[], Awaitable[bool]]
_SETTING: Final = (parameter_srv.SetParametersAtomically, "set_parameters_atomically")
LIFECYCLE: Final = ("get_state", "change_state")
PARAMETERS: Final = ("list_parameters", "get_parameters", "get_parameter_types")
_TYPES: Final[Mapping[str, Any]] = {
    **dict(zip(LIFECYCLE, (GetState, ChangeState), strict=True)),
    **dict(
        zip(
            PARAMETERS,
            (parameter_srv.ListParameters, parameter_srv.GetParameters, parameter_srv.GetParameterTypes),
            strict=True,
        )
    ),
    _SETTING[1]: _SETTING[0],
    EXPORT_STATE[0]: parameter_srv.GetParameters,
    IMPORT_STATE[0]: parameter_srv.SetParameters,
}
_TRANSITIONS: Final = {"configure": 1, "cleanup": 2, "activate": 3, "deactivate": 4, "shutdown": 5}


async def _not_lost() -> bool:
    """Of a request that is sent once: what it asks for may take as long as it may wait for an answer."""
    return False


class RosNodeServices:
    """The services of the node with the full name ``name``: a :class:`midstride.foreign.services.NodeServices`.

    No executor takes the responses: they are taken here, as soon as the middleware has them. The manager's ``node`` is
    not spun; of one that is, ``group`` keeps the executor away, and clients are made by :meth:`connect`.
    """

    # The services that change nothing: they may be asked twice.
    _reading: frozenset[str] = frozenset({LIFECYCLE[0], *PARAMETERS})

    def __init__(self, node: Any, name: str, group: Any = None) -> None:
        self._node = node
        self._group = group
        self._name = name
        self._clients: dict[str, Any] = {}
        self._waiting: dict[str, dict[int, asyncio.Future[Any]]] = {}  # by service, and number of the request

    def connect(self, *services: str) -> list[Any]:
        """Make the clients of these services, in the thread that may create endpoints, and return them."""
        for service in services:
            name = f"{self._name}/{service}"
            self._clients[service] = self._node.create_client(_TYPES[service], name, callback_group=self._group)
        return list(self._clients.values())

    def is_ready(self, service: str) -> bool:
        """Return whether a server of ``service`` has been discovered, of which there is a client."""
        try:
            return bool(self._clients[service].service_is_ready())
        except InvalidHandle:  # it ends
            return False

    def close(self) -> None:
        for client in self._clients.values():
            self._node.destroy_client(client)
        self._clients.clear()

    async def lifecycle_state(self, timeout: float) -> str:
        return str((await self._call(GetState, "get_state", timeout)).current_state.label)

    async def transition(self, name: str, state: str, timeout: float) -> bool:
        request = ChangeState.Request()
        request.transition.id = _TRANSITIONS[name]

        async def lost() -> bool:
            """Not if the node is busy with it."""
            try:
                return await self.lifecycle_state(AGAIN) == state
            except NoAnswer:
                return False

        return bool((await self._call(ChangeState, "change_state", timeout, request, lost)).success)

    async def parameters(self, timeout: float) -> dict[str, Any]:
        if self._is_ambiguous:
            raise NoAnswer(f"more than one node is called {self._name}: either may answer for the other")
        names = (await self._call(parameter_srv.ListParameters, "list_parameters", timeout)).result.names
        values = await self._values(names, timeout)
        if len(values) < len(names):  # one has no value: then a node says none of those that it is asked for
            types = await self._types(names, timeout)
            names = [name for name, type_ in types.items() if type_ != ParameterType.PARAMETER_NOT_SET]
            values = await self._values(names, timeout)
        found = {name: as_json(parameter_value_to_python(value)) for name, value in zip(names, values, strict=False)}
        return {name: value for name, value in found.items() if value is not None}

    def offers_parameters(self) -> bool:
        try:
            return self._is_offered(parameter_srv.ListParameters, "list_parameters")
        except RuntimeError:  # as in _call
            return False

    def _is_offered(self, type_: Any, service: str) -> bool:
        """Return whether a request would be sent now, and not wait for the service."""
        return self._offers(type_, service)

    async def _values(self, names: Sequence[str], timeout: float) -> list[Any]:
        request = parameter_srv.GetParameters.Request(names=names)
        return list((await self._call(parameter_srv.GetParameters, "get_parameters", timeout, request)).values)

    async def _types(self, names: Sequence[str], timeout: float) -> dict[str, int]:
        request = parameter_srv.GetParameterTypes.Request(names=names)
        found = (await self._call(parameter_srv.GetParameterTypes, "get_parameter_types", timeout, request)).types
        return dict(zip(names, found, strict=False))

    @property
    def _is_ambiguous(self) -> bool:
        """Return whether a request may reach another node of the same name."""
        return int(self._node.get_node_names_and_namespaces().count(split_name(self._name))) > 1

    async def set_parameters(self, values: Mapping[str, Any], timeout: float) -> str | None:
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        empty = [parameter for parameter in parameters if values[parameter.name] == []]
        if empty:  # rclpy takes an empty list for bytes: it is of the type that the node has
            types = await self._types([parameter.name for parameter in empty], timeout)
            for parameter in empty:
                if (type_ := types.get(parameter.name, 0)) >= ParameterType.PARAMETER_BYTE_ARRAY:
                    parameter.value.type = type_
        request = parameter_srv.SetParametersAtomically.Request(parameters=parameters)
        type_, service = _SETTING
        result = (await self._call(type_, service, timeout, request)).result
        return None if result.successful else str(result.reason)

    def settings_in(self, request: bytes) -> dict[str, Any]:
        # Both kinds of requests have the same field.
        try:
            found = deserialize_message(request, parameter_srv.SetParameters.Request).parameters
            return {each.name: as_json(parameter_value_to_python(each.value)) for each in found}
        except (RuntimeError, ValueError) as error:  # the middleware's own kind, or a type that rclpy does not know
            raise BackendError(f"a request to set parameters of {self._name} cannot be read: {error}") from error

    async def export_state(self, timeout: float) -> bytes | str:
        request = parameter_srv.GetParameters.Request(names=[STATE])
        values = (await self._call(parameter_srv.GetParameters, EXPORT_STATE[0], timeout, request, _not_lost)).values
        value = values[0] if values else ParameterValue()
        if value.type == ParameterType.PARAMETER_BYTE_ARRAY:
            return b"".join(value.byte_array_value)
        return value.string_value or "its response has no bytes"

    async def import_state(self, state: bytes, timeout: float) -> str | None:
        value = ParameterValue(type=ParameterType.PARAMETER_BYTE_ARRAY)
        value.byte_array_value = [bytes((each,)) for each in state]
        request = parameter_srv.SetParameters.Request(parameters=[ParameterMessage(name=STATE, value=value)])
        results = (await self._call(parameter_srv.SetParameters, IMPORT_STATE[0], timeout, request, _not_lost)).results
        if not results:
            return "its response has no result"
        return None if results[0].successful else str(results[0].reason) or "it says no reason"

    async def _call(
        self, type_: Any, service: str, timeout: float, request: Any = None, lost: Lost | None = None
    ) -> Any:
        """The response, within ``timeout`` seconds in all; a request that may be ``lost`` is sent again.

        Raises NoAnswer.
        """
        try:
            return await self._response(type_, service, timeout, request, lost)
        except RuntimeError as error:  # the base of rclpy's own kinds: no memory left, or the client was destroyed
            raise NoAnswer(f"{self._name}/{service} cannot be asked: {error}", sent=True) from error

    async def _response(self, type_: Any, service: str, timeout: float, request: Any, lost: Lost | None) -> Any:
        loop = asyncio.get_running_loop()
        deadline = (begun := loop.time()) + timeout
        name = f"{self._name}/{service}"
        while not self._offers(type_, service):
            if loop.time() >= deadline:
                raise NoAnswer(f"it has offered no service {name} within {timeout:g} s")
            await asyncio.sleep(INTERVAL)
        client = self._clients[service]
        answered: asyncio.Future[Any] = loop.create_future()
        waiting, sent = self._waiting.setdefault(service, {}), -math.inf
        again = SOON if lost is None and service in self._reading else AGAIN
        try:
            while not answered.done():
                if loop.time() >= deadline:
                    raise NoAnswer(f"{name} has not answered within {timeout:.3g} s", sent=sent > 0)
                if loop.time() >= sent + again and (sent < 0 or lost is None or await lost()):
                    again = again if sent < 0 else min(AGAIN, 2 * again)
                    with client.handle:
                        waiting[client.handle.send_request(request or type_.Request())] = answered
                    sent = loop.time()
                self._take(client, waiting)
                if not answered.done():  # it may never be: the longer it takes, the longer the pause
                    await asyncio.sleep(max(INTERVAL, (loop.time() - begun) / 1000))
            return answered.result()
        finally:
            for number in [number for number, each in waiting.items() if each is answered]:
                del waiting[number]

    def _offers(self, type_: Any, service: str) -> bool:
        """Return whether the graph shows the service, of which a client is made first."""
        if service not in self._clients:
            name = f"{self._name}/{service}"
            self._clients[service] = self._node.create_client(type_, name, callback_group=self._group)
        return bool(self._clients[service].service_is_ready())

    @staticmethod
    def _take(client: Any, waiting: Mapping[int, asyncio.Future[Any]]) -> None:
        """Take what has arrived, also for others that wait for the same service."""
        while True:
            with client.handle:
                header, response = client.handle.take_response(client.srv_type.Response) or (None, None)
            if header is None:
                return
            found = waiting.get(header.request_id.sequence_number)
            if found is not None and not found.done():
                found.set_result(response)

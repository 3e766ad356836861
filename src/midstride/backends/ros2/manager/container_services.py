"""The services of a component container, called from the manager's loop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final, TypeAlias

from rclpy.parameter import Parameter

from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.node_services import AGAIN, RosNodeServices
from midstride.errors import BackendError
from midstride.foreign.services import NoAnswer
from midstride.model.instance_names import split_name

_LOAD: Final = "_container/load_node"
_LIST: Final = "_container/list_nodes"
_UNLOAD: Final = "_container/unload_node"
# How often a container is asked which nodes it has (s).
_LOOK: Final = 0.1


# Of a request to load a node: None where it is loaded, else why not.
LateResponse: TypeAlias = asyncio.Future[str | None]


class _Listed(Exception):
    """The container has the node, and its response to the request has not arrived."""


class LoadUnanswered(BackendError):
    """A container has not answered in time a request to load a node, and may load it still.

    ``late``: its response, whenever it comes. Raises NoAnswer.
    """

    def __init__(self, words: str, late: LateResponse) -> None:
        super().__init__(words)
        self.late = late


class UnloadUnanswered(BackendError):
    """A container has not answered in time a request to unload a node, and may unload it still."""


class ContainerServices(RosNodeServices):
    """The services of the container with the full name ``name``, called from the manager's loop without a thread."""

    _reading = RosNodeServices._reading | {_LIST}

    async def load(self, request: LoadRequest, timeout: float) -> None:
        """Have the node loaded within ``timeout`` (s). Raises BackendError: it is not; LoadUnanswered: it may be.

        It is asked once: a container that handles several requests at a time, and is busy with this one, would have the
        node twice. Where no response comes, it is asked which nodes it has. So it is before: the graph may still show
        the services of an earlier container of its name, which has ended, and the request would be lost.
        """
        what = f"{request.plugin} of package {request.package}"
        longer = f"if it takes longer, state `takes {2 * timeout:g} s` after its `run` command"
        deadline = asyncio.get_running_loop().time() + timeout
        try:
            await self._nodes(timeout)
        except NoAnswer as error:
            raise BackendError(f"{what} is not loaded: {error}; {longer}") from None
        late = asyncio.ensure_future(self._load(request))
        try:
            await asyncio.wait({late}, timeout=max(0.0, deadline - asyncio.get_running_loop().time()))
        except asyncio.CancelledError:
            late.cancel()
            raise
        if not late.done():
            service = f"{request.container}/{_LOAD}"
            raise LoadUnanswered(
                f"{what} is not loaded: {service} has not answered within {timeout:g} s; {longer}", late
            )
        if (fault := late.result()) is not None:
            raise BackendError(f"{request.container} has not loaded {what}: {fault}")

    async def _load(self, request: LoadRequest) -> str | None:
        """Have the node loaded, however long that takes; None, or why it is not. Raises NoAnswer."""
        from composition_interfaces.srv import LoadNode

        async def listed() -> bool:
            """Raises _Listed once it has the node; the request is never taken for lost."""
            if await self.lists(request.node):
                raise _Listed
            return False

        name, namespace = split_name(request.node)
        message = LoadNode.Request(
            package_name=request.package,
            plugin_name=request.plugin,
            node_name=name,
            node_namespace=namespace,
            remap_rules=[*request.remaps],
            parameters=_messages(request.parameters),
            extra_arguments=_messages(request.extra),
        )
        try:
            response = await self._call(LoadNode, _LOAD, math.inf, message, listed)
        except _Listed:
            return None
        return None if response.success else str(response.error_message) or "no reason given"

    async def _nodes(self, timeout: float) -> dict[int, str]:
        """By number, the full names of the nodes that it has, said within ``timeout`` (s). Raises NoAnswer."""
        from composition_interfaces.srv import ListNodes

        listed = await self._call(ListNodes, _LIST, timeout)
        return dict(zip(listed.unique_ids, listed.full_node_names, strict=False))

    async def require_answer(self, timeout: float) -> None:
        """Raises BackendError where it does not say within ``timeout`` (s) which nodes it has."""
        try:
            await self._nodes(timeout)
        except NoAnswer as error:
            raise BackendError(f"nothing can be unloaded: {error}") from None

    async def lists(self, node: str) -> bool:
        """Return whether it has the node with that full name, and says so within a second."""
        try:
            return node in (await self._nodes(AGAIN)).values()
        except NoAnswer:
            return False

    async def until_known(self, node: str, is_loading: Callable[[], bool]) -> str | None:
        """Wait until it has the node with that full name; or it has said twice that it has not, and is not loading one.

        Then, returns that. A request that had not arrived when it said so first has been taken when it says so again.
        """
        without = 0
        while without < 2:
            try:
                names = (await self._nodes(AGAIN)).values()
            except NoAnswer:
                await asyncio.sleep(_LOOK)
                continue
            if node in names:
                return None
            without = 0 if is_loading() else without + 1
            await asyncio.sleep(_LOOK)
        return "the container does not have it"

    async def unload(self, node: str, timeout: float) -> None:
        """Have the node with that full name unloaded, if it is loaded, within ``timeout`` (s) for each request.

        Raises BackendError: it is not; UnloadUnanswered: it may be.
        """
        from composition_interfaces.srv import UnloadNode

        try:
            numbers = [number for number, name in (await self._nodes(timeout)).items() if name == node]
        except NoAnswer as error:
            raise BackendError(f"{node} is not unloaded: {error}") from None
        for number in numbers:
            request = UnloadNode.Request(unique_id=number)
            try:
                response = await self._call(UnloadNode, _UNLOAD, timeout, request)
            except NoAnswer as error:
                kind = UnloadUnanswered if error.sent else BackendError
                raise kind(f"{node} is not unloaded: {error}") from None
            if not response.success:
                raise BackendError(f"{self._name} has not unloaded {node}: {response.error_message or 'no reason'}")

    async def until_gone(self, node: str) -> None:
        """Wait until it says that it does not have the node with that full name."""
        while True:
            with suppress(NoAnswer):
                if node not in (await self._nodes(AGAIN)).values():
                    return
            await asyncio.sleep(AGAIN)


def _messages(values: Mapping[str, Any]) -> list[Any]:
    """An empty list has no type that a message could state, and a parameter file leaves it out as well."""
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items() if value != []]

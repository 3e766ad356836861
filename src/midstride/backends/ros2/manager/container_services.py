"""The services of a component container, called from the manager's loop."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, Final

from rclpy.parameter import Parameter

from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.node_services import AGAIN, RosNodeServices
from midstride.errors import BackendError
from midstride.foreign.services import NoAnswer
from midstride.model.instance_names import split_name

_LOAD: Final = "_container/load_node"
_LIST: Final = "_container/list_nodes"
_UNLOAD: Final = "_container/unload_node"


class _Listed(Exception):
    """The container has the node, and its response to the request has not arrived."""


class ContainerServices(RosNodeServices):
    """The services of the container with the full name ``name``, called from the manager's loop without a thread."""

    async def load(self, request: LoadRequest, timeout: float) -> None:
        """Have the node loaded within ``timeout`` (s). Raises BackendError: why it is not.

        It is asked once: a container that handles several requests at a time, and is busy with this one, would have the
        node twice. Where no response comes, it is asked which nodes it has. So it is before: the graph may still show
        the services of an earlier container of its name, which has ended, and the request would be lost.
        """
        from composition_interfaces.srv import ListNodes, LoadNode

        async def listed() -> bool:
            """Raises _Listed once it has the node; the request is never taken for lost."""
            try:
                found = await self._call(ListNodes, _LIST, AGAIN)
            except NoAnswer:
                return False
            if request.node in found.full_node_names:
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
        what = f"{request.plugin} of package {request.package}"
        deadline = asyncio.get_running_loop().time() + timeout
        try:
            await self._call(ListNodes, _LIST, timeout)
            left = deadline - asyncio.get_running_loop().time()
            response = await self._call(LoadNode, _LOAD, left, message, listed)
        except _Listed:
            return
        except NoAnswer as error:
            late = f"if it takes longer, state `takes {2 * timeout:g} s` after its `run` command"
            raise BackendError(f"{what} is not loaded: {error}; {late}") from None
        if not response.success:
            raise BackendError(
                f"{request.container} has not loaded {what}: {response.error_message or 'no reason given'}"
            )

    async def unload(self, node: str, timeout: float) -> None:
        """Have the node with that full name unloaded, if it is loaded. Raises BackendError: why it is not."""
        from composition_interfaces.srv import ListNodes, UnloadNode

        try:
            listed = await self._call(ListNodes, _LIST, timeout)
            numbers = [
                number for name, number in zip(listed.full_node_names, listed.unique_ids, strict=False) if name == node
            ]
            for number in numbers:
                request = UnloadNode.Request(unique_id=number)
                response = await self._call(UnloadNode, _UNLOAD, timeout, request)
                if not response.success:
                    raise BackendError(f"{self._name} has not unloaded {node}: {response.error_message or 'no reason'}")
        except NoAnswer as error:
            raise BackendError(f"{node} is not unloaded: {error}") from None


def _messages(values: Mapping[str, Any]) -> list[Any]:
    """An empty list has no type that a message could state, and a parameter file leaves it out as well."""
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items() if value != []]

"""Commands to components, as parameters to set atomically: the caller's side of the control plane.

A command travels as the parameter ``midstride.command``, its reply in the result's ``reason``. A
request or a reply to a process that has just been found may be lost, so the same command is sent
again, at growing intervals; its id makes a repeat harmless (wire/messages.py).
"""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import replace
from typing import Any, Final
from uuid import uuid4

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.exceptions import InvalidHandle
from rclpy.parameter import Parameter

from midstride.backends.ros2.names import COMMAND
from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within
from midstride.wire.messages import Command, Reply

# How long to wait for a reply before sending again (s): at first, where the other side has answered before, at most.
_FIRST: Final = 0.1
_LATER: Final = 1.0
_LONGEST: Final = 4.0
_POLL: Final = 0.005


class Caller:
    """Calls components by the full names of their nodes. To be used on one event loop.

    ``node`` is spun by another thread, ``executor`` is its executor.
    """

    def __init__(self, node: Any, executor: Any, group: Any) -> None:
        self._node = node
        self._executor = executor
        self._group = group
        self._clients: dict[str, Any] = {}
        self._answered: set[str] = set()

    async def call(self, name: str, command: Command, timeout: float) -> Reply:
        """Raises CallTimeout where no reply comes in time, Unreachable where nobody is there to reply."""
        if not command.id:
            command = replace(command, id=uuid4().hex)
        request = SetParametersAtomically.Request(
            parameters=[Parameter(COMMAND, value=command.to_json()).to_parameter_msg()]
        )
        deadline = time.monotonic() + timeout
        client = self._client(name)
        if not await self.ready(name, timeout):
            raise Unreachable(f"no component {name} answers for itself: its control service is not there")
        replies: asyncio.Queue[Any] = asyncio.Queue()
        sent: list[Any] = []
        patience = _LATER if name in self._answered else _FIRST
        try:
            while True:
                remaining = deadline - time.monotonic()
                if remaining <= 0:
                    raise CallTimeout(f"{name} did not answer `{command.op}` within {timeout:g} s")
                sent.append(self._send(client, request, replies))
                try:
                    async with within(min(patience, remaining)):
                        response = await replies.get()
                except asyncio.TimeoutError:
                    patience = min(2 * patience, _LONGEST)
                    continue
                self._answered.add(name)
                return _reply(name, response)
        except InvalidHandle:
            raise Unreachable(f"{name} is gone") from None
        finally:
            for future in sent:
                client.remove_pending_request(future)

    async def ready(self, name: str, timeout: float) -> bool:
        """Whether the component's control service is seen within ``timeout`` seconds."""
        deadline = time.monotonic() + timeout
        client = self._client(name)
        try:
            while not client.service_is_ready():
                if time.monotonic() > deadline:
                    return False
                await asyncio.sleep(_POLL)
        except InvalidHandle:
            return False
        return True

    def forget(self, name: str) -> None:
        """The component is gone."""
        self._answered.discard(name)
        client = self._clients.pop(name, None)
        if client is not None:
            self._executor.create_task(self._node.destroy_client, client)

    def _client(self, name: str) -> Any:
        client = self._clients.get(name)
        if client is None:
            client = self._node.create_client(
                SetParametersAtomically, f"{name}/set_parameters_atomically", callback_group=self._group
            )
            self._clients[name] = client
        return client

    @staticmethod
    def _send(client: Any, request: Any, replies: asyncio.Queue[Any]) -> Any:
        loop = asyncio.get_running_loop()

        def arrived(future: Any) -> None:
            if not loop.is_closed() and (response := future.result()) is not None:
                loop.call_soon_threadsafe(replies.put_nowait, response)

        future = client.call_async(request)
        future.add_done_callback(arrived)
        return future


def _reply(name: str, response: Any) -> Reply:
    text = response.result.reason
    try:
        return Reply.from_json(text)
    except (ValueError, KeyError, TypeError, json.JSONDecodeError):
        raise BackendError(
            f"{name} answers for its parameters, but is no component of Midstride: {text or 'it gave no reply'}"
        ) from None

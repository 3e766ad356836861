"""The component's side of the control plane: one service that takes commands as JSON and replies in JSON.

rospy serves each connection in a thread of its own; there the command is handed to the control side's event
loop, and the reply awaited. So neither user code nor another command delays it.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import io
import sys
import time
import types
from collections.abc import Awaitable, Callable
from typing import Any

import genmsg.msg_loader
import genpy.generator
import rospy

from midstride.backends.ros1 import names
from midstride.errors import CommandRefused
from midstride.wire.messages import Command, Reply


def command_type() -> Any:
    """The class of the service, made by genpy from its definition (in a few milliseconds: there is nothing to keep)."""
    module_name = "midstride.backends.ros1._command"
    if module_name not in sys.modules:
        context = genmsg.msg_loader.MsgContext.create_default()
        spec = genmsg.msg_loader.load_srv_from_string(context, names.COMMAND_DEFINITION, names.COMMAND_TYPE)
        source = io.StringIO()
        for line in genpy.generator.srv_generator(context, spec, {}):
            print(line, file=source)
        module = types.ModuleType(module_name)
        exec(compile(source.getvalue(), module_name, "exec"), module.__dict__)
        sys.modules[module_name] = module
    return sys.modules[module_name].__dict__["Command"]


class CommandServer:
    """Serves the commands to ``node``; to be made on the control side's event loop."""

    def __init__(self, node: str, serve: Callable[[Command], Awaitable[Reply]]) -> None:
        self._serve = serve
        self._loop = asyncio.get_running_loop()
        self._pending: set[concurrent.futures.Future[str]] = set()
        self._replying = 0
        self._service = rospy.Service(names.command_service(node), command_type(), self._asked)

    def _asked(self, request: Any) -> str:
        """In a thread of rospy's. What it raises is told to the caller as the service's failure."""
        self._replying += 1
        try:
            answer = asyncio.run_coroutine_threadsafe(self._carry_out(request.request), self._loop)
            self._pending.add(answer)
            try:
                return answer.result()
            except concurrent.futures.CancelledError:
                raise rospy.ServiceException("the component has ended") from None
            finally:
                self._pending.discard(answer)
        finally:
            self._replying -= 1

    async def _carry_out(self, text: str) -> str:
        try:
            command = Command.from_json(text)
        except CommandRefused as error:
            return Reply(0, {}, str(error)).to_json()
        return (await self._serve(command)).to_json()

    async def answered(self, timeout: float) -> None:
        """Wait until what was asked has been answered, and take no further commands."""
        deadline = time.monotonic() + timeout
        while self._replying and time.monotonic() < deadline:
            await asyncio.sleep(0.002)
        for answer in list(self._pending):
            answer.cancel()
        await asyncio.sleep(0.02)  # the last answer is written right after it is returned

"""Commands to components over their command services: both the manager's and a peer's way to a component."""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import replace
from typing import Final
from uuid import uuid4

from midstride.backends.ros1 import tcpros
from midstride.backends.ros1.master import Master
from midstride.errors import BackendError, CallTimeout, Unreachable
from midstride.runtime.timeouts import within
from midstride.wire.messages import Command, Reply

_POLL: Final = 0.02


class Caller:
    """Calls command services; knows where those were that answered. To be used on one event loop."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._known: dict[str, str] = {}

    async def call(self, service: str, command: Command, timeout: float) -> Reply:
        """Raises CallTimeout where no reply comes in time, Unreachable where nobody is there to reply."""
        if not command.id:
            command = replace(command, id=uuid4().hex)
        deadline = time.monotonic() + timeout
        known = self._known.get(service)
        if known is not None:
            try:
                return await self._call(known, service, command, timeout)
            except Unreachable:
                self.forget(service)  # it may have moved; the id makes a repeat harmless
        where = await self._where(service, timeout)
        reply = await self._call(where, service, command, deadline - time.monotonic())
        self._known[service] = where
        return reply

    async def _where(self, service: str, timeout: float) -> str:
        try:
            async with within(timeout):
                return await self._master.service_at(service)
        except asyncio.TimeoutError:
            raise CallTimeout(f"the ROS master did not say within {timeout:g} s where {service} is") from None

    async def _call(self, where: str, service: str, command: Command, timeout: float) -> Reply:
        text = await tcpros.call_service(where, service, command.to_json(), self._master.caller, timeout)
        try:
            return Reply.from_json(text)
        except (ValueError, KeyError, TypeError, json.JSONDecodeError):
            raise BackendError(f"{service} is no component of Midstride: it replies {text[:80]!r}") from None

    async def ready(self, service: str, timeout: float) -> bool:
        """Whether somebody serves it within ``timeout`` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                await self._master.service_at(service)
                return True
            except BackendError:
                if time.monotonic() > deadline:
                    return False
            await asyncio.sleep(_POLL)

    def forget(self, service: str) -> None:
        """It is gone."""
        self._known.pop(service, None)

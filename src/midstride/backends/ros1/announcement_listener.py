"""The manager as a node of ROS 1: registered with the master, and subscribed to one topic of strings."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from midstride.backends.ros1 import rpc, tcpros
from midstride.backends.ros1.master import Master
from midstride.backends.ros1.names import STRING
from midstride.errors import BackendError, Unreachable
from midstride.runtime.timeouts import within

# A publisher that cannot be connected to is tried again after this (s), this often.
_AGAIN: Final = 0.2
_ATTEMPTS: Final = 5


class AnnouncementListener:
    """Hands every message on ``topic`` to ``heard``; to be used on one event loop."""

    def __init__(self, master: Master, topic: str, heard: Callable[[str], None]) -> None:
        self._master = master
        self._topic = topic
        self._on_backend_event = heard
        self._server = rpc.Server(
            {
                "publisherUpdate": self._publisher_update,
                "paramUpdate": self._nothing,
                "getPid": self._pid,
                "getName": self._name,
                "getMasterUri": self._master_uri,
                "getBusInfo": self._bus_info,
                "getBusStats": self._bus_stats,
                "getSubscriptions": self._subscriptions,
                "getPublications": self._publications,
                "requestTopic": self._request_topic,
                "shutdown": self._shutdown,
            }
        )
        self._uri = ""
        self._connections: dict[str, asyncio.Task[None]] = {}

    async def open(self, host: str) -> None:
        """Join, reachable under ``host``. Raises BackendError."""
        self._uri = f"http://{host}:{await self._server.open(host)}/"
        try:
            publishers = await self._master.ask(
                "registerSubscriber", self._master.caller, self._topic, STRING, self._uri
            )
        except BackendError:
            await self._server.close()
            raise
        self._connect(publishers)

    async def close(self) -> None:
        """Leave. What the master no longer answers is left as it is."""
        with suppress(BackendError):
            await self._master.ask("unregisterSubscriber", self._master.caller, self._topic, self._uri)
        for task in self._connections.values():
            task.cancel()
        await asyncio.gather(*self._connections.values(), return_exceptions=True)
        await self._server.close()

    # -- the topic -----------------------------------------------------------------------------------

    def _connect(self, publishers: list[str]) -> None:
        for uri in publishers:
            if uri not in self._connections:
                task = asyncio.ensure_future(self._follow(uri))
                self._connections[uri] = task
                task.add_done_callback(lambda _, uri=uri: self._connections.pop(uri, None))  # type: ignore[misc]

    async def _follow(self, uri: str) -> None:
        """Read one publisher until it goes."""
        for _ in range(_ATTEMPTS):
            try:
                await self._read(uri)
                return
            except (OSError, EOFError, ValueError, TypeError, LookupError, asyncio.TimeoutError, BackendError):
                await asyncio.sleep(_AGAIN)  # not there yet, or it answers otherwise than a node does

    async def _read(self, uri: str) -> None:
        answer = await rpc.call(uri, "requestTopic", self._master.caller, self._topic, [["TCPROS"]])
        code, words, protocol = answer
        if code != 1 or protocol[0] != "TCPROS":
            raise Unreachable(f"{uri} does not publish {self._topic}: {words}")
        async with within(rpc.PATIENCE):
            reader, writer = await asyncio.open_connection(protocol[1], protocol[2])
        try:
            fields = {
                "callerid": self._master.caller,
                "topic": self._topic,
                "type": STRING,
                "md5sum": tcpros.ANY,
                "message_definition": "string data\n",
                "tcp_nodelay": "1",
            }
            async with within(rpc.PATIENCE):
                await tcpros.handshake(reader, writer, fields)
            with suppress(OSError, EOFError):
                while True:
                    self._on_backend_event(tcpros.unpack_string(await tcpros.read_block(reader)))
        finally:
            writer.close()

    # -- what others ask of a node -------------------------------------------------------------------

    async def _publisher_update(self, caller: str, topic: str, publishers: list[str]) -> Any:
        if topic == self._topic:
            self._connect(publishers)
        return [1, "", 0]

    async def _nothing(self, *arguments: Any) -> Any:
        return [1, "", 0]

    async def _pid(self, caller: str) -> Any:
        return [1, "", os.getpid()]

    async def _name(self, caller: str) -> Any:
        return [1, "", self._master.caller]

    async def _master_uri(self, caller: str) -> Any:
        return [1, "", self._master.uri]

    async def _bus_info(self, caller: str) -> Any:
        told = [
            [number, uri, "i", "TCPROS", self._topic, 1, f"{self._topic} from {uri}"]
            for number, uri in enumerate(self._connections)
        ]
        return [1, "", told]

    async def _bus_stats(self, caller: str) -> Any:
        return [1, "", [[], [], []]]

    async def _subscriptions(self, caller: str) -> Any:
        return [1, "", [[self._topic, STRING]]]

    async def _publications(self, caller: str) -> Any:
        return [1, "", []]

    async def _request_topic(self, caller: str, topic: str, protocols: Any) -> Any:
        return [0, "the manager publishes nothing", []]

    async def _shutdown(self, caller: str, words: str = "") -> Any:
        return [0, "the manager is ended by `midstride down`, or by SIGTERM", 0]

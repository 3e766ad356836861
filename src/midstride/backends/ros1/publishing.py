"""The publishers of a component: rospy's, with numbers and source times where a subscriber requests them.

A message of ROS 1 carries neither a number nor a time of publication; docs/protocols/measurement.md needs both.
But connections begin with headers (:mod:`.connection_headers`): where a subscriber requests it, each message on that
connection is followed by a trailer, beyond the message's own length. Every other subscriber gets exactly what rospy
would send. The header names each publisher by a new identity, which distinguishes two of one name, one after the other.

A node has one connection to each subscriber of a topic, however many of its outputs are attached there, so the trailer
also says which output wrote the message.
"""

from __future__ import annotations

import asyncio
import io
import struct
import threading
import time
import uuid
from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any, Final

import rospy.impl.tcpros_base
from rospy.msg import serialize_message
from rospy.topics import _PublisherImpl, _TopicImpl

from midstride.backends.common import comes_true
from midstride.backends.ros1 import connection_headers
from midstride.backends.ros1.registrar import Registrar
from midstride.backends.ros1.subscriber_connection import SubscriberConnection
from midstride.model.contract import QoS

# What follows a message where it was requested: its number, from 1, when it was published (ns), which output of the
# node wrote it, and whether it was held for late joiners.
TRAILER: Final = struct.Struct("<QQIB")
_LENGTH: Final = struct.Struct("<I")
# How long the end of a publisher may take: for the last messages to be sent, and for subscribers to have read them (s).
FLUSH: Final = 0.5
READ: Final = 0.3

# The header of the subscriber whose connection is being added, in the thread that adds it.
_joining = threading.local()
# Tells the outputs of this node apart.
_indices: Final = count()


def prepare() -> None:
    """Once, after rospy's start: let publishers see the headers of their subscribers.

    And accept each connection in its own thread: rospy reads their headers one after another, so one peer that freezes
    in the middle of its header would keep all others out.
    """
    server = rospy.impl.tcpros_base._tcpros_server
    handle = server.topic_connection_handler

    def topic_connection(connection: Any, address: Any, header: dict[str, str]) -> Any:
        _joining.header = header
        try:
            return handle(connection, address, header)
        finally:
            _joining.header = {}

    server.topic_connection_handler = topic_connection
    server.start_server()
    accept = server.tcp_ros_server.inbound_handler
    server.tcp_ros_server.inbound_handler = lambda connection, address: threading.Thread(
        target=accept, args=(connection, address), daemon=True
    ).start()


def _joining_header() -> dict[str, str]:
    header: dict[str, str] = getattr(_joining, "header", {})
    return header


class NumberedTopic(_PublisherImpl):  # type: ignore[misc]  # rospy has no stubs
    """rospy's object of a topic that this node publishes; shared by the outputs that are attached to it."""

    def __init__(self, topic: str, type_: Any, offered: QoS, control: asyncio.AbstractEventLoop) -> None:
        self._headers: dict[str, str] = {}
        self._endpoint = uuid.uuid4().hex
        self._offered = offered
        super().__init__(topic, type_)
        self.connections: list[SubscriberConnection] = []
        self.registered = False
        self.given_up = False
        self.is_latch = offered.is_transient_local  # said in headers; what is held for late joiners is each port's
        self.ports: tuple[PortPublisher, ...] = ()
        self._control = control
        self._buffer = io.BytesIO()

    @property
    def headers(self) -> dict[str, str]:
        """The fields that rospy adds to the header of the connection it is about to answer."""
        return {**self._headers, **connection_headers.grant(_joining_header(), self._endpoint, self._offered)}

    @headers.setter
    def headers(self, headers: dict[str, str] | None) -> None:
        self._headers = headers or {}

    def add_connection(self, transport: Any) -> bool:
        """rospy, in the thread of a new connection: its header has been answered."""
        requested = connection_headers.requested(_joining_header())
        depth = max((port.depth for port in self.ports), default=1)
        compatible = requested is None or not requested.unmet_by(self._offered)
        peer = SubscriberConnection(transport, requested is not None, compatible, depth, self._control)
        with self.publock:
            if not _TopicImpl.add_connection(self, peer):
                return False
            for port in self.ports if compatible else ():
                if port.held is not None:
                    peer.write(self._frame(port, *port.held, held=True)[peer.numbered])
        return True

    def remove_connection(self, connection: Any) -> None:
        """rospy, once a connection is closed. Compared by identity: its file descriptor may be another one's by now."""
        with self.c_lock:
            self.connections = [
                peer for peer in self.connections if peer is not connection and peer.transport is not connection
            ]

    def send(self, port: PortPublisher, message: Any, source: int) -> None:
        """Send to every subscriber. Raises what serialising raises, and then nothing has been sent."""
        with self.publock:
            number = port.sent + 1
            peers = self.connections
            if peers or port.latched:
                plain, numbered = self._frame(port, message, number, source)
                if port.latched:
                    port.held = (message, number, source)
                for peer in peers:
                    if peer.compatible:
                        peer.write(numbered if peer.numbered else plain)
            port.sent = number

    def _frame(
        self, port: PortPublisher, message: Any, number: int, source: int, held: bool = False
    ) -> tuple[bytes, bytes]:
        """The message as rospy sends it, and with its trailer."""
        buffer = self._buffer
        try:
            serialize_message(buffer, number, message)
            plain = buffer.getvalue()
        finally:
            buffer.seek(0)
            buffer.truncate()
        length = _LENGTH.pack(len(plain) - 4 + TRAILER.size)
        return plain, b"".join((length, memoryview(plain)[4:], TRAILER.pack(number, source, port.index, held)))

    def publish(self, message: Any, connection_override: Any = None) -> bool:
        """For an author's own rospy publisher on a port's topic: as if the first port had written."""
        if self.ports:
            self.send(self.ports[0], message, time.time_ns())
        return True

    def joined(self) -> int:
        return sum(not peer.gone.is_set() for peer in self.connections)

    def connected(self) -> int:
        """Subscribers that are connected and request no more than is offered."""
        return sum(peer.compatible and not peer.gone.is_set() for peer in self.connections)

    async def drained(self, timeout: float) -> bool:
        """Return whether every subscriber's machine has everything that was written, within ``timeout`` seconds."""
        return await comes_true(lambda: all(peer.idle for peer in self.connections), timeout)

    async def leave(self) -> None:
        """On the control thread, without ports: every subscriber reads to the end, then the connections close."""
        peers: list[SubscriberConnection] = list(self.connections)
        await self.drained(FLUSH)
        for peer in peers:
            peer.finish()
        await comes_true(lambda: all(peer.gone.is_set() for peer in peers), READ)
        for peer in peers:
            peer.leave()


class PortPublisher:
    """See :class:`midstride.node.component_host.Publisher`.

    ``registrar`` registers new topics and unregisters the others.
    """

    def __init__(
        self, topic: str, type_: Any, qos: QoS, now: Callable[[], int], registrar: Registrar[NumberedTopic]
    ) -> None:
        """Raises NodeError where the node publishes there by other means, or another type."""
        stated = qos.effective()
        self.depth = 100_000 if stated.history == "keep_all" else stated.depth or 1
        self.latched = stated.is_transient_local
        self.sent = 0
        self.held: tuple[Any, int, int] | None = None
        self._now = now
        self._registrar = registrar
        self.index = next(_indices)
        make = partial(NumberedTopic, type_=type_, offered=stated, control=registrar.loop)
        self.topic: NumberedTopic = registrar.attach(self, topic, type_, make)
        self.topic.is_latch = self.topic.is_latch or self.latched
        self._send = self.topic.send

    def publish(self, message: Any) -> None:
        self._send(self, message, self._now())

    def reader_ids(self) -> frozenset[str]:
        return frozenset()

    def matched(self) -> int:
        """-1 until the master lists it and the subscribers there have had time to connect."""
        return self.topic.connected() if self.topic.registered else -1

    async def acknowledged(self, timeout: float) -> bool | None:
        """Return whether every subscriber's machine has all; what its node has not read yet, it still reads."""
        return await self.topic.drained(timeout) or None

    def destroy(self) -> None:
        """Messages already written still arrive."""
        self._registrar.detach(self, self.topic)
        if self.topic.given_up:
            self.topic.closed = True  # no further subscriber

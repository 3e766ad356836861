"""The subscriptions of a component: rospy's connections, with the number, time and publisher of each message."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Final, TypeAlias

import genpy
from rospy.topics import _SubscriberImpl

from midstride.backends.ros1 import connection_headers
from midstride.backends.ros1.data_thread import DataThread
from midstride.backends.ros1.publishing import TRAILER
from midstride.backends.ros1.registrar import Registrar
from midstride.model.contract import QoS

# A header's time further than this (ns) from the time of receipt is not the time of the message.
_PLAUSIBLE: Final = 1_000_000_000

# Of a message: its source time, number, publisher and stamp, each None where it is unknown.
Info: TypeAlias = tuple[int | None, int | None, str | None, int | None]


def frame_of(type_: Any, qos: QoS) -> type:
    """A message class for rospy that requests a trailer of publishers, and keeps it beside the message."""

    def deserialize(frame: Any, data: bytes) -> Any:
        frame.message = type_().deserialize(data)
        frame.tail = data[-TRAILER.size :]
        return frame

    return type(
        "Frame",
        (genpy.Message,),
        {
            "__slots__": ("message", "tail"),
            "__init__": lambda frame: None,
            "_type": type_._type,
            "_md5sum": type_._md5sum,
            "_full_text": connection_headers.request(type_._full_text, qos),
            "_has_header": False,
            "deserialize": deserialize,
        },
    )


class FramedTopic(_SubscriberImpl):  # type: ignore[misc]  # rospy has no stubs
    """rospy's object of a topic that this node subscribes to; shared by the inputs that are attached to it."""

    def __init__(self, topic: str, type_: Any, qos: QoS, now: Callable[[], int]) -> None:
        super().__init__(topic, frame_of(type_, qos))
        self.registered = False
        self.given_up = False
        self.ports: tuple[PortSubscription, ...] = ()
        self.set_tcp_nodelay(True)
        self._now = now
        self._has_header = bool(type_._has_header)

    def receive_callback(self, frames: list[Any], connection: Any) -> None:
        """rospy, in the thread of a connection: messages have arrived."""
        ports, callbacks = self.ports, self.callbacks
        for frame in frames:
            info, held = self.read(frame, connection)
            for port in ports:
                if not held or port.wants_held:
                    port.arrived(frame.message, info)
            for callback, arguments in callbacks or ():  # the author's own
                self._invoke_callback(frame.message, callback, arguments)

    def read(self, frame: Any, connection: Any) -> tuple[Info, bool]:
        """The details of a message by its connection, and whether it was held for late joiners."""
        publisher = connection_headers.publisher_of(connection.header)
        if publisher is not None:
            number, source, index, held = TRAILER.unpack(frame.tail)
            return (source, number, f"{publisher}.{index}", None), bool(held)
        caller = connection.header.get("callerid")
        if not self._has_header:
            return (None, None, caller, None), False
        # A publisher that is not Midstride's gives its name, and where the type has a header its number.
        header = frame.message.header
        stamp = header.stamp.to_nsec()
        return (None, header.seq, caller, stamp if abs(self._now() - stamp) < _PLAUSIBLE else None), False

    def joined(self) -> int:
        return sum(bool(connection.header) and not connection.done for connection in self.connections)

    def connected(self) -> int:
        """Publishers that have answered and offer what is requested."""
        return sum(
            bool(connection.header) and connection_headers.is_compatible(connection.header) and not connection.done
            for connection in self.connections
        )

    async def leave(self) -> None:
        self.close()


class PortSubscription:
    """See :class:`midstride.node.component_host.Subscription`."""

    def __init__(
        self,
        topic: str,
        type_: Any,
        qos: QoS,
        callback: Callable[[Any, Any], None],
        now: Callable[[], int],
        data: DataThread,
        registrar: Registrar[FramedTopic],
    ) -> None:
        """Raises NodeError where the node is subscribed there by other means, or to another type."""
        stated = qos.effective()
        self.wants_held = stated.is_transient_local
        self._callback: Callable[[Any, Any], None] | None = callback
        self._data = data
        self._registrar = registrar
        depth = None if stated.history == "keep_all" else stated.depth or 1
        self._waiting: deque[tuple[Any, Info]] = deque(maxlen=depth)
        found = registrar.attach(self, topic, type_, lambda name: FramedTopic(name, type_, stated, now))
        self.topic: FramedTopic = found
        for connection in found.connections if self.wants_held else ():  # messages from before this input was attached
            if connection.latch is not None:
                self.arrived(connection.latch.message, found.read(connection.latch, connection)[0])

    def arrived(self, message: Any, info: Info) -> None:
        """In any thread."""
        self._waiting.append((message, info))
        self._data.post(self._take)

    def _take(self) -> None:
        """On the data thread, once for each message; those beyond the depth are missing."""
        if self._waiting and self._callback is not None:
            self._callback(*self._waiting.popleft())

    def matched(self) -> int:
        """-1 until the master lists it and the publishers there have had time to connect."""
        return self.topic.connected() if self.topic.registered else -1

    def publisher_ids(self) -> frozenset[str] | None:
        return None

    def destroy(self) -> None:
        """No callback from now on."""
        self._callback = None
        self._registrar.detach(self, self.topic)

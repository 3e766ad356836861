"""The simulated middleware: the endpoints on each topic, and messages in flight.

Delivery is in order for each pair of endpoints and takes a fixed latency, plus a seeded jitter
where one is asked for. Matching, latching, queue depths and QoS are as ROS 2 has them.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from midstride.backends.simulator.links import Links
from midstride.backends.simulator.message_copy import copied
from midstride.backends.simulator.service_network import ServiceNetwork
from midstride.backends.simulator.simulated_process import THAW_INTERVAL, SimulatedProcess
from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.model.contract import QoS


class EndpointOwner(Protocol):
    """The owner of an endpoint: its host, the name of its ROS node, and until when it is frozen (steady s; 0: it is
    not).
    """

    @property
    def on(self) -> str: ...

    @property
    def node(self) -> str: ...

    @property
    def thawed_at(self) -> float: ...


class SimulatedWriter:
    """A publishing endpoint."""

    def __init__(self, network: Network, owner: SimulatedProcess, topic: str, type_: str, qos: QoS) -> None:
        self.owner = owner
        self.topic = topic
        self.type = type_
        self.qos = qos.effective()
        self.identity = network.next_identity()
        self.created = network.clock.steady()
        self.number = 0
        self.in_flight = 0
        self.history: deque[tuple[Any, Any]] = deque(maxlen=_depth(self.qos))
        # The readers of the topic, and which of them it is matched with, since all have been discovered.
        self.known: tuple[list[SimulatedReader], list[SimulatedReader]] = ([], [])
        self._network = network

    def publish(self, message: Any) -> None:
        self._network.publish(self, message)

    def matched(self) -> int:
        return len(self._network.readers_of(self))

    def reader_ids(self) -> frozenset[str]:
        return frozenset()

    async def acknowledged(self, timeout: float) -> bool | None:
        if not self.qos.is_reliable:
            return None
        clock = self._network.clock
        deadline = clock.steady() + timeout
        while self.in_flight:
            if clock.steady() >= deadline:
                return None
            await clock.sleep(self._network.latency)
        return True

    def destroy(self) -> None:
        with suppress(ValueError):  # it went with its process
            self._network.topic(self.topic).writers.remove(self)


class SimulatedReader:
    """A subscribing endpoint; ``wake`` has its process take one message from the queue."""

    def __init__(
        self, network: Network, owner: EndpointOwner, topic: str, type_: str, qos: QoS, wake: Callable[[], None]
    ) -> None:
        self.owner = owner
        self.topic = topic
        self.type = type_
        self.qos = qos.effective()
        self.created = network.clock.steady()
        self.queue: deque[tuple[Any, Any]] = deque(maxlen=_depth(self.qos))
        self.gone = False
        self._wake = wake
        self._network = network

    def arrive(self, message: Any, info: Any) -> None:
        self.queue.append((message, info))
        self._wake()

    def matched(self) -> int:
        return len(self._network.writers_of(self))

    def publisher_ids(self) -> frozenset[str] | None:
        return frozenset(writer.identity for writer in self._network.writers_of(self))

    def destroy(self) -> None:
        self.gone = True
        with suppress(ValueError):
            self._network.topic(self.topic).readers.remove(self)


def _depth(qos: QoS) -> int | None:
    return None if qos.history == "keep_all" else qos.depth


@dataclass(slots=True)
class SimulatedTopic:
    """The endpoints of a topic, and what a fault does to its messages."""

    writers: list[SimulatedWriter] = field(default_factory=list)
    readers: list[SimulatedReader] = field(default_factory=list)
    dropping: int = 0
    delay: float = 0.0


class Network:
    """``latency`` of a message, ``discovery`` until two endpoints are matched: seconds, greater than 0."""

    def __init__(self, clock: SimulatedClock, latency: float, jitter: float, discovery: float, seed: int) -> None:
        self.clock = clock
        self.links = Links(clock, random.Random(seed))  # between the hosts
        self.latency = latency
        self.discovery = discovery
        self.topics: dict[str, SimulatedTopic] = {}
        # Called with each writer that has published a message.
        self.on_publish: Callable[[SimulatedWriter], None] = lambda writer: None
        # The manager's endpoints, and when each was created; they belong to no process.
        self.probes: dict[str, float] = {}
        self._jitter = jitter
        self.random = random.Random(seed)
        self._identities = 0
        # The processes that find no endpoints any more, and since when (steady s): a fault.
        self.undiscovering: dict[EndpointOwner, float] = {}
        # What is in flight between two endpoints, in order: timers of the same moment fire in any order.
        self._in_flight: dict[tuple[SimulatedWriter, SimulatedReader], deque[tuple[float, Any, Any]]] = {}

        self.services = ServiceNetwork(self)

    def drawn_latency(self) -> float:
        """The latency of a message that is sent now (s)."""
        return self.latency + (self.random.uniform(0.0, self._jitter) if self._jitter else 0.0)

    def next_identity(self) -> str:
        self._identities += 1
        return f"{self._identities:04x}"

    def topic(self, name: str) -> SimulatedTopic:
        known = self.topics.get(name)
        if known is None:
            known = self.topics.setdefault(name if name.startswith("/") else f"/{name}", SimulatedTopic())
        return known

    def create_writer(self, owner: SimulatedProcess, topic: str, type_: str, qos: QoS) -> SimulatedWriter:
        writer = SimulatedWriter(self, owner, topic, type_, qos)
        self.topic(topic).writers.append(writer)
        return writer

    def create_reader(
        self, owner: EndpointOwner, topic: str, type_: str, qos: QoS, wake: Callable[[], None]
    ) -> SimulatedReader:
        reader = SimulatedReader(self, owner, topic, type_, qos, wake)
        self.topic(topic).readers.append(reader)
        # A late joiner gets what transient-local writers have kept, once they are matched.
        for writer in self.topic(topic).writers:
            if writer.qos.is_transient_local and reader.qos.is_transient_local and _compatible(writer, reader):
                for message, info in writer.history:
                    self._send(writer, reader, message, info, self.discovery)
        return reader

    def remove_process(self, owner: SimulatedProcess) -> None:
        """Remove the endpoints of a process that has ended."""
        self.services.remove_process(owner)
        for topic in self.topics.values():
            topic.writers = [writer for writer in topic.writers if writer.owner is not owner]
            for reader in topic.readers:
                reader.gone = reader.gone or reader.owner is owner
            topic.readers = [reader for reader in topic.readers if not reader.gone]

    def readers_of(self, writer: SimulatedWriter) -> list[SimulatedReader]:
        """The readers it is matched with now."""
        readers = self.topic(writer.topic).readers
        if not readers or writer.known[0] == readers:
            return writer.known[1]
        matched = [reader for reader in readers if self._matched(writer, reader)]
        found = max(writer.created, *(reader.created for reader in readers)) + self.discovery <= self.clock.steady()
        if found and not self.links.any_cut:
            writer.known = list(readers), matched
        return matched

    def writers_of(self, reader: SimulatedReader) -> list[SimulatedWriter]:
        writers = self.topic(reader.topic).writers
        return [writer for writer in writers if self._matched(writer, reader) and self._found(writer, reader)]

    def _matched(self, writer: SimulatedWriter, reader: SimulatedReader) -> bool:
        known = max(writer.created, reader.created) + self.discovery
        if self.links.any_cut and known > min(
            self.links.cut_since(writer.owner.on, reader.owner.on),
            self.links.cut_since(reader.owner.on, writer.owner.on),
        ):
            return False  # they find each other once the line is back
        return known <= self.clock.steady() and _compatible(writer, reader)

    def shows_probe(self, owner: SimulatedProcess, topic: str) -> bool:
        """Return whether a process has found the manager's endpoint on ``topic``."""
        created = self.probes.get(topic, math.inf)
        known = created + self.discovery <= self.clock.steady()
        return known and created < self.undiscovering.get(owner, math.inf)

    def _found(self, writer: SimulatedWriter, reader: SimulatedReader) -> bool:
        """Return whether the reader's process knows of the writer."""
        return writer.created < self.undiscovering.get(reader.owner, math.inf)

    def publish(self, writer: SimulatedWriter, message: Any) -> None:
        topic = self.topic(writer.topic)
        if writer not in topic.writers:
            return  # destroyed, or its process is gone
        writer.number += 1
        self.on_publish(writer)
        info = (writer.owner.own_clock.system_now(), writer.number, writer.identity)
        if writer.qos.is_transient_local:
            writer.history.append((copied(message), info))
        if topic.dropping:
            topic.dropping -= 1
            return
        for reader in self.readers_of(writer):
            if self._found(writer, reader):
                self._send(writer, reader, message, info)

    def _send(
        self, writer: SimulatedWriter, reader: SimulatedReader, message: Any, info: Any, extra: float = 0.0
    ) -> None:
        now, line = self.clock.steady(), (writer.owner.on, reader.owner.on)
        if not writer.qos.is_reliable and self.links.loses(*line):
            return
        at = now + self.drawn_latency() + self.topic(writer.topic).delay + extra
        waiting = self._in_flight.setdefault((writer, reader), deque())
        if waiting:
            at = max(at, waiting[-1][0])
        # A copy for each: what a process does to its message is not seen by others.
        waiting.append((at, copied(message), info))
        writer.in_flight += 1
        self.links.deliver(*line, at - now, partial(self._arrive, writer, reader))

    def _arrive(self, writer: SimulatedWriter, reader: SimulatedReader) -> None:
        thawed_at = reader.owner.thawed_at
        if thawed_at and not reader.gone and (left := thawed_at - self.clock.steady()) > 0:
            # A frozen process acknowledges nothing.
            self.clock.loop.call_later(min(left, THAW_INTERVAL), self._arrive, writer, reader)
            return
        waiting = self._in_flight[writer, reader]
        _, message, info = waiting.popleft()
        if not waiting:
            del self._in_flight[writer, reader]
        writer.in_flight -= 1
        if not reader.gone:
            reader.arrive(message, info)


def _compatible(writer: SimulatedWriter, reader: SimulatedReader) -> bool:
    return writer.type == reader.type and not reader.qos.unmet_by(writer.qos)

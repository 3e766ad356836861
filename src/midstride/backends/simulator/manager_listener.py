"""The manager's subscriptions of topics on the simulator."""

from __future__ import annotations

from functools import partial
from typing import Final

from midstride.backends.last_message import EVERY, KEPT, LastMessage
from midstride.backends.simulator.network import Network, SimulatedReader
from midstride.model.contract import Predicate, QoS
from midstride.runtime.backend_protocol import HeardMessage
from midstride.wire.pipe import MEMORY

# The full name of the manager's node.
MANAGER: Final = "/_midstride_manager"


class _Manager:
    """The owner of the manager's endpoints."""

    on = MEMORY
    node = MANAGER
    thawed_at = 0.0


_OWNER: Final = _Manager()


class SimulatedListener:
    """Listens to ``topic``; a publisher that is gone has said nothing any more."""

    def __init__(self, network: Network, topic: str, assumption: Predicate) -> None:
        self._network, self._topic, self._type = network, topic, assumption.type
        self._last = LastMessage(assumption)
        self._every = self._reader(EVERY)
        self._kept = self._reader(KEPT)

    def _reader(self, qos: QoS) -> SimulatedReader:
        found: list[SimulatedReader] = []
        reader = self._network.create_reader(_OWNER, self._topic, self._type, qos, partial(self._take, found))
        found.append(reader)
        return reader

    def _take(self, reader: list[SimulatedReader]) -> None:
        while reader[0].queue:
            message, (written, _, writer) = reader[0].queue.popleft()
            at = self._network.clock.steady()
            self._last.received(message, at, written, writer, kept=reader[0].qos.is_transient_local)

    def heard(self) -> HeardMessage:
        writers = self._network.topic(self._topic).writers
        if others := sorted({writer.type for writer in writers} - {self._type}):
            return HeardMessage(publishers=len(writers), problem=f"{', '.join(others)} is published there")
        found = self._network.writers_of(self._every)
        if self._last.may_be_gone({writer.identity for writer in found}):
            self._last.forget()
            self._kept.destroy()
            self._kept = self._reader(KEPT)  # what the others have kept
        return self._last.heard(len(found))

    def close(self) -> None:
        self._every.destroy()
        self._kept.destroy()

"""Registers a component's topics with the master, and checks that the registration has had its effect.

rospy registers in the calling thread and without a deadline: a frozen master would block user code for ever. Here it
happens on the control thread. And where a subscriber that the master lists does not connect (rospy's overlook a
publisher that comes back while they are inside a callback), the topic is registered again, and the master notifies them
again.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Generic, Protocol, TypeVar, cast

import rospy
from rospy.impl.registration import RegManager, get_registration_listeners, get_topic_manager

from midstride.backends.common import comes_true, in_background
from midstride.backends.ros1.master import Master
from midstride.errors import BackendError, NodeError

# The pauses before each check that all nodes of a topic have connected (s).
_CHECKS: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
# A master that does not answer is called again after this (s).
_RETRY: Final = 0.2
# How long to wait for the nodes that the master lists on a topic (s), Midstride's or not. A dead node's registration
# costs as much.
_PATIENCE: Final = 0.5


class RegisteredTopic(Protocol):
    """rospy's object of a topic, as far as it matters here.

    ``registered``: the master lists it, and the nodes that the master listed there have had time to connect.
    """

    resolved_name: str
    type: str
    registered: bool
    given_up: bool
    ports: tuple[Any, ...]
    ref_count: int

    def joined(self) -> int:
        """The number of others connected, compatible or not."""
        ...

    async def leave(self) -> None: ...


T = TypeVar("T", bound=RegisteredTopic)


class Registrar(Generic[T]):
    """``kind`` is ``Publisher`` or ``Subscriber``. ``attach`` and ``detach`` may be called in any thread."""

    def __init__(self, kind: str, master: Master, node: str, uri: str, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._kind = kind
        self._master = master
        self._identity = node, uri
        self._locks: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._tasks: set[asyncio.Task[None]] = set()
        self._leaving: set[asyncio.Task[None]] = set()

    def attach(self, port: Any, topic: str, type_: Any, make: Callable[[str], T]) -> T:
        """rospy's object of ``topic`` with one more port; what ``make`` makes of its full name where it is new.

        Raises NodeError where the node uses the topic by other means, or with another type.
        """
        name, manager = rospy.names.resolve_name(topic), get_topic_manager()
        with manager.lock:
            found = self._topics_of(manager).get(name)
            if found is None:
                found = self._topics_of(manager)[name] = make(name)
                manager.topics.add(name)
                self.loop.call_soon_threadsafe(in_background, self._join(found), self._tasks)
            elif not hasattr(found, "ports") or found.data_class._md5sum != type_._md5sum:
                does = "publishes on" if self._kind == "Publisher" else "is subscribed to"
                raise NodeError(f"this node {does} {name} already, but not by a port of this type")
            found.ref_count += 1  # an author's own use of the topic must not end it
            found.ports = (*found.ports, port)
        return cast("T", found)

    def detach(self, port: Any, topic: T) -> None:
        """Take a port from its topic. Without ports it is given up: it is closed in order and unregistered."""
        manager = get_topic_manager()
        with manager.lock:
            topic.ports = tuple(other for other in topic.ports if other is not port)
            topic.ref_count -= 1
            if topic.ref_count == 0 and self._topics_of(manager).get(topic.resolved_name) is topic:
                topic.given_up = True
                del self._topics_of(manager)[topic.resolved_name]
                manager._recalculate_topics()
                self.loop.call_soon_threadsafe(in_background, self._leave(topic), self._leaving)

    def _topics_of(self, manager: Any) -> dict[str, Any]:
        return manager.pubs if self._kind == "Publisher" else manager.subs  # type: ignore[no-any-return]

    async def end(self, timeout: float) -> None:
        """The component ends: topics that are being given up have ``timeout`` seconds."""
        await asyncio.sleep(0)  # what was queued by now has begun
        for task in self._tasks:
            task.cancel()
        if self._leaving:
            await asyncio.wait(self._leaving, timeout=timeout)

    async def _join(self, topic: T) -> None:
        expected = -1
        async with self._locks[topic.resolved_name]:  # an earlier one that is being given up comes first
            while expected < 0 and not topic.given_up:
                try:
                    expected = await self._register(topic)
                except BackendError:
                    await asyncio.sleep(_RETRY)
            await comes_true(lambda: topic.given_up or topic.joined() >= expected, _PATIENCE)
            topic.registered = True
        for pause in _CHECKS:
            if topic.given_up or topic.joined() >= expected:
                return
            await asyncio.sleep(pause)
            with suppress(BackendError):
                expected = await self._register(topic)

    async def _register(self, topic: T) -> int:
        """Register with the master; how many others it lists on the topic."""
        node, uri = self._identity
        others = await self._master.call(f"register{self._kind}", node, topic.resolved_name, topic.type, uri)
        if self._kind == "Subscriber":
            for manager in managers():  # connects to those to which it is not connected yet
                manager.publisher_update(topic.resolved_name, others)
        return len(set(others))

    async def _leave(self, topic: T) -> None:
        async with self._locks[topic.resolved_name]:
            await topic.leave()
            node, uri = self._identity
            with suppress(BackendError):  # a master that is gone lists nothing
                await self._master.call(f"unregister{self._kind}", node, topic.resolved_name, uri)


def managers() -> list[Any]:
    """rospy's managers of connections to publishers (one, once a node has started)."""
    return [found for found in get_registration_listeners().listeners if isinstance(found, RegManager)]

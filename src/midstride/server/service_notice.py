"""Notices to systemd about this manager: that it is ready, that its loop turns, and how its system is.

The protocol is that of sd_notify(3): each notice is a datagram of assignments, to the socket that ``NOTIFY_SOCKET``
names. Without that variable, nobody is told anything.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import AsyncIterator, MutableMapping
from dataclasses import dataclass
from typing import Final

from midstride.errors import internal_error
from midstride.runtime.timeouts import within
from midstride.runtime.view.status import status
from midstride.server.manager_lifecycle import Lifecycle

log = logging.getLogger(__name__)

# How often it is looked how the system is, where no event says so before, and how long to wait after an event (s).
EVERY: Final = 5.0
TOGETHER: Final = 0.2
# How much longer the start, a change or the end may take after each notice (s), whatever the unit says.
LONGER: Final = 30.0
# Notices between two that are due for the watchdog.
_NOTICES_PER_WATCH: Final = 3
# A longer line would not be read in `systemctl status`.
_LONGEST_STATUS: Final = 500
READY: Final = "READY=1"
STOPPING: Final = "STOPPING=1"
WATCHDOG: Final = "WATCHDOG=1"
_VARIABLES: Final = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")


@dataclass(frozen=True, slots=True)
class ServiceNotice:
    """The address for notices, and systemd's interval for them (``watchdog``, s; None: it does not watch)."""

    address: str
    watchdog: float | None = None

    @classmethod
    def taken_from(cls, environment: MutableMapping[str, str]) -> ServiceNotice | None:
        """Take the address out of the environment, so that no component, which inherits that, sends notices, too."""
        values = {name: environment.pop(name, "") for name in _VARIABLES}
        address, watched = values["NOTIFY_SOCKET"], values["WATCHDOG_PID"] in ("", str(os.getpid()))
        if not address.startswith(("/", "@")):
            return None
        usec = values["WATCHDOG_USEC"]
        return cls(address, int(usec) / 1e6 if watched and usec.isdecimal() and int(usec) > 0 else None)

    @property
    def every(self) -> float:
        """The time between two notices (s)."""
        return EVERY if self.watchdog is None else min(EVERY, self.watchdog / _NOTICES_PER_WATCH)

    def send(self, *assignments: str) -> bool:
        """Send a notice without waiting; returns whether it was taken."""
        address = f"\0{self.address[1:]}" if self.address.startswith("@") else self.address
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
            sending.setblocking(False)
            sending.sendto("\n".join(assignments).encode(errors="replace"), address)
            return True
        return False

    @contextlib.asynccontextmanager
    async def kept(self, lifecycle: Lifecycle) -> AsyncIterator[None]:
        """Send notices while the context is open, and that the manager ends at its end."""
        sending = asyncio.ensure_future(self._keep(lifecycle))
        try:
            yield
        finally:
            sending.cancel()
            await asyncio.wait({sending})
            self.send(*lasting(lifecycle))

    async def _keep(self, lifecycle: Lifecycle) -> None:
        told: frozenset[str] = frozenset()
        with lifecycle.manager.watched.events.wakers.client() as waker:
            ends = [asyncio.ensure_future(each.wait()) for each in (lifecycle.up_ended, lifecycle.ended)]
            for end in ends:
                end.add_done_callback(lambda _: waker.set())
            try:
                while True:
                    waker.clear()
                    news = lasting(lifecycle)
                    if self.send(WATCHDOG, *_more_time(lifecycle), *(each for each in news if each not in told)):
                        told = frozenset(news)
                    with contextlib.suppress(asyncio.TimeoutError):
                        async with within(self.every):
                            await waker.wait()
                            await asyncio.sleep(0 if lifecycle.ended.is_set() else min(TOGETHER, self.every))
            finally:
                for end in ends:
                    end.cancel()


def _more_time(lifecycle: Lifecycle) -> list[str]:
    """A start, a change and an end take as long as they take; only a manager that says nothing has hung."""
    busy = lifecycle.phase != "up" or lifecycle.ends or lifecycle.manager.watched.commands.running is not None
    return [f"EXTEND_TIMEOUT_USEC={round(LONGER * 1e6)}"] if busy else []


def lasting(lifecycle: Lifecycle) -> list[str]:
    """The assignments that hold until others are sent: the state of the manager, and in words that of its system.

    A system that is degraded is ready: it does what can be done, and its manager answers.
    """
    told = [f"STATUS={' '.join(status_words(lifecycle).split())[:_LONGEST_STATUS]}"]
    if lifecycle.ended.is_set():
        return [STOPPING, *told]
    return [READY, *told] if lifecycle.phase == "up" else told


def status_words(lifecycle: Lifecycle) -> str:
    """The state of the system in one line."""
    if lifecycle.failure is not None:
        return f"not up: {lifecycle.failure}"
    if lifecycle.phase == "starting":
        return "starting"
    if lifecycle.phase == "down":
        return "down"
    if lifecycle.ends:
        return "stopping"
    if lifecycle.ended.is_set():
        return "the manager ends, and its components keep running"
    try:
        return status(lifecycle.manager.watched, ()).condition.headline
    except Exception as error:  # a fault of ours must not look as if the manager hung
        log.exception("the status cannot be told")
        return internal_error(error)

"""The back-end protocol: what the manager asks of a platform, and nothing else.

A back end starts and ends components, carries commands to them and their announcements back, and
shows the graph as the middleware sees it. What the commands mean is :mod:`midstride.wire`'s and
the component's affair, so a hand-over is written once for every platform. Foreign exceptions are
translated here: a back end raises ``BackendError`` and its kinds only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from midstride.runtime.clock import Clock
from midstride.wire.messages import Announcement, Command, Reply


@dataclass(frozen=True, slots=True)
class Launch:
    """How to start one component: its command (split as a shell would), and who it shall be."""

    instance: str
    namespace: str
    arguments: tuple[str, ...]
    token: str
    directory: Path
    parameters: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Handle:
    """What is kept of a started component so that a later manager finds it again."""

    instance: str
    pid: int | None = None
    started: float | None = None
    log: str | None = None


@dataclass(frozen=True, slots=True)
class Exited:
    """A component's process ended. ``status`` is negative for a signal, None where nobody can tell."""

    instance: str
    status: int | None
    log_tail: str = ""


@dataclass(frozen=True, slots=True)
class Endpoints:
    """The middleware's own view: who publishes and who subscribes, as (node, topic) pairs."""

    nodes: frozenset[str] = frozenset()
    publishers: tuple[tuple[str, str], ...] = ()
    subscribers: tuple[tuple[str, str], ...] = ()


class Backend(Protocol):
    name: str
    clock: Clock

    async def open(self, on_event: Callable[[Announcement | Exited], None]) -> None:
        """Join the platform. Events come on the manager's loop."""
        ...

    async def close(self) -> None:
        """Leave the platform; components go on."""
        ...

    async def start(self, launch: Launch) -> Handle:
        """Start a component's process; it announces itself later. Raises StartFailed."""
        ...

    async def adopt(self, handle: Handle) -> bool:
        """Take over a component that an earlier manager started. False where it no longer runs."""
        ...

    async def call(self, instance: str, command: Command, timeout: float) -> Reply:
        """Carry a command to a component. Raises CallTimeout or Unreachable. Safe to repeat."""
        ...

    async def end(self, instance: str, grace: float) -> None:
        """End a started component: in order, then by force after ``grace`` seconds. Returns when it is gone."""
        ...

    async def endpoints(self) -> Endpoints:
        """Who is on which topic, as the middleware sees it."""
        ...

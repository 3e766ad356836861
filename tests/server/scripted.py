"""A manager whose behaviour is written by the test: what the HTTP API does with each kind of answer and failure."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from midstride.codec.specification_form import decode_specification
from midstride.model.specification import Specification, initial
from midstride.plan.request import PlanRequest
from midstride.runtime.change.change_permission import ChangePermission
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.manager import Manager
from midstride.runtime.manager_clock import SystemClock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.reports import DownReport, Event, UpReport
from midstride.runtime.records.status_forms import Middleware, Status
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.view.status import status
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.runtime.watch.silence import SilenceMonitor
from tests.examples import json_form

EXAMPLES = Path(__file__).parents[2] / "examples"


def watched_system(specification: Specification, events: EventLog) -> WatchedSystem:
    """What the manager of a system knows before any of its components has reported."""
    clock = SystemClock()
    client = ComponentClient(cast(Any, None), clock, "token")
    nothing = cast(Any, SimpleNamespace(status=lambda _: None, crash_loop=lambda _: None))
    backend = SimpleNamespace(
        name="scripted",
        clock=clock,
        middleware=lambda: Middleware(name="none"),
        spares=lambda: 0,
        host_links=tuple,
        unwritten=lambda: None,
        hanging=list,
    )
    records = SimpleNamespace(unwritten=None, damaged=None)
    session = SimpleNamespace(
        system=RunningSystem(specification, initial(specification), client.life),
        client=client,
        launcher=nothing,
        events=events,
        store=records,
        commands=CommandQueue(clock, events),
        monitor=SilenceMonitor(client.life, clock, events),
        clock=clock,
        backend=backend,
        journal=records,
        permission=ChangePermission(cast(Any, backend), events, cast(Any, records)),
    )
    return WatchedSystem(cast(Any, session), nothing, nothing, nothing, 0)


class ScriptedManager:
    """Says what it was told to say, raises what it was told to raise, and notes what it was asked."""

    def __init__(self) -> None:
        self.specification = decode_specification(json_form("talker"))
        self.revision = 7
        self.events = EventLog()
        self.watched = watched_system(self.specification, self.events)
        self.answers: dict[str, Any] = {
            "up": UpReport(outcome="done", instances=["listener", "talker"]),
            "down": DownReport(),
            "why": {},
            "programs": [],
        }
        self.holds: dict[str, asyncio.Event] = {}
        self.asked: list[tuple[str, Any]] = []

    async def _answer(self, operation: str, argument: Any = None) -> Any:
        self.asked.append((operation, argument))
        if operation in self.holds:
            await self.holds[operation].wait()
        answer = self.answers[operation]
        if isinstance(answer, Exception):
            raise answer
        self.events.add(operation, f"{operation} is done")
        return answer

    async def up(self) -> Any:
        return await self._answer("up")

    async def down(self, id: str | None = None) -> Any:
        return await self._answer("down")

    async def close(self) -> None:
        self.asked.append(("close", None))

    async def status(self) -> Status:
        return status(self.watched, ())

    async def programs(self) -> Any:
        return await self._answer("programs")

    async def why(self, functionality: str) -> Any:
        return await self._answer("why", functionality)

    async def plan(self, request: PlanRequest) -> Any:
        return await self._answer("plan", request)

    async def change(
        self, request: PlanRequest, *, expected: int | None = None, verify: bool = False, **_: object
    ) -> Any:
        return await self._answer("change", (request, expected, verify))

    def log(self, since: int = 0) -> Any:
        return self.events.since(since)

    def subscribe(self, since: int = 0) -> AsyncIterator[Event]:
        return self.events.follow(since)

    @property
    def as_manager(self) -> Manager:
        return cast(Manager, self)

"""A server of the dashboard's files and of views made up here, for what no small system shows: size, and hostile names.

Its documents are instances of the API's own forms.
"""

from __future__ import annotations

import asyncio
import random
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import StreamingResponse
from msgspec import structs

from midstride.model.contract import connector_kind
from midstride.runtime.records.reports import Event
from midstride.runtime.records.status_forms import (
    CrashedInstance,
    FunctionalityStatus,
    InstanceStatus,
    Middleware,
    ParameterStatus,
    PortStatus,
    SpareStatus,
    TopicStatus,
)
from midstride.server.static import dashboard
from midstride.server.view.view_forms import Patch, SystemView
from midstride.verdicts.conditions import system_condition
from tests.server.support import free_port

MODES = ["normal", "reduced", "degraded"]


def functionality(name: str, mode: str = "normal", because: str | None = None) -> FunctionalityStatus:
    return FunctionalityStatus(
        name=name,
        mode=mode,
        modes=[*MODES] if mode in MODES else [mode, "off"],
        modelled=mode,
        normal=mode not in MODES[1:],
        because=because,
        reflex=False,
        restoring=None,
        since=1_000_000_000.0,
    )


def port(name: str, direction: str, topic: str | None, rate: float | None = 10.0, **more: Any) -> PortStatus:
    return PortStatus(
        name=name,
        direction=direction,  # type: ignore[arg-type]
        functionalities=["work"],
        topic=topic,
        type=more.get("type", "std_msgs/msg/String"),
        gate="open" if direction == "out" else None,
        declared=10.0,
        rate=rate,
        met=None if rate is None else rate >= 9.0,
        age=0.05,
        jitter=0.001,
        longest=0.12,
    )


def service_port(name: str, direction: str, service: str, type_: str) -> PortStatus:
    """A server (`out`) or a client: nothing counts its requests."""
    unknown = {"declared": None, "rate": None, "met": None, "age": None, "jitter": None, "longest": None}
    return structs.replace(port(name, direction, service, type=type_), **unknown)


def component(
    name: str, functionalities: list[FunctionalityStatus], ports: list[PortStatus], **more: Any
) -> InstanceStatus:
    known: dict[str, Any] = {
        "role": name,
        "component": "Worker",
        "namespace": f"/{name.rpartition('/')[0]}",
        "host": None,
        "node": f"/{name}",
        "pid": 1,
        "reachable": True,
        "answers": True,
        "ending": False,
        "waiting": None,
        "as_modelled": True,
        "differences": [],
        "undeclared": [],
        "deviation": None,
        "simulated_time": False,
        "run": None,
        "log_file": None,
        "parameters": [],
        "endpoints": [],
    }
    return InstanceStatus(name=name, functionalities=functionalities, ports=ports, **{**known, **more})


def topics_of(components: list[InstanceStatus]) -> list[TopicStatus]:
    ends: dict[str, tuple[str, list[str], list[str]]] = {}
    for each in components:
        for found in each.ports:
            if found.topic is not None:
                _, outs, ins = ends.setdefault(found.topic, (found.type or "", [], []))
                (outs if found.direction == "out" else ins).append(f"{each.name}.{found.name}")
    return [
        TopicStatus(
            name=name,
            topic=name,
            type=type_,
            rate=10.0 if connector_kind(type_) == "topic" else None,
            satisfied=True,
            publishers=outs,
            subscribers=ins,
            outside=[],
        )
        for name, (type_, outs, ins) in sorted(ends.items())
    ]


def large(nodes: int, topics: int, groups: int = 20, seed: int = 3) -> list[InstanceStatus]:
    """``nodes`` components in ``groups`` namespaces, which mostly talk within their own one."""
    drawn = random.Random(seed)
    size = nodes // groups
    names = [f"area_{number // size:02d}/node_{number % size:02d}" for number in range(nodes)]
    ports: list[list[PortStatus]] = [[] for _ in names]
    for number in range(topics):
        source = number % nodes
        group = source // size
        ports[source].append(port(f"out_{number}", "out", f"/topic_{number}"))
        for _ in range(drawn.choice([1, 1, 2])):
            other = group if drawn.random() < 0.8 else (group + drawn.choice([1, 1, 1, 2])) % groups
            target = other * size + drawn.randrange(size)
            if target != source and not any(each.topic == f"/topic_{number}" for each in ports[target]):
                ports[target].append(port(f"in_{number}", "in", f"/topic_{number}"))
    return [
        component(name, [functionality("work", drawn.choices(MODES, [92, 4, 4])[0])], ports[number])
        for number, name in enumerate(names)
    ]


class Synthetic:
    """The state that is served; :meth:`patch` changes it for every page."""

    def __init__(self, components: list[InstanceStatus], crashed: list[CrashedInstance] | None = None) -> None:
        self.components = {each.name: each for each in components}
        self.crashed = crashed or []
        self.topics = topics_of(components)
        self.events: list[Event] = []
        self.n = 1
        self.quiet = 0.0  # for how long nothing has changed (s)
        self.condition = system_condition(1, 1, [])
        self.port = free_port()
        self._queues: set[asyncio.Queue[bytes]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/dashboard/"

    def view(self) -> SystemView:
        return SystemView(
            version=1,
            manager="0" * 16,
            n=self.n,
            at=time.time() - self.quiet,
            system="synthetic",
            backend="sim",
            phase="up",
            condition=self.condition,
            revision=1,
            running=None,
            valid=True,
            violations=[],
            instances=sorted(self.components.values(), key=lambda each: each.name),
            topics=self.topics,
            crashed=self.crashed,
            silences=[],
            unwritten=None,
            damaged=None,
            file=None,
            changed_since=False,
            middleware=Middleware(name="none"),
            spares=SpareStatus(kept=0, ready=0, unused_by=[]),
            change=None,
        )

    def patch(self, components: list[InstanceStatus]) -> None:
        self.n += 1
        self.components.update({each.name: each for each in components})
        found = Patch(n=self.n, at=time.time(), instances={each.name: each for each in components})
        message = self._message("patch", msgspec.json.encode(found))
        assert self._loop is not None
        for queue in list(self._queues):
            self._loop.call_soon_threadsafe(queue.put_nowait, message)

    def _message(self, kind: str, document: bytes) -> bytes:
        return b"id: %s:%d.0\nevent: %s\ndata: %s\n\n" % (b"0" * 16, self.n, kind.encode(), document)

    def app(self) -> FastAPI:
        app = FastAPI()
        app.include_router(dashboard())

        @app.get("/api/v1/view/stream")
        async def stream() -> Response:
            self._loop = asyncio.get_running_loop()
            return StreamingResponse(self._stream(), media_type="text/event-stream")

        @app.get("/api/v1/log")
        async def log() -> Response:
            return Response(msgspec.json.encode(self.events), media_type="application/json")

        return app

    async def _stream(self) -> AsyncIterator[bytes]:
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        self._queues.add(queue)
        try:
            yield self._message("view", msgspec.json.encode(self.view()))
            for event in self.events:
                yield self._message("event", msgspec.json.encode(event))
            while True:
                yield await queue.get()
        finally:
            self._queues.discard(queue)


@contextmanager
def serving(synthetic: Synthetic) -> Iterator[Synthetic]:
    """Serves it from a thread until the block ends."""
    config = uvicorn.Config(synthetic.app(), port=synthetic.port, log_level="error", timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.01)
    try:
        yield synthetic
    finally:
        server.should_exit = True
        thread.join(10)


def parameter(name: str, value: str) -> ParameterStatus:
    return ParameterStatus(name=name, value=value, declared=value, set_at_run_time=False)

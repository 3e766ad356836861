"""A system on the simulator, in virtual time, with its live view, and clients that read the stream as they please."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Iterable
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.view.live import LiveView
from midstride.server.view.view_stream import position, stream
from tests.runtime.systems import managed

T = TypeVar("T")
Document = dict[str, Any]

# When virtual time begins (UNIX time).
EPOCH = 1_700_000_000.0
FIGURES = ("rate", "age", "jitter", "longest")


@dataclass
class Viewed:
    """What a test uses: the manager of a running system, and the view of it."""

    manager: Manager
    simulator: Simulator
    live: LiveView

    def now(self) -> float:
        return self.live.now()

    def document(self) -> Document:
        return json.loads(self.live.document())  # type: ignore[no-any-return]

    def component(self, name: str) -> Document:
        return next(each for each in self.document()["instances"] if each["name"] == name)


def live_view(manager: Manager, simulator: Simulator, *, phase: str = "up") -> LiveView:
    lifecycle = Lifecycle(manager)
    lifecycle.phase = phase  # type: ignore[assignment]  # one of them
    return LiveView(lifecycle, now=lambda: EPOCH + simulator.clock.steady())


def viewed(name: str, folder: Path, body: Callable[[Viewed], Awaitable[T]]) -> T:
    """Bring the example up in virtual time and run ``body`` with its view."""

    async def run(manager: Manager, simulator: Simulator) -> T:
        live = live_view(manager, simulator)
        live.start()
        try:
            return await body(Viewed(manager, simulator, live))
        finally:
            live.lifecycle.ended.set()
            live.close()
            await asyncio.sleep(0.2)

    return managed(name, folder, run)


@dataclass
class Message:
    """One event of the stream, and when it was taken (loop time)."""

    kind: str
    id: str
    document: Document
    at: float


@dataclass
class Reader:
    """A client of the stream. It keeps the view up to date by the patches that it is sent, and nothing else."""

    live: LiveView
    since: str = ""
    messages: list[Message] = field(default_factory=list)
    view: Document = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._source = stream(self.live, position(self.since))

    async def take(self) -> Message | None:
        """The next event; None at the end of the stream. Comments are skipped."""
        async for text in self._source:
            if text.startswith(b":"):
                continue
            fields = dict(line.split(": ", 1) for line in text.decode().strip().split("\n"))
            message = Message(
                fields["event"], fields["id"], json.loads(fields["data"]), asyncio.get_running_loop().time()
            )
            self.messages.append(message)
            self._apply(message)
            return message
        return None

    async def follow(self) -> None:
        while await self.take() is not None:
            pass

    async def close(self) -> None:
        await self._source.aclose()

    def of(self, kind: str) -> list[Message]:
        return [message for message in self.messages if message.kind == kind]

    def _apply(self, message: Message) -> None:
        if message.kind == "view":
            self.view = message.document
        elif message.kind == "patch":
            self.view = patched(self.view, message.document)


@contextmanager
def following(readers: Iterable[Reader]) -> Any:
    """The readers read all the time while the context is open."""
    tasks = [asyncio.ensure_future(reader.follow()) for reader in readers]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()


def patched(view: Document, patch: Document) -> Document:
    """The view after a patch, by the words of docs/http.md."""
    after = {**view, **patch}
    for field_name in ("instances", "topics"):
        entries = {entry["name"]: entry for entry in view[field_name]}
        for name, entry in patch.get(field_name, {}).items():
            if entry is None:
                entries.pop(name, None)  # it may have come and gone in between
            else:
                entries[name] = entry
        after[field_name] = [entries[name] for name in sorted(entries)]
    return after


def without_figures(view: Document) -> Document:
    """A view without what is measured, or is in words that change with time."""
    instances = [
        {
            **each,
            "ports": [{**port, **dict.fromkeys(FIGURES)} for port in each["ports"]],
            "functionalities": [{**mode, "since": None, "restoring": None} for mode in each["functionalities"]],
        }
        for each in view["instances"]
    ]
    return {**view, "instances": instances}

"""The stream of the live view: server-sent events `view`, `patch` and `event`.

The differences are made when the client takes them: one that does not read is owed nothing but the current state and
the events that the manager keeps, and no queue grows for it.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Any, Final, NamedTuple

import msgspec

from midstride.server.stream import KEEP_ALIVE
from midstride.server.view.live import SOON, LiveView

_POSITION: Final = re.compile(r"([0-9a-f]+):([0-9]{1,15})(?:\.([0-9]{1,15}))?")


class Position(NamedTuple):
    """What a client was last sent: the state of a view of one manager, and the last event, where that is known."""

    manager: str
    n: int
    event: int | None


def position(text: str) -> Position | None:
    """The position that an event's id is; None for any other text: its client is sent the whole view."""
    match = _POSITION.fullmatch(text)
    if match is None:
        return None
    manager, n, event = match.groups()
    return Position(manager, int(n), None if event is None else int(event))


async def view_events(live: LiveView, since: Position | None) -> AsyncIterator[bytes]:
    """The view, or what has changed since ``since``, and then each difference, until the manager exits."""
    lifecycle, events, table = live.lifecycle, live.events, live.table
    known = since is not None and since.manager == live.manager
    with live.client() as waker:
        sent = since.n if since is not None and known and table.knows(since.n) else 0
        last = since.event if since is not None and known and since.event is not None else events.last
        last = min(last, events.last)
        ended = asyncio.ensure_future(lifecycle.ended.wait())
        loop = asyncio.get_running_loop()
        sent_at = loop.time() - SOON
        try:
            yield b": midstride\n\n"
            while True:
                waker.clear()
                if not table.knows(sent):
                    sent, sent_at = table.n, loop.time()
                    yield _message("view", live.manager, sent, last, live.document())
                elif table.n != sent:
                    await asyncio.sleep(sent_at + SOON - loop.time())
                    patch, sent, sent_at = table.patch(sent), table.n, loop.time()
                    yield _message("patch", live.manager, sent, last, patch)
                for event in events.since(last):
                    last = event.n
                    yield _message("event", live.manager, sent, last, msgspec.json.encode(event))
                if ended.done():
                    return
                if table.n == sent and events.last == last and not await _woken(waker, ended):
                    yield b": still here\n\n"
        finally:
            ended.cancel()


async def _woken(waker: asyncio.Event, ended: asyncio.Future[Any]) -> bool:
    """Wait until something has changed or the manager exits; False if neither happens for a long time."""
    waiting = asyncio.ensure_future(waker.wait())
    try:
        done, _ = await asyncio.wait({waiting, ended}, timeout=KEEP_ALIVE, return_when=asyncio.FIRST_COMPLETED)
        return bool(done)
    finally:
        waiting.cancel()


def _message(kind: str, manager: str, n: int, event: int, json: bytes) -> bytes:
    return b"id: %s:%d.%d\nevent: %s\ndata: %s\n\n" % (manager.encode(), n, event, kind.encode(), json)

"""The stream of the live view: server-sent events `view`, `patch` and `event`.

The differences are made when the client takes them: one that does not read is owed nothing but the current state and
the events that the manager keeps, and no queue grows for it.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator
from typing import Final, NamedTuple

from midstride.codec.writing import to_json
from midstride.runtime.timeouts import within
from midstride.server.event_stream import KEEP_ALIVE
from midstride.server.view.live import LiveView
from midstride.server.view.timing import SOON

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


async def view_events(live: LiveView, since: Position | None) -> AsyncGenerator[bytes, None]:
    """The view, or what has changed since ``since``, and then each difference, until the manager exits."""
    lifecycle, events, table = live.lifecycle, live.events, live.table
    known = since is not None and since.manager == live.manager
    with live.client() as waker:
        sent = since.n if since is not None and known and table.knows(since.n) else 0
        last = since.event if since is not None and known and since.event is not None else events.last
        last = min(last, events.last)
        ended = asyncio.ensure_future(lifecycle.ended.wait())
        ended.add_done_callback(lambda _: waker.set())
        loop = asyncio.get_running_loop()
        due = loop.time()  # when the next difference may be sent; an event may at any time
        try:
            yield b": midstride\n\n"
            while True:
                waker.clear()
                if over := ended.done():
                    live.refresh(figures=False)  # the last difference is sent as well
                known = table.knows(sent)
                if not known or (table.n != sent and (over or loop.time() >= due)):
                    kind, json = ("patch", table.patch(sent)) if known else ("view", live.document())
                    sent, due = table.n, loop.time() + SOON
                    yield _message(kind, live.manager, sent, last, json)
                for event in events.since(last):
                    last = event.n
                    yield _message("event", live.manager, sent, last, to_json(event))
                if over:
                    return
                if table.n != sent:
                    await _woken(waker, due - loop.time())
                elif events.last == last and not await _woken(waker, KEEP_ALIVE):
                    yield b": still here\n\n"
        finally:
            ended.cancel()


async def _woken(waker: asyncio.Event, seconds: float) -> bool:
    """Wait until something has happened; False if nothing does in so many seconds."""
    try:
        async with within(seconds):
            await waker.wait()
    except asyncio.TimeoutError:
        return False
    return True


def _message(kind: str, manager: str, n: int, event: int, json: bytes) -> bytes:
    return b"id: %s:%d.%d\nevent: %s\ndata: %s\n\n" % (manager.encode(), n, event, kind.encode(), json)

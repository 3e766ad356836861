"""The stream of a manager: server-sent events `view`, `patch` and `event`.

The differences are made when the client takes them: one that does not read is owed nothing but the current state and
the events that the manager keeps, and no queue grows for it. A comment every few seconds keeps proxies from closing the
connection, and shows when the client has gone.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator
from typing import Final, NamedTuple

from midstride.codec.writing import to_json
from midstride.runtime.timeouts import within
from midstride.server.view.live import LiveView
from midstride.server.view.timing import SOON

# How long nothing is sent at most (s).
KEEP_ALIVE: Final = 15.0
_NUMBER: Final = re.compile(r"[0-9]{1,15}")
_POSITION: Final = re.compile(r"([0-9a-f]+):([0-9]{1,15})(?:\.([0-9]{1,15}))?")


class Position(NamedTuple):
    """The position of a client in the stream: the state of a view of one manager, and the last event, where that is
    known.

    ``manager`` is None where the client has the number of an event alone.
    """

    manager: str | None
    n: int
    event: int | None


def position(text: str) -> Position | None:
    """The position that an id or the number of an event is; None for any other text: its client is sent the whole."""
    if _NUMBER.fullmatch(text):
        return Position(None, 0, int(text))
    match = _POSITION.fullmatch(text)
    if match is None:
        return None
    manager, n, event = match.groups()
    return Position(manager, int(n), None if event is None else int(event))


async def stream(live: LiveView, since: Position | None, *, log_only: bool = False) -> AsyncGenerator[bytes, None]:
    """The view, or what has changed since ``since``, and then each difference, until the manager exits.

    ``log_only``: events of the log alone, from the first on where ``since`` says nothing, and only until it is known
    that the system could not be brought up.
    """
    lifecycle, table = live.lifecycle, live.table
    events = lifecycle.manager.watched.events
    known = since is not None and since.manager in {None, live.manager}
    with events.wakers.client() if log_only else live.client() as waker:
        sent = since.n if since is not None and known and table.knows(since.n) else 0
        unknown = 0 if log_only else events.last
        last = since.event if since is not None and known and since.event is not None else unknown
        last = unknown if last > events.last else last  # the number of an earlier manager's event
        ends = [asyncio.ensure_future(end.wait()) for end in (lifecycle.ended, lifecycle.up_ended)]
        for end in ends:
            end.add_done_callback(lambda _: waker.set())
        loop = asyncio.get_running_loop()
        due = loop.time()  # when the next difference may be sent; an event may at any time
        try:
            yield b": midstride\n\n"
            while True:
                waker.clear()
                over = lifecycle.ended.is_set() or (log_only and lifecycle.failure is not None)
                if over and not log_only:
                    live.refresh(measurements=False)  # the last difference is sent as well
                known = log_only or table.knows(sent)
                if not known or (not log_only and table.n != sent and (over or loop.time() >= due)):
                    kind, json = ("patch", table.patch(sent)) if known else ("view", live.document())
                    sent, due = table.n, loop.time() + SOON
                    yield _message(kind, live.manager, sent, last, json)
                for event in events.since(last):
                    last = event.n
                    yield _message("event", live.manager, sent, last, to_json(event))
                if over:
                    return
                if not log_only and table.n != sent:
                    await _woken(waker, due - loop.time())
                elif events.last == last and not await _woken(waker, KEEP_ALIVE):
                    yield b": still here\n\n"
        finally:
            for end in ends:
                end.cancel()


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

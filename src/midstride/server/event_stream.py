"""The event stream: server-sent events, each a JSON document with its number as the id.

A client that reconnects with ``Last-Event-ID``, as browsers do, misses nothing that the manager still keeps. A comment
every few seconds keeps proxies from closing the connection, and shows when the client has gone.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, Final

from midstride.codec.writing import to_json
from midstride.runtime.records.reports import Event
from midstride.server.manager_lifecycle import Lifecycle

KEEP_ALIVE: Final = 15.0


def encode(event: Event) -> str:
    """One event in the format of server-sent events. JSON has no raw line breaks, so one ``data`` line holds it."""
    return f"id: {event.n}\nevent: {event.kind}\ndata: {to_json(event).decode()}\n\n"


async def events(lifecycle: Lifecycle, since: int) -> AsyncIterator[str]:
    """The events after number ``since`` and all that come, until the system is down or could not be brought up."""
    last = since
    source = lifecycle.manager.subscribe(since)
    upcoming = asyncio.ensure_future(anext(source))
    ended = asyncio.ensure_future(lifecycle.ended.wait())
    settled = asyncio.ensure_future(lifecycle.settled.wait())
    waits: set[asyncio.Future[Any]] = {upcoming, ended, settled}
    try:
        yield ": midstride\n\n"
        while True:
            done, _ = await asyncio.wait(waits, timeout=KEEP_ALIVE, return_when=asyncio.FIRST_COMPLETED)
            if not done:
                yield ": still here\n\n"
            elif upcoming in done:  # before an end: events precede it
                event = upcoming.result()
                last = event.n
                waits.discard(upcoming)
                upcoming = asyncio.ensure_future(anext(source))
                waits.add(upcoming)
                await asyncio.sleep(0)  # so that an event that is already known is done in the next round
                yield encode(event)
            elif ended in done:
                return
            else:
                waits.discard(settled)
                if lifecycle.failure is not None:
                    yield encode(lifecycle.failure_event(last + 1))
                    return
    finally:
        for wait in (upcoming, ended, settled):
            wait.cancel()

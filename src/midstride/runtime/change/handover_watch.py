"""After a hand-over, the new publishers are watched; the old ones stay warm (docs/protocols/probation.md)."""

from __future__ import annotations

import asyncio
from typing import Final

from midstride.model.action import Handover
from midstride.model.configuration import Configuration
from midstride.model.specification import FEWEST_PERIODS, handover_seconds
from midstride.runtime.cancellation import all_of
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.handover.probation import (
    WATCHED_WINDOW,
    WatchedOutput,
    WatchedServer,
    watch_after,
    watch_servers_after,
)
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.watch.simulated_time import stretch_of

# The rates of a brief change are judged over so long (s), or five periods, where that is not longer than the second;
# and they are watched for so many times as long, where the specification does not say.
BRIEF_WINDOW: Final = 0.5
LONGEST_BRIEF_WINDOW: Final = 2.0
BRIEF_WATCH: Final = 1.2


async def watch_new_publishers(
    client: ComponentClient, events: EventLog, change: RunningChange, configuration: Configuration, action: Handover
) -> None:
    """Watch what has taken over by ``action`` for as long as the specification says.

    Those of a brief change are watched for a while by default, until the next command waits; servers only where the
    specification says for how long. Raises StepFailed if one breaks what it guarantees.
    """
    timing = change.target.timing
    swaps = [swap for swap in action.swaps if configuration.is_topic(swap.connector)]
    servers = [
        WatchedServer(swap.new, configuration.topic(swap.connector))
        for swap in action.swaps
        if swap not in swaps and configuration.bound(swap.new) is not None
    ]
    by_default = change.brief and "probation" not in timing and "watch_after" not in timing
    rates = {swap.new: configuration.rate(swap.new) or 0.0 for swap in swaps}
    seconds, shortest = handover_seconds(timing, "watch_after"), WATCHED_WINDOW
    if by_default:
        rates = {port: rate for port, rate in rates.items() if rate * LONGEST_BRIEF_WINDOW >= FEWEST_PERIODS}
        shortest = BRIEF_WINDOW
        windows = [max(shortest, FEWEST_PERIODS / rate) for rate in rates.values()]
        seconds = BRIEF_WATCH * max(windows, default=0.0)
    if not seconds or not (swaps or servers):
        return
    outputs = sorted(
        {
            WatchedOutput(swap.new, swap.old, configuration.topic(swap.connector), rates.get(swap.new, 0.0))
            for swap in swaps
        }
    )
    watched = ", ".join(map(str, [*(each.port for each in outputs), *(each.port for each in servers)]))
    events.add("watching", f"watching {watched} for {seconds:g} s")
    slowest = max((stretch_of(client, each.port.instance) for each in outputs), default=1.0)

    async def watch_all() -> None:
        await all_of(
            [
                watch_after(client, outputs, seconds, slowest, shortest),
                watch_servers_after(client, servers, seconds),
            ]
        )

    await change.unless_hurried(asyncio.ensure_future(watch_all()), by_default)

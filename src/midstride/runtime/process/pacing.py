"""Paces the starts of processes by what the machine can do.

A process that starts needs a processor for its imports, and each that runs already needs time to discover it. If many
start at once, all are slow, the middleware repeats what was not acknowledged in time, and the sum of the work grows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from midstride.runtime.manager_clock import Clock

# How many processes per processor may be starting while these are idle, because they wait for devices or disks.
MOST_EACH: Final = 8
# Over this time (s), at least this share of one processor must have been idle before another process starts.
INTERVAL: Final = 0.1
SPARE: Final = 0.5
# After how long (s) one more may start in any case: what does not register may wait for another that does not run yet,
# as a lifecycle node for the program that configures it.
PATIENCE: Final = 3.0
# How soon it is noticed that one has registered, which makes room for another (s): one that is forked takes 0.1 s.
LOOK: Final = 0.01


async def room_for_a_start(clock: Clock, starting: Callable[[], int]) -> None:
    """Return when another process may start; ``starting`` counts those that have not registered yet.

    One per processor may start in any case, also on a machine that is busy with other work, and one more each PATIENCE.
    """
    processors, begun = clock.processors(), clock.steady()
    while starting() >= processors and clock.steady() - begun < PATIENCE:
        at, idle = clock.steady(), clock.idle()
        while (passed := clock.steady() - at) < INTERVAL:
            await clock.sleep(LOOK)
            if starting() < processors:
                return
        if starting() < MOST_EACH * processors and clock.idle() - idle >= SPARE * passed:
            return

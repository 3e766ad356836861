"""Simulated time on the manager's side: how far time-outs are stretched, and observations on the ROS clock.

Receipts carry the steady clock of the subscriber and the publication's time on the system's clock. Where ``/clock``
drives a subscriber, its slots, rates and gaps are of the ROS clock, so both times are converted, along the moments at
which the subscriber saw that clock move (docs/protocols/clocks.md).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from msgspec import structs

from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.measure import Observation, SwapReport, report
from midstride.wire.replies import ClockMoment
from midstride.wire.state import ComponentState

# A time-out that waits for periods of a slow clock is stretched by this factor at most.
LONGEST_STRETCH: Final = 20.0


def stretch(state: ComponentState | None) -> float:
    """By which factor to stretch a time-out that waits for periods of the component's ROS clock: never less than 1."""
    if state is None or not state.simulated_time or state.clock_speed <= 0:
        return 1.0
    return min(max(1.0, 1 / state.clock_speed), LONGEST_STRETCH)


def stretch_of(client: ComponentClient, instance: str) -> float:
    """The :func:`stretch` of the state that ``instance`` last reported."""
    latest = client.life.latest(instance)
    return stretch(None if latest is None else latest.state)


def report_on_ros_clock(seen: Observation, moments: Sequence[ClockMoment], *, ros_sources: bool = False) -> SwapReport:
    """The figures of an observation of simulated time; ``moments`` are those of the subscriber's clock.

    ``ros_sources``: times of publication are on the ROS clock already.

    Where the clock jumped back meanwhile, slots and gaps mean nothing: those figures are None.
    """
    jumped = max((index for index in range(1, len(moments)) if moments[index][1] < moments[index - 1][1]), default=0)
    known = moments[jumped:]
    if len(known) < 2 or (jumped and known[0][0] > seen.begun):
        raw = report(seen)
        return structs.replace(raw, gap=None, gap_periods=None, missed=None, duplicates=None)
    if jumped:
        seen = replace(seen, rows=[row for row in seen.rows if row.received >= known[0][0]])
    return report(on_ros_clock(seen, known, ros_sources))


def on_ros_clock(seen: Observation, moments: Sequence[ClockMoment], ros_sources: bool = False) -> Observation:
    """The observation with all its times on the ROS clock, which moved forward at ``moments``, two or more."""
    steady = [moment[0] for moment in moments]

    def ros(time: int) -> int:
        index = min(max(bisect.bisect_right(steady, time), 1), len(moments) - 1)
        (begin, first), (end, last) = moments[index - 1], moments[index]
        # Beyond the last moment it runs on for as long as it took before: then it stands still.
        passed = min(time - begin, 2 * (end - begin))
        return first + round(passed * (last - first) / max(1, end - begin))

    # The system's clock against the subscriber's steady one, from the fastest transmission.
    offset = min((row.received - row.source for row in seen.rows if row.source is not None), default=0)

    def published(source: int) -> int:
        return source if ros_sources else ros(source + offset)

    rows = [
        structs.replace(row, received=ros(row.received), source=None if row.source is None else published(row.source))
        for row in seen.rows
    ]
    inputs = None if seen.inputs is None else [published(source) for source in seen.inputs]
    watched = seen.watched
    if not math.isinf(watched):
        watched = (ros(seen.ended) - ros(seen.ended - int(watched * 1e9))) / 1e9
    earliest = ros(seen.earliest) if seen.earliest else 0
    return replace(
        seen, rows=rows, begun=ros(seen.begun), ended=ros(seen.ended), inputs=inputs, watched=watched, earliest=earliest
    )

"""``python -m midstride.simulation.rehearsal``: rehearse one change in a process, for the manager.

Reads the change from standard input and prints what came of it, both as JSON. A manager does not run seeds itself: its
loop must answer components within milliseconds.
"""

from __future__ import annotations

import sys
import time
from typing import Final

import msgspec

from midstride.errors import MidstrideError
from midstride.runtime.records.rehearsal_forms import Rehearsal, RehearsalOrder, RehearsedSeed
from midstride.simulation.campaign import Summary, simulate_many
from midstride.simulation.scenario import rehearsed
from midstride.simulation.seed_run import SeedRun

# The ways in which a change, or the recovery from it, ends.
BRANCHES: Final = ("done", "refused", "rolled_back", "failed", "manager killed", "recovered")


def rehearsal_of(summary: Summary) -> Rehearsal:
    """The summary as it is printed."""
    return Rehearsal(
        seeds=summary.seeds,
        outcomes=dict(summary.outcomes),
        faults={
            fault: {"struck": count, **{name: summary.branches[fault, name] for name in BRANCHES}}
            for fault, count in sorted(summary.struck.items())
        },
        failed=[rehearsed_seed(run) for run in summary.failed],
    )


def rehearsed_seed(run: SeedRun) -> RehearsedSeed:
    return RehearsedSeed(run.seed, run.problems, run.outcomes)


def rehearse(order: RehearsalOrder) -> Rehearsal:
    """Run the seeds one after another. Raises PlanRefused if nothing can be planned for the request."""
    end = time.monotonic() + order.within
    scenario = rehearsed(order.specification.specification(), order.request.request())
    summary = Summary()
    for run in simulate_many(range(order.first, order.first + order.seeds), scenario):
        summary.add(run)
        if time.monotonic() > end:
            break
    return rehearsal_of(summary)


def main() -> int:
    """The exit status is 1 if the change cannot be rehearsed: the reason is then on standard error."""
    order = msgspec.json.decode(sys.stdin.buffer.read(), type=RehearsalOrder)
    try:
        result = rehearse(order)
    except MidstrideError as error:
        print(error, file=sys.stderr)
        return 1
    sys.stdout.buffer.write(msgspec.json.encode(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What measuring contracts costs: a message written or received, a message checked, and a report, at 1 kHz.

The real ports, with endpoints that do nothing; beside them the same ports whose links take no time. Processor time of
one thread, the median of interleaved runs.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from midstride.model.contract import Interval, Predicate, QoS, ValueSet
from midstride.node.author.declared_contracts import Guarantee
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Input, InputLink, Output, OutputLink

RESULTS = Path(__file__).parent / "results" / "measuring.json"
MESSAGES, RUNS = 50_000, 9
# Of a core, at 1 kHz: what counts as not noticed.
LIMIT = 0.01
KINDS = ("write", "receive")


class Range:
    """A message of one field."""

    __msgtype__ = "sensor_msgs/msg/Range"
    range = 2.0


class Unmeasured(MessageTimes):
    """Takes no time: the ports as they were without a measurement."""

    def mark(self) -> int:
        return 0


CONSTRAINT: tuple[tuple[str, ValueSet], ...] = (("range", Interval(low=1.5)),)


def writing(times: type[MessageTimes], where: Any = ()) -> Callable[[Any], object]:
    output = Output("out", Range, QoS())
    output.promise(Guarantee(1000.0, where))
    publisher = cast(Any, SimpleNamespace(publish=lambda message: None))
    link = OutputLink(output, "/t", publisher, times(time.time_ns))
    link.set_gate(True)
    output.links = (link,)
    return output.write


def receiving(times: type[MessageTimes], where: Any = ()) -> Callable[[Any], object]:
    port = Input("in", Range, Predicate(Range.__msgtype__, 1000.0, QoS(), where))
    host = cast(Any, SimpleNamespace(now=time.time_ns, steady=time.monotonic_ns))
    receive = port.receiver(InputLink(port, "/t", times(time.time_ns)), host)
    return lambda message: receive(message, None)


def microseconds(call: Callable[[Any], object], calls: int = MESSAGES) -> float:
    message, begun = Range(), time.thread_time_ns()
    for _ in range(calls):
        call(message)
    return (time.thread_time_ns() - begun) / calls / 1e3


def full() -> MessageTimes:
    """The times of an attachment at 1 kHz."""
    clock = SimpleNamespace(now=1)
    times = MessageTimes(lambda: int(clock.now))
    for _ in range(2_000):
        clock.now += 1_000_000
        times.mark()
    return times


def main() -> int:
    argparse.ArgumentParser(description=__doc__).parse_args()
    busy = full()
    measured: dict[str, Callable[[], float]] = {
        "write, not measured": lambda: microseconds(writing(Unmeasured)),
        "write": lambda: microseconds(writing(MessageTimes)),
        "write, one field constrained": lambda: microseconds(writing(MessageTimes, CONSTRAINT)),
        "receive, not measured": lambda: microseconds(receiving(Unmeasured)),
        "receive": lambda: microseconds(receiving(MessageTimes)),
        "receive, one field constrained": lambda: microseconds(receiving(MessageTimes, CONSTRAINT)),
        "the figures for one report": lambda: microseconds(lambda _: busy.measured(1.0), 200),
    }
    runs: dict[str, list[float]] = {name: [] for name in measured}
    for _ in range(RUNS):
        for name, run in measured.items():
            runs[name].append(run())
    found = {name: statistics.median(each) for name, each in runs.items()}
    print(f"{'':32}{'µs each':>10}{'of a core at 1 kHz':>22}")
    for name, each in found.items():
        per_second = 2 if name.startswith("the figures") else 1000
        print(f"{name:32}{each:>10.2f}{each * per_second / 1e6:>21.2%}")
    added = 1e-3 * max(found[f"{kind}, one field constrained"] - found[f"{kind}, not measured"] for kind in KINDS)
    added += 2e-6 * found["the figures for one report"]
    print(f"\nmeasuring costs at most {added:.2%} of a core for an attachment at 1 kHz (limit {LIMIT:.0%})")
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps({"microseconds": found, "of_a_core": added}, indent=1) + "\n")
    return int(added > LIMIT)


if __name__ == "__main__":
    sys.exit(main())

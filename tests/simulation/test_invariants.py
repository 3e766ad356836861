"""What counts as two publishers heard at once, message by message."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.simulation.invariants import Invariants
from midstride.simulation.stand_in import StandIn


def publisher(instance: str, pid: int) -> Any:
    process: Any = StandIn.__new__(StandIn)
    process.instance, process.role, process.pid = instance, instance.partition("_")[0], pid
    return process


OLD, NEW, AGAIN = publisher("talker", 1), publisher("talker_2", 2), publisher("talker_2", 3)


@pytest.mark.parametrize(
    ("heard", "violations"),
    [
        ((OLD, NEW, OLD, AGAIN, AGAIN), []),  # handed over, rolled back, and handed over again
        ((OLD, NEW, OLD, NEW), ["talker and talker_2 are both heard on /chatter"]),
        ((OLD, NEW, OLD, AGAIN, OLD, AGAIN), ["talker and talker_2 are both heard on /chatter"]),
    ],
)
def test_two_processes_that_take_turns_are_both_heard(heard: list[Any], violations: list[str]) -> None:
    times = iter(range(100))
    time = SimpleNamespace(steady=lambda: next(times) / 10)
    found: list[str] = []
    invariants = Invariants(SimpleNamespace(time=time), SimpleNamespace(period=lambda topic: 0.1))  # type: ignore[arg-type]
    invariants.begin(lambda: math.inf, lambda: 0.0, lambda: True, found.append)
    for process in heard:
        invariants.on_publish(SimpleNamespace(topic="/chatter", owner=process))  # type: ignore[arg-type]
    assert found == violations

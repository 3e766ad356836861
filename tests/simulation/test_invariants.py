"""What counts as two publishers heard at once, message by message."""

from __future__ import annotations

import math
import random
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.simulation.invariants import Invariants, received
from midstride.simulation.oracle import Oracle, Shown
from midstride.simulation.scenario import built_in
from midstride.simulation.stand_in import StandIn
from midstride.wire.state import LinkState


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
    invariants.begin(lambda: math.inf, lambda: 0.0, lambda: True, bool, found.append)
    for process in heard:
        invariants.on_publish(SimpleNamespace(topic="/chatter", owner=process))  # type: ignore[arg-type]
    assert found == violations


@pytest.mark.parametrize(
    ("period", "silence", "violated"), [(0.1, 1.4, False), (0.1, 1.6, True), (0.2, 2.0, False), (0.2, 2.6, True)]
)
def test_the_topic_of_a_cut_whose_manager_has_died_is_silent_for_ten_periods_at_most(
    period: float, silence: float, violated: bool
) -> None:
    times = iter([1.0, 1.0 + silence])
    found: list[str] = []
    platform: Any = SimpleNamespace(time=SimpleNamespace(steady=lambda: next(times)))
    invariants = Invariants(platform, SimpleNamespace(period=lambda topic: period))  # type: ignore[arg-type]
    invariants.begin(lambda: math.inf, lambda: 0.0, lambda: True, bool, found.append)
    for _ in range(2):
        invariants.on_publish(SimpleNamespace(topic="/chatter", owner=OLD))  # type: ignore[arg-type]
    expected = f"/chatter was silent for {silence:.1f} s although its publishers were alive"
    assert found == ([expected] if violated else [])


@pytest.mark.parametrize("count", [0, 1])
def test_a_component_must_notice_the_silence_of_what_it_has_received(count: int) -> None:
    """An input that has never received anything is not watched."""
    process = publisher("detector", 1)
    process._published = SimpleNamespace(ports={"in": {"/scan": LinkState(gate=None, count=count)}})
    specification = built_in(random.Random(0)).specification
    shown = Shown("detector", "", specification.components["Detector"], (("detect", "normal"),), (("in", "/scan"),))
    assert Oracle([specification]).reflex_applies(shown, "detect", received(process)) is bool(count)


@pytest.mark.parametrize(
    ("modes", "violations"),
    [
        (("normal", "normal"), ["out of both talker and talker_2 is open on /chatter"]),
        (("off", "normal"), ["out of both talker and talker_2 is open on /chatter"]),
        (("off", "off"), []),  # there is nothing to take over
    ],
)
def test_the_outputs_of_two_instances_are_both_open_only_while_neither_guarantees_anything(
    modes: tuple[str, str], violations: list[str]
) -> None:
    component = built_in(random.Random(0)).specification.components["Lidar"]
    pair = publisher("talker", 1), publisher("talker_2", 2)
    for process, mode in zip(pair, modes, strict=True):
        process.host = ""
        process._stand_in = SimpleNamespace(component=component)
        process._published = SimpleNamespace(functionalities={"scan": SimpleNamespace(mode=mode)})
        process.open_outputs = lambda: {("out", "/chatter")}
    platform: Any = SimpleNamespace(stand_ins=lambda: pair)
    found: list[str] = []
    invariants = Invariants(platform, SimpleNamespace())  # type: ignore[arg-type]
    invariants.begin(lambda: math.inf, lambda: 0.0, lambda: True, bool, found.append)
    invariants._check_gates(pair[0])
    assert found == violations

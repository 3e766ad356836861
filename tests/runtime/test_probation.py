"""What new code must have shown behind its gate before it takes over, and what the next command need not wait for."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.runtime.systems import example, managed, rewritten

RESTART = PlanRequest(restart=("talker",))


def at_rate(rate: str, folder: Path) -> Path:
    """The talker's example at another rate (Hz)."""
    return rewritten(
        "talker",
        folder,
        lambda _, text: text.replace("rate=10", f"rate={rate}").replace("@ 10 Hz", f"@ {rate} Hz"),
    )


def restarted(programs: Path, folder: Path, code: str, **timing: float) -> tuple[Outcome, list[str], float]:
    """The outcome after `code` was put first in the talker's mode function, which runs, and how long it took."""
    specification = replace(example("talker", programs), timing=Map(timing))

    async def body(manager: Manager, simulator: Simulator) -> tuple[Outcome, list[str], float]:
        script = programs / "talker.py"
        text = script.read_text().replace("def normal() -> None:\n", f"calls = []\n\n\ndef normal() -> None:\n{code}")
        assert code in text
        script.write_text(text)
        begun = simulator.clock.steady()
        outcome = await manager.change(RESTART)
        assert (await manager.status()).valid
        return outcome, sorted(manager.configuration.instances), simulator.clock.steady() - begun - 20 / 5

    folder.mkdir()
    return managed("talker", folder, body, specification=specification, directory=programs)


@pytest.mark.parametrize("call", [1, 2, 3])
@pytest.mark.parametrize("rate", ["5", "50"])
def test_code_that_raises_in_one_of_its_first_calls_is_not_let_in(rate: str, call: int, tmp_path: Path) -> None:
    code = f"    calls.append(1)\n    if len(calls) == {call}:\n        raise ValueError('not like this')\n"
    outcome, instances, seconds = restarted(at_rate(rate, tmp_path / "programs"), tmp_path / "workspace", code)
    assert outcome.outcome == "rolled_back"
    assert "ValueError: not like this" in str(outcome.because)
    assert instances == ["listener", "talker"]
    assert [(swap.missed, swap.duplicates) for swap in outcome.swaps] == [(0, 0)]
    assert seconds < 1.5  # it does not wait for a message that will not come


@pytest.mark.parametrize(("timing", "least"), [({"probation": 0.0}, 0.5), ({}, 5.0)])
def test_the_calls_of_slow_code_are_not_waited_for(timing: dict[str, float], least: float, tmp_path: Path) -> None:
    """At 1 Hz, three calls would take two seconds more. Its rate is judged over five periods."""
    programs = at_rate("1", tmp_path / "programs")
    outcome, instances, _ = restarted(programs, tmp_path / "workspace", "    pass\n", **timing)
    assert outcome.outcome == "done", outcome.because
    assert least < outcome.seconds < least + 2.1
    assert instances == ["listener", "talker_2"]


def two_restarts(brief: bool, folder: Path) -> tuple[list[Outcome], float]:
    """Of the talker, the second while the first is being measured; and when the second was done (s)."""

    async def body(manager: Manager, simulator: Simulator) -> tuple[list[Outcome], float]:
        begun = simulator.clock.steady()
        first = asyncio.ensure_future(manager.change(RESTART, brief=brief))
        while not any(event.kind == "measuring" for event in manager.log()):
            await asyncio.sleep(0.01)
        second = asyncio.ensure_future(manager.change(RESTART, brief=True))
        while manager.log()[-1].kind != "measuring" or "talker_3" not in manager.configuration.instances:
            await asyncio.sleep(0.01)
        took = simulator.clock.steady() - begun
        return [await first, await second], took

    folder.mkdir()
    specification = replace(example("talker"), timing=Map({"probation": 0.0, "watch_after": 0.0}))
    return managed("talker", folder, body, specification=specification)


def test_the_next_change_does_not_wait_for_the_measurement_of_a_brief_one(tmp_path: Path) -> None:
    outcomes, brief = two_restarts(True, tmp_path / "brief")
    whole_outcomes, whole = two_restarts(False, tmp_path / "whole")
    assert whole - brief == pytest.approx(17 / 10, abs=0.2)  # 3 periods at 10 Hz instead of 20
    for outcome in [*outcomes, *whole_outcomes]:
        assert outcome.outcome == "done", outcome.because
        assert [(swap.missed, swap.lost, swap.duplicates) for swap in outcome.swaps] == [(0, 0, 0)]
        assert [swap.gap_periods for swap in outcome.swaps] == [pytest.approx(1.0, abs=0.1)]


def test_a_brief_change_with_nothing_behind_it_is_measured_in_full(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> float:
        begun = simulator.clock.steady()
        outcome = await manager.change(RESTART, brief=True)
        return simulator.clock.steady() - begun - outcome.seconds

    (tmp_path / "workspace").mkdir()
    assert managed("talker", tmp_path / "workspace", body) >= 2.0

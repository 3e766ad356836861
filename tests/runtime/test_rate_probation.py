"""Probation and watch-after by measured rates, on the simulator: what is let in, and what hands back."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.runtime.handover.probation import SHORTEST_PERIODS, require_rate, watch_after
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.wire.commands import AwaitRateCommand
from midstride.wire.replies import RateVerdict
from tests.model import build
from tests.runtime.counting import Reader, at_rates, counting, exchanged, settle, system
from tests.runtime.scripted import Bench, bench, talking

# How the new component writes: put before its only write. It is called at 20 Hz.
LATE = "calls.append(1)\n        if len(calls) < 60 and len(calls) % 2: return\n"
SLOW = "calls.append(1)\n        if len(calls) % 2: return\n"
BURSTS = """calls.append(1)
        if len(calls) % 20 >= 10: return
        output.write(String(data=f"{count[name]} {comp.instance}"))
"""
STALLS = "calls.append(1)\n        if len(calls) % 20 < 8: return\n"
SLOW_WHEN_LIVE = "calls.append(1)\n        if comp.is_live and len(calls) % 3: return\n"
SILENT_WHEN_LIVE = "calls.append(comp.is_live)\n        if calls.count(True) > 5: return\n"
RAISES_WHEN_LIVE = "calls.append(comp.is_live)\n        if calls.count(True) == 20: raise ValueError('now')\n"
TIMING = {"probation": 1.0, "probation_timeout": 4.0}


def program(before: str = "") -> str:
    text = at_rates(out=20).replace("count = {", "calls = []\ncount = {")
    return text.replace(
        "        output.write", f"        {before}        output.write" if before else "        output.write"
    )


def changed(
    folder: Path, new: str, timing: dict[str, float], kill_after: float | None = None
) -> tuple[Outcome, float, list[str], list[str]]:
    """The outcome of the replacement, how long it took, what runs afterwards, and what a subscriber received."""

    async def body(manager: Manager, simulator: Simulator) -> tuple[Outcome, float, list[str], list[str]]:
        manager.system.specification = replace(manager.specification, timing=Map(timing))
        reader = Reader(simulator, "/out")
        await settle()
        begun = simulator.clock.steady()
        changing = asyncio.ensure_future(exchanged(manager))
        if kill_after is not None:
            while manager.log()[-1].kind != "watching":
                await asyncio.sleep(0.01)
            await settle(kill_after)
            simulator.faults.kill("counter_2")
        outcome = await changing
        took = simulator.clock.steady() - begun
        await settle(1)
        assert (await manager.status()).valid
        return outcome, took, sorted(manager.configuration.instances), reader.words

    return counting(system(folder, program(), new, out=20), body)


@pytest.mark.parametrize(("new", "least"), [(program(), 1.0), (program(LATE), 3.5)])
def test_a_new_one_is_let_in_once_it_has_kept_its_rate(new: str, least: float, tmp_path: Path) -> None:
    """What is inconclusive waits: one that is slow for its first three seconds is let in a window later."""
    outcome, _, instances, words = changed(tmp_path, new, TIMING)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert instances == ["counter_2", "sink"]
    assert least <= outcome.seconds < least + 1.5
    assert [swap.missed for swap in outcome.swaps] == [0] and words[-1].endswith("counter_2")


@pytest.mark.parametrize("before", [SLOW, BURSTS, STALLS])
def test_what_is_slow_or_comes_in_bursts_or_stalls_is_refused(before: str, tmp_path: Path) -> None:
    outcome, _, instances, words = changed(tmp_path, program(before), TIMING)
    assert outcome.outcome == "rolled_back"
    assert "counter_2.out does not keep the 20 Hz that its mode guarantees: in the last 1 s it wrote at" in str(
        outcome.because
    )
    assert "behind its gate; it was given 5 s" in str(outcome.because)
    assert instances == ["counter", "sink"]
    assert all(word.endswith(" counter") for word in words)
    assert outcome.seconds < 8


@pytest.mark.parametrize(
    ("before", "because"),
    [
        (SLOW_WHEN_LIVE, "counter_2.out does not keep the 20 Hz that its mode guarantees"),
        (SILENT_WHEN_LIVE, "with a pause of"),
        (RAISES_WHEN_LIVE, "ValueError: now"),
    ],
)
def test_a_contract_that_breaks_after_the_cut_hands_back(before: str, because: str, tmp_path: Path) -> None:
    outcome, took, instances, words = changed(tmp_path, program(before), {"watch_after": 10.0})
    assert outcome.outcome == "rolled_back" and because in str(outcome.because)
    assert instances == ["counter", "sink"] and words[-1].endswith(" counter")
    assert any(word.endswith("counter_2") for word in words), "it had taken over"
    assert took < 8, "it does not wait until the end"


def test_one_that_exits_while_it_is_watched_hands_back(tmp_path: Path) -> None:
    outcome, _, instances, words = changed(tmp_path, program(), {"watch_after": 10.0}, kill_after=1.0)
    assert outcome.outcome == "rolled_back", outcome
    assert instances == ["counter", "sink"] and words[-1].endswith(" counter")


def test_the_old_one_stays_warm_while_the_new_one_is_watched(tmp_path: Path) -> None:
    outcome, _, instances, words = changed(tmp_path, program(), {"watch_after": 3.0})
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert instances == ["counter_2", "sink"] and words[-1].endswith("counter_2")
    assert 3.0 <= outcome.seconds < 4.5


def test_without_a_stated_time_neither_takes_any(tmp_path: Path) -> None:
    outcome, _, _, _ = changed(tmp_path, program(), {})
    assert outcome.outcome == "done" and outcome.seconds < 1.5


def test_the_window_of_a_slow_output_is_some_of_its_periods_long(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", AwaitRateCommand, RateVerdict(reached=True, rate=0.5, pause=2.0, failed=False))
        await require_rate(b.client, build.port("talker.out"), "/chatter", 0.5, TIMING, stretch=1.0)
        [asked] = b.client.of(AwaitRateCommand)
        assert (asked.window, asked.timeout) == (SHORTEST_PERIODS / 0.5, SHORTEST_PERIODS / 0.5 + 4.0)

    bench(talking(), tmp_path, body)


def test_what_is_watched_on_a_slow_clock_is_watched_for_longer(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", AwaitRateCommand, RateVerdict(reached=False, rate=5.0, pause=0.2, failed=False))
        await watch_after(b.client, [(build.port("talker.out"), "/chatter", 5.0)], 3.0, stretch=2.0)
        assert [asked.timeout for asked in b.client.of(AwaitRateCommand)] == [6.0]

    bench(talking(), tmp_path, body)

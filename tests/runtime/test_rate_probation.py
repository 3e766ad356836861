"""Probation and watch-after by measured rates, on the simulator: what is let in, and what hands back."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.errors import StepFailed
from midstride.model.action import Swap
from midstride.model.specification import FEWEST_PERIODS
from midstride.plan.request import PlanRequest
from midstride.runtime.handover.probation import (
    Probation,
    WatchedOutput,
    WatchedServer,
    watch_after,
    watch_servers_after,
)
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.wire.commands import AwaitRateCommand
from midstride.wire.replies import RateVerdict
from midstride.wire.state import ComponentState, LinkState, MeasuredResponses
from tests.model import build
from tests.runtime.counting import Reader, at_rates, counting, exchanged, for_messages, settle, system
from tests.runtime.scripted import Bench, bench, talking

# How the new component writes: put before its only write. It is called at 20 Hz.
LATE = "calls.append(1)\n        if len(calls) < 60 and len(calls) % 2: return\n"
SLOW = "calls.append(1)\n        if len(calls) % 2: return\n"
BURSTS = """calls.append(1)
        if len(calls) % 20 >= 10: return
        output.write(String(data=f"{count[name]} {comp.instance}"))
"""
STALLS = "calls.append(1)\n        if len(calls) % 20 < 8: return\n"
STALLS_AT_TIMES = "calls.append(1)\n        if len(calls) % 50 < 10: return\n"
THIRD = "calls.append(1)\n        if len(calls) % 3: return\n"
# Its first calls are as they should be.
SLOW_LATER = "calls.append(1)\n        if len(calls) > 8 and len(calls) % 3: return\n"
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
    folder: Path,
    new: str,
    timing: dict[str, float],
    kill_after: float | None = None,
    old: str = "",
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

    return counting(system(folder, old or program(), new, out=20), body)


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
    assert "behind its gate (counter.out wrote at 20 Hz in that time); it was given 5 s" in str(outcome.because)
    assert instances == ["counter", "sink"]
    assert all(word.endswith(" counter") for word in words)
    assert outcome.seconds < 8


def test_the_time_that_is_noted_of_a_hand_over_is_without_the_probation(tmp_path: Path) -> None:
    """The probation is stated, and added to what is estimated from it."""

    async def body(manager: Manager, simulator: Simulator) -> float:
        manager.system.specification = replace(manager.specification, timing=Map(TIMING))
        await settle()
        outcome = await exchanged(manager)
        assert outcome.outcome == "done" and outcome.seconds > 1.0
        return manager._journal.estimates["handover"].seconds

    assert counting(system(tmp_path, program(), program(), out=20), body) < 0.7


def test_a_rate_is_asked_for_also_where_the_specification_does_not_say_for_how_long(tmp_path: Path) -> None:
    outcome, _, instances, _ = changed(tmp_path, program(SLOW), {})
    assert outcome.outcome == "rolled_back"
    assert "does not keep the 20 Hz that its mode guarantees" in str(outcome.because)
    assert instances == ["counter", "sink"]


def test_a_stall_of_the_old_one_does_not_let_in_a_slow_one(tmp_path: Path) -> None:
    """Over the few periods in which it stalls, half the rate is more than it writes."""
    outcome, _, instances, _ = changed(tmp_path, program(SLOW), {}, old=program(STALLS_AT_TIMES))
    assert outcome.outcome == "rolled_back"
    assert "counter_2.out does not keep the 20 Hz that its mode guarantees" in str(outcome.because)
    assert instances == ["counter", "sink"]


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


@pytest.mark.parametrize(("new", "taken"), [(program(), True), (program(SLOW), False), (program(THIRD), False)])
def test_a_rate_is_judged_without_a_stated_time(new: str, taken: bool, tmp_path: Path) -> None:
    outcome, _, instances, words = changed(tmp_path, new, {})
    if taken:
        assert outcome.outcome == "done" and outcome.seconds < 1.7 and instances == ["counter_2", "sink"]
        return
    assert outcome.outcome == "rolled_back" and instances == ["counter", "sink"]
    assert "counter_2.out does not keep the 20 Hz that its mode guarantees: in the last 0.5 s" in str(outcome.because)
    assert "(counter.out wrote at 20 Hz in that time)" in str(outcome.because)
    assert "`timing { probation 0 s }` in the specification lets it in all the same" in str(outcome.because)
    assert all(word.endswith(" counter") for word in words)


def test_without_probation_and_watch_neither_takes_any_time(tmp_path: Path) -> None:
    outcome, _, _, words = changed(tmp_path, program(SLOW), {"probation": 0.0})
    assert outcome.outcome == "done" and outcome.seconds < 1.2 and words[-1].endswith("counter_2")


@pytest.mark.parametrize(("old", "new", "taken"), [(SLOW, SLOW, True), (THIRD, SLOW, True), (SLOW, THIRD, False)])
def test_one_that_writes_no_less_than_an_old_one_that_is_slow_itself_is_let_in(
    old: str, new: str, taken: bool, tmp_path: Path
) -> None:
    outcome, _, instances, _ = changed(tmp_path, program(new), {}, old=program(old))
    assert outcome.outcome == ("done" if taken else "rolled_back"), outcome.because
    assert instances == ["counter_2" if taken else "counter", "sink"]


@pytest.mark.parametrize("arriving", [7.0, 20.0])
def test_a_filter_is_judged_by_what_comes_in(arriving: float, tmp_path: Path) -> None:
    """It guarantees 20 Hz, and answers each of the messages that arrive at another rate."""
    system(tmp_path, for_messages(20), source=20)
    source = (tmp_path / "source.py").read_text()
    (tmp_path / "source.py").write_text(source.replace("rate=20", f"rate={arriving:g}"))
    document = json.loads((tmp_path / "counting.json").read_text())
    talk = document["components"]["Source"]["functionalities"]["talk"]
    talk["modes"]["normal"]["guarantees"]["out"]["rate"] = document["topics"]["/ticks"]["rate"] = arriving
    (tmp_path / "counting.json").write_text(json.dumps(document))
    outcomes: list[Outcome] = []

    async def body(manager: Manager, simulator: Simulator) -> None:
        await settle(1)
        outcomes.append(await exchanged(manager))

    counting(tmp_path, body)
    [outcome] = outcomes
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert outcome.seconds < 2.5


@pytest.mark.parametrize(("before", "taken"), [("", True), (SLOW_LATER, False), (SLOW, False)])
def test_a_brief_change_lets_in_after_three_calls_and_judges_the_rate_afterwards(
    before: str, taken: bool, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> tuple[Outcome, float, list[str], list[str]]:
        reader = Reader(simulator, "/out")
        await settle()
        begun = simulator.clock.steady()
        request = PlanRequest(replace=(("counter", "B"),))
        outcome = await manager.change(request, brief=True)
        first = next(at for at, word in zip(reader.times, reader.words, strict=True) if word.endswith("counter_2"))
        return outcome, first - begun, sorted(manager.configuration.instances), reader.words

    folder = system(tmp_path, program(), program(before), out=20)
    outcome, first, instances, words = counting(folder, body)
    assert first < 0.6, "when its first message was heard"
    assert (outcome.outcome == "done") == taken, outcome.because
    assert instances == ["counter_2" if taken else "counter", "sink"]
    assert words[-1].endswith(instances[0])


def test_the_next_change_does_not_wait_until_a_brief_one_has_been_watched(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> float:
        first = asyncio.ensure_future(manager.change(PlanRequest(replace=(("counter", "B"),)), brief=True))
        while manager.log()[-1].kind != "watching":
            await asyncio.sleep(0.01)
        begun = simulator.clock.steady()
        second = asyncio.ensure_future(manager.change(PlanRequest(replace=(("counter", "A"),)), brief=True))
        assert (await first).outcome == "done"
        took = simulator.clock.steady() - begun
        assert (await second).outcome == "done"
        return took

    assert counting(system(tmp_path, program(), out=20), body) < 1.0


def test_the_window_of_a_slow_output_is_some_of_its_periods_long(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        swap = Swap("/chatter", build.port("talker.out"), build.port("talker_2.out"))

        async def nothing(_: str) -> str:
            return ""

        assert await Probation(b.client, swap, "/chatter", 0.5, False, TIMING, nothing).run() == "writes"
        [asked] = b.client.of(AwaitRateCommand)
        assert (asked.window, asked.timeout) == (FEWEST_PERIODS / 0.5, FEWEST_PERIODS / 0.5 + 4.0)

    bench(talking(), tmp_path, body)


def test_a_slow_output_is_watched_over_some_of_its_periods(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", AwaitRateCommand, RateVerdict(reached=False, rate=0.5, pause=2.0, failed=False))
        watched = WatchedOutput(build.port("talker.out"), build.port("talker_2.out"), "/chatter", 0.5)
        await watch_after(b.client, [watched], 30.0, stretch=1.0, shortest=1.0)
        assert [asked.window for asked in b.client.of(AwaitRateCommand)] == [FEWEST_PERIODS / 0.5]

    bench(talking(), tmp_path, body)


def test_what_is_watched_on_a_slow_clock_is_watched_for_longer(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", AwaitRateCommand, RateVerdict(reached=False, rate=5.0, pause=0.2, failed=False))
        watched = WatchedOutput(build.port("talker.out"), build.port("talker_2.out"), "/chatter", 5.0)
        await watch_after(b.client, [watched], 3.0, stretch=2.0)
        assert [asked.timeout for asked in b.client.of(AwaitRateCommand)] == [6.0]

    bench(talking(), tmp_path, body)


def serving(responses: MeasuredResponses) -> ComponentState:
    return ComponentState(
        instance="server_2",
        uuid="1",
        pid=1,
        revision=0,
        functionalities={},
        ports={"map": {"/map": LinkState(gate="open", count=0, responses=responses)}},
        parameters={},
        stopping=0.0,
    )


@pytest.mark.parametrize(
    ("seen", "because"),
    [
        ({"silent": 1.4}, None),
        ({"silent": 2.1}, "has not answered for 2.1 s on /map after the hand-over: 0.2 s are promised"),
        ({"answered": 14, "late": 5}, None),  # of fewer than five, nothing is concluded
        ({"answered": 20, "late": 6}, None),
        ({"answered": 20, "late": 9, "longest": 0.5}, r"has answered 4 of 10 requests late \(in up to 0.5 s\) on /map"),
    ],
)
def test_a_new_server_is_watched_by_its_bound(seen: dict[str, float], because: str | None, tmp_path: Path) -> None:
    """It has answered ten requests before, five of them late, which do not count."""
    before = {"within": 0.2, "tolerated": 5.0, "answered": 10, "late": 5}

    async def body(b: Bench) -> None:
        b.client.states["server_2"] = serving(MeasuredResponses(**before))  # type: ignore[arg-type]
        watched = [WatchedServer(build.port("server_2.map"), "/map")]
        watching = asyncio.ensure_future(watch_servers_after(b.client, watched, 5.0))
        begun = b.clock.steady()
        await asyncio.sleep(1.0)
        b.client.states["server_2"] = serving(MeasuredResponses(**{**before, **seen}))  # type: ignore[arg-type]
        if because is None:
            await watching
            assert b.clock.steady() - begun == pytest.approx(5.0)
            return
        with pytest.raises(StepFailed, match=because):
            await watching
        assert b.clock.steady() - begun <= 1.3

    bench(talking(), tmp_path, body)


def test_a_new_server_that_has_exited_breaks_off_the_watch(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        with pytest.raises(StepFailed, match="server_2 does not answer, or has exited, after the hand-over"):
            await watch_servers_after(b.client, [WatchedServer(build.port("server_2.map"), "/map")], 5.0)

    bench(talking(), tmp_path, body)

"""What is recorded at which subscriber, for how long, and what comes of it where something cannot be recorded."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.model.action import Action, Attach, Create, Detach, Handover, Remove, Swap
from midstride.model.component import ComponentSpec, PortRef
from midstride.runtime.records.measure import WINDOW_PERIODS, SwapReport
from midstride.runtime.watch.subscriber_recording import LONGEST_TAIL, TAIL_WITHOUT_RATE, Exchange, Recording, exchanges
from midstride.wire import replies
from midstride.wire.commands import GridCommand, RecordCommand, RecordsCommand
from midstride.wire.replies import Grid, Receipt, Records
from tests.model import build
from tests.runtime.scripted import LISTENER, TALKER, TIMEOUT, UNREACHABLE, Bench, bench, instance, started, talking

OUT, NEW_OUT, IN = build.port("talker.out"), build.port("talker_2.out"), build.port("listener.in")
NEW = instance("talker_2", TALKER, "talker")
STAND_IN, STAND_IN_OUT = instance("talker_3", TALKER, "talker"), build.port("talker_3.out")
SWAP = Handover((Swap("/chatter", OUT, NEW_OUT),))
REPLACEMENT = [Create(NEW), SWAP, Remove("talker")]
SECOND = 1_000_000_000
START_RECORDING, STOP_RECORDING = (RecordCommand(inputs=["in"], on=on) for on in (True, False))


# -- what is exchanged ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("actions", "expected"),
    [
        (REPLACEMENT, [Exchange("/chatter", OUT, NEW_OUT)]),
        (
            [Detach(OUT, "/chatter"), Remove("talker"), Create(NEW), Attach(NEW_OUT, "/chatter")],
            [Exchange("/chatter", OUT, NEW_OUT)],
        ),
        ([Detach(OUT, "/chatter"), Attach(OUT, "/chatter")], [Exchange("/chatter", OUT, OUT)]),
        ([Detach(OUT, "/chatter"), Remove("talker")], []),
        (  # over a stand-in
            [
                Create(STAND_IN),
                Handover((Swap("/chatter", OUT, STAND_IN_OUT),)),
                Create(NEW),
                Handover((Swap("/chatter", STAND_IN_OUT, NEW_OUT),)),
            ],
            [Exchange("/chatter", OUT, NEW_OUT)],
        ),
        ([Create(NEW), Attach(NEW_OUT, "/chatter")], []),
        ([Detach(IN, "/chatter"), Attach(IN, "/chatter")], []),
        ([Detach(OUT, "/chatter"), Create(NEW), Attach(NEW_OUT, "/other")], []),
        (
            [Detach(OUT, "/chatter"), Create(changed(NEW, role="another")), Attach(NEW_OUT, "/chatter")],
            [],
        ),
    ],
)
def test_publishers_are_exchanged_by_hand_over_or_one_after_the_other(
    actions: Sequence[Action], expected: list[Exchange]
) -> None:
    assert exchanges(talking(), actions) == expected


# -- from the beginning to the end ---------------------------------------------------------------------


def recording(b: Bench) -> Recording:
    return Recording(b.client, b.clock)


def rows(*seconds: float, publisher: str = "old", first: int = 1) -> list[Receipt]:
    """One message at each of these times, received at once, numbered from ``first``."""
    times = [round(second * SECOND) for second in seconds]
    return [Receipt(time, time, number, publisher) for number, time in enumerate(times, first)]


def test_each_subscriber_that_stays_is_recorded_from_before_the_first_step(tmp_path: Path) -> None:
    instances = {"talker": TALKER, "listener": LISTENER, "second": LISTENER, "leaving": LISTENER}
    topics = ["talker.out /chatter", "listener.in /chatter", "second.in /chatter", "leaving.in /chatter"]
    configuration = build.system(instances, topics)

    async def body(b: Bench) -> None:
        under_test = recording(b)
        await under_test.begin(configuration, [*REPLACEMENT, Remove("leaving")])
        assert b.client.changes == [("listener", "record"), ("second", "record")]
        assert b.client.of(RecordCommand) == [START_RECORDING] * 2
        assert [each.input for each in under_test.recorded] == [IN, build.port("second.in")]

    bench(configuration, tmp_path, body)


def test_an_input_that_sees_two_exchanges_is_recorded_once(tmp_path: Path) -> None:
    pair: list[Action] = [Handover((Swap("/chatter", OUT, NEW_OUT), Swap("/chatter", OUT, NEW_OUT)))]

    async def body(b: Bench) -> None:
        under_test = recording(b)
        b.client.reply("listener", RecordCommand, replies.RecordingSwitched(now=7))
        await under_test.begin(talking(), pair)
        assert b.client.of(RecordCommand) == [START_RECORDING]
        assert [each.observation.begun for each in under_test.recorded] == [7, 7]

    bench(talking(), tmp_path, body)


def test_a_swap_is_measured_once_its_tail_is_over(tmp_path: Path) -> None:
    old = rows(*(0.1 * n for n in range(10, 30)))
    new = rows(*(0.1 * n for n in range(30, 50)), publisher="new")

    async def body(b: Bench) -> None:
        under_test = recording(b)
        b.client.reply("listener", RecordCommand, replies.RecordingSwitched(now=2 * SECOND))
        b.client.reply("listener", RecordsCommand, Records(rows=old + new, publisher_identity=True, now=5 * SECOND))
        await under_test.begin(talking(), REPLACEMENT)
        begun = b.clock.steady()
        [swap] = await under_test.finish({OUT: 20})
        assert b.clock.steady() - begun == pytest.approx(WINDOW_PERIODS * 0.1)
        assert (swap.topic, swap.subscriber, swap.period) == ("/chatter", "listener.in", 0.1)
        assert (swap.gap_periods, swap.missed, swap.lost, swap.duplicates) == (1.0, 0, 0, 0)

    bench(talking(), tmp_path, body)


def test_the_last_number_of_the_old_side_shows_what_was_lost(tmp_path: Path) -> None:
    old = rows(*(0.1 * n for n in range(10, 30)))
    new = rows(*(0.1 * n for n in range(30, 50)), publisher="new")

    async def body(b: Bench) -> None:
        under_test = recording(b)
        b.client.reply("listener", RecordCommand, replies.RecordingSwitched(now=2 * SECOND))
        b.client.reply("listener", RecordsCommand, Records(rows=old + new, publisher_identity=True, now=5 * SECOND))
        await under_test.begin(talking(), REPLACEMENT)
        [swap] = await under_test.finish({OUT: 23})
        assert swap.lost == 3

    bench(talking(), tmp_path, body)


def slow(rate: float | None) -> ComponentSpec:
    return started(build.component("Slow", {}, ["out"], [build.mode("normal", out=build.at(rate)), build.mode("off")]))


@pytest.mark.parametrize(("rate", "seconds"), [(100.0, 0.2), (0.1, LONGEST_TAIL), (None, TAIL_WITHOUT_RATE)])
def test_the_tail_follows_the_rate_and_is_bounded(rate: float | None, seconds: float, tmp_path: Path) -> None:
    configuration = talking(talker=slow(rate))

    async def body(b: Bench) -> None:
        under_test = recording(b)
        await under_test.begin(configuration, REPLACEMENT)
        begun = b.clock.steady()
        await under_test.finish({})
        assert b.clock.steady() - begun == pytest.approx(seconds)

    bench(configuration, tmp_path, body)


def test_a_change_that_exchanges_no_publisher_takes_no_time(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        under_test = recording(b)
        await under_test.begin(talking(), [Detach(OUT, "/chatter")])
        assert await under_test.finish({}) == []
        await under_test.stop(talking().instances)
        assert b.client.sent == [] and b.clock.steady() == 0.0

    bench(talking(), tmp_path, body)


# -- what cannot be recorded ---------------------------------------------------------------------------


def unknown(port: PortRef) -> SwapReport:
    return SwapReport("/chatter", str(port), 0.1, None, None, None, None, None)


def test_a_subscriber_that_cannot_be_recorded_is_reported_as_unknown(tmp_path: Path) -> None:
    configuration = build.system(
        {"talker": TALKER, "listener": LISTENER, "second": LISTENER},
        ["talker.out /chatter", "listener.in /chatter", "second.in /chatter"],
    )

    async def body(b: Bench) -> None:
        under_test = recording(b)
        b.client.reply("listener", RecordCommand, TIMEOUT)
        b.client.reply("second", RecordsCommand, UNREACHABLE)
        b.client.reply("talker", GridCommand, UNREACHABLE)
        await under_test.begin(configuration, REPLACEMENT)
        assert await under_test.finish({}) == [unknown(build.port("second.in")), unknown(IN)]
        # The first may be recording: its answer was lost.
        await under_test.stop(configuration.instances)
        assert [(sent.instance, sent.command) for sent in b.client.sent if sent.how == "undo"] == [
            ("listener", STOP_RECORDING),
            ("second", STOP_RECORDING),
        ]

    bench(configuration, tmp_path, body)


def test_measuring_that_is_broken_off_reports_what_is_known(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        under_test = recording(b)
        await under_test.begin(talking(), REPLACEMENT)
        measuring = asyncio.ensure_future(under_test.finish({}))
        await asyncio.sleep(1)
        under_test.broken_off.set()
        assert await measuring == [unknown(IN)]
        assert b.clock.steady() == 1.0
        assert b.client.of(RecordsCommand) == []

    bench(talking(), tmp_path, body)


def test_recording_ends_at_those_that_are_live_and_once(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        under_test = recording(b)
        await under_test.begin(talking(), REPLACEMENT)
        await under_test.stop(talking().without_instance("talker").instances)
        await under_test.stop(talking().instances)
        assert b.client.of(RecordCommand, "listener") == [START_RECORDING, STOP_RECORDING]
        await under_test.begin(talking(), REPLACEMENT)
        await under_test.stop({})
        assert b.client.of(RecordCommand, "listener") == [START_RECORDING, STOP_RECORDING, START_RECORDING]

    bench(talking(), tmp_path, body)


# -- outputs that answer messages ----------------------------------------------------------------------

ANSWERING = build.system(
    {"source": TALKER, "filter": started(build.filter_()), "sink": LISTENER},
    ["source.out /raw", "filter.in /raw", "filter.out /clean", "sink.in /clean"],
).with_instance(instance("filter_2", started(build.filter_()), "filter"))
ANSWERS = Handover((Swap("/clean", build.port("filter.out"), build.port("filter_2.out")),))


def test_what_the_new_side_has_to_answer_is_recorded_there(tmp_path: Path) -> None:
    """By time alone the third answer is missing; there was no third question."""
    questions = [0.1, 0.2, 0.4, 0.5, 0.6]
    asked = [Receipt(round(at * SECOND), round(at * SECOND), None, None) for at in questions]
    answered = [
        *rows(0.11, 0.21, publisher="old"),
        *rows(0.41, 0.51, 0.61, publisher="new"),
    ]

    async def swap(b: Bench, trigger: str) -> SwapReport:
        under_test = recording(b)
        grid = Grid(trigger=trigger, now=0, epoch=0, period=None if trigger == "message" else 0.1)  # type: ignore[arg-type]
        b.client.reply("filter", GridCommand, grid)
        b.client.reply("sink", RecordsCommand, Records(rows=answered, publisher_identity=True, now=round(0.7 * SECOND)))
        b.client.reply("filter_2", RecordsCommand, Records(rows=asked, publisher_identity=True, now=SECOND))
        b.client.reply("sink", RecordCommand, replies.RecordingSwitched(now=round(0.05 * SECOND)))
        await under_test.begin(ANSWERING, [ANSWERS])
        await under_test.before_handover(ANSWERING, ANSWERS)
        [found] = await under_test.finish({})
        await under_test.stop(ANSWERING.instances)
        return found

    async def body(b: Bench) -> None:
        assert (await swap(b, "message")).missed == 0
        assert b.client.of(RecordCommand, "filter_2") == [START_RECORDING, STOP_RECORDING]
        b.client.sent.clear()
        assert (await swap(b, "rate")).missed == 1
        assert b.client.of(RecordCommand, "filter_2") == []

    bench(ANSWERING, tmp_path, body)


def test_a_new_side_that_cannot_be_recorded_does_not_stop_the_hand_over(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        under_test = recording(b)
        b.client.reply("filter", GridCommand, Grid(trigger="message", now=0))
        b.client.reply("filter_2", RecordCommand, TIMEOUT)
        await under_test.before_handover(ANSWERING, ANSWERS)
        b.client.reply("filter", GridCommand, UNREACHABLE)
        await under_test.before_handover(ANSWERING, ANSWERS)
        await under_test.stop(ANSWERING.instances)
        assert b.client.of(RecordCommand, "filter_2") == [START_RECORDING, STOP_RECORDING]

    bench(ANSWERING, tmp_path, body)


def test_a_wait_that_is_cut_short_leaves_nothing_that_waits(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        hurried, before = asyncio.Event(), asyncio.all_tasks()
        hurried.set()
        await recording(b).wait(60.0, hurried)
        await asyncio.sleep(0)
        assert asyncio.all_tasks() == before and b.clock.steady() == 0.0

    bench(talking(), tmp_path, body)

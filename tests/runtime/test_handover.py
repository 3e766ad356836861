"""The hand-over as the manager sees it: what it asks of the two sides, in which order, and what it makes of replies."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map
from msgspec import structs

from midstride.errors import CommandRefused, StepFailed, Unreachable
from midstride.model.action import Swap
from midstride.model.component import ComponentSpec, FunctionalitySpec, Mode, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.handover.agreed_cut import FIND_TIMEOUT, RESUME_PERIODS, RESUME_WITHOUT_RATE, SHORTEST_RESUME
from midstride.runtime.handover.live_handover import LEADS, MEET_ATTEMPTS, MEET_TIMEOUT, LiveHandover
from midstride.runtime.handover.new_publishers import ATTACH_TIMEOUT, DETACH_TIMEOUT, OUTSIDE_READERS_TIMEOUT
from midstride.runtime.handover.probation import CALLS, CALLS_PATIENCE, PROBATION
from midstride.runtime.handover.state_transfers import StateTransfers
from midstride.runtime.watch.simulated_time import LONGEST_STRETCH
from midstride.wire.clock_offset import ClockOffset
from midstride.wire.commands import (
    AttachCommand,
    AwaitCutCommand,
    AwaitMatchCommand,
    AwaitReadersCommand,
    AwaitWriteCommand,
    CancelCutCommand,
    CutInCommand,
    CutOutCommand,
    CutSwap,
    DetachCommand,
    GridCommand,
    MeetCommand,
    PrepareStateCommand,
)
from midstride.wire.replies import Attached, CutResult, GatedWrites, Grid, LastWrite, StateOffer, TriggerKind
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import (
    REFUSED,
    TALKER,
    TIMEOUT,
    UNREACHABLE,
    Bench,
    C,
    bench,
    instance,
    started,
    talking,
)

OUT, NEW_OUT = build.port("talker.out"), build.port("talker_2.out")
SWAP = Swap("/chatter", OUT, NEW_OUT)
CONFIGURATION = talking().with_instance(instance("talker_2", TALKER, "talker")).with_modes({work("talker_2"): 0})


async def swapped(b: Bench, *swaps: Swap) -> dict[PortRef, int | None]:
    handover = LiveHandover(
        b.client,
        b.events,
        b.configuration,
        swaps or (SWAP,),
        b.backend,
        StateTransfers(b.client, b.events),
        b.driver.fences,
    )
    return await handover.run()


async def fails(b: Bench, words: str, *swaps: Swap) -> None:
    """It fails for this reason, and leaves the old side as it was and the new one off the topic."""
    with pytest.raises(StepFailed, match=words):
        await swapped(b, *swaps)
    assert [entry for entry in b.client.changes if entry[1] == "detach"] == []
    assert ("talker_2", "undo detach") in b.client.changes[-len(swaps or (SWAP,)) :]


def only(b: Bench, kind: type[C], instance: str) -> C:
    [command] = b.client.of(kind, instance)
    return command


def test_state_that_a_node_without_the_api_cannot_import_is_reported(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", PrepareStateCommand, StateOffer(exports="nothing"))
        states = StateTransfers(b.client, b.events, [("talker", "talker_2")], keeping={"talker"})
        await states.prepare()
        assert "the two have different kinds of gate" in states.own_state["talker_2"]
        assert states.agreed == {}

    bench(CONFIGURATION, tmp_path, body)


# -- the order of things -------------------------------------------------------------------------------


def test_the_two_sides_are_asked_in_the_order_that_loses_nothing(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        last: dict[str, LastWrite | None] = {"out /chatter": LastWrite(number=17, source=5)}
        b.client.reply("talker", AwaitCutCommand, CutResult(outcome="done", last=last))
        assert await swapped(b) == {OUT: 17}
        b.client.assert_order(
            ("talker_2", "attach"),
            ("listener", "await_match"),  # it has found the new publisher before any message of that one
            ("talker_2", "await_write"),  # behind its gate
            ("talker", "grid"),  # the moment is agreed on once nothing needs to be waited for
            ("talker", "cut_out"),  # before the new side: it alone can go on by itself
            ("talker_2", "cut_in"),
            ("talker", "await_cut"),
            ("talker", "detach"),
        )
        b.client.assert_order(("talker_2", "cut_in"), ("talker_2", "await_cut"), ("talker", "detach"))
        cut_out = b.client.of(CutOutCommand, "talker")[0]
        assert only(b, CutInCommand, "talker_2") == CutInCommand(
            cut=cut_out.cut,
            swaps=[CutSwap(port="out", topic="/chatter")],
            at=cut_out.at,
            peer="talker",
            address="memory:talker",
            epoch=cut_out.at,
        )
        assert only(b, DetachCommand, "talker") == DetachCommand(port="out", topic="/chatter", timeout=DETACH_TIMEOUT)

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize(
    ("readers", "lingering", "expected", "ids"),
    [(3, 0, 3, ["a", "b", "c"]), (3, 2, 1, []), (None, 0, 0, [])],
)
def test_the_new_publisher_waits_behind_its_gate_for_every_living_reader_of_the_old(
    readers: int | None, lingering: int, expected: int, ids: list[str], tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.backend.lingering["/chatter"] = lingering
        known = ["a", "b", "c"] if readers else []
        grid = Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=readers, reader_ids=known)
        b.client.reply("talker", GridCommand, grid)
        b.client.reply("talker_2", AwaitReadersCommand, Attached(matched=expected))
        await swapped(b)
        assert b.words("note") == []
        assert only(b, AttachCommand, "talker_2") == AttachCommand(port="out", topic="/chatter", gate="closed")
        assert only(b, AwaitReadersCommand, "talker_2") == AwaitReadersCommand(
            port="out",
            topic="/chatter",
            peers=1,
            everyone=expected,
            reader_ids=ids,
            patience=OUTSIDE_READERS_TIMEOUT,
            timeout=ATTACH_TIMEOUT + OUTSIDE_READERS_TIMEOUT,
        )

    bench(CONFIGURATION, tmp_path, body)


def test_the_new_publisher_does_not_wait_for_a_subscriber_whose_process_has_exited(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.crash("listener")
        await swapped(b)
        assert only(b, AwaitReadersCommand, "talker_2").peers == 0

    bench(CONFIGURATION, tmp_path, body)


def test_readers_that_the_new_publisher_does_not_find_are_a_warning(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", GridCommand, Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=3))
        b.client.reply("talker_2", AwaitReadersCommand, Attached(matched=2))
        await swapped(b)
        [warning] = b.words("note")
        assert warning.startswith("talker.out had 3 readers on /chatter, and talker_2.out has found 2 of them")

    bench(CONFIGURATION, tmp_path, body)


def test_readers_that_the_old_publisher_does_not_find_any_longer_are_no_warning(tmp_path: Path) -> None:
    """Readers that were killed: the graph had dropped them, and the old publisher drops them a moment later."""

    async def body(b: Bench) -> None:
        counted = [Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=readers) for readers in (3, 2)]
        b.client.reply("talker", GridCommand, *counted)
        b.client.reply("talker_2", AwaitReadersCommand, Attached(matched=2))
        await swapped(b)
        assert b.words() == []

    bench(CONFIGURATION, tmp_path, body)


def test_an_old_side_that_does_not_detach_is_a_warning_since_the_new_one_writes(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", DetachCommand, TIMEOUT)
        await swapped(b)
        [warning] = b.words("note")
        assert warning == f"talker.out could not be taken off /chatter after the hand-over: {TIMEOUT}"

    bench(CONFIGURATION, tmp_path, body)


# -- before the cut ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (
            GatedWrites(gated=3, wrong_type="Int32 instead of String"),
            r"talker_2\.out wrote a message of the wrong type behind its gate: Int32 instead of String",
        ),
        (
            GatedWrites(gated=2, wrong_type=None, failed=True),
            r"the code that writes talker_2\.out has raised behind its gate",
        ),
        (GatedWrites(gated=0, wrong_type=None), r"talker_2\.out has written nothing within 6 s"),
    ],
)
def test_a_new_side_that_does_not_write_as_it_should_does_not_take_over(
    seen: GatedWrites, words: str, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", AwaitWriteCommand, seen)
        await fails(b, words)
        assert b.client.of(CutOutCommand) == []
        probation = only(b, AwaitWriteCommand, "talker_2")
        assert probation == AwaitWriteCommand(
            port="out", topic="/chatter", calls=CALLS, patience=CALLS_PATIENCE, timeout=PROBATION + 10 * 0.1
        )

    bench(CONFIGURATION, tmp_path, body)


def test_the_two_sides_have_some_turns_to_find_each_other(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", MeetCommand, REFUSED, REFUSED, REFUSED, None)
        await swapped(b)
        meetings = b.client.of(MeetCommand, "talker_2")
        assert meetings == [MeetCommand(peer="talker", address="memory:talker", timeout=MEET_TIMEOUT)] * 4

    bench(CONFIGURATION, tmp_path, body)


def test_two_sides_that_do_not_find_each_other_stay_as_they_are(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", MeetCommand, REFUSED)
        await fails(b, str(REFUSED))
        assert len(b.client.of(MeetCommand, "talker_2")) == MEET_ATTEMPTS

    bench(CONFIGURATION, tmp_path, body)


def test_an_old_side_that_ends_meanwhile_is_known_in_one_turn(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        def dies(_: MeetCommand) -> CommandRefused:
            b.client.states.pop("talker")
            return REFUSED

        b.client.reply("talker_2", MeetCommand, dies)
        await fails(b, str(UNREACHABLE))
        assert len(b.client.of(MeetCommand, "talker_2")) == 1

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize("error", [REFUSED, UNREACHABLE])
def test_a_new_side_in_its_mode_or_gone_leaves_the_first_reason(error: Exception, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        def fails_to_attach(_: AttachCommand) -> Exception:
            if error is UNREACHABLE:
                b.client.states.pop("talker_2")
            return error

        b.client.reply("talker_2", AttachCommand, fails_to_attach)
        await fails(b, f"^{error}$")

    bench(CONFIGURATION, tmp_path, body)


def test_a_subscriber_that_has_not_found_the_new_publisher_stops_the_hand_over(tmp_path: Path) -> None:
    """Its middleware discovers nothing any more: the publisher has found it, and it would be blind after the cut."""

    async def body(b: Bench) -> None:
        b.client.reply("listener", AwaitMatchCommand, Attached(matched=1))
        await fails(b, r"listener\.in has found only 1 of 2 publishers on /chatter within 5 s")
        assert b.client.of(CutOutCommand) == []
        found = AwaitMatchCommand(port="in", topic="/chatter", peers=2, timeout=FIND_TIMEOUT)
        assert b.client.of(AwaitMatchCommand, "listener")[-1] == found

    bench(CONFIGURATION, tmp_path, body)


def test_a_publisher_that_left_is_not_taken_for_the_new_one(tmp_path: Path) -> None:
    """A middleware that has stopped may not have noticed who left: it goes on counting two."""

    async def body(b: Bench) -> None:
        b.client.reply("listener", AwaitMatchCommand, Attached(matched=2))
        await fails(b, r"listener\.in has found only 2 of 3 publishers on /chatter within 5 s")

    bench(CONFIGURATION, tmp_path, body)


def tells_identities(b: Bench, before: int, missing: list[str]) -> None:
    """The listener counts ``before`` publishers, and 2 after the new one has been attached; the back end knows that."""
    b.backend.publishers["/chatter", "talker_2"] = frozenset({"2a"})

    def found(command: AwaitMatchCommand) -> Attached:
        asked = command.publisher_ids == ["2a"]
        return Attached(matched=2, missing=missing) if asked else Attached(matched=before)

    b.client.reply("listener", AwaitMatchCommand, found)


def test_dead_publishers_that_leave_meanwhile_do_not_stop_the_hand_over(tmp_path: Path) -> None:
    """Seven that were killed within the lease are counted before the new one is attached, and not after."""

    async def body(b: Bench) -> None:
        tells_identities(b, before=8, missing=[])
        assert await swapped(b) == {OUT: None}

    bench(CONFIGURATION, tmp_path, body)


def test_a_new_publisher_is_missed_by_its_identity_though_the_number_grows(tmp_path: Path) -> None:
    """Another publisher has joined the topic in this moment."""

    async def body(b: Bench) -> None:
        tells_identities(b, before=1, missing=["2a"])
        await fails(b, r"listener\.in has not found talker_2\.out on /chatter within 5 s")
        assert b.client.of(CutOutCommand) == []

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize("ids", [None, frozenset[str]()])
def test_without_the_identity_of_the_new_publisher_the_number_decides(
    ids: frozenset[str] | None, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        tells_identities(b, before=8, missing=[])
        b.backend.publishers["/chatter", "talker_2"] = ids
        await fails(b, r"listener\.in has found only 8 of 9 publishers on /chatter within 5 s")

    bench(CONFIGURATION, tmp_path, body)


def test_a_subscriber_has_time_to_notice_that_a_publisher_left(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        counted = iter([2, 2, 1, 2])
        b.client.reply("listener", AwaitMatchCommand, lambda _: Attached(matched=next(counted)))
        assert await swapped(b) == {OUT: None}
        assert [command.peers for command in b.client.of(AwaitMatchCommand, "listener")] == [0, 0, 0, 2]

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize("error", [TIMEOUT, UNREACHABLE])
def test_a_subscriber_that_does_not_answer_does_not_stop_the_hand_over(error: Exception, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("listener", AwaitMatchCommand, error)
        assert await swapped(b) == {OUT: None}

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize("simulated", ["talker", "talker_2"])
def test_sides_that_follow_different_clocks_do_not_agree_on_a_moment(simulated: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.report(structs.replace(b.client.states[simulated], simulated_time=True))
        await differs(b, rf"^{simulated} follows /clock \(use_sim_time\) and talker(_2)? the clock of the system")

    bench(CONFIGURATION, tmp_path, body)


def test_an_old_side_that_waits_for_a_clock_says_so(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        for name in ("talker", "talker_2"):
            b.client.report(structs.replace(b.client.states[name], simulated_time=True, waiting="no /clock"))
        await differs(b, r"^talker cannot hand over: no /clock$")

    bench(CONFIGURATION, tmp_path, body)


async def differs(b: Bench, words: str) -> None:
    with pytest.raises(StepFailed, match=words):
        await swapped(b)
    assert b.client.changes == []  # before anything was attached


# -- the cut -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grid", "at", "epoch"),
    [
        # The next slot of the grid after the lead; 0.1 s ahead of 12.34 s is 12.44 s.
        (Grid(trigger="rate", now=12_340_000_000, epoch=0, period=0.5), 12_500_000_000, True),
        (Grid(trigger="rate", now=12_340_000_000, epoch=20_000_000, period=0.1), 12_520_000_000, True),
        (Grid(trigger="rate", now=12_340_000_000, epoch=0, period=0.44), 12_760_000_000, True),
        # The lead is real time: 1 s of a clock that runs at 10x, and 0.05 s of one at 0.5x.
        (Grid(trigger="rate", now=12_340_000_000, speed=10.0, epoch=0, period=0.5), 13_500_000_000, True),
        (Grid(trigger="rate", now=12_340_000_000, speed=0.5, epoch=0, period=0.01), 12_390_000_000, True),
        (Grid(trigger="rate", now=12_340_000_000, speed=0.0, epoch=0, period=0.5), 12_500_000_000, True),
        (Grid(trigger="message", clock="message", now=12_340_000_000), 12_440_000_000, False),
        # What has no grid is cut at the moment itself.
        (Grid(trigger="message", now=12_340_000_000), 12_440_000_000, False),
        (Grid(trigger="none", now=12_340_000_000), 12_440_000_000, False),
    ],
)
def test_the_cut_is_at_a_slot_of_the_old_sides_grid(grid: Grid, at: int, epoch: bool, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", GridCommand, grid)
        await swapped(b)
        [cut_out], [cut_in] = b.client.of(CutOutCommand, "talker"), b.client.of(CutInCommand, "talker_2")
        assert (cut_out.at, cut_in.at) == (at, at)
        assert cut_out.clock == cut_in.clock == grid.clock
        assert cut_in.epoch == (at if epoch else None)
        # What is written neither at a rate nor for a message would not be written again.
        assert cut_in.swaps[0].latch is (grid.trigger == "none")

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize(("speed", "factor"), [(0.5, 2.0), (0.001, LONGEST_STRETCH), (10.0, 1.0)])
def test_what_waits_for_periods_of_a_slow_clock_waits_for_longer(speed: float, factor: float, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        for name in ("talker", "talker_2"):
            b.client.report(structs.replace(b.client.states[name], simulated_time=True, clock_speed=speed))
        b.client.reply("talker", GridCommand, Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=1))
        await swapped(b)
        assert only(b, AwaitWriteCommand, "talker_2").timeout == pytest.approx(PROBATION + 10 * 0.1 * factor)
        for side in ("talker", "talker_2"):
            assert only(b, AwaitCutCommand, side).timeout == pytest.approx(LEADS[0] + 0.9 * factor + 2.0)
        [cut_out] = b.client.of(CutOutCommand, "talker")
        assert cut_out.resume_after == pytest.approx(0.9), "on the ROS clock"

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize(
    ("period", "topic_rate", "seconds"),
    [
        # In its next slot the old side writes again: the silence is RESUME_PERIODS periods, one of them is that.
        (0.2, 5.0, 1.8),
        (0.02, 5.0, 0.18),
        (0.001, 5.0, SHORTEST_RESUME),
        (None, 5.0, 1.8),  # by the contract of the topic
        (None, None, 0.9),  # by what the old side guarantees: 10 Hz
    ],
)
def test_the_old_side_resumes_after_a_silence_of_so_many_periods(
    period: float | None, topic_rate: float | None, seconds: float, tmp_path: Path
) -> None:
    configuration = build.system(
        {"talker": TALKER, "talker_2": TALKER},
        ["talker.out /chatter"],
        topics={"/chatter": build.at(topic_rate)},
        modes={"talker.work": 0, "talker_2.work": 0},
    )

    async def body(b: Bench) -> None:
        trigger = "message" if period is None else "rate"
        b.client.reply("talker", GridCommand, Grid(trigger=trigger, now=0, epoch=0, period=period, readers=1))  # type: ignore[arg-type]
        await swapped(b)
        [cut_out] = b.client.of(CutOutCommand, "talker")
        assert cut_out.resume_after == pytest.approx(seconds)
        if period is not None and seconds > SHORTEST_RESUME:
            assert cut_out.resume_after + period == pytest.approx(RESUME_PERIODS * period)

    bench(configuration, tmp_path, body)


def test_without_any_rate_the_old_side_resumes_after_a_fixed_time(tmp_path: Path) -> None:
    latched = started(build.component("Map", {}, ["out"], [build.mode("normal", out=build.at()), build.mode("off")]))
    configuration = build.system(
        {"talker": latched, "talker_2": latched},
        ["talker.out /chatter"],
        topics={"/chatter": build.at()},
        modes={"talker.work": 0, "talker_2.work": 0},
    )

    async def body(b: Bench) -> None:
        b.client.reply("talker", GridCommand, Grid(trigger="none", now=0))
        await swapped(b)
        [cut_out] = b.client.of(CutOutCommand, "talker")
        assert cut_out.resume_after == RESUME_WITHOUT_RATE
        probation = b.client.of(AwaitWriteCommand, "talker_2")
        assert [command.timeout for command in probation] == [PROBATION]

    bench(configuration, tmp_path, body)


@pytest.mark.parametrize("late", [CutOutCommand, CutInCommand])
def test_a_cut_that_one_side_learns_of_too_late_is_agreed_again_later(late: type, tmp_path: Path) -> None:
    side = "talker" if late is CutOutCommand else "talker_2"

    async def body(b: Bench) -> None:
        b.client.reply(side, late, REFUSED, None)
        await swapped(b)
        cuts = b.client.of(CutOutCommand, "talker")
        assert [cut.at for cut in cuts] == [100_000_000, 300_000_000], LEADS
        cancelled = CancelCutCommand(cut=cuts[0].cut)
        assert b.client.of(CancelCutCommand, "talker_2") == [cancelled]
        assert b.client.of(CancelCutCommand, "talker") == [cancelled]
        assert cuts[1].cut != cuts[0].cut

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize(("takes", "lead"), [(0.0, 0.1), (0.04, 0.1), (0.06, 0.3), (0.2, 1.0), (0.9, 1.0)])
def test_a_cut_is_further_ahead_where_the_two_sides_take_long_to_connect(
    takes: float, lead: float, tmp_path: Path
) -> None:
    async def meet(_: MeetCommand) -> None:
        await asyncio.sleep(takes)

    async def body(b: Bench) -> None:
        b.client.reply("talker_2", MeetCommand, meet)
        await swapped(b)
        [cut] = b.client.of(CutOutCommand, "talker")
        assert cut.at == lead * 1e9

    bench(CONFIGURATION, tmp_path, body)


def test_a_cut_that_cannot_be_agreed_in_time_is_given_up(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", CutInCommand, REFUSED)
        await fails(b, str(REFUSED))
        assert len(b.client.of(CutInCommand, "talker_2")) == len(LEADS)

    bench(CONFIGURATION, tmp_path, body)


@pytest.mark.parametrize(
    ("side", "result", "words"),
    [
        ("talker_2", CutResult(outcome="cancelled"), r"talker_2 did not publish after the cut; talker continues"),
        ("talker_2", CutResult(outcome="waiting"), r"talker_2 did not publish after the cut; talker continues"),
        (
            "talker_2",
            CutResult(outcome="cancelled", first={"out /chatter": LastWrite(number=1, source=5)}),
            r"talker resumed before it learned that talker_2 had published",
        ),
        ("talker", CutResult(outcome="resumed"), r"talker resumed before it learned that talker_2 had published"),
        ("talker", CutResult(outcome="waiting"), r"talker resumed before it learned that talker_2 had published"),
    ],
)
def test_a_cut_that_either_side_did_not_pass_is_taken_back(
    side: str, result: CutResult, words: str, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.client.reply(side, AwaitCutCommand, result)
        await fails(b, words)
        b.client.assert_order(
            ("talker_2", "undo cancel_cut"),  # first: only one of them may write
            ("talker", "undo cancel_cut"),
            ("talker_2", "undo detach"),
        )

    bench(CONFIGURATION, tmp_path, body)


def test_a_take_over_that_fails_leaves_no_new_publisher_on_the_topic(tmp_path: Path) -> None:
    """Nor one that was attached only because the old side had exited."""
    other = Swap("/chatter", OUT, build.port("talker_3.out"))
    configuration = CONFIGURATION.with_instance(instance("talker_3", TALKER, "talker"))

    async def body(b: Bench) -> None:
        b.crash("talker")
        b.client.reply("talker", GridCommand, UNREACHABLE)
        b.client.reply("talker_3", AwaitWriteCommand, GatedWrites(gated=0, wrong_type=None))
        with pytest.raises(StepFailed, match=r"talker_3\.out has written nothing"):
            await swapped(b, SWAP, other)
        b.client.assert_order(("talker_2", "attach"), ("talker_2", "undo detach"))
        b.client.assert_order(("talker_3", "attach"), ("talker_3", "undo detach"))

    bench(configuration.with_modes({work("talker_3"): 0}), tmp_path, body)


def test_a_hand_over_that_is_cancelled_is_taken_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", AwaitCutCommand, lambda _: asyncio.sleep(3))
        swapping = asyncio.ensure_future(swapped(b))
        await asyncio.sleep(1)
        swapping.cancel()
        with pytest.raises(asyncio.CancelledError):
            await swapping
        b.client.assert_order(
            ("talker_2", "undo cancel_cut"),
            ("talker", "undo cancel_cut"),
            ("talker_2", "undo detach"),
        )

    bench(CONFIGURATION, tmp_path, body)


# -- several outputs -----------------------------------------------------------------------------------


def camera(*functionalities: tuple[str, ...]) -> ComponentSpec:
    """One functionality for each group of outputs, all at 10 Hz."""
    groups = [
        FunctionalitySpec(
            f"work{number}",
            (Mode("normal", (), Map({name: build.at(10.0) for name in outputs})), build.mode("degraded")),
            (),
            outputs,
        )
        for number, outputs in enumerate(functionalities)
    ]
    outputs = tuple(name for group in functionalities for name in group)
    return started(ComponentSpec.of("Camera", outputs=outputs, functionalities=tuple(groups)))


def cameras(component: ComponentSpec) -> tuple[Configuration, list[Swap]]:
    attachments = [f"old.{name} /{name}" for name in component.outputs]
    configuration = build.system({"old": component, "new": component}, attachments)
    configuration = configuration.with_modes(dict.fromkeys(configuration.modes, 0))
    return configuration, [Swap(f"/{name}", PortRef("old", name), PortRef("new", name)) for name in component.outputs]


def test_outputs_of_one_functionality_share_a_cut(tmp_path: Path) -> None:
    configuration, swaps = cameras(camera(("left", "right")))

    async def body(b: Bench) -> None:
        last = {"left /left": LastWrite(number=3, source=0), "right /right": None}
        b.client.reply("old", AwaitCutCommand, CutResult(outcome="done", last=last))
        assert await swapped(b, *swaps) == {swaps[0].old: 3, swaps[1].old: None}
        [cut] = b.client.of(CutOutCommand, "old")
        assert cut.swaps == [CutSwap(port="left", topic="/left"), CutSwap(port="right", topic="/right")]
        b.client.assert_order(("old", "await_cut"), ("old", "detach"), ("old", "detach"))

    bench(configuration, tmp_path, body)


def test_functionalities_of_their_own_grids_are_cut_apart_but_at_about_one_moment(tmp_path: Path) -> None:
    configuration, swaps = cameras(camera(("left",), ("right",)))

    async def body(b: Bench) -> None:
        replies: list[Callable[..., Grid]] = [_grid(period) for period in (0.1, 0.1, 0.03, 0.4)]
        b.client.reply("old", GridCommand, *replies)
        await swapped(b, *swaps)
        cuts = b.client.of(CutOutCommand, "old")
        assert [(cut.swaps, cut.at) for cut in cuts] == [
            ([CutSwap(port="left", topic="/left")], 1_110_000_000),
            ([CutSwap(port="right", topic="/right")], 1_200_000_000),
        ]
        assert len({cut.cut for cut in cuts}) == 2

    bench(configuration, tmp_path, body)


def _grid(period: float) -> Callable[..., Grid]:
    return lambda _: Grid(trigger="rate", now=1_000_000_000, epoch=0, period=period, readers=0)


def test_where_the_second_output_does_not_come_the_first_is_taken_back_too(tmp_path: Path) -> None:
    configuration, swaps = cameras(camera(("left",), ("right",)))

    async def body(b: Bench) -> None:
        b.client.reply("new", AttachCommand, Attached(matched=1), Unreachable("it has ended"))
        with pytest.raises(StepFailed, match="it has ended"):
            await swapped(b, *swaps)
        undone = [sent.command for sent in b.client.sent if sent.how == "undo"]
        assert undone == [
            DetachCommand(port=name, topic=f"/{name}", timeout=DETACH_TIMEOUT) for name in ("left", "right")
        ]

    bench(configuration, tmp_path, body)


# -- two hosts -----------------------------------------------------------------------------------------

MS = 10**6
APART = CONFIGURATION.with_instance(replace(CONFIGURATION.instances["talker_2"], host="arm"))


@pytest.mark.parametrize(
    ("trigger", "uncertainty", "shift"),
    [("rate", MS, 5001 * MS), ("rate", 200 * MS, 5200 * MS), ("none", 300 * MS, 5300 * MS)],
)
def test_a_new_side_on_another_host_gets_the_latest_moment_that_may_be_meant(
    trigger: TriggerKind, uncertainty: int, shift: int, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.backend.offsets["arm"] = ClockOffset(5000 * MS, uncertainty, time.time_ns())
        grid = (0, 0.5) if trigger == "rate" else (None, None)
        b.client.reply("talker", GridCommand, Grid(trigger=trigger, now=10**9, epoch=grid[0], period=grid[1]))
        await swapped(b)
        [cut_out], [cut_in] = b.client.of(CutOutCommand, "talker"), b.client.of(CutInCommand, "talker_2")
        assert abs(cut_in.shift - shift) < MS  # the clocks may have drifted apart since
        assert cut_in.at == cut_out.at + cut_in.shift and cut_in.state is None
        assert cut_in.epoch == (cut_in.at if trigger == "rate" else None)
        assert cut_out.at - 10**9 >= 2 * uncertainty
        longest = {"rate": 9 * 0.5, "none": 9 / 5}[trigger]
        assert cut_out.resume_after == pytest.approx(longest + 4 * uncertainty / 1e9, abs=0.01)

    bench(APART, tmp_path, body)


def test_where_the_clocks_are_not_known_so_well_the_new_side_waits_for_the_last_message(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.offsets["arm"] = ClockOffset(-5000 * MS, 300 * MS, time.time_ns())
        b.client.reply("talker", GridCommand, Grid(trigger="rate", now=10**9, epoch=0, period=0.5))
        await swapped(b)
        [cut_out], [cut_in] = b.client.of(CutOutCommand, "talker"), b.client.of(CutInCommand, "talker_2")
        assert abs(cut_in.shift - -5300 * MS) < MS  # the earliest moment
        assert cut_out.state is not None and cut_in.state is not None
        assert cut_out.state.order_only and not cut_out.state.required
        assert (cut_out.state.id, cut_out.state.cuts) == (cut_in.state.id, cut_in.state.cuts)
        assert (cut_out.state.at, cut_in.state.at) == (cut_out.at, cut_in.at)

    bench(APART, tmp_path, body)


def test_on_one_host_no_clock_is_measured(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.offsets[""] = ClockOffset(5000 * MS, MS, time.time_ns())
        await swapped(b)
        assert only(b, CutInCommand, "talker_2").shift == 0

    bench(CONFIGURATION, tmp_path, body)

"""The cut on the data thread: which write passes which gate, decided from times alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from midstride.model.contract import QoS
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Output, OutputLink
from midstride.node.component_host import Host, MessageInfo
from midstride.node.data.trigger import InfoSet
from midstride.node.handover.arbiter import LockArbiter
from midstride.node.handover.cut import GRACE, IncomingCut, OutgoingCut, belongs_after, source_of
from midstride.wire.pipe import PipeLock

from .author import String

# The agreed moment (ns on the ROS clock), and a period of 20 ms.
T = 1_000_000_000_000
PERIOD = 0.02


class Clocks:
    """A host that has clocks and reads a message's info as its time of publication."""

    simulated_time = publishes_ros_time = False

    def __init__(self, now: int = T) -> None:
        self.time = now
        self.real: int | None = None  # the steady clock, where it runs otherwise

    def now(self) -> int:
        return self.time

    message_now = now

    def steady(self) -> int:
        return self.time - T if self.real is None else self.real

    def read_info(self, info: Any) -> MessageInfo:
        return info if isinstance(info, MessageInfo) else MessageInfo(info, None, None)

    @property
    def host(self) -> Host:
        return cast(Host, self)


@dataclass(eq=False)
class Grid:
    period: float = PERIOD
    slot: int | None = None
    epoch: int | None = None

    def regrid(self, epoch: int) -> None:
        self.epoch = epoch


@dataclass(eq=False)
class Owner:
    """A functionality as a cut sees it."""

    driven: Any = "rate"
    rate: Grid | None = field(default_factory=Grid)
    slots: tuple[int, int] | None = None
    info: Any = None
    busy: int | None = None
    watch: Any = None
    driving: Any = ()
    failed: bool = False
    calls: int = 0


class Wire:
    """The publisher of a link: what has gone out."""

    def __init__(self) -> None:
        self.published: list[str] = []

    def publish(self, message: Any) -> None:
        self.published.append(message.data)

    def destroy(self) -> None:
        """Nothing is to be released."""


def link_of(owner: Owner, topic: str = "/chatter") -> tuple[OutputLink, list[str]]:
    output, wire = Output("out", String, QoS()), Wire()
    output.owner = owner
    link = OutputLink(output, topic, cast(Any, wire), MessageTimes(lambda: T))
    output.links = (link,)
    return link, wire.published


def write(link: OutputLink, words: str) -> None:
    link.output.write(String(data=words))


def cut_lock() -> LockArbiter:
    return LockArbiter(PipeLock({}, "cut"))


# -- what belongs where ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("slot", "after"),
    [(T, True), (T - 1, True), (T + 1, True), (T - 4_000_000, True), (T - 6_000_000, False), (T - 20_000_000, False)],
)
def test_the_slot_nearest_to_the_moment_is_the_moment(slot: int, after: bool) -> None:
    """Both sides round their grid to whole nanoseconds."""
    assert belongs_after(Owner(slots=(slot, slot)), T, Clocks(0).host) is after


def test_a_late_call_belongs_to_its_first_slot_on_the_old_side_and_to_its_last_on_the_new() -> None:
    owner = Owner(slots=(T - 20_000_000, T))
    assert not belongs_after(owner, T, Clocks().host, slot=0)
    assert belongs_after(owner, T, Clocks().host, slot=1)


@pytest.mark.parametrize(("source", "after"), [(T - 1, False), (T, False), (T + 1, True)])
def test_the_answer_to_a_message_of_the_moment_itself_is_the_old_sides(source: int, after: bool) -> None:
    owner = Owner(driven="message", rate=None, info=source)
    assert belongs_after(owner, T, Clocks(T + 10**9).host) is after


def test_a_message_has_one_time_on_both_hosts_and_a_slot_that_of_its_own() -> None:
    """The clock here is 5 s ahead of that of the old side, whose moment is T - 5 s on its clock."""
    shift, host = 5 * 10**9, Clocks(T + 10**9).host
    for source, after in ((T - shift, False), (T - shift + 1, True), (T, True)):
        assert belongs_after(Owner(driven="message", rate=None, info=source), T, host, shift=shift) is after
    for slot in (T - 20_000_000, T):
        assert belongs_after(Owner(slots=(slot, slot)), T, host, shift=shift) is (slot == T)


@pytest.mark.parametrize(("now", "after"), [(T - 1, False), (T, True)])
def test_what_answers_nothing_belongs_to_the_moment_it_is_written(now: int, after: bool) -> None:
    assert belongs_after(Owner(driven="none", rate=None), T, Clocks(now).host) is after


def test_a_set_of_messages_is_as_new_as_its_newest() -> None:
    clocks = Clocks(T + 5)
    assert source_of(InfoSet((T - 1, T + 1, T)), clocks.host) == T + 1
    assert source_of(MessageInfo(None, None, None, stamp=T - 3), clocks.host) == T - 3
    assert source_of(MessageInfo(None, None, None), clocks.host) == T + 5


# -- the new side ----------------------------------------------------------------------------------


def incoming(*links: OutputLink, latches: tuple[OutputLink, ...] = ()) -> IncomingCut:
    side = IncomingCut(links, Clocks().host, cut_lock(), T, latches=latches)
    side.arm(T)
    return side


def test_only_what_has_not_written_since_the_moment_is_latched() -> None:
    owner = Owner(slots=(T - 20_000_000, T - 20_000_000))
    (written, first), (silent, second) = link_of(owner, "/a"), link_of(owner, "/b")
    side = incoming(written, silent, latches=(written, silent))
    for link in (written, silent):
        write(link, "before")
    owner.slots = (T, T)
    write(written, "at the moment")
    side.latch()
    side.latch()
    assert first == ["at the moment"], "a late joiner would get an older message after a newer one"
    assert second == ["before"] and side.first().keys() == {"out /a", "out /b"}


def test_what_was_written_once_is_published_at_the_end_where_another_output_ended_the_cut() -> None:
    owner = Owner(slots=(T - 20_000_000, T - 20_000_000))
    (moving, _), (fixed, published) = link_of(owner, "/tf"), link_of(owner, "/tf_static")
    side = incoming(moving, fixed, latches=(fixed,))
    write(fixed, "once")
    owner.slots = (T, T)
    write(moving, "at the moment")
    side.conclude()
    assert published == ["once"] and (moving.gate, fixed.gate) == ("open", "open")


def test_the_end_of_a_cut_leaves_the_gates_of_links_that_were_taken_out_of_it() -> None:
    (kept, _), (taken_out, published) = link_of(Owner(), "/a"), link_of(Owner(), "/b")
    side = incoming(kept, taken_out)
    taken_out.set_gate(False)  # as a detach does
    side.conclude()
    assert kept.gate == "open" and taken_out.gate == "closed"
    write(taken_out, "nothing")
    assert published == [] and taken_out.gated == 1


def test_the_new_side_continues_the_grid_it_is_given() -> None:
    owner = Owner()
    link, _ = link_of(owner)
    incoming(link)
    assert owner.rate is not None and owner.rate.epoch == T


def test_the_new_side_keeps_its_grid_where_it_is_given_none() -> None:
    owner = Owner(rate=Grid(epoch=5))
    link, _ = link_of(owner)
    IncomingCut([link], Clocks(T).host, cut_lock(), T).arm()
    assert owner.rate is not None and owner.rate.epoch == 5


# -- the old side ----------------------------------------------------------------------------------


def outgoing(owner: Owner, clocks: Clocks) -> tuple[OutgoingCut, OutputLink]:
    link, _ = link_of(owner)
    side = OutgoingCut([link], clocks.host, cut_lock(), T)
    side.arm()
    return side, link


def test_a_grid_whose_slot_before_the_moment_is_over_has_passed_it() -> None:
    owner, clocks = Owner(rate=Grid(slot=T - 20_000_000)), Clocks(T + 1)
    side, link = outgoing(owner, clocks)
    assert not side.passed(), "the call of the moment's own slot has not come yet, so an earlier one may be late"
    assert owner.rate is not None
    owner.rate.slot = T - 1
    assert side.passed() and link.gate == "closed"


def test_an_old_side_has_passed_once_each_of_its_functionalities_has() -> None:
    past, late = Owner(rate=Grid(slot=T - 1)), Owner(rate=Grid(slot=T - 20_000_000))
    links = [link_of(owner, topic)[0] for owner, topic in ((past, "/a"), (late, "/b"))]
    side = OutgoingCut(links, Clocks(T + 1).host, cut_lock(), T)
    side.arm()
    assert not side.passed() and not any(link.gate == "closed" and not link.cut for link in links)
    assert late.rate is not None
    late.rate.slot = T - 1
    assert side.passed() and [link.gate for link in links] == ["closed", "closed"]


def test_a_fast_clock_leaves_a_call_real_time_to_be_late_in() -> None:
    """At 50x, two periods of 20 ms are less than 1 ms."""
    clocks = Clocks(T + 10**9)
    clocks.simulated_time, clocks.real = True, 0
    side = OutgoingCut([link_of(Owner())[0]], clocks.host, cut_lock(), T)
    side.arm()
    assert not side.passed()
    clocks.real += int(GRACE * 0.9e9)
    assert not side.passed()
    clocks.real += int(GRACE * 0.2e9)
    assert side.passed()


def test_a_grid_that_has_stopped_is_not_waited_for() -> None:
    clocks = Clocks(T + round(GRACE * 1e9))
    side, link = outgoing(Owner(rate=Grid(slot=None)), clocks)
    assert not side.passed()
    clocks.time += 1
    assert side.passed() and link.gate == "closed"
    slow = Clocks(T + 2_000_000_000)
    side, _ = outgoing(Owner(rate=Grid(period=1.0, slot=T - 1_000_000_000)), slow)
    assert not side.passed(), "two periods have not gone by"
    slow.time += 1
    assert side.passed()


def test_messages_that_reach_the_old_side_are_watched_until_the_new_side_is_confirmed() -> None:
    owner, clocks = Owner(driven="message", rate=None), Clocks(T - 10)
    side, _ = outgoing(owner, clocks)
    seen = []
    for steady, source in ((10, T), (20, T + 1), (30, T + 2)):
        clocks.time = T + steady
        owner.watch(source)
        seen.append(side.newer_at)
    assert seen == [None, 20, 20]
    side.confirmed()
    assert owner.watch is None


@pytest.mark.parametrize("in_order", [False, True])
def test_of_one_publisher_a_newer_message_shows_that_all_older_have_arrived(in_order: bool) -> None:
    owner, clocks = Owner(driven="message", rate=None), Clocks(T)
    link, _ = link_of(owner)
    side = OutgoingCut([link], clocks.host, cut_lock(), T, in_order=in_order)
    side.arm()
    owner.watch(T)
    assert not side.passed(), "a message of the moment itself says nothing about others of that moment"
    clocks.time += 1
    owner.watch(T + 1)
    assert side.passed() is in_order


def test_a_data_thread_that_did_not_run_may_have_messages_waiting() -> None:
    """So that none has come for long says nothing until it has looked again."""
    owner, clocks = Owner(driven="message", rate=None), Clocks(T - 100)
    link, published = link_of(owner)
    side = OutgoingCut([link], clocks.host, cut_lock(), T, in_order=True)
    side.arm()
    clocks.time = T + 300_000_000
    assert not side.passed()
    owner.info = T - 10
    owner.watch(T - 10)
    write(link, "late")
    clocks.time += 60_000_000
    assert [side.passed() for _ in range(3)] == [False, False, True]
    assert published == ["late"]


def test_what_comes_after_the_new_side_has_waited_for_it_is_left_out() -> None:
    owner, clocks = Owner(driven="message", rate=None, info=T - 10), Clocks(T)
    link, published = link_of(owner)
    side = OutgoingCut([link], clocks.host, cut_lock(), T, until=T + 1000)
    side.arm()
    clocks.time = T + 1000
    write(link, "in time")
    clocks.time += 1
    write(link, "too late")
    assert (published, link.gated) == (["in time"], 1)


@pytest.mark.parametrize("by", ["its report", "its lock"])
@pytest.mark.parametrize("passed", [-20_000_000, 0, 50_000_000, 50_000_001, 1_000_000_000])
def test_a_call_that_hung_is_outdated_if_the_new_side_writes(passed: int, by: str) -> None:
    """Whichever way the old side learns of it: after a stop it may come to the call before it hears of anything."""
    link, published = link_of(Owner(slots=(T - 20_000_000, T - 20_000_000)))
    holders: dict[str, PipeLock] = {}
    clocks, new = Clocks(T + passed), PipeLock(holders, "cut")
    side = OutgoingCut([link], clocks.host, LockArbiter(PipeLock(holders, "cut")), T)
    side.arm()
    write(link, "nobody else writes")
    if by == "its lock":
        assert new.take()
    else:
        side.taken_at = clocks.steady()
    write(link, "beside the new one's")
    assert published == ["nobody else writes", "beside the new one's"][: 1 + (passed <= 50_000_000)]
    assert side.arbiter.reclaim() == (by != "its lock")


def test_a_fast_clock_leaves_a_call_real_time_before_it_is_outdated() -> None:
    owner, clocks = Owner(slots=(T - 20_000_000, T - 20_000_000)), Clocks(T + 1_000_000_000)
    clocks.simulated_time = True
    side, link = outgoing(owner, clocks)
    side.taken_at = 1_000
    for passed, passes in [(0, True), (49_999_999, True), (50_000_000, False)]:
        clocks.real = side.taken_at + passed
        assert side.passes(link) == passes


@pytest.mark.parametrize(
    ("driven", "rate", "heard"),
    [("rate", Grid(), ["before", "3", "after"]), ("message", None, ["before", "1", "2", "3", "after"])],
)
def test_an_old_side_that_writes_again_has_lost_nothing(driven: str, rate: Grid | None, heard: list[str]) -> None:
    """One late message stands for all slots that have come, as where state moves; and each message is answered."""
    owner, clocks = Owner(driven=driven, rate=rate), Clocks(T - 10)
    link, published = link_of(owner)
    side = OutgoingCut([link], clocks.host, cut_lock(), T)
    side.arm()
    write(link, "before")
    clocks.time = T + 10
    message = String()
    for number in range(1, 4):
        message.data = str(number)  # an author may fill the same object again
        link.output.write(message)
    side.reopen()
    write(link, "after")
    assert published == heard
    assert (link.count, link.gated) == (len(heard), 5 - len(heard))


def answered_after_the_moment() -> tuple[OutgoingCut, OutputLink, list[str]]:
    """The old side that has answered a message of the new one's, its attachment, and what has gone out."""
    link, published = link_of(Owner(driven="message", rate=None, info=T + 10))
    side = OutgoingCut([link], Clocks(T - 10).host, cut_lock(), T)
    side.arm()
    write(link, "held back")
    return side, link, published


def test_what_was_held_back_is_not_written_once_the_new_side_has_taken_over() -> None:
    side, _, published = answered_after_the_moment()
    side.confirmed()
    side.reopen()
    assert published == []


def test_what_was_held_back_stays_behind_a_gate_that_something_else_has_set() -> None:
    side, link, published = answered_after_the_moment()
    link.set_gate(False)
    side.reopen()
    assert (published, link.gate) == ([], "closed")

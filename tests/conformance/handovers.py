"""The hand-over: agreed cuts, and what happens where one side fails."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Final

from midstride.runtime.backend_protocol import Backend
from tests.conformance import puppets
from tests.conformance.lab import CHECKS, Lab, assert_unbroken, check

# How far ahead a cut is agreed (s): many round trips on a busy machine.
LEAD: Final = 0.5
# How many attempts there are on a machine that is too busy for the writers to keep their slots.
_ATTEMPTS: Final = 5
# How far from the cut a slot is still the hand-over's to keep (slots): in it both sides have taken part.
_NEAR_THE_CUT: Final = 8


async def _two_talkers(lab: Lab, rate: float = 50, mode: puppets.Description | None = None) -> None:
    """``old`` talks to ``sink``, ``new`` does so behind its gate, in the manner of ``mode``."""
    await lab.listen()
    for name, gate, manner in (("old", "open", None), ("new", "closed", mode)):
        await lab.start(name, puppets.talker(rate, manner))
        await lab.attach(name, "out", "/chatter", peers=1, gate=gate)
    for name in ("old", "new"):
        await lab.mode(name, "talk", "normal")
    await lab.read("new", "await_write", port="out", topic="/chatter", timeout=5.0)
    await lab.change("new", "meet", peer="old")
    await lab.sleep(0.3)


async def _slot(lab: Lab, instance: str, lead: float = LEAD) -> tuple[int, int, float]:
    """A slot of the output's grid ``lead`` seconds ahead, an epoch of the grid, and its period."""
    grid = await lab.read(instance, "grid", port="out")
    period = round(grid["period"] * 1e9)
    ahead = (grid["now"] + int(lead * 1e9) - grid["epoch"]) // period + 1
    return grid["epoch"] + ahead * period, grid["epoch"], grid["period"]


def _swap(**more: Any) -> list[dict[str, Any]]:
    return [{"port": "out", "topic": "/chatter", **more}]


async def _cut(
    lab: Lab, at: int, epoch: int | None, resume_after: float, cut: str = "cut", latch: bool = False
) -> None:
    await lab.change("old", "cut_out", cut=cut, swaps=_swap(), at=at, resume_after=resume_after)
    await lab.change("new", "cut_in", cut=cut, swaps=_swap(latch=latch), at=at, epoch=epoch, peer="old")


async def _outcomes(lab: Lab, expected: str = "done", cut: str = "cut") -> tuple[dict[str, Any], dict[str, Any]]:
    new = await lab.read("new", "await_cut", cut=cut, timeout=5.0)
    old = await lab.read("old", "await_cut", cut=cut, timeout=5.0)
    assert old["outcome"] == new["outcome"] == expected, (old, new)
    return old, new


def _messages_of_old(words: list[str]) -> int:
    """The number of messages of the old side, all of which come before those of the new one."""
    sides = [word.split(" ")[0] for word in words]
    of_old = sides.index("new")
    assert sides == ["old"] * of_old + ["new"] * (len(sides) - of_old), "their messages are interleaved"
    return of_old


async def hands_over_on_the_grid(backend: Backend, workspace: Path) -> None:
    """At 50 Hz: every slot near the cut written by exactly one side, both publishers in the graph.

    A busy machine may delay a writer by more than a slot, but not every time.
    """
    faults: list[str] = []
    while (fault := await _hand_over_on_the_grid(backend, workspace)) is not None:
        faults.append(fault)
        assert len(faults) < _ATTEMPTS, faults


CHECKS.append(hands_over_on_the_grid)


async def _hand_over_on_the_grid(backend: Backend, workspace: Path) -> str | None:
    """What was wrong with the slots, according to the messages' source times."""
    async with Lab(backend, workspace) as lab:
        await _two_talkers(lab)
        await lab.shows(publishers=[("/old", "/chatter"), ("/new", "/chatter")])
        at, epoch, period = await _slot(lab, "old")
        await lab.change("sink", "record", inputs=["in"], on=True)
        await _cut(lab, at, epoch, resume_after=1.0)
        old, new = await _outcomes(lab)
        assert (await lab.port("old", "out", "/chatter"))["gate"] == "closed"
        assert (await lab.port("new", "out", "/chatter"))["gate"] == "open"
        await lab.change("old", "detach", port="out", topic="/chatter", timeout=2.0)
        await lab.sleep(0.5)
        words = await lab.received("sink")
        of_old = _messages_of_old(words)
        assert_unbroken(words[:of_old])
        assert_unbroken(words[of_old:])
        assert old["last"]["out /chatter"]["number"] == of_old, (old, of_old)
        assert new["first"]["out /chatter"]["number"] == 1, new
        rows = await lab.rows("sink")
        return _fault_of_slots(rows, at, period) if all(row[1] is not None for row in rows) else None


@check
async def hands_over_to_another_of_its_outputs(lab: Lab) -> None:
    """One component is both sides, for a topic that allows one publisher."""
    description = puppets.talker(rate=50)
    description["component"]["outputs"].append("other")
    talk = description["component"]["functionalities"]["talk"]
    talk["produces"].append("other")
    talk["modes"]["normal"]["guarantees"]["other"] = {"type": puppets.STRING, "rate": 50}
    await lab.listen()
    await lab.start("old", description)
    await lab.attach("old", "out", "/chatter", peers=1)
    await lab.attach("old", "other", "/chatter", peers=1, gate="closed")
    await lab.mode("old", "talk", "normal")
    await lab.read("old", "await_write", port="other", topic="/chatter", timeout=5.0)
    await lab.change("old", "meet", peer="old")
    at, epoch, _ = await _slot(lab, "old")
    await lab.change("old", "cut_out", cut="cut", swaps=_swap(), at=at, resume_after=1.0)
    swaps = [{"port": "other", "topic": "/chatter"}]
    await lab.change("old", "cut_in", cut="cut", swaps=swaps, at=at, epoch=epoch, peer="old")
    result = await lab.read("old", "await_cut", cut="cut", timeout=5.0)
    assert result["outcome"] == "done", result
    assert result["last"]["out /chatter"] and result["first"]["other /chatter"]["number"] == 1, result
    assert (await lab.port("old", "out", "/chatter"))["gate"] == "closed"
    assert (await lab.port("old", "other", "/chatter"))["gate"] == "open"
    await lab.change("old", "detach", port="out", topic="/chatter", timeout=2.0)
    await lab.sleep(0.5)
    assert_unbroken(await lab.received("sink"))


def _fault_of_slots(rows: list[list[Any]], at: int, period: float) -> str | None:
    """By source time: one message in each slot near the cut. Further away, a slot is the writer's alone to keep."""
    slots = [slot for row in rows if abs(slot := (row[1] - at) / 1e9 / period) < _NEAR_THE_CUT]
    # A write comes after its slot's time, never before it; how late depends on the machine.
    begun = [math.floor(slot + 0.05) for slot in slots]
    if len(set(begun)) < len(begun):
        return f"two messages in one slot: {slots}"
    if begun != list(range(begun[0], begun[0] + len(begun))):
        return f"a slot without a message: {slots}"
    return None


@check
async def hands_over_what_messages_drive(lab: Lab) -> None:
    """At 200 Hz: every question is answered exactly once, by either side."""
    await lab.start("source", puppets.talker(rate=200))
    await lab.listen()
    for name, gate in (("old", "open"), ("new", "closed")):
        await lab.start(name, puppets.relay())
        await lab.attach(name, "out", "/chatter", peers=1, gate=gate)
        await lab.attach(name, "in", "/questions")
        await lab.mode(name, "answer", "normal")
    await lab.attach("source", "out", "/questions", peers=2)
    await lab.mode("source", "talk", "normal")
    await lab.read("new", "await_write", port="out", topic="/chatter", timeout=5.0)
    await lab.change("new", "meet", peer="old")
    await lab.sleep(0.3)
    grid = await lab.read("old", "grid", port="out")
    at = grid["now"] + int(LEAD * 1e9)
    await _cut(lab, at, None, resume_after=1.0)
    await _outcomes(lab)
    await lab.change("old", "detach", port="out", topic="/chatter", timeout=2.0)
    await lab.sleep(0.3)
    await lab.mode("source", "talk", "degraded")
    await lab.sleep(0.3)
    asked = (await lab.exported("source"))["calls"]["talk.normal"]
    # Each exactly once. At the cut the new side may be faster: messages of two publishers have no common order.
    answered = sorted(int(word.rsplit(" ", 1)[1]) for word in await lab.received("sink"))
    lost = sorted(set(range(1, asked + 1)) - set(answered))
    twice = sorted(number for number in set(answered) if answered.count(number) > 1)
    assert not lost and not twice, f"of {asked} questions, not answered: {lost}, answered twice: {twice}"
    link = await lab.port("new", "out", "/chatter")
    assert link["count"] > 20, link


@check
async def hands_over_a_latched_topic(lab: Lab) -> None:
    """On a transient-local topic the new side writes before the old one detaches, and late joiners get its message."""
    for name, gate in (("old", "open"), ("new", "closed")):
        await lab.start(name, puppets.latch())
        await lab.attach(name, "out", "/chatter", gate=gate)
        await lab.mode(name, "talk", "normal")
    await lab.read("new", "await_write", port="out", topic="/chatter", timeout=5.0)
    await lab.change("new", "meet", peer="old")
    grid = await lab.read("old", "grid", port="out")
    assert grid["trigger"] == "none" and grid["epoch"] is None, grid
    await _cut(lab, grid["now"] + int(LEAD * 1e9), None, resume_after=2.0, latch=True)
    await _outcomes(lab)
    await lab.change("old", "detach", port="out", topic="/chatter", timeout=2.0)
    await lab.start("late", puppets.sink(durability="transient_local"))
    await lab.mode("late", "hear", "normal")
    await lab.attach("late", "in", "/chatter", peers=1)
    await lab.eventually("the late joiner has it", lambda: lab.received("late"))
    assert await lab.received("late") == ["new normal 1"]


@check
async def hands_over_to_one_that_writes_once(lab: Lab) -> None:
    """The old side writes at a rate, the new one once, on entry: at the cut it writes that message again."""
    await lab.listen()
    description = puppets.latch()
    description["component"]["functionalities"]["talk"]["modes"]["normal"]["guarantees"]["out"]["qos"] = {}
    for name, gate, puppet in (("old", "open", puppets.talker(50)), ("new", "closed", description)):
        await lab.start(name, puppet)
        await lab.attach(name, "out", "/chatter", peers=1, gate=gate)
        await lab.mode(name, "talk", "normal")
    await lab.read("new", "await_write", port="out", topic="/chatter", timeout=5.0)
    await lab.change("new", "meet", peer="old")
    at, epoch, _ = await _slot(lab, "old")
    await _cut(lab, at, epoch, resume_after=2.0)
    await _outcomes(lab)
    await lab.eventually("it is received", lambda: lab.received("sink"), lambda words: words[-1:] == ["new normal 1"])
    assert _messages_of_old(await lab.received("sink")) > 0


@check
async def resumes_unless_confirmed(lab: Lab) -> None:
    """The new side never learns of the cut: the old one resumes by itself, after the agreed time and not before."""
    await _two_talkers(lab)
    await lab.change("sink", "record", inputs=["in"], on=True)
    at, _, _ = await _slot(lab, "old")
    await lab.change("old", "cut_out", cut="cut", swaps=_swap(), at=at, resume_after=0.4)
    old = await lab.read("old", "await_cut", cut="cut", timeout=5.0)
    assert old["outcome"] == "resumed", old
    assert (await lab.port("old", "out", "/chatter"))["gate"] == "open"
    await lab.sleep(0.3)
    words = await lab.received("sink")
    assert all(word.startswith("old ") for word in words)
    received = [row[0] for row in await lab.rows("sink")]
    gap = max(later - earlier for earlier, later in itertools.pairwise(received)) / 1e9
    assert 0.35 < gap < 0.7, f"it was silent for {gap} s"
    # If the new side starts too late, it learns that and stays behind its gate.
    late, epoch, _ = await _slot(lab, "old")
    await lab.change("new", "cut_in", cut="cut", swaps=_swap(), at=late, epoch=epoch, peer="old")
    new = await lab.read("new", "await_cut", cut="cut", timeout=5.0)
    assert new["outcome"] == "cancelled", new
    assert (await lab.port("new", "out", "/chatter"))["gate"] == "closed"


@check
async def waits_for_a_question_before_it_resumes(lab: Lab) -> None:
    """A message-driven old side that receives no question does not resume; when it does, it has missed none."""
    await lab.start("source", puppets.talker(rate=50))
    await lab.start("old", puppets.relay())
    await lab.listen()
    await lab.attach("old", "out", "/chatter", peers=1)
    await lab.attach("old", "in", "/questions")
    await lab.mode("old", "answer", "normal")
    await lab.attach("source", "out", "/questions", peers=1)
    grid = await lab.read("old", "grid", port="out")
    at = grid["now"] + int(LEAD * 1e9)
    await lab.change("old", "cut_out", cut="cut", swaps=_swap(), at=at, resume_after=0.2)
    waiting = await lab.read("old", "await_cut", cut="cut", timeout=LEAD + 1.0)
    assert waiting["outcome"] == "waiting", waiting
    await lab.mode("source", "talk", "normal")
    old = await lab.read("old", "await_cut", cut="cut", timeout=5.0)
    assert old["outcome"] == "resumed", old
    await lab.sleep(0.3)
    await lab.mode("source", "talk", "degraded")
    asked = (await lab.exported("source"))["calls"]["talk.normal"]
    await lab.eventually("all are answered", lambda: lab.received("sink"), lambda words: len(words) >= asked)
    answered = [int(word.rsplit(" ", 1)[1]) for word in await lab.received("sink")]
    assert answered == list(range(1, asked + 1)), (
        f"{asked} questions have been asked, and answered in this order: {answered}"
    )


@check
async def cancels_a_cut(lab: Lab) -> None:
    """Before its moment or after it: the old side's gate is open, the new one's closed; and another cut is possible."""
    await _two_talkers(lab)
    at, epoch, _ = await _slot(lab, "old")
    await _cut(lab, at, epoch, resume_after=1.0, cut="first")
    for side in ("new", "old"):
        await lab.change(side, "cancel_cut", cut="first")
    await _outcomes(lab, "cancelled", "first")
    await lab.sleep(LEAD + 0.2)
    assert (await lab.port("old", "out", "/chatter"))["gate"] == "open"
    assert (await lab.port("new", "out", "/chatter"))["count"] == 0
    at, epoch, _ = await _slot(lab, "old")
    await _cut(lab, at, epoch, resume_after=1.0, cut="second")
    await _outcomes(lab, "done", "second")
    for side in ("new", "old"):
        await lab.change(side, "cancel_cut", cut="second")
    assert (await lab.port("old", "out", "/chatter"))["gate"] == "open"
    closed = await lab.port("new", "out", "/chatter")
    assert closed["gate"] == "closed"
    words = await lab.eventually(
        "what the new side has written has arrived",
        lambda: lab.received("sink"),
        lambda words: sum(word.startswith("new ") for word in words) == closed["count"],
    )
    count = len(words)
    await lab.sleep(0.3)
    words = (await lab.received("sink"))[count:]
    assert words and all(word.startswith("old ") for word in words), words
    await lab.change("new", "cancel_cut", cut="never agreed")


@check
async def refuses_impossible_cuts(lab: Lab) -> None:
    """In the past, on the wrong side of a gate, on what is not attached, twice: refused, and nothing has changed."""
    await _two_talkers(lab)
    at, epoch, _ = await _slot(lab, "old")
    past = at - int(10e9)
    common: dict[str, Any] = {"cut": "cut", "swaps": _swap()}
    assert "passed" in await lab.refusal("old", "cut_out", **common, at=past, resume_after=1.0)
    assert "passed" in await lab.refusal("new", "cut_in", **common, at=past, epoch=epoch, peer="old")
    assert "closed" in await lab.refusal("new", "cut_out", **common, at=at, resume_after=1.0)
    assert "open" in await lab.refusal("old", "cut_in", **common, at=at, epoch=epoch, peer="new")
    elsewhere = [{"port": "out", "topic": "/elsewhere"}]
    refused = await lab.refusal("old", "cut_out", cut="cut", swaps=elsewhere, at=at, resume_after=1.0)
    assert "/elsewhere" in refused
    assert "missing" in await lab.refusal("new", "meet", peer="missing", timeout=0.5)
    at, epoch, _ = await _slot(lab, "old", lead=5.0)
    await lab.change("old", "cut_out", **common, at=at, resume_after=1.0)
    assert "cut" in await lab.refusal("old", "cut_out", **common, at=at, resume_after=1.0)
    assert "cut" in await lab.refusal("old", "gate", port="out", topic="/chatter", gate="closed")
    await lab.change("old", "cancel_cut", cut="cut")
    assert "unheard of" in await lab.read_refusal("old", "await_cut", cut="unheard of", timeout=0.1)


@check
async def keeps_to_the_grid_across_a_busy_spell(lab: Lab) -> None:
    """A new side that is busy at the cut writes its slots late or not at all, but never one of the old side's."""
    await _two_talkers(lab, rate=20, mode={"sleep": 0.2, "at_call": 30})
    await lab.eventually("it is about to be busy", lambda: lab.calls("new", "talk.normal"), lambda calls: calls >= 24)
    at, epoch, _ = await _slot(lab, "old", lead=0.25)
    await _cut(lab, at, epoch, resume_after=2.0)
    await _outcomes(lab)
    await lab.sleep(0.3)
    assert (await lab.port("old", "out", "/chatter"))["count"] == _messages_of_old(await lab.received("sink"))

"""The counts of an exchanged output: how much of what its rate promises has been written over the whole change."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.model.action import Action, Attach, Detach, Handover, Swap
from midstride.model.component import PortRef
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.watch.output_tallies import OutputTallies, _Begun, recorded_topics
from midstride.runtime.watch.subscriber_recording import Exchange
from midstride.verdicts.assessment import Assessment
from midstride.wire.state import LinkState

RATE, WINDOW, BEFORE = 50.0, 4.0, 1000
OLD, NEW = PortRef("talker", "out"), PortRef("talker_2", "out")


def said(
    count: int,
    last: int | None,
    *,
    resumed: bool,
    performed: Sequence[Action] = (),
    last_of_new: int | None = None,
    before: int = BEFORE,
    window: float = WINDOW,
    only_counted: bool = False,
    received: Sequence[str] = (),
    inactive: float | None = None,
) -> list[str]:
    """What is said if the side that writes in the end has written ``count``, and ``last`` is the old side's last.

    ``performed``: what the change has done on its way; ``last_of_new``: the last of the new side, where it has written.
    """
    link = LinkState(gate="open", count=count, inactive=inactive)

    async def peek(_: str) -> Any:
        return SimpleNamespace(ports={"out": {"/chat": link}})

    tallies = OutputTallies(
        cast("Any", SimpleNamespace(peek=peek)), cast("Any", SimpleNamespace(steady=lambda: window))
    )
    begun = LinkState(gate="open", count=before)
    tallies._begun = [_Begun(Exchange("/chat", OLD, NEW), "/chat", 0.0, begun, RATE, only_counted)]

    async def assessed() -> list[Assessment]:
        for each in performed:
            await tallies.performed(each)
        return await tallies.assessments({OLD: last, NEW: last_of_new}, received, resumed=resumed)

    return [each.words for each in asyncio.run(assessed())]


ATTACHED_ANEW = [Detach(OLD, "/chat"), Attach(OLD, "/chat")]
THERE_AND_BACK = [Handover((Swap("/chat", OLD, NEW),)), Handover((Swap("/chat", NEW, OLD),))]


@pytest.mark.parametrize(
    ("count", "last", "resumed", "performed", "last_of_new"),
    [
        (1200, None, True, [], None),  # the old side has never been detached
        (1100, 1050, True, THERE_AND_BACK, 100),  # it was handed over, and back; the new one wrote meanwhile
        (90, 1110, True, ATTACHED_ANEW, None),  # it counts from 0
        (90, 1110, False, [], None),  # the new one writes
    ],
)
def test_nothing_is_said_where_all_has_been_written(
    count: int, last: int | None, resumed: bool, performed: list[Action], last_of_new: int | None
) -> None:
    assert said(count, last, resumed=resumed, performed=performed, last_of_new=last_of_new) == []


def test_what_was_attached_anew_soon_after_its_start_has_not_counted_on() -> None:
    """Its count has passed what it was before, and would be taken for one that had gone on."""
    assert said(150, 50, resumed=True, performed=ATTACHED_ANEW, before=10) == []
    (words,) = said(60, 50, resumed=True, performed=ATTACHED_ANEW, before=10)
    assert words.startswith("/chat was silent for about 2.00 s: 100 messages of")


@pytest.mark.parametrize(
    ("count", "last", "resumed", "performed"),
    [(1100, 1050, True, []), (50, 1050, True, ATTACHED_ANEW), (50, 1050, False, [])],
)
def test_what_is_missing_is_said_as_silence(count: int, last: int, resumed: bool, performed: list[Action]) -> None:
    (words,) = said(count, last, resumed=resumed, performed=performed)
    assert words.startswith("/chat was silent for about 2") and "100 messages of" in words


@pytest.mark.parametrize(("resumed", "performed"), [(True, ATTACHED_ANEW), (True, THERE_AND_BACK), (False, [])])
def test_where_a_part_of_the_count_is_missing_nothing_is_known(resumed: bool, performed: list[Action]) -> None:
    (words,) = said(90, None, resumed=resumed, performed=performed)
    assert words == "whether /chat was silent: how much talker.out wrote last is not known"


def test_a_silence_that_a_count_does_not_show_is_not_excluded() -> None:
    """Of 450 messages in 9 s, 45 may be missing without a word: 0.9 s at 50 Hz."""
    whole = {"last": 1040, "resumed": False, "window": 9.0}
    (words,) = said(410, **whole, only_counted=True)  # type: ignore[arg-type]
    assert words == (
        "whether /chat was silent for up to 900 ms: the messages of talker_2.out were counted over 9.00 s, and no "
        "subscriber in the system has recorded them"
    )
    assert said(410, **whole, only_counted=True, received=["/chat"]) == []  # type: ignore[arg-type]
    assert said(410, **whole) == []  # type: ignore[arg-type]  # with the API
    assert said(160, 1040, resumed=False, only_counted=True) == []  # 0.4 s of 4 s


def test_a_subscriber_that_knows_its_longest_gap_has_recorded_its_topic() -> None:
    """After a roll-back, what was missed is not known."""

    def row(topic: str, gap: float | None, missed: int | None) -> SwapReport:
        return SwapReport(topic, "listener.in", 0.05, gap, None, missed, None, None)

    swaps = [row("/gap", 0.2, None), row("/missed", None, 1), row("/neither", None, None)]
    assert recorded_topics(swaps) == {"/gap", "/missed"}


def test_a_lifecycle_node_that_is_active_need_not_write() -> None:
    found = said(0, None, resumed=False, inactive=0.3)
    assert len(found) == 2 and found[0].startswith("/chat was silent while no node")
    assert found[1] == (
        "when /chat was written again: nothing counts the messages of talker_2.out, and no subscriber in the system "
        "has recorded them"
    )
    assert len(said(0, None, resumed=False, inactive=0.3, received=["/chat"])) == 1
    assert said(0, None, resumed=False, inactive=0.0) == []

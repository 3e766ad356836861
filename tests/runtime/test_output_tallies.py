"""The counts of an exchanged output: how much of what its rate promises has been written over the whole change."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride import verdicts
from midstride.model.action import Action, Attach, Detach, Handover, Swap
from midstride.model.component import PortRef
from midstride.runtime.watch.output_tallies import OutputTallies, _Begun
from midstride.runtime.watch.subscriber_recording import Exchange
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
) -> list[str]:
    """What is said if the side that writes in the end has written ``count``, and ``last`` is the old side's last.

    ``performed``: what the change has done on its way; ``last_of_new``: the last of the new side, where it has written.
    """
    link = LinkState(gate="open", count=count)

    async def peek(_: str) -> Any:
        return SimpleNamespace(ports={"out": {"/chat": link}})

    tallies = OutputTallies(
        cast("Any", SimpleNamespace(peek=peek)), cast("Any", SimpleNamespace(steady=lambda: WINDOW))
    )
    tallies._begun = [_Begun(Exchange("/chat", OLD, NEW), "/chat", 0.0, LinkState(gate="open", count=before), RATE)]

    async def assessed() -> list[verdicts.Assessment]:
        for each in performed:
            await tallies.performed(each)
        return await tallies.assessments({OLD: last, NEW: last_of_new}, resumed=resumed)

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

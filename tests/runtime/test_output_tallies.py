"""The counts of an exchanged output: how much of what its rate promises has been written over the whole change."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.model.component import PortRef
from midstride.runtime.watch.output_tallies import OutputTallies, _Begun
from midstride.runtime.watch.subscriber_recording import Exchange
from midstride.wire.state import LinkState

RATE, WINDOW, BEFORE = 50.0, 4.0, 1000
OLD, NEW = PortRef("talker", "out"), PortRef("talker_2", "out")


def said(count: int, last: int | None, *, resumed: bool) -> list[str]:
    """What is said if the side that writes in the end has written ``count``, and ``last`` is the old side's last."""
    link = LinkState(gate="open", count=count)

    async def peek(_: str) -> Any:
        return SimpleNamespace(ports={"out": {"/chat": link}})

    tallies = OutputTallies(
        cast("Any", SimpleNamespace(peek=peek)), cast("Any", SimpleNamespace(steady=lambda: WINDOW))
    )
    tallies._begun = [_Begun(Exchange("/chat", OLD, NEW), "/chat", 0.0, LinkState(gate="open", count=BEFORE), RATE)]
    found = asyncio.run(tallies.assessments({} if last is None else {OLD: last}, resumed=resumed))
    return [each.words for each in found]


@pytest.mark.parametrize(
    ("count", "last", "resumed"),
    [
        (1200, None, True),  # the old side has never been detached
        (1200, 1100, True),  # it was handed over, and back
        (90, 1110, True),  # it was detached, and attached anew: it counts from 0
        (90, 1110, False),  # the new one writes
    ],
)
def test_nothing_is_said_where_all_has_been_written(count: int, last: int | None, resumed: bool) -> None:
    assert said(count, last, resumed=resumed) == []


@pytest.mark.parametrize(("count", "last", "resumed"), [(1100, 1050, True), (50, 1050, True), (50, 1050, False)])
def test_what_is_missing_is_said_as_silence(count: int, last: int, resumed: bool) -> None:
    (words,) = said(count, last, resumed=resumed)
    assert words.startswith("/chat was silent for about 2") and "100 messages of" in words


def test_of_an_output_that_was_attached_anew_nothing_is_said_unless_its_last_number_is_known() -> None:
    assert said(90, None, resumed=True) == said(90, None, resumed=False) == []

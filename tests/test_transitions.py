"""A table of transitions: what it allows, and what happens where it does not."""

from __future__ import annotations

import logging
from enum import Enum

import pytest

from midstride import transitions
from midstride.transitions import POLICY, ForbiddenTransition, Transitions


class Door(Enum):
    OPEN = "open"
    SHUT = "shut"


class Push(Enum):
    CLOSE = "close"
    OPEN = "open"


DOOR = Transitions({Door.OPEN: {Push.CLOSE: Door.SHUT}, Door.SHUT: {Push.OPEN: Door.OPEN}})


def test_an_event_leads_to_the_state_of_the_table() -> None:
    assert DOOR.after(Door.OPEN, Push.CLOSE, "the door") is Door.SHUT
    assert DOOR.after(Door.SHUT, Push.OPEN, "the door") is Door.OPEN


def test_in_tests_a_forbidden_transition_raises() -> None:
    with pytest.raises(ForbiddenTransition, match="the door: OPEN must not happen in the state OPEN"):
        DOOR.after(Door.OPEN, Push.OPEN, "the door")


def test_in_production_a_forbidden_transition_is_logged_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(POLICY, "on_forbidden", transitions.survive)
    with caplog.at_level(logging.ERROR, logger=transitions.__name__):
        assert DOOR.after(Door.SHUT, Push.CLOSE, "the door") is Door.SHUT
    assert caplog.messages == ["the door: CLOSE must not happen in the state SHUT; the state is kept"]


def test_a_table_is_read_as_it_is_shown() -> None:
    assert (
        Transitions.read(
            Door,
            Push,
            """
        event  open  shut
        close  shut  .
        open   .     open
        """,
        )
        == DOOR
    )


@pytest.mark.parametrize("text", ["event open\nslam shut", "event open\nclose ajar", "event open\nclose shut open"])
def test_a_table_with_another_name_or_a_cell_too_many_is_refused(text: str) -> None:
    with pytest.raises((KeyError, ValueError)):
        Transitions.read(Door, Push, text)

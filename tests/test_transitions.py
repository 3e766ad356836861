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

"""The phases of a change: what may follow what, and what the change is reported as."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride import transitions
from midstride.model.action import Remove
from midstride.runtime.change.change_phases import CHANGE_PHASES, OUTCOMES, ChangeEvent, ChangePhase
from midstride.runtime.records.reports import OutcomeKind
from midstride.transitions import POLICY, ForbiddenTransition
from tests.runtime.scripted import Bench, bench, talking


def test_each_event_that_ends_the_steps_has_an_outcome_and_no_other_has() -> None:
    ending = {
        event
        for following in CHANGE_PHASES.table.values()
        for event, state in following.items()
        if state is ChangePhase.ENDED
    }
    assert ending == OUTCOMES.keys()


@pytest.mark.parametrize(
    ("events", "outcome"),
    [
        ([ChangeEvent.BEGUN, ChangeEvent.ALL_DONE], "done"),
        ([ChangeEvent.BEGUN, ChangeEvent.STEP_FAILED, ChangeEvent.UNDONE], "rolled_back"),
        ([ChangeEvent.BEGUN, ChangeEvent.STEP_FAILED, ChangeEvent.NOT_UNDONE], "failed"),
        ([ChangeEvent.BEGUN, ChangeEvent.LEFT_OUT], "incomplete"),
        ([ChangeEvent.BEGUN, ChangeEvent.SUPERSEDED], "failed"),
        ([ChangeEvent.CALLED_OFF], "rolled_back"),
    ],
)
def test_a_change_is_measured_whatever_its_steps_have_ended_with(
    events: list[ChangeEvent], outcome: OutcomeKind, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        for event in events:
            assert b.change.outcome is None
            b.change.happened(event, "the reason")
        assert (b.change.phase, b.change.outcome, b.change.because) == (ChangePhase.ENDED, outcome, "the reason")
        b.change.happened(ChangeEvent.WATCHING)
        b.change.happened(ChangeEvent.WATCHED)
        assert (b.change.phase, b.change.outcome, b.change.because) == (ChangePhase.MEASURED, outcome, "the reason")

    bench(talking(), tmp_path, body)


def test_what_has_ended_does_not_begin_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(POLICY, "on_forbidden", transitions.reject)

    async def body(b: Bench) -> None:
        b.begin(Remove("second"))
        b.change.happened(ChangeEvent.BEGUN)
        b.change.happened(ChangeEvent.ALL_DONE)
        with pytest.raises(ForbiddenTransition, match="BEGUN must not happen in the state ENDED"):
            b.change.happened(ChangeEvent.BEGUN)

    bench(talking(), tmp_path, body)

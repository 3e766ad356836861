"""The changes of a running system, as the manager's events tell of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from msgspec import UNSET, structs

from midstride.codec.form import given
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.reports import Event, OutcomeKind
from midstride.server.view.view_forms import ChangeState, ChangeView, PastChange, StepView

# How many changes are remembered; the journal has all of them.
REMEMBERED: Final = 1_000
# What an event of a kind says of the state of the change in progress.
_STATES: Final[dict[str, ChangeState]] = {
    "verifying": "verifying",
    "plan": "executing",
    "rollback": "rolling_back",
    "measuring": "measuring",
    "outcome": "ended",
}


@dataclass(slots=True)
class _Change:
    id: str | None
    command: str
    began: float
    state: ChangeState = "planning"
    plan: PlanPreview | None = None
    index: int | None = None
    total: int | None = None
    ended: float | None = None
    steps: dict[int, StepView] = field(default_factory=dict)
    swaps: list[SwapReport] = field(default_factory=list)
    outcome: OutcomeKind | None = None
    because: str | None = None


class ChangeTracker:
    """Follows the events of one manager. One change is in progress at a time."""

    def __init__(self) -> None:
        self._command: _Change | None = None  # becomes the current change with its plan, or its refusal
        self._current: _Change | None = None
        self._past: deque[PastChange] = deque(maxlen=REMEMBERED)

    def on_event(self, event: Event) -> None:
        if event.kind == "command":
            self._command = _Change(given(event.id), event.words, event.at)
            return
        change = self._command
        if change is None:
            return
        if event.kind in {"plan", "verifying", "outcome"} and self._current is not change:
            self._retire()
            self._current = change
        if change is not self._current:
            return  # a command that is no change, as `up`
        self._take(change, event)

    def _take(self, change: _Change, event: Event) -> None:
        if change.ended is None:
            change.state = _STATES.get(event.kind, change.state)
        if event.plan is not UNSET:
            change.plan, change.total = event.plan, len(event.plan.steps)
        if event.swaps is not UNSET:
            change.swaps = event.swaps
        if event.kind == "outcome":
            change.ended, change.outcome, change.because = event.at, given(event.outcome), event.words
        elif event.index is not UNSET and event.kind == "step":
            change.index = event.index
            change.steps[event.index] = StepView(
                index=event.index, words=event.words, began=event.at, ended=None, failed=False
            )
        elif event.index is not UNSET and event.index in change.steps:
            change.steps[event.index] = structs.replace(
                change.steps[event.index], ended=event.at, failed=event.kind == "step_failed"
            )

    def _retire(self) -> None:
        if self._current is not None:
            self._past.append(_past(self._current))

    @property
    def current(self) -> ChangeView | None:
        """The change in progress, or the last one that ended."""
        change = self._current
        if change is None:
            return None
        return ChangeView(
            id=change.id,
            command=change.command,
            state=change.state,
            plan=change.plan,
            index=change.index,
            total=change.total,
            began=change.began,
            ended=change.ended,
            steps=[change.steps[index] for index in sorted(change.steps)],
            swaps=change.swaps,
            outcome=change.outcome,
            because=change.because,
        )

    def between(self, since: float, until: float) -> Iterator[PastChange]:
        """The changes that overlap the time, by their beginning."""
        current = [] if self._current is None else [_past(self._current)]
        for change in [*self._past, *current]:
            if change.began <= until and (change.ended is None or change.ended >= since):
                yield change


def _past(change: _Change) -> PastChange:
    return PastChange(
        id=change.id,
        command=change.command,
        began=change.began,
        ended=change.ended,
        outcome=change.outcome,
        because=change.because,
    )

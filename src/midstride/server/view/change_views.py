"""The changes of a running system, as the manager's events tell of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, Final

from msgspec import UNSET, convert, structs

from midstride.codec.form import given
from midstride.runtime.records.reports import Event
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


class ChangeTracker:
    """Follows the events of one manager. One change is in progress at a time."""

    def __init__(self) -> None:
        # The change in progress, or the last one that ended.
        self.current: ChangeView | None = None
        self._command: ChangeView | None = None  # becomes the current change with its plan, or its refusal
        self._past: deque[PastChange] = deque(maxlen=REMEMBERED)

    def on_event(self, event: Event) -> None:
        if event.kind == "command":
            self._command = _begun(event)
            return
        if self._command is not None and event.kind in {"plan", "verifying", "outcome"}:
            if self.current is not None:
                self._past.append(_past(self.current))
            self.current, self._command = self._command, None
        if self._command is None and self.current is not None:  # else a command that is no change, as `up`
            self.current = _after(self.current, event)

    def between(self, since: float, until: float) -> Iterator[PastChange]:
        """The changes that overlap the time, by their beginning."""
        current = [] if self.current is None else [_past(self.current)]
        for change in [*self._past, *current]:
            if change.began <= until and (change.ended is None or change.ended >= since):
                yield change


def _begun(command: Event) -> ChangeView:
    return ChangeView(
        id=given(command.id),
        command=command.words,
        state="planning",
        plan=None,
        index=None,
        total=None,
        began=command.at,
        ended=None,
        steps=[],
        swaps=[],
        outcome=None,
        because=None,
    )


def _after(change: ChangeView, event: Event) -> ChangeView:
    """The change once the event has happened."""
    differing: dict[str, Any] = {}
    if change.ended is None:
        differing["state"] = _STATES.get(event.kind, change.state)
    if event.plan is not UNSET:
        differing |= {"plan": event.plan, "total": len(event.plan.steps)}
    if event.swaps is not UNSET:
        differing["swaps"] = event.swaps
    if event.kind == "outcome":
        differing |= {"ended": event.at, "outcome": given(event.outcome), "because": event.words}
    elif event.index is not UNSET:
        steps = {step.index: step for step in change.steps}
        if event.kind == "step":
            step = StepView(index=event.index, words=event.words, began=event.at, ended=None, failed=False)
            steps[event.index], differing["index"] = step, event.index
        elif event.index in steps:
            failed = event.kind == "step_failed"
            steps[event.index] = structs.replace(steps[event.index], ended=event.at, failed=failed)
        differing["steps"] = [steps[index] for index in sorted(steps)]
    return structs.replace(change, **differing)


def _past(change: ChangeView) -> PastChange:
    return convert(change, PastChange, from_attributes=True)

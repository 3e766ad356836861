"""The phases of a change, and what leads from one to the next.

It is rolled back from the first step that fails, and also where the manager is to end. Once its steps have ended it has
an outcome, and what is left is to measure it, while the reconciler follows what happens as if no command ran.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from midstride.runtime.records.reports import OutcomeKind
from midstride.transitions import Transitions


class ChangePhase(Enum):
    PLANNED = "its plan is in the journal, and no step has begun"
    EXECUTING = "its steps are being carried out"
    ROLLING_BACK = "what has been done is being undone"
    ENDED = "no step is carried out any more"
    MEASURING = "its subscribers are watched for a while"
    MEASURED = "all that is reported of it is known"


class ChangeEvent(Enum):
    BEGUN = "the first step is about to begin"
    ALL_DONE = "every step is done"
    LEFT_OUT = "some instances could not be created, and the steps without them are for another plan"
    STEP_FAILED = "a step has failed, or the manager is to end"
    UNDONE = "every step that was done is undone"
    NOT_UNDONE = "something could not be undone"
    SUPERSEDED = "another manager has taken over, so nothing is undone"
    CALLED_OFF = "the manager is to end before the first step"
    WATCHING = "its subscribers are being watched"
    WATCHED = "they have been watched for long enough"


CHANGE_PHASES: Final = Transitions(
    {
        ChangePhase.PLANNED: {
            ChangeEvent.BEGUN: ChangePhase.EXECUTING,
            ChangeEvent.CALLED_OFF: ChangePhase.ENDED,
        },
        ChangePhase.EXECUTING: {
            ChangeEvent.ALL_DONE: ChangePhase.ENDED,
            ChangeEvent.LEFT_OUT: ChangePhase.ENDED,
            ChangeEvent.STEP_FAILED: ChangePhase.ROLLING_BACK,
            ChangeEvent.SUPERSEDED: ChangePhase.ENDED,
        },
        ChangePhase.ROLLING_BACK: {
            ChangeEvent.UNDONE: ChangePhase.ENDED,
            ChangeEvent.NOT_UNDONE: ChangePhase.ENDED,
        },
        ChangePhase.ENDED: {ChangeEvent.WATCHING: ChangePhase.MEASURING},
        ChangePhase.MEASURING: {ChangeEvent.WATCHED: ChangePhase.MEASURED},
        ChangePhase.MEASURED: {},
    }
)

# What the change is reported as, by the event that ends its steps.
OUTCOMES: Final[dict[ChangeEvent, OutcomeKind]] = {
    ChangeEvent.ALL_DONE: "done",
    ChangeEvent.LEFT_OUT: "incomplete",
    ChangeEvent.UNDONE: "rolled_back",
    ChangeEvent.CALLED_OFF: "rolled_back",
    ChangeEvent.NOT_UNDONE: "failed",
    ChangeEvent.SUPERSEDED: "failed",
}

"""The life of one side of a cut: how far its task is, and how the cut has ended here (docs/protocols/cut.md).

The two are apart because a command may give a side its outcome in any phase.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from midstride.transitions import Transitions


class CutPhase(Enum):
    """The progress of a side."""

    APPROACHING = "approaching"  # waits for T
    CROSSING = "crossing"  # T has come: the old side writes the rest, the new one its first message
    REPORTING = "reporting"  # the new side reports that message
    CONCLUDING = "concluding"  # messages from before T may still be in transit to the new side
    WATCHING = "watching"  # until nothing of the hand-over can be undone: see `watch_successor`


class CutProgress(Enum):
    """The events that take a side to its next phase."""

    DUE = "T has come, or is no longer waited for"
    DECIDED = "the new side has written, or it is known that it will not"
    CONFIRMED = "the old side knows, or cannot be reached"
    FINISHED = "nothing is left to be written that is not its own"


class CutState(Enum):
    """The result of the cut on this side; the values are those of :data:`midstride.wire.replies.CutOutcome`."""

    WAITING = "waiting"
    DONE = "done"
    RESUMED = "resumed"
    CANCELLED = "cancelled"


class CutEvent(Enum):
    """The events that give a side its outcome."""

    TAKEN_OVER = "the new side writes, and the old one does not"
    RECLAIMED = "the old side has the right to write, and writes again"
    CANCELLED = "neither side changes: the gates are as before the cut"


PHASES: Final = Transitions(
    {
        CutPhase.APPROACHING: {CutProgress.DUE: CutPhase.CROSSING},
        CutPhase.CROSSING: {
            CutProgress.DECIDED: CutPhase.REPORTING,  # of the new side
            CutProgress.FINISHED: CutPhase.WATCHING,  # of the old side
        },
        CutPhase.REPORTING: {CutProgress.CONFIRMED: CutPhase.CONCLUDING},
        CutPhase.CONCLUDING: {CutProgress.FINISHED: CutPhase.WATCHING},
        CutPhase.WATCHING: {},
    }
)

STATES: Final = Transitions(
    {
        CutState.WAITING: {
            CutEvent.TAKEN_OVER: CutState.DONE,
            CutEvent.RECLAIMED: CutState.RESUMED,
            CutEvent.CANCELLED: CutState.CANCELLED,
        },
        # The new side has given up, or its process has ended.
        CutState.DONE: {CutEvent.RECLAIMED: CutState.RESUMED, CutEvent.CANCELLED: CutState.CANCELLED},
        CutState.RESUMED: {CutEvent.CANCELLED: CutState.CANCELLED},
        CutState.CANCELLED: {CutEvent.CANCELLED: CutState.CANCELLED},
    }
)

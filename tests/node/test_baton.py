"""The slot of a hand-over with a node that does not use Midstride's API: what each side makes of the baton's word."""

from __future__ import annotations

from typing import Any

import pytest

from midstride.node.handover.baton import BatonState, BatonStep, BatonWord, SharedSlot

ME, OTHER = 1, 2


class Slot(SharedSlot):
    """A slot whose word the test sets; ``steps``: those that were taken, which change nothing but what FENCE does."""

    def __init__(self, *, joined: bool = True, **word: Any) -> None:
        fields = {"writers": 0, "state": BatonState.HELD, "successor": 0, "predecessor": 0, "generation": 1}
        self._slot, self.me, self.other, self.timed = 1 if joined else None, ME, OTHER, False
        self.now = BatonWord(**{**fields, **word})
        self.steps: list[BatonStep] = []

    def word(self) -> BatonWord:
        return self.now

    def step(self, step: BatonStep, node: int, successor: int = 0, *, at_once: bool = False) -> BatonWord:
        self.steps.append(step)
        return self.now


@pytest.mark.parametrize(
    ("slot", "reclaimed", "steps"),
    [
        (Slot(holder=ME), True, [BatonStep.FENCE]),  # it has come back, and no other node can take it any more
        (Slot(holder=OTHER), False, []),  # that may still be writing, and is not disturbed
        (Slot(holder=OTHER, joined=False), True, []),
    ],
)
def test_the_old_side_writes_again_only_once_it_has_the_baton_back(
    slot: Slot, reclaimed: bool, steps: list[BatonStep]
) -> None:
    assert slot.reclaim_freed() is reclaimed
    assert slot.steps == steps


def test_the_old_side_can_take_back_what_the_new_one_has_not_taken() -> None:
    assert Slot(holder=ME, successor=OTHER, state=BatonState.OFFERED).reclaim()
    assert not Slot(holder=OTHER).reclaim()
    assert Slot(holder=OTHER, joined=False).reclaim()


@pytest.mark.parametrize(
    ("slot", "passed_on", "settled", "refused", "admits"),
    [
        (Slot(holder=ME), False, True, False, True),
        (Slot(holder=ME, predecessor=OTHER), False, False, False, True),
        (Slot(holder=OTHER), True, True, True, False),
        (Slot(holder=OTHER, successor=ME), True, True, False, False),
        (Slot(holder=OTHER, successor=ME, state=BatonState.OFFERED), True, True, False, True),
        (Slot(holder=OTHER, predecessor=ME), True, True, True, False),
        (Slot(holder=OTHER, joined=False), False, True, True, False),
    ],
)
def test_what_the_word_says(slot: Slot, passed_on: bool, settled: bool, refused: bool, admits: bool) -> None:
    assert (slot.passed_on, slot.settled, slot.refused, slot.admits()) == (passed_on, settled, refused, admits)

"""The state of programs behind relays, where they offer it: moved at the cut, refused, and not answered for."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.foreign.foreign_state import EXPORT_STATE, IMPORT_STATE
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from tests.foreign.chat import chat
from tests.foreign.relayed import Program, SimulatedRelays, managed

TEXT = chat("relay", listener="tolerates 10 missed")
BOTH = EXPORT_STATE, IMPORT_STATE


def replaced(component: str, strategy: str = "minimal") -> PlanRequest:
    return PlanRequest(replace=(("talker", component),), strategy=strategy)


def numbers(simulator: SimulatedRelays) -> list[tuple[str, int]]:
    return [(words.split()[0], int(words.split()[1])) for _, words in simulator.heard["listener"]]


@pytest.mark.parametrize("takes", [0.0, 0.013, 0.1])
def test_what_a_program_has_counted_goes_on_at_its_successor(tmp_path: Path, takes: float) -> None:
    """Each number comes once at most, in order: the new program had others, and its messages with these are dropped."""
    programs = {name: Program(offers=BOTH, takes=takes) for name in ("Talker", "Other")} | {"Listener": Program()}

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(2)
        for number in range(4):
            await asyncio.sleep(1 + number * 0.007)  # at another phase of the old program's grid
            component = ("Other", "Talker")[number % 2]
            plan = await manager.plan(replaced(component))
            assert any("while the state of talker" in each.words for each in plan.besides)
            outcome = await manager.change(replaced(component))
            assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {}), outcome
        await asyncio.sleep(1)
        found = numbers(simulator)
        assert all(a < b for (_, a), (_, b) in pairwise(found))
        changes = [b - a for (old, a), (new, b) in pairwise(found) if old != new]
        assert len(changes) == 4
        # What the old program counts until it has exported is published by nobody, nor what the new one does meanwhile.
        assert all(1 <= left_out <= 4 + 2 * takes * 50 for left_out in changes), changes
        assert all(b == a + 1 for (old, a), (new, b) in pairwise(found) if old == new)

    managed(tmp_path, TEXT, programs, body)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (Program(offers=BOTH, refuses="of another version"), "has not imported the state: of another version"),
        (Program(offers=BOTH, mute={"talker_2"}), "the state took longer than 2 s"),
        (
            Program(),
            r"cannot import state: its node offers no service /talker_2/midstride/import_state (rcl_interfaces",
        ),
    ],
    ids=["refused", "mute", "not offered"],
)
def test_where_the_new_program_does_not_take_it_over_the_old_one_goes_on(
    tmp_path: Path, other: Program, said: str
) -> None:
    programs = {"Talker": Program(offers=BOTH), "Other": other, "Listener": Program()}

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(2)
        outcome = await manager.change(replaced("Other"))
        assert outcome.outcome == "rolled_back" and said in (outcome.because or ""), outcome
        await asyncio.sleep(1)
        found = numbers(simulator)
        assert {name for name, _ in found} == {"talker"}
        # What it has published meanwhile waited in its relay: of 100 at once, some do not fit into a queue of 10.
        assert all(a < b for (_, a), (_, b) in pairwise(found))
        if "longer" not in said:
            assert all(b == a + 1 for (_, a), (_, b) in pairwise(found))

    managed(tmp_path, TEXT, programs, body)


def test_a_program_that_does_not_answer_for_its_state_can_be_removed_without_it(tmp_path: Path) -> None:
    programs = {name: Program(offers=BOTH) for name in ("Talker", "Other")} | {"Listener": Program()}

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(2)
        outcome = await manager.change(replaced("Other", "paper"))
        assert (outcome.outcome, outcome.own_state) == ("done", {}), outcome
        await asyncio.sleep(1)
        found = numbers(simulator)
        assert all(a < b for (_, a), (_, b) in pairwise(found))
        programs["Other"].mute.add(found[-1][0])
        outcome = await manager.change(replaced("Talker", "paper"))
        assert outcome.outcome == "done" and "has not answered within" in str(outcome.own_state), outcome

    managed(tmp_path, TEXT, programs, body)

"""Whose cut is next among hand-overs of one round, and what is given up where one fails."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.runtime.handover.cut_turns import INTERVAL, CutTurn, CutTurns, GivenUp, only_turn


def never_silent() -> bool:
    return False


def begun(turn: CutTurn) -> asyncio.Future[None]:
    return asyncio.ensure_future(turn.begin(never_silent))


def test_no_cut_begins_before_all_are_ready_and_then_one_after_another() -> None:
    async def main() -> None:
        turns = CutTurns()
        first, second, third = turns.add(), turns.add(), turns.add()
        waiting = [begun(second), begun(first)]
        await asyncio.sleep(1.0)
        assert not any(each.begun for each in (first, second, third)), "the third is not ready"
        waiting.append(begun(third))
        for ready, others in [(first, (second, third)), (second, (third,)), (third, ())]:
            await asyncio.sleep(2 * INTERVAL)
            assert ready.begun and not any(each.begun for each in others)
            await asyncio.sleep(1.0)
            assert not any(each.begun for each in others), "each waits for the end of the one before"
            ready.ended = True
        await asyncio.gather(*waiting)

    run(main())


def test_one_that_has_ended_without_a_cut_keeps_nobody_waiting() -> None:
    async def main() -> None:
        turns = CutTurns()
        failed, other = turns.add(), turns.add()
        failed.ended = True
        await asyncio.wait_for(other.begin(never_silent), INTERVAL)

    run(main())


def test_one_whose_old_side_is_silent_does_not_wait_for_its_turn() -> None:
    async def main() -> None:
        turns, at = CutTurns(), asyncio.get_running_loop().time
        turns.add()
        await turns.add().begin(lambda: at() >= 0.5)
        assert at() == pytest.approx(0.5, abs=INTERVAL)
        await only_turn().begin(never_silent)
        assert at() == pytest.approx(0.5, abs=INTERVAL)

    run(main())


def test_what_waits_is_given_up_at_once_and_what_has_begun_is_not_interrupted() -> None:
    async def main() -> None:
        turns = CutTurns()
        cutting, waiting, preparing = turns.add(), turns.add(), turns.add()
        interrupted: list[str] = []

        async def work() -> str:
            try:
                await asyncio.sleep(1.0)
            except asyncio.CancelledError:
                interrupted.append("a preparation")
                raise
            return "done"

        cutting.ready = cutting.begun = True
        watching = asyncio.ensure_future(cutting.prepare(work()))
        tasks: list[asyncio.Future[Any]] = [begun(waiting), asyncio.ensure_future(preparing.prepare(work()))]
        await asyncio.sleep(0.1)
        turns.give_up()
        await asyncio.sleep(2 * INTERVAL)
        assert [type(task.exception()) for task in tasks] == [GivenUp, GivenUp]
        assert interrupted == ["a preparation"]
        assert await watching == "done"
        with pytest.raises(GivenUp):
            await turns.waiting(work())
        with pytest.raises(GivenUp):
            turns.check()

    run(main())


def test_what_a_preparation_returns_or_raises_is_passed_on() -> None:
    async def main() -> None:
        async def returning() -> int:
            return 7

        async def raising() -> None:
            raise ValueError("no discovery")

        turns = CutTurns()
        turn = turns.add()
        assert await turn.prepare(returning()) == 7
        with pytest.raises(ValueError, match="no discovery"):
            await turn.prepare(raising())
        turns.check()

    run(main())

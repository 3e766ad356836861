"""Hand-overs that are prepared at once, and cut one after another.

The long parts of a hand-over are the waits before its cut (for discovery, and for the probation of the new publisher)
and after it. Those of a round overlap. No cut begins before all are ready, so that one which cannot take over leaves
all topics as they are; each cut waits for the one before, so that the states in between are those of the sequence.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

T = TypeVar("T")

# How often a hand-over that is ready looks whether it is its turn (s).
INTERVAL: Final = 0.01


class GivenUp(Exception):
    """A hand-over is interrupted, since one beside it has failed; nothing is wrong with this one."""


@dataclass(slots=True)
class CutTurns:
    """The turns of the hand-overs of one round, in the order of the plan."""

    _turns: list[CutTurn] = field(default_factory=list)
    _given_up: asyncio.Event = field(default_factory=asyncio.Event)

    def add(self) -> CutTurn:
        """The turn after all others."""
        turn = CutTurn(self)
        self._turns.append(turn)
        return turn

    def give_up(self) -> None:
        """No further cut begins, and what only waits is interrupted."""
        self._given_up.set()

    def is_next(self, turn: CutTurn) -> bool:
        """Return whether all hand-overs are ready, or have ended, and those before ``turn`` have ended."""
        before = self._turns[: self._turns.index(turn)]
        return all(each.ended for each in before) and all(each.ready or each.ended for each in self._turns)

    def check(self) -> None:
        """Raises GivenUp."""
        if self._given_up.is_set():
            raise GivenUp

    async def waiting(self, work: Coroutine[Any, Any, T]) -> T:
        """The result of ``work``, which changes nothing. Raises what it raises, and GivenUp at once."""
        doing, giving_up = asyncio.ensure_future(work), asyncio.ensure_future(self._given_up.wait())
        try:
            await asyncio.wait({doing, giving_up}, return_when=asyncio.FIRST_COMPLETED)
            if doing.done():
                return doing.result()
        finally:
            for task in (doing, giving_up):
                task.cancel()
            await asyncio.gather(doing, giving_up, return_exceptions=True)
        raise GivenUp


@dataclass(slots=True, eq=False)
class CutTurn:
    """The turn of one hand-over: ``ready`` for its cut, which may have ``begun``, and has ``ended``.

    From the beginning of its cut on, it is not interrupted.
    """

    turns: CutTurns
    ready: bool = False
    begun: bool = False
    ended: bool = False

    async def prepare(self, work: Coroutine[Any, Any, T]) -> T:
        """The result of ``work``, which changes nothing. Raises what it raises, and GivenUp at once."""
        return await (work if self.begun else self.turns.waiting(work))

    async def begin(self, old_is_silent: Callable[[], bool]) -> None:
        """Return when it is its turn, or at once where the old side publishes nothing any more. Raises GivenUp."""
        self.ready = True
        while not self.begun:
            self.turns.check()
            if old_is_silent() or self.turns.is_next(self):
                self.begun = True
            else:
                await asyncio.sleep(INTERVAL)


def only_turn() -> CutTurn:
    """The turn of a hand-over with none beside it."""
    return CutTurns().add()

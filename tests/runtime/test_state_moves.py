"""State that moves between components without outputs: before which step, and what becomes of it in a roll-back."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from immutables import Map

from midstride.model.action import Action, Degrade, Detach, Remove, Upgrade
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.handover.state_moves import StateMoves
from midstride.wire.commands import MuteCommand, PrepareStateCommand
from midstride.wire.replies import StateOffer
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import LISTENER, REFUSED, Bench, bench, instance, talking

NEW = instance("listener_2", LISTENER, "listener")
CONFIGURATION = talking().with_instance(NEW)
UPGRADE = Upgrade(Map({work("listener_2"): 0}))
REMOVE = Remove("listener")


class Moves:
    """The moves of one change, and what they have led to."""

    def __init__(self, b: Bench, exports: str = "whole") -> None:
        self.moved: list[tuple[str, str]] = []
        self.kept: list[tuple[str, str, str]] = []
        b.client.reply("listener_2", PrepareStateCommand, StateOffer(exports=exports))  # type: ignore[arg-type]
        b.client.reply("listener", PrepareStateCommand, StateOffer(exports=exports))  # type: ignore[arg-type]
        self.moves = StateMoves(
            b.client, self._move, lambda *words: self.kept.append(words), {"listener_2": "listener"}
        )
        self.live = set(b.configuration.instances)

    async def _move(self, old: str, new: str) -> None:
        self.moved.append((old, new))

    async def before(self, *actions: Action) -> None:
        for action in actions:
            await self.moves.before(action, self.live)


def on_bench(folder: Path, body: Callable[[Bench], Awaitable[None]]) -> None:
    async def main(b: Bench) -> None:
        await body(b)

    bench(CONFIGURATION, folder, main)


@pytest.mark.parametrize(
    "step", [REMOVE, Degrade(Map({work("listener"): 1})), Detach(build.port("listener.in"), "/chatter")]
)
def test_the_state_moves_before_anything_is_taken_from_the_old_one(step: Action, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        moves = Moves(b)
        await moves.before(UPGRADE, UPGRADE)
        assert [each.instance for each in b.client.sent if isinstance(each.command, MuteCommand)] == ["listener_2"]
        assert moves.moved == []
        await moves.before(Remove("talker"))
        assert moves.moved == [], "that concerns another one"
        await moves.before(step, step)
        assert moves.moved == [("listener", "listener_2")] and moves.kept == [], "once"

    on_bench(tmp_path, body)


def test_a_roll_back_moves_it_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        moves = Moves(b)
        await moves.before(UPGRADE, REMOVE, Remove("listener_2"))
        assert moves.moved == [("listener", "listener_2"), ("listener_2", "listener")]

    on_bench(tmp_path, body)


def test_nothing_moves_where_the_old_one_has_no_state(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        moves = Moves(b, exports="nothing")
        await moves.before(UPGRADE, REMOVE)
        assert (moves.moved, moves.kept, b.client.of(MuteCommand)) == ([], [], [])

    on_bench(tmp_path, body)


def test_where_it_cannot_be_had_the_new_one_keeps_its_own_and_that_is_said(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        moves = Moves(b)
        b.client.reply("listener_2", PrepareStateCommand, REFUSED)
        await moves.before(UPGRADE, REMOVE)
        assert (moves.moved, moves.kept) == ([], [("listener", "listener_2", str(REFUSED))])

    on_bench(tmp_path, body)


def test_an_old_one_that_exits_meanwhile_leaves_none(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        moves = Moves(b)
        await moves.before(UPGRADE)
        b.system.life.exited(Exited("listener", -9))
        await moves.before(REMOVE)
        because = "listener exited or hangs, so it could not export its state"
        assert (moves.moved, moves.kept) == ([], [("listener", "listener_2", because)])
        again, asked = Moves(b), len(b.client.of(PrepareStateCommand))
        await again.before(UPGRADE)
        assert (again.moved, again.kept) == ([], [])
        assert len(b.client.of(PrepareStateCommand)) == asked, "it is not asked any more"

    on_bench(tmp_path, body)


def test_one_that_does_not_run_yet_or_any_more_is_left_alone(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        for missing in ("listener", "listener_2"):
            moves = Moves(b)
            moves.live.discard(missing)
            await moves.before(UPGRADE, REMOVE)
            assert (moves.moved, moves.kept, b.client.of(MuteCommand)) == ([], [], [])

    on_bench(tmp_path, body)

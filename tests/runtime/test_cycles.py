"""Functionalities that support each other in a cycle change their modes in one step, at one moment."""

from __future__ import annotations

from pathlib import Path

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from tests.runtime.cyclic import check_both_ways, check_members_replaced, cyclic
from tests.runtime.systems import managed


def test_a_cycle_is_degraded_and_upgraded_at_one_moment_although_calls_are_under_way(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def body(manager: Manager, _: Simulator) -> None:
        await check_both_ways(manager, specification, within=0.01)  # a call takes 0.3 s or more

    managed("", tmp_path, body, specification=specification, directory=tmp_path / "programs")


def test_a_member_of_a_cycle_is_replaced_while_the_other_relies_on_it(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def body(manager: Manager, _: Simulator) -> None:
        await check_members_replaced(manager)

    managed("", tmp_path, body, specification=specification, directory=tmp_path / "programs")

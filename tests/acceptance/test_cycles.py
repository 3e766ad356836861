"""Functionalities of two processes that support each other in a cycle, on ROS 2: they change their modes at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.acceptance.support import ended, managed
from tests.backends.ros2_support import run
from tests.runtime.cyclic import check_both_ways, check_members_replaced, cyclic

pytestmark = [pytest.mark.ros2, pytest.mark.full]


def test_a_cycle_comes_up_and_is_degraded_and_upgraded_in_one_step(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def main() -> None:
        async with managed(tmp_path / "system", specification, tmp_path / "programs") as (manager, _):
            await check_both_ways(manager, specification, within=1.0)

    with ended():
        run(main())


@pytest.mark.long
def test_a_member_is_replaced_while_the_other_relies_on_it(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def main() -> None:
        async with managed(tmp_path / "system", specification, tmp_path / "programs") as (manager, _):
            await check_members_replaced(manager)

    with ended():
        run(main())

"""Nodes without Midstride's API, replaced by others of every kind on real ROS 2 while a bare recorder listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.acceptance.foreign_support import robot, talkers
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.timeout(240)]


def test_a_node_in_c_replaces_one_in_rclpy_and_the_other_way_round(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(talkers(tmp_path), tmp_path) as system:
            await system.replaced("Native")
            await system.replaced("Plain")
            assert system.changes() == [("talker", "talker_2"), ("talker_2", "talker_3")]
            assert system.holes() == []

    with ended():
        run(scenario(), 200)


@pytest.mark.parametrize(("first", "kinds"), [("Plain", ("Ours", "Plain")), ("Ours", ("Native", "Ours"))])
def test_a_node_hands_over_to_a_component_and_back(tmp_path: Path, first: str, kinds: tuple[str, str]) -> None:
    # Of the first node, which has the role's name, the component must not think that it is foreign.
    timing = "timing { watch_after 5 s }" if first == "Plain" else ""

    async def scenario() -> None:
        async with robot(talkers(tmp_path, first, timing=timing), tmp_path) as system:
            await system.replaced(kinds[0])
            await system.another_manager()
            await system.replaced(kinds[1])
            assert system.changes() == [("talker", "talker_2"), ("talker_2", "talker_3")]
            assert system.holes() == []
            assert (await system.manager.status()).valid

    with ended():
        run(scenario(), 200)

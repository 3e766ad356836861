"""Nodes in plain rclpy and in C behind relays replace each other, and others, while a bare recorder listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import OURS, declared_talker, programs_of_the_page, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.native import compiled

pytestmark = [pytest.mark.ros2, pytest.mark.full]


def test_a_relayed_node_is_replaced(tmp_path: Path) -> None:
    programs_of_the_page(tmp_path)
    (tmp_path / "ours.py").write_text(OURS, encoding="utf-8")
    compiled(tmp_path)
    text = "system swaps\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Plain", "python3 talker.py", "preload")
    text += declared_talker("Relayed", "python3 talker.py", "relay")
    text += declared_talker("Other", "python3 ./talker.py", "relay")
    text += declared_talker("Native", "./c_talker 20000000 chatter", "relay")
    text += declared_talker("Ours", "python3 ours.py")
    path = tmp_path / "swaps.stride"
    path.write_text(f"{text}node talker : Relayed {{ out -> /chat }}\n", encoding="utf-8")
    components = ("Other", "Plain", "Native", "Ours", "Relayed")

    async def scenario() -> None:
        async with robot(load(path).require(), tmp_path) as made:
            for component in components:
                await made.replaced(component)
                if component in ("Other", "Native"):  # relayed programs go on without a manager
                    await made.another_manager()
            made.require_changes(len(components))
            assert made.holes() == []
            status = await made.manager.status()
            assert status.valid, status

    with ended():
        run(scenario())

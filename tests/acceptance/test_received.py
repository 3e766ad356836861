"""What the report of a change says of a subscriber without Midstride's API, beside what that has noted itself."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import robot, talkers
from tests.acceptance.support import ended
from tests.backends.ros2_support import messages_are_numbered, run

LISTENER = """
import time
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node, log = Node("listener"), open("heard.txt", "a", buffering=1)
node.create_subscription(String, "chatter", lambda message: print(time.monotonic(), message.data, file=log), 10)
rclpy.spin(node)
"""
DECLARED = """
component Listener {
  run "python3 noting.py" gate preload
  input in : std_msgs/msg/String @ 50 Hz as chatter
  functionality listen {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}
node listener : Listener { in <- /chat }
"""
pytestmark = [pytest.mark.ros2, pytest.mark.long]


def test_the_figures_of_a_reader_with_a_gate_are_those_that_it_has_noted(tmp_path: Path) -> None:
    talkers(tmp_path)
    (tmp_path / "noting.py").write_text(LISTENER, encoding="utf-8")
    path = tmp_path / "swaps.stride"
    path.write_text(path.read_text(encoding="utf-8") + DECLARED, encoding="utf-8")

    def heard() -> list[tuple[float, str, int]]:
        lines = (tmp_path / "heard.txt").read_text(encoding="utf-8").splitlines()
        found = (line.split() for line in lines if line.count(" ") == 2)
        return [(float(at), name, int(number)) for at, name, number in found]

    async def scenario() -> None:
        async with robot(load(path).require(), tmp_path) as system:
            for component in ("Native", "Plain", "Native"):
                before = len(heard())
                report = await system.change(component)
                assert report.outcome == "done", report.because
                [swap] = [each for each in report.swaps if each.subscriber == "listener.in"]
                rows = heard()[before:]
                gap = max(later - earlier for (earlier, *_), (later, *_) in pairwise(rows))
                lost = sum(
                    number - last - 1
                    for name in {name for _, name, _ in rows}
                    for last, number in pairwise([number for _, each, number in rows if each == name])
                )
                print(component, swap, f"own gap {gap * 1000:.1f} ms, {lost} lost")
                assert swap.gap == pytest.approx(gap, abs=0.01)
                assert (swap.missed, swap.lost, swap.duplicates) == (0, lost if messages_are_numbered() else None, 0)

    with ended():
        run(scenario())

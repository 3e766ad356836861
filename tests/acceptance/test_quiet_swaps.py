"""On ROS 2, nodes that answer messages are replaced while there are none, and answer all that come afterwards."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import Robot, manager_of
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

PLAIN = """
import os
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("filter")
publisher = node.create_publisher(String, "out", 100)
answer = lambda said: publisher.publish(String(data=f"{os.environ['MIDSTRIDE_INSTANCE']} {said.data}"))
node.create_subscription(String, "in", answer, 100)
rclpy.spin(node)
"""
OURS = """
import os

from midstride import Component
from std_msgs.msg import String

comp = Component("Ours")
inlet = comp.create_input("in", String, qos=100)
out = comp.create_output("out", String, qos=100)
answer = comp.create_functionality("answer", inputs=[inlet], outputs=[out])
name = os.environ["MIDSTRIDE_INSTANCE"]

def heard(message):
    out.write(String(data=f"{name} {message.data}"))

answer.set_normal_mode(heard, inputs=[inlet], outputs=[out], guarantees=RATES)
answer.set_degraded_mode(lambda: None)
comp.start()
"""
SYSTEM = """system quiet
topic /ticks : std_msgs/msg/String
topic /chat : std_msgs/msg/String RATE
component Plain {
  run "python3 plain.py" gate preload
  input in : std_msgs/msg/String
  output out
  functionality answer {
    uses in
    produces out
    mode normal { assume in   guarantee out : std_msgs/msg/String RATE }
    mode degraded { }
  }
}
component Ours {
  run "python3 ours.py"
  input in : std_msgs/msg/String
  output out
  functionality answer {
    uses in
    produces out
    mode normal { assume in   guarantee out : std_msgs/msg/String RATE }
    mode degraded { }
  }
}
environment { guarantee ticks on /ticks : std_msgs/msg/String }
node talker : Plain { in <- /ticks   out -> /chat }
"""

pytestmark = [pytest.mark.ros2, pytest.mark.full]


@pytest.mark.parametrize(("rate", "kinds"), [("@ 20 Hz", ("Ours", "Plain")), ("", ("Plain", "Ours", "Ours"))])
def test_a_node_that_answers_messages_is_replaced_while_there_are_none(
    rate: str, kinds: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "plain.py").write_text(PLAIN, encoding="utf-8")
    (tmp_path / "ours.py").write_text(OURS.replace("RATES", "{out: 20}" if rate else "None"), encoding="utf-8")
    (tmp_path / "quiet.stride").write_text(SYSTEM.replace(" RATE", f" {rate}" if rate else ""), encoding="utf-8")
    specification = load(tmp_path / "quiet.stride").require()

    async def scenario(bare: Bare) -> None:
        from std_msgs.msg import String

        (tmp_path / "system").mkdir()
        manager = manager_of(specification, tmp_path)
        system = Robot(tmp_path, manager, bare)
        bare.node.create_subscription(String, "/chat", system.hear, 100)
        ticks = bare.node.create_publisher(String, "/ticks", 100)
        sent: list[int] = []

        known: set[bytes] = set()

        def new_reader_is_matched() -> bool:
            """The reader of an instance that has ended may stay for the lease of the middleware, 20 s."""
            readers = {bytes(each.endpoint_gid) for each in bare.node.get_subscriptions_info_by_topic("/ticks")}
            if not readers - known or ticks.get_subscription_count() != len(readers):
                return False
            known.update(readers)
            return True

        async def speaks() -> None:
            await bare.until(new_reader_is_matched)
            for _ in range(5):
                sent.append(len(sent) + 1)
                ticks.publish(String(data=str(sent[-1])))
                await bare.until(lambda: bool(system.heard) and system.heard[-1][2] == sent[-1])

        try:
            await system.meanwhile(manager.up())
            await speaks()
            for kind in kinds:
                outcome = await system.change(kind)
                assert (outcome.outcome, outcome.because) == ("done", None), outcome.because
                notes = [event.words for event in manager.log() if event.kind == "note"]
                assert "without a message: neither writes any" in " ".join(notes)
                await speaks()
        finally:
            await manager.down()
            await manager.close()
        assert [number for _, _, number in system.heard] == sent
        names = ["talker", "talker_2", "talker_3", "talker_2"][: len(kinds) + 1]
        assert system.changes() == list(pairwise(names))

    with ended(), Bare("recorder") as bare:
        run(scenario(bare))

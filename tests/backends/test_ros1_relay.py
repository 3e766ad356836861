"""Unmodified nodes of ROS 1 behind relays: rospy talkers replace each other and a component, and are measured."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.backends.ros1 import create_backend
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.backends.ros1_support import own_master_uri, program, wait_for
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros1, pytest.mark.full, pytest.mark.timeout(180)]

TALKER = """
import rospy
from std_msgs.msg import String

rospy.init_node("talker")
out = rospy.Publisher("chatter", String, queue_size=10)
count, rate = 0, rospy.Rate(50)
while not rospy.is_shutdown():
    count += 1
    out.publish(f"{rospy.get_name()} {count} {rospy.get_param('~word')}")
    rate.sleep()
"""
OURS = """
from midstride import Component
from std_msgs.msg import String

comp = Component("ours")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    count += 1
    out.write(String(data=f"/{comp.instance} {count} ours"))

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
TEXT = """system chat

topic /chat : std_msgs/msg/String @ 50 Hz

component Talker {
  run "python3 talker.py" gate relay
  parameters { word = "hello" }
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

component Other like Talker { run "python3 ./talker.py" gate relay }

component Ours {
  run "python3 ours.py"
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

node talker : Talker { out -> /chat }
"""


def test_rospy_talkers_replace_each_other_and_a_component(tmp_path: Path) -> None:
    (tmp_path / "talker.py").write_text(TALKER, encoding="utf-8")
    (tmp_path / "ours.py").write_text(OURS, encoding="utf-8")
    (tmp_path / "chat.stride").write_text(TEXT, encoding="utf-8")
    (tmp_path / "system").mkdir()
    heard = tmp_path / "heard"

    async def scenario() -> None:
        workspace = Workspace(tmp_path / "system")
        backend = create_backend(tmp_path / "components", logs=tmp_path / "logs")
        manager = Manager(load(tmp_path / "chat.stride").require(), backend, workspace, tmp_path)
        await manager.up()
        try:
            with program("recorder", "/chat", str(heard)):
                await asyncio.to_thread(wait_for, heard, 50)
                for component in ("Other", "Ours", "Talker"):
                    outcome = await manager.change(PlanRequest(replace=(("talker", component),)))
                    assert (outcome.outcome, outcome.because) == ("done", None)
                    lines = len(heard.read_text().splitlines())
                    await asyncio.to_thread(wait_for, heard, lines + 20)
            status = await manager.status()
            assert status.valid, status
        finally:
            await manager.down()
            await manager.close()

    with own_master_uri():
        run(scenario(), 170)
    found = [(words[0], int(words[1])) for words in map(str.split, heard.read_text().splitlines())]
    writers = [old for (old, _), (new, _) in pairwise(found) if old != new] + [found[-1][0]]
    assert writers == ["/talker", "/talker_2", "/talker_3", "/talker_2"], writers
    assert {words for line in heard.read_text().splitlines() for words in line.split()[2:]} == {"hello", "ours"}
    # One that has the topic writes all of its messages, and after the change none.
    assert all(number == last + 1 for (before, last), (writer, number) in pairwise(found) if before == writer)

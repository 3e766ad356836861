"""Nodes of ROS 1 behind relays that are not as the talkers of test_ros1_relay.py: one that everyone uses, and one that
takes no notice of its names."""

from __future__ import annotations

import asyncio
import time
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from tests.backends.ros1_support import program, wait_for
from tests.backends.ros2_support import until, until_async
from tests.backends.test_ros1_relay import TEXT, system

ROBOT_STATE_PUBLISHER = Path("/usr/lib/robot_state_publisher/robot_state_publisher")
pytestmark = [pytest.mark.ros1, pytest.mark.full]

JOINTS = """
import rospy
from sensor_msgs.msg import JointState

rospy.init_node("joints")
out = rospy.Publisher("joint_states", JointState, queue_size=10)
rate = rospy.Rate(50)
while not rospy.is_shutdown():
    message = JointState(name=["elbow"], position=[0.5])
    message.header.stamp = rospy.Time.now()
    out.publish(message)
    rate.sleep()
"""
URDF = (
    "<robot name='arm'><link name='upper'/><link name='lower'/><link name='hand'/>"
    "<joint name='elbow' type='continuous'><parent link='upper'/><child link='lower'/><axis xyz='0 0 1'/></joint>"
    "<joint name='wrist' type='fixed'><parent link='lower'/><child link='hand'/></joint></robot>"
)
# It reads a parameter that belongs to no node, and that someone sets before.
DESCRIBE = f"""
import os, sys, rosgraph
rosgraph.Master("/describe").setParam("/robot_description", {URDF!r})
os.execv({str(ROBOT_STATE_PUBLISHER)!r}, [{str(ROBOT_STATE_PUBLISHER)!r}, *sys.argv[1:]])
"""
ARM = f"""system arm

topic /joint_states : sensor_msgs/msg/JointState @ 50 Hz
topic /tf           : tf2_msgs/msg/TFMessage @ 40 Hz
topic /tf_static    : tf2_msgs/msg/TFMessage qos(durability = transient_local)

component Joints {{
  run "python3 joints.py" gate relay
  output out as joint_states
  functionality measure {{
    produces out
    mode normal {{ guarantee out : sensor_msgs/msg/JointState @ 50 Hz }}
    mode degraded {{ }}
  }}
}}

component States {{
  run "python3 describe.py" gate relay
  parameters {{ publish_frequency = 200.0 }}
  input joints : sensor_msgs/msg/JointState @ 50 Hz as joint_states
  output moving as /tf
  output fixed as /tf_static
  functionality compute {{
    uses joints
    produces moving, fixed
    mode normal {{
      assume joints
      guarantee moving : tf2_msgs/msg/TFMessage @ 40 Hz
      guarantee fixed  : tf2_msgs/msg/TFMessage qos(durability = transient_local)
    }}
    mode degraded {{ }}
  }}
}}

component Other like States {{
  run "{ROBOT_STATE_PUBLISHER}" gate relay
}}

node joints : Joints {{ out -> /joint_states }}
node states : States {{ joints <- /joint_states  moving -> /tf  fixed -> /tf_static }}
"""
RECORDER = """
import sys, rospy
from tf2_msgs.msg import TFMessage
rospy.init_node(sys.argv[1])
heard = open(sys.argv[3], "a", buffering=1)

def hear(message):
    frames = ",".join(each.child_frame_id for each in message.transforms)
    heard.write(f"{message._connection_header['callerid']} {frames}" + chr(10))

rospy.Subscriber(sys.argv[2], TFMessage, hear, tcp_nodelay=True)
rospy.spin()
"""


@pytest.mark.skipif(not ROBOT_STATE_PUBLISHER.exists(), reason="needs Debian's ros-robot-state-publisher")
def test_robot_state_publisher_is_started_watched_and_replaced(tmp_path: Path) -> None:
    """In roscpp, with a parameter, an output with a rate, and one that is written once."""
    moving, fixed = tmp_path / "moving", tmp_path / "fixed"

    async def body(manager: Manager) -> None:
        with program("moving", "/tf", str(moving), source=RECORDER):
            await asyncio.to_thread(wait_for, moving, 50)
            outcome = await manager.change(PlanRequest(replace=(("states", "Other"),)))
            assert (outcome.outcome, outcome.because) == ("done", None)
            lines = len(moving.read_text().splitlines())
            await asyncio.to_thread(wait_for, moving, lines + 50)
            with program("fixed", "/tf_static", str(fixed), source=RECORDER):  # late, as what is latched is there for
                await asyncio.to_thread(wait_for, fixed, 1)
            await until_async(lambda: measured(manager), 60)
        status = await manager.status()
        assert status.valid, status

    async def measured(manager: Manager) -> bool:
        seen = (await manager.peek("states_2")).ports["moving"]["/tf"].measured
        return seen is not None and (seen.rate or 0.0) > 25

    (tmp_path / "joints.py").write_text(JOINTS, encoding="utf-8")
    (tmp_path / "describe.py").write_text(DESCRIBE, encoding="utf-8")
    system(tmp_path, ARM, body)
    heard = moving.read_text().splitlines()
    assert {line.split()[1] for line in heard} == {"lower"}
    writers = [line.split()[0] for line in heard]
    changes = [(old, new) for old, new in pairwise(writers) if old != new]
    assert changes == [("/states_relay", "/states_2_relay")]
    assert fixed.read_text().splitlines() == ["/states_2_relay hand"]


DEAF = """
import sys, time
import rospy
from std_msgs.msg import String

rospy.init_node(sys.argv[1].split(":=")[1], argv=[])
if sys.argv[2] == "later":
    time.sleep(3)
out = rospy.Publisher("chatter", String, queue_size=10)
while not rospy.is_shutdown():
    out.publish("deaf")
    time.sleep(0.02)
"""


def test_a_program_that_takes_no_notice_of_remappings_is_noticed(tmp_path: Path) -> None:
    """When it advertises: at its start it is not let in; later, when its relay has registered, it is ended."""
    (tmp_path / "deaf.py").write_text(DEAF, encoding="utf-8")
    # Its name comes last of what it is given.
    shell = "sh -c 'for name; do :; done; exec python3 deaf.py $name WHEN' deaf"
    text = TEXT
    for component, when in (("Deaf", "at_once"), ("Later", "later")):
        text += f'component {component} like Talker {{ run "{shell.replace("WHEN", when)}" gate relay }}\n'

    async def body(manager: Manager) -> None:
        begun = time.monotonic()
        outcome = await manager.change(PlanRequest(replace=(("talker", "Deaf"),)))
        assert outcome.outcome == "rolled_back"
        assert "node /talker_2 publishes on /chatter itself, for output out of Deaf" in str(outcome.because)
        print(f"refused after {time.monotonic() - begun:.1f} s")
        change = asyncio.ensure_future(manager.change(PlanRequest(replace=(("talker", "Later"),))))
        outcome = await change
        assert outcome.outcome == "rolled_back"
        logs = "".join(path.read_text(encoding="utf-8") for path in (tmp_path / "logs").rglob("*") if path.is_file())
        assert "publishes on /chatter itself, for output out of Later" in logs
        await until(lambda: set(manager.configuration.instances) == {"talker"})
        assert (await manager.status()).valid

    system(tmp_path, text, body)

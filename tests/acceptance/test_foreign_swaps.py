"""Nodes without Midstride's API, replaced by others of every kind on real ROS 2 while a bare recorder listens."""

from __future__ import annotations

import re
from itertools import chain, pairwise
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import OURS, Robot, declared_talker, robot, talkers
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

# What is not let in: a program, in plain rclpy, that differs from the talker in one way.
FAULTY = """
import os, sys, time
import rclpy
from rclpy.node import Node
from std_msgs.msg import Int32, String

kind = sys.argv[1]
rclpy.init()
node, instance = Node("talker"), os.environ["MIDSTRIDE_INSTANCE"]
publisher = node.create_publisher(Int32 if kind == "type" else String, "chatter", 10)
count = 0

def talk():
    global count
    count += 1
    if kind == "dies" and publisher.get_subscription_count():
        sys.exit(7)
    if kind == "hangs" and count > 10:
        time.sleep(1000)
    publisher.publish(Int32(data=count) if kind == "type" else String(data=f"{instance} {count}"))

node.create_timer(0.04 if kind == "half" else 0.02, talk)
rclpy.spin(node)
"""
REASONS = {
    "dies": "talker_2 ",
    "hangs": "has written nothing|wrote at 0 Hz",  # whether its first messages were counted is chance
    "type": "node /talker publishes std_msgs/msg/Int32 on /chat, and output out of Type is declared as std_msgs",
    "qos": "node /talker publishes on /chat with reliable, volatile, and output out of Qos is declared with",
}

# Two outputs with a rate, and one that is written at the start only; with the API, and without.
SEVERAL_PLAIN = """
import os
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node, instance = Node("several"), os.environ["MIDSTRIDE_INSTANCE"]
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
counts = {"fast": 0, "slow": 0}
publishers = {name: node.create_publisher(String, name, 10) for name in counts}
once = node.create_publisher(String, "once", latched)

def talk(name):
    counts[name] += 1
    publishers[name].publish(String(data=f"{instance} {counts[name]}"))

for number in (1, 2, 3):  # as what broadcasts static transforms
    once.publish(String(data=f"{instance} {number}"))
node.create_timer(0.02, lambda: talk("fast"))
node.create_timer(0.05, lambda: talk("slow"))
rclpy.spin(node)
"""
SEVERAL_OURS = """
import os

from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("Ours")
name = os.environ["MIDSTRIDE_INSTANCE"]
counts = {"fast": 0, "slow": 0}

def functionality(port, rate):
    output = comp.create_output(port, String)
    def talk():
        counts[port] += 1
        output.write(String(data=f"{name} {counts[port]}"))
    made = comp.create_functionality(f"talk_{port}", outputs=[output])
    made.set_normal_mode(talk, rate=rate, outputs=[output])
    made.set_degraded_mode(lambda: None)

functionality("fast", 50)
functionality("slow", 20)
once = comp.create_output("once", String, qos=QoS(durability="transient_local"))
latch = comp.create_functionality("latch", outputs=[once])
latch.set_normal_mode(lambda: once.write(String(data=f"{name} 1")), outputs=[once])
latch.set_degraded_mode(lambda: None)
comp.start()
"""
SEVERAL = """system several
topic /fast : std_msgs/msg/String @ 50 Hz
topic /slow : std_msgs/msg/String @ 20 Hz
topic /once : std_msgs/msg/String qos(durability = transient_local)

component Plain {
  run "python3 plain.py" gate preload
  output fast
  output slow
  output once
  functionality talk_fast {
    produces fast
    mode normal { guarantee fast : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
  functionality talk_slow {
    produces slow
    mode normal { guarantee slow : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
  functionality latch {
    produces once
    mode normal { guarantee once : std_msgs/msg/String qos(durability = transient_local) }
    mode degraded { }
  }
}
"""

pytestmark = [pytest.mark.ros2, pytest.mark.full]


def test_a_node_in_c_replaces_one_in_rclpy_and_the_other_way_round(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(talkers(tmp_path), tmp_path) as system:
            await system.replaced("Native")
            await system.replaced("Plain")
            assert system.changes() == [("talker", "talker_2"), ("talker_2", "talker_3")]
            assert system.holes() == []

    with ended():
        run(scenario())


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
        run(scenario())


def test_a_node_that_is_not_what_was_declared_is_not_let_in(tmp_path: Path) -> None:
    """It dies or hangs behind its gate, or has another type or QoS: the old one never stops."""
    specification = talkers(tmp_path, timing="timing { probation 1 s  probation_timeout 2 s }")
    (tmp_path / "faulty.py").write_text(FAULTY, encoding="utf-8")
    text = (tmp_path / "swaps.stride").read_text(encoding="utf-8")
    for kind in REASONS:
        words = declared_talker(kind.capitalize(), f"python3 faulty.py {kind}", "preload")
        text += words if kind != "qos" else words.replace("50 Hz", "50 Hz qos(durability = transient_local)")
    (tmp_path / "swaps.stride").write_text(text, encoding="utf-8")
    specification = load(tmp_path / "swaps.stride").require()

    async def scenario() -> None:
        async with robot(specification, tmp_path) as system:
            for kind, reason in REASONS.items():
                outcome = await system.change(kind.capitalize())
                assert outcome.outcome == "rolled_back", (kind, outcome)
                assert re.search(reason, outcome.because or ""), (kind, outcome.because)
                await system.hears()
            assert {name for _, name, _ in system.heard} == {"talker"}
            assert system.holes() == []
            assert (await system.manager.status()).valid

    with ended():
        run(scenario())


def test_a_node_or_a_component_below_its_rate_is_not_let_in_by_default(tmp_path: Path) -> None:
    """A node at half its rate, and code with the API that writes in each third of its calls."""
    talkers(tmp_path, timing="timing { probation_timeout 2 s }")
    (tmp_path / "faulty.py").write_text(FAULTY, encoding="utf-8")
    third = OURS.replace("    out.write", "    if count % 3 == 0:\n        out.write")
    assert third != OURS
    (tmp_path / "third.py").write_text(third, encoding="utf-8")
    slow = declared_talker("Half", "python3 faulty.py half", "preload") + declared_talker("Third", "python3 third.py")
    path = tmp_path / "swaps.stride"
    path.write_text(path.read_text(encoding="utf-8") + slow, encoding="utf-8")

    async def scenario() -> None:
        async with robot(load(path).require(), tmp_path) as system:
            for kind in ("Half", "Third"):
                outcome = await system.change(kind)
                assert outcome.outcome == "rolled_back", (kind, outcome)
                assert "talker_2.out does not keep the 50 Hz" in (outcome.because or "")
                assert "(talker.out wrote at " in (outcome.because or "")
                await system.hears()
            assert system.changes() == [] and system.holes() == []

    with ended():
        run(scenario())


def test_several_outputs_change_together_and_what_is_written_once_is_written_at_the_change(tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(SEVERAL_PLAIN, encoding="utf-8")
    (tmp_path / "ours.py").write_text(SEVERAL_OURS, encoding="utf-8")
    ours = SEVERAL[SEVERAL.index("component") :].replace("component Plain", "component Ours")
    ours = ours.replace('"python3 plain.py" gate preload', '"python3 ours.py"')
    attached = "node talker : Plain { fast -> /fast, slow -> /slow, once -> /once }\n"
    (tmp_path / "several.stride").write_text(SEVERAL + ours + attached, encoding="utf-8")

    async def scenario() -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        once: list[str] = []
        async with robot(load(tmp_path / "several.stride").require(), tmp_path, "/fast") as system:
            slow = Robot(system.folder, system.manager, system.bare)
            system.bare.node.create_subscription(String, "/slow", slow.hear, 1000)
            system.bare.node.create_subscription(String, "/once", lambda said: once.append(said.data), latched)
            await slow.hears()
            names = ["talker", "talker_2", "talker_3", "talker_2"]
            written = [[f"{name} {number}" for number in ((1,) if name == "talker_3" else (1, 2, 3))] for name in names]
            await system.bare.until(lambda: once == written[0])
            for number, component in enumerate(("Plain", "Ours", "Plain"), 1):
                await system.replaced(component)
                await slow.hears()
                await system.bare.until(lambda last=written[number][-1]: once[-1] == last)  # type: ignore[misc]
            assert once == list(chain(*written))
            late: list[str] = []
            system.bare.node.create_subscription(String, "/once", lambda said: late.append(said.data), latched)
            await system.bare.until(lambda: late == written[-1])
            for heard in (system, slow):
                assert heard.changes() == list(pairwise(names))
                assert heard.holes() == []

    with ended():
        run(scenario())

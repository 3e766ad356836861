"""Nodes that move between two hosts, over SSH and real ROS 2: what a bare recorder on each host has heard."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest

from tests.hosts.counting import Heard, counting
from tests.hosts.robots import Robot

pytestmark = [pytest.mark.ros2]
# How often the node moves in the tests that are `long`: 20 or more for a measurement.
MOVES = int(os.environ.get("MIDSTRIDE_MOVES", "20"))
# At how many moments of a move the link is cut, every 0.1 s.
CUTS = int(os.environ.get("MIDSTRIDE_CUTS", "8"))


@dataclass
class Moving:
    """A robot with a node that counts, and the recorders on its hosts."""

    robot: Robot
    heard: dict[str, Heard] = field(default_factory=dict)

    def move(self, host: str) -> None:
        done = self.robot("replace", "counter", "--on", host, "--yes", "--json")
        assert done.status == 0 and done.json["outcome"] == "done", done.out + done.err + self.robot("log").out

    def delay(self, *netem: str) -> None:
        """Have packets between the two hosts delayed, or lost, both ways."""
        for name in (self.robot.hosts.near, self.robot.hosts.far):
            words = ["tc", "qdisc", "add", "dev", "cable", "root", "netem", *netem]
            done = subprocess.run(["ip", "netns", "exec", name, *words], capture_output=True, text=True)
            if "qdisc kind is unknown" in done.stderr:
                pytest.skip("this kernel has no netem")
            assert done.returncode == 0, done.stderr


@pytest.fixture
def moving(tmp_path: Path) -> Iterator[Moving]:
    """The system runs, and both recorders hear it."""
    with counting(tmp_path) as (robot, heard):
        yield Moving(robot, heard)


def require_whole(moving: Moving, moves: int) -> list[float]:
    """Require that each recorder has heard each number once and in order; the gaps at the moves, in periods."""
    time.sleep(0.5)  # of what is on its way
    gaps = []
    for heard in moving.heard.values():
        heard.read().require_each_once_and_in_order()
        assert len(heard.gaps) == moves
        gaps += heard.gaps
    return sorted(gaps)


@pytest.mark.full
@pytest.mark.timeout(120)
def test_a_node_moves_to_another_host_and_back_and_each_host_hears_each_message_once(moving: Moving) -> None:
    plan = moving.robot("plan", "--on", "counter=arm")
    assert "counter moves from the host of the manager to host arm" in plan.out, plan.out
    moving.move("arm")
    assert moving.robot.instance("counter")["host"] == "arm"
    moving.move("manager")
    assert moving.robot.instance("counter")["host"] is None
    require_whole(moving, moves=2)


@pytest.mark.long
@pytest.mark.timeout(60 + 15 * MOVES)
@pytest.mark.parametrize("netem", ["", "delay 5ms 2ms loss 0.5%"])
def test_a_node_moves_there_and_back_again_and_again(moving: Moving, netem: str) -> None:
    if netem:
        moving.delay(*netem.split())
    for number in range(MOVES):
        moving.move("manager" if number % 2 else "arm")
    gaps = require_whole(moving, moves=MOVES)
    middle, most = gaps[len(gaps) // 2], gaps[-1]
    print(f"{MOVES} moves ({netem or 'no delay'}): gap {middle:.2f} periods at the median, {most:.2f} at most")


@pytest.mark.long
@pytest.mark.timeout(200)
@pytest.mark.parametrize("after", [1.2 + 0.1 * number for number in range(CUTS)])
def test_a_link_that_is_cut_during_a_move_leaves_one_writer_and_is_recovered_from(moving: Moving, after: float) -> None:
    """The cable is down for 8 s, from so long (s) after the command was begun: longer than SSH waits."""
    robot = moving.robot
    with robot.begin("replace", "counter", "--on", "arm", "--yes", "--json") as command:
        time.sleep(after)
        robot.hosts.link("down")
        time.sleep(8.0)
        robot.hosts.link("up")
        command.communicate(timeout=120)
    robot.until(lambda: robot.status["condition"]["state"] == "up", "all is as it should be, without a command")
    for heard in moving.heard.values():
        assert len(heard.read().gaps) <= 2, robot("log").out  # one writes, and then the other one
    # On the host of the one that writes, nothing is missed for longer than the lease and its slack.
    silences = [max(two[0] - one[0] for one, two in pairwise(heard.rows)) for heard in moving.heard.values()]
    assert min(silences) < 2.5, robot("log").out

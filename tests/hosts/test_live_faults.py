"""Faults of the link and of the host process while a system of two hosts runs and is changed."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from tests.cli.conftest import EXAMPLES
from tests.hosts.robots import Robot, robots

pytestmark = [pytest.mark.ros2, pytest.mark.hosts, pytest.mark.long, pytest.mark.timeout(900)]

# How long the link is cut (s): so that SSH notices, after 4 to 6 s, or does not.
CUT = 8.0
SHORT_CUT = 2.0
# Within which time a system is as the manager says, on both sides, once a fault is over (s): the longest pause between
# two attempts to connect, a login, and a round of looking at what runs.
BOUND = 30.0
# After how long a fault begins, from the start of a command that takes about 4 s (s).
MOMENTS = (0.6, 0.9, 1.2, 1.6, 2.0, 2.5, 3.0, 4.0)


@pytest.fixture
def robot() -> Iterator[Robot]:
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    moved = text.replace("node talker   : Talker ", "node talker : Talker on arm ")
    assert moved != text
    with robots(EXAMPLES / "talker", moved) as robot:
        yield robot


def cut(robot: Robot, seconds: float) -> None:
    robot.hosts.link("down")
    time.sleep(seconds)
    robot.hosts.link("up")


def kill(robot: Robot) -> None:
    os.kill(robot.host_process, signal.SIGKILL)


FAULTS: dict[str, Callable[[Robot], None]] = {
    "cut": lambda robot: cut(robot, CUT),
    "short cut": lambda robot: cut(robot, SHORT_CUT),
    "kill": kill,
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    "command", [("replace", "talker", "NewTalker"), ("restart", "talker")], ids=["replace", "restart"]
)
def test_a_fault_during_a_change_leaves_a_system_that_is_as_the_manager_says(
    robot: Robot, fault: str, command: tuple[str, ...]
) -> None:
    assert robot("up", robot.file, "-d").status == 0
    longest, outcomes = 0.0, set()
    for moment in MOMENTS:
        changing = robot.begin(*command, "--yes", "--json")
        time.sleep(moment)
        FAULTS[fault](robot)
        said, errors = changing.communicate(timeout=90)
        over = time.monotonic()
        robot.until(lambda: robot.is_sound(2), f"{fault} after {moment} s: {said} {errors}", BOUND)
        longest = max(longest, time.monotonic() - over)
        outcomes.add(json.loads(said)["outcome"] if said else errors)
    print(f"{command[0]}, {fault}: {sorted(outcomes)}, as the manager says after {longest:.1f} s at most")
    assert robot("down").status == 0
    assert robot.programs() == []


def as_said(robot: Robot) -> bool:
    """Whether just the processes run that the manager knows, and it knows what each does."""
    status = robot.status
    pids = {each["pid"] for each in status["instances"]}
    return set(robot.programs()) == pids and all(each["reachable"] for each in status["instances"])


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_during_up_leaves_no_process_that_the_manager_does_not_know(robot: Robot, fault: str) -> None:
    """A node that could not be started is missing, as on one host: `restart` starts it."""
    for moment in (1.0, 2.0, 3.0, 4.5):
        begun = robot.begin("up", robot.file, "-d")
        time.sleep(moment)
        if fault != "kill" or robot.host_runs():
            FAULTS[fault](robot)
        said, errors = begun.communicate(timeout=120)
        if robot("status").status in (0, 3):
            robot.until(lambda: as_said(robot), f"{fault} after {moment} s: {said} {errors}", BOUND)
            robot.until(lambda: bool(robot.status["hosts"][0]["connected"]), "the host is reached again", BOUND)
            if robot.status["crashed"]:
                # Fast DDS does not use a network that was down when a node began: the one that is here restarts first.
                for name in ("listener", "talker"):
                    restarted = robot("restart", name, "--yes", timeout=60)
                    assert restarted.status == 0, restarted.out + restarted.err
            robot.until(lambda: robot.is_sound(2), f"{fault} after {moment} s: {said} {errors}", BOUND)
        print(f"up, {fault} after {moment} s: exit status {begun.returncode}, {said.strip().splitlines()[-1:]}")
        assert robot("down").status == 0
        robot.until(lambda: robot.programs() == [], "nothing is left", BOUND)

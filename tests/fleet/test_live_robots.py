"""Eight robots with real ROS 2 nodes and an SSH server each, and the playbook that rolls a change out over them."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.acceptance.support import ended
from tests.conftest import _claimed_domain
from tests.fleet.robots import Fleet, fleet, new_program, release, tiring_program

NUMBER = 8

pytestmark = [pytest.mark.long, pytest.mark.ros2, pytest.mark.ansible, pytest.mark.hosts]


@pytest.fixture(scope="module")
def robots() -> Iterator[Fleet]:
    folder = Path(tempfile.mkdtemp(prefix="ms", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None))
    try:
        with ended(), fleet(folder, [_claimed_domain() for _ in range(NUMBER)]) as found:
            found.up()
            yield found
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def recap(output: str) -> dict[str, dict[str, int]]:
    """The last table that Ansible prints, by robot."""
    lines = re.findall(r"^(r\d+) +: (.*)$", output, flags=re.MULTILINE)
    return {name: {k: int(v) for k, v in re.findall(r"(\w+)=(\d+)", rest)} for name, rest in lines}


def test_a_good_change_reaches_all_and_a_bad_one_ends_at_the_first(robots: Fleet) -> None:
    good = release(robots.folder, "good", new_program())
    done = robots.rollout(good, "-f", str(NUMBER), watch_seconds=5)
    assert done.returncode == 0, done.stdout + done.stderr
    for robot in robots.robots:
        report = robots.report(robot)
        assert report["applied"]["report"]["outcome"] == "done" and report["watched"]["condition"]["state"] == "up"
        assert {swap["lost"] for swap in report["applied"]["report"]["swaps"]} <= {0, None}
        assert robot.talker() == "NewTalker"
    batches = done.stdout.count("PLAY [Roll out]")
    assert batches == 3, done.stdout

    again = robots.rollout(good, "-f", str(NUMBER), watch_seconds=0)
    assert again.returncode == 0, again.stdout + again.stderr
    assert [row["changed"] for row in recap(again.stdout).values()] == [0] * NUMBER

    first, *others = robots.robots
    before = {robot.name: len(robot.changes()) for robot in others}
    for robot in robots.robots:
        (robots.folder / "reports" / f"{robot.name}.json").unlink()
    bad = release(robots.folder, "bad", tiring_program())
    ended_early = robots.rollout(bad, "-f", str(NUMBER), watch_seconds=60)
    assert ended_early.returncode == 2, ended_early.stdout + ended_early.stderr
    assert recap(ended_early.stdout).keys() == {first.name}
    assert "the robot was rolled back to version 2" in ended_early.stdout
    report = robots.report(first)
    assert report["applied"]["report"]["outcome"] == "done"
    assert report["watched"]["failed"] and "and guarantees 10 Hz" in report["watched"]["msg"]
    assert report["undone"]["changed"] and report["undone"]["report"]["outcome"] == "done"
    assert [each["outcome"] for each in first.changes()][-2:] == ["done", "done"]
    assert {robot.name: len(robot.changes()) for robot in others} == before
    assert not [robot.name for robot in others if (robots.folder / "reports" / f"{robot.name}.json").exists()]
    assert {robot.talker() for robot in robots.robots} == {"NewTalker"}


def test_a_robot_that_cannot_be_reached_ends_the_rollout_or_is_left_out(robots: Fleet) -> None:
    last = robots.robots[-1]
    current = release(robots.folder, "good", new_program())
    entries = len(last.changes())
    robots.link(last, "down")
    try:
        ends = robots.rollout(current, "-f", str(NUMBER), "-T", "3", watch_seconds=0)
        assert ends.returncode != 0 and recap(ends.stdout)[last.name]["unreachable"] == 1, ends.stdout + ends.stderr
        goes_on = robots.rollout(current, "-f", str(NUMBER), "-T", "3", watch_seconds=0, skip_unreachable=True)
        assert goes_on.returncode == 0, goes_on.stdout + goes_on.stderr
        assert len(last.changes()) == entries
    finally:
        robots.link(last, "up")


def test_a_connection_that_is_cut_during_the_change_leaves_it_to_the_manager(robots: Fleet) -> None:
    robot = robots.robots[1]
    other = release(robots.folder, "other", new_program().replace("good news", "other news"))
    entries = len(robot.changes())
    with ThreadPoolExecutor(1) as pool:
        rollout = pool.submit(robots.rollout, other, "--limit", robot.name, watch_seconds=60)
        try:
            until(lambda: len(robot.changes()) > entries, "the change begins")
            robots.link(robot, "down")
            done = rollout.result(timeout=120)
        finally:
            robots.link(robot, "up")
    assert done.returncode != 0 and recap(done.stdout)[robot.name]["unreachable"] == 1, done.stdout + done.stderr
    until(lambda: robot.changes()[-1]["outcome"] is not None, "the manager ends the change")
    assert [each["outcome"] for each in robot.changes()[entries:]] == ["done"]
    again = robots.rollout(other, "--limit", robot.name, watch_seconds=0)
    assert again.returncode == 0 and recap(again.stdout)[robot.name]["changed"] == 0, again.stdout + again.stderr


def until(condition: Callable[[], bool], what: str, seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)

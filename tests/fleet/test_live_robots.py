"""Eight robots with real ROS 2 nodes and an SSH server each, and the playbook that rolls a change out over them."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.support import ended
from tests.conftest import _claimed_domain
from tests.fleet.robots import Fleet, fleet, new_program, release, tiring_program
from tests.hosts.two_hosts import missing

NUMBER = 8

pytestmark = [pytest.mark.long, pytest.mark.ros2, pytest.mark.ansible]


@pytest.fixture(scope="module")
def robots() -> Iterator[Fleet]:
    if (why := missing()) is not None:
        pytest.skip(f"robots with a network each cannot be had here: {why}")
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
    robots.stop_serving(last)
    try:
        entries = len(last.changes())
        current = Path(str(robots.folder / "good.stride"))
        ends = robots.rollout(current, "-f", str(NUMBER), "-T", "3", watch_seconds=0)
        assert ends.returncode != 0 and recap(ends.stdout)[last.name]["unreachable"] == 1, ends.stdout + ends.stderr
        goes_on = robots.rollout(current, "-f", str(NUMBER), "-T", "3", watch_seconds=0, skip_unreachable=True)
        assert goes_on.returncode == 0, goes_on.stdout + goes_on.stderr
        assert len(last.changes()) == entries
    finally:
        robots.serve(last)

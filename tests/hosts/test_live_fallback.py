"""A node with a fallback on another host, on real ROS 2: the link is cut, and it comes back."""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path

import pytest

from tests.hosts.counting import SPECIFICATION, Heard, counting
from tests.hosts.robots import Robot
from tests.hosts.test_live_faults import BOUND

pytestmark = [pytest.mark.ros2, pytest.mark.long, pytest.mark.timeout(900)]

LEASE = 5.0
# After how long at most its fallback is heard (s): the lease by the manager's clock, which allows for both rates, the
# time until the loss of the host is known besides, and the start.
HEARD = 6.25 + 6.0 + 10.0
CUTS = 3
POLICY = f"respawn   respawn_fallback Counter on manager lease {LEASE:g} s"
ON_ARM = SPECIFICATION.replace(
    "node counter : Counter { out -> /count }", f"node counter : Counter on arm {{ out -> /count   {POLICY} }}"
)


def test_the_fallback_takes_over_after_the_lease_and_never_are_two_heard(tmp_path: Path) -> None:
    assert ON_ARM != SPECIFICATION
    with counting(tmp_path, ON_ARM) as (robot, heard):
        for number in range(CUTS):
            if number:
                done = robot("apply", robot.file, "--yes")
                assert done.status == 0, done.out + done.err
            time.sleep(3.0)
            _cut(robot, heard)


def _cut(robot: Robot, heard: dict[str, Heard]) -> None:
    """Cut the link until the fallback is heard, and see what both recorders have heard once all is well again."""
    old = robot.instance("counter")["name"]
    cut = time.monotonic()
    robot.hosts.lose(True)

    def taken_over() -> bool:
        return any(each.instance != old for each in heard["manager"].read().rows if each.heard > cut)

    robot.until(taken_over, "the fallback is heard", HEARD)
    robot.hosts.lose(False)
    back = time.monotonic()
    robot.until(lambda: bool(robot.status["hosts"][0]["connected"]), "the host is reached again", BOUND)
    robot.until(lambda: len(robot.programs("_counter.py")) == 1, "the old one is ended", BOUND)
    robot.until(lambda: robot.status["condition"]["state"] == "up", "it is up", BOUND)
    recovered = time.monotonic() - back
    new = robot.instance("counter")["name"]
    robot.until(lambda: all(each.read().rows[-1].instance == new for each in heard.values()), "both hear it", BOUND)
    for host, each in heard.items():
        rows = [row for row in each.read().rows if row.heard > cut - 1.0]
        turns = [one.instance for one, two in pairwise(rows) if one.instance != two.instance]
        assert turns == [old] and {row.instance for row in rows} == {old, new}, f"the turns on {host}"
        silent = max(row.heard for row in rows if row.instance == old) - cut
        first = min(row.heard for row in rows if row.instance == new) - cut
        assert silent < LEASE < first, (host, silent, first)
        print(f"on {host}: the old one until {silent:.2f} s after the cut, the fallback from {first:.2f} s on")
    print(f"as specified {recovered:.1f} s after the link was back")

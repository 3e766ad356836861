"""Nodes that move between two hosts, over SSH and real ROS 2: what a bare recorder on each host has heard."""

from __future__ import annotations

import json
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from tests.hosts.counting import PLAIN, SPECIFICATION, Heard, Message, counting
from tests.hosts.robots import Robot
from tests.hosts.slow_link import Slow

pytestmark = [pytest.mark.ros2, pytest.mark.hosts]
# How often the node moves in the tests that are `long`: 20 or more for a measurement.
MOVES = int(os.environ.get("MIDSTRIDE_MOVES", "20"))
# How many moves have a fault, of each kind: one after the other, each at a later moment of the move.
CUTS = int(os.environ.get("MIDSTRIDE_CUTS", "8"))
SLOW = Slow(delay=0.005, jitter=0.002, loss=0.005)
# How long the link is cut (s): longer than SSH waits.
CUT = 8.0
# Within which time the system is up and valid, once a fault is over (s), as in test_live_faults.
BOUND = 30.0


@dataclass
class Moving:
    """A robot with a node that counts, and the recorders on its hosts."""

    robot: Robot
    heard: dict[str, Heard] = field(default_factory=dict)

    def move(self, host: str) -> None:
        done = self.robot("replace", "counter", "--on", host, "--yes", "--json")
        assert done.status == 0 and done.json["outcome"] == "done", done.out + done.err + self.robot("log").out

    def written(self, since: int) -> list[Message]:
        """What either recorder has heard of what was published since then (system, ns), in that order."""
        found = {each.written: each for heard in self.heard.values() for each in heard.read().rows}
        return [found[at] for at in sorted(found) if at >= since]


@pytest.fixture
def moving(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Moving]:
    """The system runs, and both recorders hear it; ``param``: a slow link, or another specification."""
    given = getattr(request, "param", None)
    slow, text = (given, SPECIFICATION) if isinstance(given, Slow) else (None, given or SPECIFICATION)
    with counting(tmp_path, text, slow) as (robot, heard):
        yield Moving(robot, heard)


def require_whole(moving: Moving, moves: int) -> list[float]:
    """Require that each recorder has heard each number once; the gaps at the moves, in periods.

    Where frames are lost, a recorder may discover a new publisher after its first message, as any node without
    Midstride's API. There it is required that each number was heard once by one of them.
    """
    time.sleep(0.5)  # of what is on its way
    gaps, missed = [], []
    for heard in moving.heard.values():
        missed.append(set(heard.read().missed()))
        assert len(heard.gaps) == moves
        gaps += heard.gaps
    assert not set.intersection(*missed)
    assert moving.robot.hosts.slow is not None or not any(missed)
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
    assert [heard.overtaken for heard in moving.heard.values()] == [0, 0]


@pytest.mark.long
@pytest.mark.timeout(60 + 15 * MOVES)
@pytest.mark.parametrize("moving", [None, SLOW], indirect=True, ids=["cable", "slow link"])
def test_a_node_moves_there_and_back_again_and_again(moving: Moving) -> None:
    slow = moving.robot.hosts.slow
    took = []
    for number in range(MOVES):
        begun = time.monotonic()
        moving.move("manager" if number % 2 else "arm")
        took.append(time.monotonic() - begun)
    gaps = require_whole(moving, moves=MOVES)
    print(f"\n{MOVES} moves ({slow or 'a cable'}), load {os.getloadavg()}: gaps, in periods: {shown(gaps)}")
    for host, heard in moving.heard.items():
        print(f"{host}: {len(heard.rows)} messages, {heard.overtaken} overtaken, missed: {heard.missed()}")
        print(f"silences, in periods: {shown(heard.silences)}")
    print(f"a move, s: {shown(sorted(took))}; {moving.robot.hosts.stop_slow_link() if slow else ''}")


@pytest.mark.long
@pytest.mark.timeout(60 + 20 * MOVES)
@pytest.mark.parametrize("moving", [PLAIN], indirect=True, ids=["relay"])
def test_a_node_without_the_api_moves_there_and_back_behind_relays(moving: Moving) -> None:
    """The programs do not know of each other: a number is published twice, or not at all, where it meets the cut."""
    for number in range(MOVES):
        moving.move("manager" if number % 2 else "arm")
    time.sleep(0.5)  # of what is on its way
    print(f"\n{MOVES} moves of a node without the API, load {os.getloadavg()}")
    for host, heard in moving.heard.items():
        numbers = Counter(each.number for each in heard.read().rows)
        twice = sum(count - 1 for count in numbers.values())
        missed = len(range(min(numbers), max(numbers) + 1)) - len(numbers)
        assert len(heard.gaps) == MOVES
        assert missed + twice <= MOVES
        print(f"{host}: {len(heard.rows)} messages, {missed} missed, {twice} twice; gaps: {shown(sorted(heard.gaps))}")
        print(f"silences: {shown(heard.silences)}")


def shown(values: list[float]) -> str:
    """The least, the median, 90 %, 99 % and the greatest of sorted values."""
    named = {"least": 0.0, "median": 0.5, "90 %": 0.9, "99 %": 0.99, "greatest": 1.0}
    return ", ".join(f"{name} {values[round(share * (len(values) - 1))]:.2f}" for name, share in named.items())


def cut(robot: Robot) -> None:
    robot.hosts.link("down")
    time.sleep(CUT)
    robot.hosts.link("up")


def kill_host_process(robot: Robot) -> None:
    os.kill(robot.host_process, signal.SIGKILL)


def kill_manager(robot: Robot) -> None:
    os.kill(robot.manager, signal.SIGKILL)
    up = robot("up", robot.file, "-d")
    assert up.status == 0, up.out + up.err


FAULTS: dict[str, Callable[[Robot], None]] = {
    "link": cut,
    "host process": kill_host_process,
    "manager": kill_manager,
}


@pytest.mark.long
@pytest.mark.timeout(120 + 60 * CUTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_each_moment_of_a_move_leaves_one_writer_and_a_valid_system(moving: Moving, fault: str) -> None:
    """No command is given afterwards, but to start another manager if that was killed."""
    robot = moving.robot
    begun = time.monotonic()
    moving.move("arm")
    home: str | None = "arm"
    moment, step = 0.2, (time.monotonic() - begun) / CUTS
    settled, outcomes, silent, twice, missed = [], Counter[str](), [], 0, 0
    for number in range(CUTS):
        other = "arm" if home is None else "manager"
        before = time.time_ns()
        with robot.begin("replace", "counter", "--on", other, "--yes", "--json") as command:
            time.sleep(moment + number * step)
            FAULTS[fault](robot)
            over = time.monotonic()
            said, errors = command.communicate(timeout=120)
        outcome = json.loads(said)["outcome"] if said else errors.strip()
        if fault == "manager":  # the next one has decided, which the command does not know
            home = robot.instance("counter")["host"]
        elif outcome == "done":
            home = "arm" if home is None else None
        robot.until(
            lambda home=home: robot.is_sound(1) and robot.instance("counter")["host"] == home,  # type: ignore[misc]
            f"{fault} after {moment + number * step:.2f} s: {said} {errors}",
            BOUND,
        )
        settled.append(time.monotonic() - over)
        written = moving.written(before)
        writers = [instance for instance, _ in groupby(each.instance for each in written)]
        numbers = Counter(each.number for each in written)
        twice += sum(count - 1 for count in numbers.values())
        missed += len(range(min(numbers), max(numbers) + 1)) - len(numbers)
        silent.append(max(two.written - one.written for one, two in pairwise(written)) / 1e9)
        outcomes[outcome] += 1
        print(
            f"{moment + number * step:.2f} s, to {other}: {outcome}, settled {settled[-1]:.1f} s, {writers}, ", end=""
        )
        print(f"silent {silent[-1]:.2f} s, twice {twice}, missed {missed}", flush=True)
        # One writes, then the other one, which may have to leave it to the first one again, or to one in its place.
        assert len(writers) <= 3, robot("log").out
    print(f"{CUTS} faults of the {fault}, load {os.getloadavg()}: {dict(outcomes)}")
    print(f"settled after {shown(sorted(settled))} s; silent for {shown(sorted(silent))} s")
    print(f"numbers published twice {twice}, missed {missed}")

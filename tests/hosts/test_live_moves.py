"""Nodes that move between two hosts, over SSH and real ROS 2: what a bare recorder on each host has heard."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from tests.hosts.counting import PLAIN, SPECIFICATION, Heard, Message, counting
from tests.hosts.moves import CUTS, FAULTS, MOVES, move, move_to_and_fro, shown, struck_moves
from tests.hosts.robots import Robot
from tests.hosts.slow_link import Slow

pytestmark = [pytest.mark.ros2, pytest.mark.hosts]
SLOW = Slow(delay=0.005, jitter=0.002, loss=0.005)


@dataclass
class Moving:
    """A robot with a node that counts, and the recorders on its hosts."""

    robot: Robot
    heard: dict[str, Heard] = field(default_factory=dict)

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
    move(moving.robot, "arm")
    assert moving.robot.instance("counter")["host"] == "arm"
    move(moving.robot, "manager")
    assert moving.robot.instance("counter")["host"] is None
    require_whole(moving, moves=2)
    assert [heard.overtaken for heard in moving.heard.values()] == [0, 0]


@pytest.mark.long
@pytest.mark.timeout(60 + 15 * MOVES)
@pytest.mark.parametrize("moving", [None, SLOW], indirect=True, ids=["cable", "slow link"])
def test_a_node_moves_there_and_back_again_and_again(moving: Moving) -> None:
    slow = moving.robot.hosts.slow
    took = move_to_and_fro(moving.robot, MOVES)
    gaps = require_whole(moving, moves=MOVES)
    print(f"\n{MOVES} moves ({slow or 'a cable'}), load {os.getloadavg()}: gaps, in periods: {shown(gaps)}")
    for host, heard in moving.heard.items():
        print(f"{host}: {len(heard.rows)} messages, {heard.overtaken} overtaken, missed: {heard.missed()}")
        print(f"silences, in periods: {shown(heard.silences)}")
    print(f"a move, s: {shown(took)}; {moving.robot.hosts.stop_slow_link() if slow else ''}")


@pytest.mark.long
@pytest.mark.timeout(60 + 20 * MOVES)
@pytest.mark.parametrize("moving", [PLAIN], indirect=True, ids=["relay"])
def test_a_node_without_the_api_moves_there_and_back_behind_relays(moving: Moving) -> None:
    """The programs do not know of each other: a number is published twice, or not at all, where it meets the cut."""
    move_to_and_fro(moving.robot, MOVES)
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


@pytest.mark.long
@pytest.mark.timeout(120 + 60 * CUTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_each_moment_of_a_move_leaves_one_writer_and_a_valid_system(moving: Moving, fault: str) -> None:
    settled, outcomes, silent, twice, missed = [], Counter[str](), [], 0, 0
    for struck in struck_moves(moving.robot, fault):
        written = moving.written(struck.begun)
        writers = [instance for instance, _ in groupby(each.instance for each in written)]
        numbers = Counter(each.number for each in written)
        twice += sum(count - 1 for count in numbers.values())
        missed += len(range(min(numbers), max(numbers) + 1)) - len(numbers)
        silent.append(max(two.written - one.written for one, two in pairwise(written)) / 1e9)
        settled.append(struck.settled)
        outcomes[struck.outcome] += 1
        print(f"{struck}, {writers}, silent {silent[-1]:.2f} s, twice {twice}, missed {missed}", flush=True)
        # One writes, then the other one, which may have to leave it to the first one again, or to one in its place.
        assert len(writers) <= 3 and not twice and not missed, moving.robot("log").out
    print(f"{CUTS} faults of the {fault}, load {os.getloadavg()}: {dict(outcomes)}")
    print(f"settled after {shown(sorted(settled))} s; silent for {shown(sorted(silent))} s")
    print(f"numbers published twice {twice}, missed {missed}")

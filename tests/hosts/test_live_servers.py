"""A node with a service and a ROS action moves between two hosts, while bare nodes of both hosts call them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.hosts.moves import CUTS, FAULTS, MOVES, move_to_and_fro, shown, struck_moves
from tests.hosts.robots import Robot, robots

pytestmark = [pytest.mark.ros2, pytest.mark.hosts]

NODES = Path(__file__).parent / "_served.py"
SPECIFICATION = """system serving
service /asked : rcl_interfaces/srv/ListParameters responds within 0.5 s
action /counted : test_msgs/action/Fibonacci accepts within 0.5 s
component Server {
  run "python3 _served.py"
  server asked
  action server counted
  functionality work {
    produces asked, counted
    mode normal {
      guarantee asked : rcl_interfaces/srv/ListParameters responds within 0.5 s
      guarantee counted : test_msgs/action/Fibonacci accepts within 0.5 s
    }
    mode degraded { }
  }
}
node counter : Server { asked -> /asked  counted -> /counted }
"""
SUCCEEDED = "4 40"  # the status, and the length of the result


class Response(NamedTuple):
    """To a request: when it was there (``at``, system, ns), how many were executed before, and how long it took (s)."""

    at: int
    before: int
    instance: str
    took: float


@dataclass
class Calls:
    """What became of the calls of one node: in ``file``."""

    file: Path

    def _lines(self, kind: str) -> list[list[str]]:
        lines = [line.split() for line in self.file.read_text().splitlines()]
        return [[at, *words] for at, called, *words in lines if called == kind]

    @property
    def responses(self) -> list[Response]:
        """Those to requests that have not been given up."""
        lines = [words for words in self._lines("request") if words[1:] != ["unanswered"]]
        return [Response(int(at), int(before), instance, float(took)) for at, before, instance, took in lines]

    @property
    def given_up(self) -> int:
        """How many requests have."""
        return sum(words[1:] == ["unanswered"] for words in self._lines("request"))

    @property
    def goals(self) -> list[str]:
        """The status of each goal, and the length of its result."""
        return [f"{status} {length}" for _, status, length in self._lines("goal")]


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[tuple[Robot, list[Calls]]]:
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    files = tmp_path / "files"
    files.mkdir()
    shutil.copy(NODES, files)
    with ExitStack() as stack:
        robot = stack.enter_context(robots(files, SPECIFICATION))
        up = robot("up", robot.file, "-d")
        assert up.status == 0, up.out + up.err
        calls = []
        for namespace in (robot.hosts.near, robot.hosts.far):
            calls.append(Calls(tmp_path / f"{namespace}.calls"))
            words = ["nsenter", f"--net=/run/netns/{namespace}", sys.executable, str(NODES), str(calls[-1].file)]
            process = subprocess.Popen(words, env=robot.environment)
            stack.callback(process.wait)
            stack.callback(process.kill)
        robot.until(lambda: all(each.file.exists() and each.goals for each in calls), "both are answered")
        yield robot, calls


def answered(calls: list[Calls]) -> list[Response]:
    """What both nodes were answered, in that order."""
    return sorted(response for each in calls for response in each.responses)


def require_answered_once(robot: Robot, calls: list[Calls], moves: int) -> None:
    """Require that each request was executed and answered once, and that each goal succeeded, over so many moves."""
    took = move_to_and_fro(robot, moves)
    ends = [len(each.goals) + 2 for each in calls]
    robot.until(lambda: all(len(each.goals) >= end for each, end in zip(calls, ends, strict=True)), "goals end")
    responses = sorted(answered(calls), key=lambda each: each.before)
    before = [each.before for each in responses]
    print(f"\n{moves} moves, load {os.getloadavg()}: {len(before)} requests, answered within, s: ", end="")
    print(f"{shown(sorted(each.took for each in responses))}; goals: {[len(each.goals) for each in calls]}")
    print(f"a move, s: {shown(took)}")
    assert [each.given_up for each in calls] == [0, 0]
    assert len({*before}) == len(before), "one state was answered twice"
    # The last one of each node may be on its way.
    assert len({*range(before[-1] + 1)} - {*before}) <= 2, "some were executed, and not answered"
    assert {goal for each in calls for goal in each.goals} == {SUCCEEDED}
    assert len([*groupby(each.instance for each in responses)]) == moves + 1


@pytest.mark.full
@pytest.mark.timeout(180)
def test_a_node_with_servers_moves_to_another_host_and_back(serving: tuple[Robot, list[Calls]]) -> None:
    require_answered_once(*serving, moves=2)


@pytest.mark.long
@pytest.mark.timeout(120 + 30 * MOVES)
def test_a_node_with_servers_moves_there_and_back_again_and_again(serving: tuple[Robot, list[Calls]]) -> None:
    require_answered_once(*serving, moves=MOVES)


@pytest.mark.long
@pytest.mark.timeout(120 + 60 * CUTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_each_moment_of_a_move_leaves_one_server_that_answers(
    serving: tuple[Robot, list[Calls]], fault: str
) -> None:
    robot, calls = serving
    settled, outcomes = [], Counter[str]()
    for struck in struck_moves(robot, fault):
        so_far = len(answered(calls))
        robot.until(lambda so_far=so_far: len(answered(calls)) > so_far + 40, "both are answered again")  # type: ignore[misc]
        now = [each for each in answered(calls) if each.at >= struck.begun]
        servers = [instance for instance, _ in groupby(each.instance for each in now)]
        twice = len(now) - len({each.before for each in now})
        given_up, lost = [each.given_up for each in calls], [each.goals.count("unanswered 0") for each in calls]
        settled.append(struck.settled)
        outcomes[struck.outcome] += 1
        print(f"{struck}, {servers}, same state {twice}, given up: {given_up}, goals {lost}", flush=True)
        assert len(servers) <= 3 and not twice, robot("log").out
    print(f"{CUTS} faults of the {fault}, load {os.getloadavg()}: {dict(outcomes)}")
    print(f"settled after {shown(sorted(settled))} s")

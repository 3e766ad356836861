"""Moves of a node between the two hosts of a robot, and faults at each moment of such a move."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.hosts.robots import Robot

# How often the node moves in the tests that are `long`: 20 or more for a measurement.
MOVES = int(os.environ.get("MIDSTRIDE_MOVES", "20"))
# How many moves have a fault, of each kind: one after the other, each at a later moment of the move.
CUTS = int(os.environ.get("MIDSTRIDE_CUTS", "8"))
# How long the link is cut (s): longer than SSH waits.
CUT = 8.0
# Within which time the system is up and valid, once a fault is over (s), as in test_live_faults.
BOUND = 30.0


def move(robot: Robot, host: str, role: str = "counter") -> float:
    """Move the node, and return how long that took (s)."""
    begun = time.monotonic()
    done = robot("replace", role, "--on", host, "--yes", "--json")
    assert done.status == 0 and done.json["outcome"] == "done", done.out + done.err + robot("log").out
    return time.monotonic() - begun


def move_to_and_fro(robot: Robot, moves: int) -> list[float]:
    """Move the node to the other host, back, and so on; how long the moves took, the shortest first (s)."""
    return sorted(move(robot, "manager" if number % 2 else "arm") for number in range(moves))


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


@dataclass(frozen=True)
class StruckMove:
    """A move with a fault ``moment`` s after its command, after which the system is sound again.

    ``begun``: when the command was given (system, ns). ``settled``: how long after the end of the fault the system was
    as its manager says (s).
    """

    moment: float
    begun: int
    to: str
    outcome: str
    settled: float

    def __str__(self) -> str:
        return f"{self.moment:.2f} s, to {self.to}: {self.outcome}, settled {self.settled:.1f} s"


def struck_moves(robot: Robot, fault: str, role: str = "counter") -> Iterator[StruckMove]:
    """Move the node again and again, with the fault at a later moment of each move.

    No command is given afterwards, but to start another manager if that was killed.
    """
    step = move(robot, "arm", role) / CUTS
    home: str | None = "arm"
    for number in range(CUTS):
        other, moment = "arm" if home is None else "manager", 0.2 + number * step
        begun = time.time_ns()
        with robot.begin("replace", role, "--on", other, "--yes", "--json") as command:
            time.sleep(moment)
            FAULTS[fault](robot)
            over = time.monotonic()
            said, errors = command.communicate(timeout=120)
        outcome = json.loads(said)["outcome"] if said else errors.strip()
        if fault == "manager":  # the next one has decided, which the command does not know
            home = robot.instance(role)["host"]
        elif outcome == "done":
            home = "arm" if home is None else None
        robot.until(
            lambda home=home: robot.is_sound(1) and robot.instance(role)["host"] == home,  # type: ignore[misc]
            f"{fault} after {moment:.2f} s: {said} {errors}",
            BOUND,
        )
        yield StruckMove(moment, begun, other, outcome, time.monotonic() - over)


def shown(values: list[float]) -> str:
    """The least, the median, 90 %, 99 % and the greatest of sorted values."""
    named = {"least": 0.0, "median": 0.5, "90 %": 0.9, "99 %": 0.99, "greatest": 1.0}
    return ", ".join(f"{name} {values[round(share * (len(values) - 1))]:.2f}" for name, share in named.items())

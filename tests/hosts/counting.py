"""A system of one node that counts at 50 Hz, for two hosts, and what a bare recorder on a host has heard of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tests.hosts.robots import Robot, robots

NODES = Path(__file__).parent / "_counter.py"
RATE = 50.0
SPECIFICATION = """system moving
contract Count = std_msgs/msg/String @ 50 Hz
topic /count : Count
component Counter {
  run "python3 _counter.py"
  output out
  functionality work {
    produces out
    mode normal { guarantee out : Count }
    mode degraded { }
  }
}
node counter : Counter { out -> /count }
"""


@dataclass
class Heard:
    """What a recorder has heard: when (s), which number, from which instance."""

    file: Path
    rows: list[tuple[float, int, str]] = field(default_factory=list)

    def read(self) -> Heard:
        lines = [line.split() for line in self.file.read_text().splitlines()]
        self.rows = [(float(at), int(number), instance) for at, number, instance in lines]
        return self

    def require_each_once_and_in_order(self) -> None:
        numbers = [number for _, number, _ in self.rows]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))

    @property
    def gaps(self) -> list[float]:
        """Between the last message of an instance and the first of the next one, in periods."""
        found = [(one, two) for one, two in pairwise(self.rows) if one[2] != two[2]]
        return [(two[0] - one[0]) * RATE for one, two in found]


@contextmanager
def recorder(robot: Robot, namespace: str, file: Path) -> Iterator[None]:
    words = ["nsenter", f"--net=/run/netns/{namespace}", sys.executable, str(NODES), str(file)]
    process = subprocess.Popen(words, env=robot.environment)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


@contextmanager
def counting(folder: Path, text: str = SPECIFICATION) -> Iterator[tuple[Robot, dict[str, Heard]]]:
    """The system of ``text`` runs on two hosts, and a recorder on each of them hears the node."""
    files = folder / "files"
    files.mkdir()
    shutil.copy(NODES, files)
    with ExitStack() as stack:
        robot = stack.enter_context(robots(files, text))
        heard = {}
        for host, namespace in (("manager", robot.hosts.near), ("arm", robot.hosts.far)):
            heard[host] = Heard(folder / f"{host}.heard")
            stack.enter_context(recorder(robot, namespace, heard[host].file))
        up = robot("up", robot.file, "-d")
        assert up.status == 0, up.out + up.err
        robot.until(lambda: all(each.read().rows for each in heard.values()), "both hear it")
        yield robot, heard

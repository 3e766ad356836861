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
from typing import NamedTuple

from tests.hosts.robots import Robot, robots
from tests.hosts.slow_link import Slow

NODES = Path(__file__).parent / "_counter.py"
RATE = 50.0
SPECIFICATION = """system moving
contract Count = std_msgs/msg/String @ 50 Hz qos(depth = 200)
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
PLAIN = SPECIFICATION.replace('_counter.py"', '_counter.py plain" gate relay').replace(
    "output out", "output out as count"
)


class Message(NamedTuple):
    """``heard``: when (steady, s). ``written``: when its instance has published it (system, ns)."""

    heard: float
    written: int
    number: int
    instance: str


@dataclass
class Heard:
    """What a recorder has heard."""

    file: Path
    rows: list[Message] = field(default_factory=list)

    def read(self) -> Heard:
        lines = [line.split() for line in self.file.read_text().splitlines()]
        self.rows = [
            Message(float(heard), int(written), int(number), instance) for heard, written, number, instance in lines
        ]
        return self

    def missed(self) -> list[int]:
        """The numbers that it has not heard between the first and the last; none may be heard twice."""
        numbers = {each.number for each in self.rows}
        assert len(numbers) == len(self.rows)
        return sorted(set(range(min(numbers), max(numbers) + 1)) - numbers)

    @property
    def overtaken(self) -> int:
        """How many messages were heard after one with a greater number."""
        return sum(two.number < one.number for one, two in pairwise(self.rows))

    @property
    def gaps(self) -> list[float]:
        """Between the last message of an instance and the first of the next one, in periods."""
        in_order = sorted(self.rows, key=lambda each: each.number)
        found = [(one, two) for one, two in pairwise(in_order) if one.instance != two.instance]
        return [(two.heard - one.heard) * RATE for one, two in found]

    @property
    def silences(self) -> list[float]:
        """Between each message and the next one, in periods, the shortest first."""
        return sorted((two.heard - one.heard) * RATE for one, two in pairwise(self.rows))


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
def counting(
    folder: Path, text: str = SPECIFICATION, slow: Slow | None = None
) -> Iterator[tuple[Robot, dict[str, Heard]]]:
    """The system of ``text`` runs on two hosts, and a recorder on each of them hears the node."""
    files = folder / "files"
    files.mkdir()
    shutil.copy(NODES, files)
    with ExitStack() as stack:
        robot = stack.enter_context(robots(files, text, slow))
        heard = {}
        for host, namespace in (("manager", robot.hosts.near), ("arm", robot.hosts.far)):
            heard[host] = Heard(folder / f"{host}.heard")
            stack.enter_context(recorder(robot, namespace, heard[host].file))
        up = robot("up", robot.file, "-d")
        assert up.status == 0, up.out + up.err
        robot.until(lambda: all(each.read().rows for each in heard.values()), "both hear it")
        yield robot, heard

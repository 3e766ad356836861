"""Talkers of every kind on real ROS 2: in plain rclpy, in C on rcl, and with Midstride's API. They replace each other.

Each publishes "NAME NUMBER", where NAME is that of its instance, and a bare recorder listens.
"""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from midstride import backends
from midstride.lang.load import load
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import ATTEMPTS, ROOT
from tests.backends.ros2_support import Bare, without_midstride
from tests.native import LISTENER, compiled, environment_of_compiled

PAGE = ROOT / "docs" / "how-to" / "unmodified-nodes.md"

OURS = """
import os

from midstride import Component
from std_msgs.msg import String

comp = Component("Ours")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    count += 1
    out.write(String(data=f"{os.environ['MIDSTRIDE_INSTANCE']} {count}"))

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


def programs_of_the_page(folder: Path) -> None:
    """The files that the how-to shows, in ``folder``; a node says its instance instead of its name, which stays."""
    for name, text in re.findall(r"```\w+ file=(\S+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        said = text.replace("self.get_name()", "__import__('os').environ['MIDSTRIDE_INSTANCE']")
        (folder / name).write_text(said, encoding="utf-8")


def declared_talker(name: str, command: str, gate: str | None = None, rate: float = 50) -> str:
    """A component in Stride that talks at ``rate`` Hz: a node without the API where it has a ``gate``."""
    return f"""component {name} {{
  run "{command}"{f" gate {gate}" if gate else ""}
  output out{" as chatter" if gate else ""}
  functionality talk {{
    produces out
    mode normal   {{ guarantee out : std_msgs/msg/String @ {rate:g} Hz }}
    mode degraded {{ }}
  }}
}}
"""


def talkers(folder: Path, first: str = "Plain", rate: float = 50, timing: str = "") -> Specification:
    """A node `talker`, at first a ``first``; it can become `Plain` (rclpy), `Native` (C) and `Ours`, at ``rate`` Hz.

    All write at 50 Hz, but `Native` at ``rate``.
    """
    programs_of_the_page(folder)
    (folder / "ours.py").write_text(OURS, encoding="utf-8")
    compiled(folder)
    text = f"system swaps\n{timing}\ntopic /chat : std_msgs/msg/String @ {rate:g} Hz\n"
    text += declared_talker("Plain", "python3 talker.py", "preload")
    text += declared_talker("Native", f"./c_talker {1e9 / rate:.0f} chatter", "preload", rate)
    text += declared_talker("Ours", "python3 ours.py")
    path = folder / "swaps.stride"
    path.write_text(f"{text}node talker : {first} {{ out -> /chat }}\n", encoding="utf-8")
    return load(path).require()


class Hole(NamedTuple):
    """Messages of one writer that are missing between two that were heard."""

    writer: str
    last: int
    next: int

    @property
    def missing(self) -> int:
        """How many; negative where it has come twice, or late."""
        return self.next - self.last - 1


def holes(heard: Sequence[tuple[float, str, int]]) -> list[Hole]:
    return [
        Hole(name, last, number)
        for (_, before, last), (_, name, number) in pairwise(heard)
        if name == before and number != last + 1
    ]


@dataclass
class Robot:
    """A system that runs, and what a bare recorder hears of it: when (monotonic, s), from which instance, number.

    ``recorded``: reads on in what a recorder in C has written, where that is the recorder. ``published``: when each was
    published by its own account (Unix time, ns), where rclpy hears them. ``given_up``: of the changes
    that :meth:`replaced` has made again, which part of what was heard is theirs, as the indices of its first and last.
    """

    folder: Path
    manager: Manager
    bare: Bare
    heard: list[tuple[float, str, int]] = field(default_factory=list)
    recorded: Recorded | None = None
    published: dict[tuple[str, int], int] = field(default_factory=dict)
    given_up: list[tuple[int, int]] = field(default_factory=list)

    async def until(self, condition: Callable[[], bool], seconds: float = 60) -> None:
        """Wait for what is heard, or for something else. A recorder in C leaves the loop to the manager meanwhile."""
        if self.recorded is None:
            await self.bare.until(condition, seconds)
            return
        deadline = time.monotonic() + seconds
        self.heard += self.recorded.more()
        while not condition():
            assert time.monotonic() < deadline, "it did not come true in time"
            await asyncio.sleep(0.005)
            self.heard += self.recorded.more()

    def hear(self, message: Any, info: Any) -> None:
        name, number = message.data.split()
        self.heard.append((time.monotonic(), name, int(number)))
        stamp = info["source_timestamp"] if isinstance(info, Mapping) else info.source_timestamp
        self.published[name, int(number)] = stamp

    async def hears(self, messages: int = 20) -> None:
        """Return when so many more have been heard."""
        count = len(self.heard)
        try:
            await self.until(lambda: len(self.heard) >= count + messages)
        except AssertionError:
            status = await self.manager.status()
            raise AssertionError(f"heard last {self.heard[-3:]}; {status}") from None

    async def meanwhile(self, work: Awaitable[Any]) -> Any:
        task = asyncio.ensure_future(work)
        await self.until(task.done, 120)
        return task.result()

    async def change(self, component: str, role: str = "talker") -> Outcome:
        """Replace the node ``role`` by a ``component``; it may be refused."""
        report: Outcome = await self.meanwhile(self.manager.change(PlanRequest(replace=((role, component),))))
        return report

    async def replaced(self, component: str, messages: int = 20, role: str = "talker") -> dict[str, float]:
        """Replace the node ``role``, and hear so many messages of the new one; how long each step took, by kind (s).

        A busy machine may give a hand-over up: a change that was rolled back, while the old one went on, is made again.
        """
        for _ in range(ATTEMPTS):
            begun = len(self.heard) - 1
            report = await self.change(component, role)
            if report.outcome != "rolled_back":
                break
            print(f"{component}: rolled back, {report.because}")
            await self.hears()
            assert self.heard[begun][1] == self.heard[-1][1]
            self.given_up.append((begun, len(self.heard) - 1))
        assert (report.outcome, report.because) == ("done", None), report.because
        instances = self.manager.configuration.instances.values()
        (writer,) = (each.name for each in instances if each.role == role)
        await self.until(lambda: self.heard[-1][1] == writer)
        await self.hears(messages)
        assert report.plan is not None
        took: dict[str, float] = {"in all": report.seconds}
        for step in report.steps:
            kind = report.plan.steps[step.step - 1].action
            took[kind] = took.get(kind, 0.0) + step.seconds
        return took

    async def another_manager(self) -> None:
        """The manager ends; the nodes go on, and the next one goes on with them."""
        await self.manager.close()
        await self.hears()
        self.manager = manager_of(self.manager.specification, self.folder)
        await self.manager.up()

    def changes(self) -> list[tuple[str, str]]:
        """Each change of the writer that was heard, but for those of changes that were given up."""
        return [(old, new) for part in self._parts() for (_, old, _), (_, new, _) in pairwise(part) if old != new]

    def require_changes(self, number: int) -> None:
        """Fail unless the writer has changed so often; else say whether the order of publication has more changes.

        The middleware keeps no order between two writers: on a busy machine a recorder may hear the first message of
        the new one before the last one of the old one, which then looks as if the old one had written again.
        """
        if len(self.changes()) == number:
            return
        rows = [(self.published.get((name, count), 0), at, name, count) for at, name, count in self.heard]
        by_time = sum(old[2] != new[2] for old, new in pairwise(sorted(rows)))
        firsts = [place for place in range(1, len(rows)) if rows[place - 1][2] != rows[place][2]]
        back = [place for place, following in pairwise(firsts) if following - place < 10]
        near = [rows[max(0, place - 3) : place + 12] for place in back]
        raise AssertionError(
            f"{len(self.changes())} changes of the writer were heard, not {number}, and {by_time} in the order in "
            f"which they were published; those that went back soon, as published, heard, writer and number: {near}"
        )

    def holes(self) -> list[Hole]:
        """What was missed, but for what was in changes that were given up."""
        return [hole for part in self._parts() for hole in holes(part)]

    def _parts(self) -> Iterator[Sequence[tuple[float, str, int]]]:
        """What was heard before, between and after the changes that were given up."""
        begun = 0
        for first, last in self.given_up:
            yield self.heard[begun : first + 1]
            begun = last
        yield self.heard[begun:]


STRICT = SystemOptions(strict=True)


def manager_of(specification: Specification, folder: Path) -> Manager:
    """Its `up` raises if a single node cannot be started."""
    workspace = Workspace(folder / "system")
    return Manager(specification, backends.make("ros2", workspace), workspace, folder, options=STRICT)


def system_to_kill(folder: Path, program: str, topic: str) -> Specification:
    """A node `source` that runs the text ``program``, and another component with it, for a manager that is killed."""
    (folder / "source.py").write_text(program, encoding="utf-8")
    text = f"system killed\ntopic {topic} : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Source", "OtherSource"):
        text += declared_talker(name, f"{sys.executable} {folder / 'source.py'}", "preload")
    path = folder / "killed.stride"
    path.write_text(f"{text}node source : Source {{ out -> {topic} }}\n", encoding="utf-8")
    (folder / "system").mkdir()
    return load(path).require()


class Recorded:
    """What a recorder in C writes into ``file``."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._rest = ""

    def more(self) -> list[tuple[float, str, int]]:
        """What it has heard since the last time."""
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        return [(int(at) / 1e9, name, int(number)) for at, name, number in map(str.split, lines)]


@contextmanager
def recorder_in_c(folder: Path, topic: str) -> Iterator[Recorded]:
    """One that hears ``topic`` meanwhile: a recorder in rclpy does not keep up with 1 kHz on a busy machine."""
    path = folder / "recorded"
    path.touch()
    program = compiled(folder, LISTENER, "listener")
    environment = environment_of_compiled(without_midstride())
    with path.open(encoding="utf-8") as file, subprocess.Popen([program, topic, path], env=environment) as process:
        try:
            yield Recorded(file)
        finally:
            process.kill()


@asynccontextmanager
async def robot(
    specification: Specification, folder: Path, topic: str = "/chat", in_c: bool = False
) -> AsyncIterator[Robot]:
    """Bring ``specification``, whose programs are in ``folder``, up, and down again. ``in_c``: the recorder."""
    from std_msgs.msg import String

    (folder / "system").mkdir()
    manager = manager_of(specification, folder)
    with Bare("watcher" if in_c else "recorder") as bare, ExitStack() as stack:
        made = Robot(folder, manager, bare)
        if in_c:
            made.recorded = stack.enter_context(recorder_in_c(folder, topic))
        else:
            bare.node.create_subscription(String, topic, made.hear, 1000)
        try:
            await made.meanwhile(manager.up())
            await made.hears()
            yield made
        finally:
            await made.manager.down()
            await made.manager.close()

"""Whole systems on real ROS 2: the specification of benchmarks/swap, a bare recorder, and an end for everything."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from benchmarks.swap.streams import Stream
from benchmarks.swap.systems import with_api
from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import Reaper
from midstride.runtime.records.measure import Observation, SwapReport, report
from midstride.runtime.watch import subscriber_recording
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import Command, CutInCommand
from midstride.wire.environment import ENV_INSTANCE
from midstride.wire.replies import Receipt
from tests.backends.ros2_support import tuned_environment

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "benchmarks"
NODES = BENCHMARKS / "swap" / "programs" / "nodes.py"
PERIOD = 0.02
# How many messages wait for a subscriber here (20 s). With ROS's default of ten, one that gets no processor for 0.2 s
# loses messages that were published, and that every other subscriber has: that is no fault of a hand-over.
QUEUE = 1000
# How often it is looked how long processes have waited for a processor (s): that takes 2 ms.
LOOK = 0.1
# How often a change is made that a busy machine may give up.
ATTEMPTS = 3
RUN = "MIDSTRIDE_TEST_RUN"


def benchmark(name: str) -> ModuleType:
    """A benchmark as a module: its nodes and its specification serve here too."""
    if str(BENCHMARKS) not in sys.path:
        sys.path.append(str(BENCHMARKS))  # for what it imports beside itself
    # What it shares with the programs of its nodes is read anew: like these, it may depend on the environment.
    for shared in [each for each in sys.modules if (BENCHMARKS / f"{each}.py").exists() and each.startswith("_")]:
        del sys.modules[shared]
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def swap_specification(queue: int = QUEUE) -> Specification:
    """The specification of benchmarks/swap; ``queue``: how many messages wait for its subscriber."""
    return load_text(with_api(NODES, Stream(1 / PERIOD), queue)).require()


@contextlib.contextmanager
def ended() -> Iterator[str]:
    """Every process started inside is ended, whoever started it: they all carry one token."""
    token = uuid.uuid4().hex
    before = os.environ.get(RUN)
    with Reaper(RUN, token):
        os.environ[RUN] = token
        try:
            yield token
        finally:
            if before is None:
                del os.environ[RUN]
            else:
                os.environ[RUN] = before
    assert reaper.remaining_groups({}, RUN, token) == set()


class Recorder:
    """A process of bare rclpy that records ``/swap``; it knows nothing of Midstride."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "recorded.json"
        self._process = subprocess.Popen(
            [sys.executable, str(NODES), "recorder", str(self._path), str(QUEUE), "middleware"],
            env=tuned_environment(dict(os.environ)),
            start_new_session=True,  # what is left of it is ended as a group, which must not be that of the tests
        )

    def wait_until_it_hears(self, seconds: float = 90.0) -> None:
        deadline = time.monotonic() + seconds
        while not (self._path.exists() and self._path.stat().st_size):
            assert time.monotonic() < deadline, "the recorder hears nothing"
            assert self._process.poll() is None, "the recorder has ended"
            time.sleep(0.02)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def stop(self) -> list[Receipt]:
        self._process.send_signal(signal.SIGTERM)
        assert self._process.wait(timeout=20) == 0
        return [Receipt(*json.loads(line)) for line in self._path.read_text().splitlines()]


class ClockSource:
    """A process that publishes ``/clock``; ``pid`` is its own."""

    def __init__(self, folder: Path, speed: float, begin: float = 100.0) -> None:
        self._path = folder / "clock.json"
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).parent / "_clock_source.py"), str(self._path), str(speed), str(begin)],
            stdin=subprocess.PIPE,
            env=tuned_environment(dict(os.environ)),
            start_new_session=True,
        )
        self.pid = self._process.pid

    def drive(self, speed: float, at: float | None = None) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{speed} {'' if at is None else at}\n".encode())
        self._process.stdin.flush()

    def stop(self) -> list[tuple[int, int]]:
        """The moments at which it moved."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        assert self._process.wait(timeout=20) == 0
        return [(steady, ros) for steady, ros in json.loads(self._path.read_text())]


@contextlib.asynccontextmanager
async def managed(
    folder: Path, specification: Specification, directory: Path = BENCHMARKS, options: SystemOptions = NO_OPTIONS
) -> AsyncIterator[tuple[Manager, Any]]:
    """A manager with its system up; down again in the end."""
    from midstride import backends

    folder.mkdir(exist_ok=True)
    workspace = Workspace(folder)
    backend: Any = backends.make("ros2", workspace)
    manager = Manager(specification, backend, workspace, directory, options=options)
    try:
        await manager.up()
        yield manager, backend
    finally:
        await manager.down()
        await manager.close()


def when_the_cut_is_agreed(manager: Manager, act: Callable[[], object]) -> None:
    """Have ``act`` called once, when both sides of the next cut know its moment, which is up to 1 s ahead."""
    client = manager._client
    send = client._send

    async def watched(instance: str, command: Command[Any], revision: int | None) -> Any:
        result = await send(instance, command, revision)
        if isinstance(command, CutInCommand):
            client._send = send  # type: ignore[method-assign]
            act()
        return result

    client._send = watched  # type: ignore[method-assign]


def stopped_for(pid: int, seconds: float) -> None:
    """Stop the process for so long; it goes on although nothing waits for that. On the event loop."""
    os.kill(pid, signal.SIGSTOP)
    asyncio.get_running_loop().call_later(seconds, os.kill, pid, signal.SIGCONT)


def pids(manager: Manager) -> dict[str, int]:
    """The processes of the components that run."""
    found = {name: handle.pid for name, handle in manager.system.life.handles.items()}
    return {name: pid for name, pid in found.items() if pid is not None}


class Starved:
    """How long processes waited for a processor, by the kernel's own account, from look to look at them.

    A slot is missed where a thread gets no processor for its length. So what was waited bounds how many can have been
    missed for no fault of a hand-over: on a machine with nothing else to do, none.
    """

    def __init__(self, *pids: int) -> None:
        self._last: dict[int, float] = {}
        self._waits: list[float] = []
        self._looked: list[float] = [time.time()]  # one more: when the first interval began
        self.watch(*pids)

    def watch(self, *pids: int) -> None:
        """From now on, if they have not been watched before."""
        for pid in pids:
            self._last.setdefault(pid, _waited(pid))

    def look(self) -> None:
        now = {pid: max(before, _waited(pid)) for pid, before in self._last.items()}
        self._waits.append(sum(now.values()) - sum(self._last.values()))
        self._looked.append(time.time())
        self._last = now

    @contextlib.asynccontextmanager
    async def looked_at(self) -> AsyncIterator[None]:
        """Look again and again inside."""

        async def keep_looking() -> None:
            while True:
                await asyncio.sleep(LOOK)
                self.look()

        looking = asyncio.ensure_future(keep_looking())
        try:
            yield
        finally:
            looking.cancel()
            self.look()

    @property
    def seconds(self) -> float:
        """The sum over all of them (s)."""
        return sum(self._waits)

    @property
    def longest(self) -> float:
        """Longer than any wait was (s), which may have ended only after a look."""
        return max(map(sum, itertools.pairwise([0.0, *self._waits, 0.0])))

    def between(self, begun: float, ended: float) -> float:
        """At least as much as they waited between two moments (s; both since the epoch).

        That of each interval between two looks that has a part in it, and of the next one: a wait may have ended there.
        """
        total, late = 0.0, False
        for (first, last), waited in zip(itertools.pairwise(self._looked), self._waits, strict=True):
            inside = first <= ended and last >= begun
            total += waited if inside or late else 0.0
            late = inside
        return total

    def often(self, length: float) -> int:
        """How often at most one had to wait for ``length`` seconds."""
        return sum(int(sum(pair) / length) for pair in itertools.pairwise([0.0, *self._waits, 0.0]))


@contextlib.contextmanager
def components_looked_at(token: str) -> Iterator[Starved]:
    """Look again and again inside, in a thread, at all components of the run ``token`` (:func:`ended`)."""
    starved, over = Starved(), threading.Event()

    def keep_looking() -> None:
        for look in itertools.count():
            if look % 5 == 0:
                of_run = (each.pid for each in reaper.processes() if reaper.environment_value(each.pid, RUN) == token)
                starved.watch(*(pid for pid in of_run if reaper.environment_value(pid, ENV_INSTANCE)))
            starved.look()
            if over.wait(LOOK):
                return

    looking = threading.Thread(target=keep_looking)
    looking.start()
    try:
        yield starved
    finally:
        over.set()
        looking.join()


def _waited(pid: int) -> float:
    """How long the threads of a process have waited for a processor since they began (s); 0 once it has ended."""
    waited = 0
    for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # that thread has ended
            waited += int(file.read_text().split()[1])
    return waited / 1e9


async def sink_receives(manager: Manager, count: int) -> None:
    """Return when the sink has received so many messages more."""

    async def number() -> int:
        return (await manager.peek("sink")).ports["in"]["/swap"].count

    begin = await number()
    while await number() < begin + count:
        await asyncio.sleep(0.01)


def other_source(manager: Manager, strategy: str = "minimal") -> PlanRequest:
    """Replace the source by the other one."""
    now = manager.specification.nodes["source"].component
    return PlanRequest(replace=(("source", "Source" if now == "OtherSource" else "OtherSource"),), strategy=strategy)


def window(observed: Observation) -> list[Receipt]:
    """The messages that a report counts: from 20 periods before the change to the end of the observation."""
    begun = observed.begun - 20 * PERIOD * 1e9
    return [row for row in observed.rows if begun <= row.received <= observed.ended]


def by_source(rows: Sequence[Receipt]) -> dict[int, Receipt]:
    """Messages by their times of publication, which no two have in common."""
    found = {row.source: row for row in rows if row.source is not None}
    assert len(found) == len(rows)
    return found


def kept_observations(monkeypatch: pytest.MonkeyPatch) -> list[Observation]:
    """Every observation that is reported from now on, in order."""
    seen: list[Observation] = []

    def kept(observation: Observation) -> SwapReport:
        seen.append(observation)
        return report(observation)

    monkeypatch.setattr(subscriber_recording, "report", kept)
    return seen

"""One scenario of benchmarks/control_plane.py, with the version of Midstride that this Python imports.

Prints a JSON object: figure -> samples, in seconds unless the figure's name says otherwise.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from midstride.model.component import DEFAULT_STOP
from midstride.runtime.records.reports import Event

HERE = Path(__file__).resolve().parent
NODES = HERE / "_control_plane_nodes.py"
Samples = dict[str, list[float]]


class Plane:
    """The control plane, for one worker."""

    def backend(self, name: str, workspace: Any) -> Any:
        from midstride import backends

        return backends.make(name, workspace)

    def connect(self, backend: Any, token: str) -> None:
        """Use ``backend`` without a manager."""
        from midstride.runtime.process.component_client import ComponentClient

        self._client = ComponentClient(backend.transport, backend.clock, token)

    def connect_manager(self, manager: Any) -> None:
        """Use what a manager uses."""
        self._client = manager._client

    async def ping(self, instance: str, timeout: float) -> None:
        """Raises BackendError where no reply comes."""
        from midstride.wire.commands import PingCommand

        await self._client.read(instance, PingCommand())

    def request(self, **wanted: Any) -> Any:
        from midstride.plan.request import PlanRequest

        return PlanRequest(**wanted)

    def outcome(self, result: Any) -> tuple[str, str | None]:
        return result.outcome, result.because

    def events(self, manager: Any, since: int) -> list[Event]:
        return list(manager.events.since(since))


def specification(nodes: str) -> Any:
    from midstride.lang.load import load_text

    return load_text(specification_text(nodes), "control_plane.stride").require()


def specification_text(nodes: str) -> str:
    run = f"python3 {shlex.quote(str(NODES))}"
    sources = "".join(
        f"""
component {name} {{
  run "{run} source {name}"
  output out
  functionality talk {{
    produces out
    mode normal {{ guarantee out : Ticks }}
    mode degraded {{ }}
  }}
}}"""
        for name in ("Source", "OtherSource")
    )
    return f"""
system control_plane_benchmark
contract Ticks = std_msgs/msg/String @ 50 Hz
contract Text = std_msgs/msg/String
{sources}
component Sink {{
  run "{run} sink"
  input in : Ticks
  functionality listen {{ uses in
    mode normal {{ assume in }}
    mode degraded {{ }} }}
}}
component Head {{
  run "{run} head"
  output out
  functionality work {{ produces out
    mode normal {{ guarantee out : Text }}
    mode degraded {{ }} }}
}}
component Link {{
  run "{run} link"
  input in : Text
  output out
  functionality work {{ uses in
    produces out
    mode normal {{ assume in
      guarantee out : Text }}
    mode degraded {{ }} }}
}}
{nodes}
"""


def pair() -> Any:
    """A source at 50 Hz and a sink."""
    return specification(
        "topic /ticks : Ticks\nnode source : Source { out -> /ticks }\nnode sink : Sink { in <- /ticks }"
    )


def chain(length: int) -> Any:
    """Components in a row, on topics on which nothing is ever written."""
    topics = [f"topic /t{index} : Text" for index in range(length)]
    nodes = ["node n0 : Head { out -> /t0 }"]
    nodes += [f"node n{i} : Link {{ in <- /t{i - 1}\n out -> /t{i} }}" for i in range(1, length)]
    return specification("\n".join(topics + nodes))


async def until(attempt: Callable[[], Awaitable[None]], deadline: float) -> float:
    """The steady time at which ``attempt`` first succeeds; repeated after 5 ms."""
    from midstride.errors import BackendError

    while True:
        try:
            await attempt()
            return time.monotonic()
        except BackendError:
            if time.monotonic() > deadline:
                raise
        await asyncio.sleep(0.005)


async def first_reply(plane: Any, name: str, folder: Path, times: int) -> Samples:
    """Components started one after another, each asked until it replies."""
    from midstride.runtime.backend_protocol import Launch
    from midstride.runtime.workspace import Workspace

    found: Samples = {"first reply after process start": [], "first reply after end of imports": []}
    marks = folder / "imports"
    os.environ["BENCHMARK_IMPORTS"] = str(marks)
    backend = plane.backend(name, Workspace(folder))
    await backend.open(lambda *_: None)
    plane.connect(backend, "a token")
    await asyncio.sleep(1.0)
    try:
        for number in range(times):
            instance, arguments = f"source{number}", ("python3", str(NODES), "source")
            marks.unlink(missing_ok=True)
            begun = time.monotonic()
            await backend.start(Launch(instance, "", arguments, "a token", HERE))
            replied = await until(lambda i=instance: plane.ping(i, 10.0), begun + 30)  # type: ignore[misc]
            found["first reply after process start"].append(replied - begun)
            found["first reply after end of imports"].append(replied - int(marks.read_text()) / 1e9)
            await asyncio.sleep(0.5)
            await backend.end(instance, DEFAULT_STOP)
    finally:
        await backend.close()
    return found


class Session:
    """A manager with its system."""

    def __init__(self, plane: Any, name: str, folder: Path, specification: Any, **options: Any) -> None:
        from midstride.runtime.manager import Manager
        from midstride.runtime.workspace import Workspace

        workspace = Workspace(folder)
        self.plane = plane
        self.manager = Manager(specification, plane.backend(name, workspace), workspace, HERE, **options)

    async def __aenter__(self) -> Session:
        begun = time.monotonic()
        await self.manager.up()
        self.up = time.monotonic() - begun
        self.plane.connect_manager(self.manager)
        return self

    async def __aexit__(self, *_: object) -> None:
        try:
            await self.manager.down()
        finally:
            await self.manager.close()

    def events(self, since: int = 0) -> list[Event]:
        found: list[Event] = self.plane.events(self.manager, since)
        return found

    async def change(self, **request: Any) -> list[Event]:
        """Carry a change out; its events."""
        last = self.events()[-1].n
        outcome, because = self.plane.outcome(await self.manager.change(self.plane.request(**request)))
        if outcome != "done":
            raise SystemExit(f"{request}: {outcome}: {because}")
        return self.events(last)

    def pids(self) -> list[int]:
        return [handle.pid for handle in self.manager.system.life.handles.values()]


def steps(events: list[Event]) -> list[tuple[str, float, float]]:
    """Each step in words, when it began and when it was done."""
    begun = [event for event in events if event.kind == "step"]
    done = [event for event in events if event.kind == "step_done"]
    return [(event.words, event.at, end.at) for event, end in zip(begun, done, strict=True)]


def creation(events: list[Event]) -> tuple[float, float]:
    """When the only creation began and was done."""
    ((begun, done),) = [(begun, done) for words, begun, done in steps(events) if " create " in words]
    return begun, done


async def life(plane: Any, name: str, folder: Path, times: int) -> Samples:
    """A source and a sink: round trips, restarts after kill -9, replacements."""
    found: Samples = {
        "create": [],
        "restart: create, same name": [],
        "restart: kill to registered": [],
        "replace: command to last step": [],
        "round trip": [],
    }
    async with Session(plane, name, folder, pair()) as session:
        for _ in range(100):
            await plane.ping("sink", 3.0)
        for _ in range(1000):
            begun = time.perf_counter()
            await plane.ping("sink", 3.0)
            found["round trip"].append(time.perf_counter() - begun)
        for _ in range(times):
            seen = session.events()[-1].n
            killed = time.time()
            os.kill(session.manager.system.life.handles["source"].pid, signal.SIGKILL)
            while not any(event.kind == "exited" for event in session.events(seen)):
                await asyncio.sleep(0.001)
            begun, done = creation(await session.change(to=session.manager.specification))
            found["restart: create, same name"].append(done - begun)
            found["restart: kill to registered"].append(done - killed)
        for number in range(times):
            asked = time.time()
            events = await session.change(replace=(("source", ("OtherSource", "Source")[number % 2]),))
            begun, done = creation(events)
            found["create"].append(done - begun)
            found["replace: command to last step"].append(steps(events)[-1][2] - asked)
    return found


async def many(plane: Any, name: str, folder: Path, nodes: int, seconds: float) -> Samples:
    """``up`` of many nodes, and the processor time that they take while nothing happens."""
    async with Session(plane, name, folder, chain(nodes)) as session:
        await asyncio.sleep(10.0)
        before = processor_time(session.pids()), processor_time([os.getpid()])
        await asyncio.sleep(seconds)
        after = processor_time(session.pids()), processor_time([os.getpid()])
    return {
        f"up of {nodes} nodes": [session.up],
        f"{nodes} idle components, % of a core": [100 * (after[0] - before[0]) / seconds],
        f"manager of {nodes} idle components, % of a core": [100 * (after[1] - before[1]) / seconds],
    }


async def bare(plane: Any, name: str, folder: Path, nodes: int, seconds: float) -> Samples:
    """The processor time of nodes without Midstride, while nothing happens."""
    from midstride.runtime.workspace import Workspace

    found: Samples = {}
    backend = plane.backend(name, Workspace(folder))
    await backend.open(lambda *_: None)  # on ROS 1, this starts a master
    try:
        for words, python, environment in bare_settings(name):
            commands = [[python, str(NODES), "bare", str(number)] for number in range(nodes)]
            environment["MIDSTRIDE_BACKEND"] = name
            processes = [subprocess.Popen(command, env=environment) for command in commands]
            try:
                await asyncio.sleep(10.0 + nodes / 5)  # they all start at once
                before = processor_time([process.pid for process in processes])
                await asyncio.sleep(seconds)
                after = processor_time([process.pid for process in processes])
            finally:
                for process in processes:
                    process.kill()
                    process.wait()
            found[f"{nodes} idle bare nodes, {words}, % of a core"] = [100 * (after - before) / seconds]
    finally:
        await backend.close()
    return found


def bare_settings(name: str) -> list[tuple[str, str, dict[str, str]]]:
    """In words, the interpreter, the environment."""
    if name == "ros2":
        from _tuned import tuned_environment

        # The first node of this process has read the profile: the environment is as it was.
        return [
            ("settings of `up`", sys.executable, tuned_environment(dict(os.environ))),
            ("ROS's defaults", sys.executable, dict(os.environ)),
        ]
    from midstride.backends.ros1 import launching

    python, uri = launching.require_interpreter(), launching.master_uri(os.environ)
    return [("as they are", python, launching.environment(os.environ, uri))]


def processor_time(pids: list[int]) -> float:
    """Of these processes together (s); without psutil, which an earlier version did not need."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


async def paused(plane: Any, name: str, folder: Path, nodes: int, seconds: float) -> Samples:
    """Components that were stopped, and continued after a while: how long until each answers again."""
    # On ROS 2 in domains of 25: the earlier version does not bring up many more in one.
    sizes = [25] * (nodes // 25) if name == "ros2" else [nodes]
    domain = int(os.environ["ROS_DOMAIN_ID"])
    async with contextlib.AsyncExitStack() as stack:
        planes: list[Any] = []
        pids: list[int] = []
        pings = []
        for number, size in enumerate(sizes):
            os.environ["ROS_DOMAIN_ID"] = str(domain + number)
            (folder / str(number)).mkdir()
            planes.append(type(plane)())
            session = await stack.enter_async_context(Session(planes[-1], name, folder / str(number), chain(size)))
            pids += session.pids()
            pings += [(planes[-1], instance) for instance in session.manager.system.life.handles]
        await asyncio.sleep(2.0)
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        await asyncio.sleep(seconds)
        continued = time.monotonic()
        for pid in pids:
            os.kill(pid, signal.SIGCONT)

        async def answered(plane: Any, instance: str) -> float | None:
            from midstride.errors import BackendError

            try:
                return await until(lambda: plane.ping(instance, 1.0), continued + 60) - continued
            except BackendError:
                return None

        times = await asyncio.gather(*(answered(*ping) for ping in pings))
        answers = [each for each in times if each is not None]
    return {
        f"answer of each of {nodes} after {seconds:g} s of SIGSTOP": answers,
        f"answer of the last of {nodes} after {seconds:g} s of SIGSTOP": [max(answers)],
        f"of {nodes} without an answer within 60 s, number": [len(times) - len(answers)],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", choices=("first", "life", "many", "bare", "paused"))
    parser.add_argument("--backend", choices=("ros2", "ros1"), required=True)
    parser.add_argument("--times", type=int, required=True)
    parser.add_argument("--nodes", type=int, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    options = parser.parse_args()
    plane = Plane()
    # Short: an earlier version keeps sockets in it.
    with tempfile.TemporaryDirectory(prefix="ms") as name:
        folder = Path(name)
        scenarios = {
            "first": lambda: first_reply(plane, options.backend, folder, options.times),
            "life": lambda: life(plane, options.backend, folder, options.times),
            "many": lambda: many(plane, options.backend, folder, options.nodes, options.seconds),
            "bare": lambda: bare(plane, options.backend, folder, options.nodes, options.seconds),
            "paused": lambda: paused(plane, options.backend, folder, options.nodes, options.seconds),
        }
        print(json.dumps(asyncio.run(scenarios[options.scenario]())))


if __name__ == "__main__":
    main()

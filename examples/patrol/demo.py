"""``midstride demo patrol``: two minutes of patrol, in which everything happens that the README lists.

The robot and its hall run on ROS 2, or on the simulator. What the table at the end counts is measured by the hall,
which knows nothing of Midstride, except for the modes and for the messages that were missed. On ROS 2, a bag of it is
checked besides, by a program that knows nothing of Midstride either.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from rich.console import Console
from rich.live import Live

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bag
import picture

from midstride.backends.simulator import Simulator
from midstride.cli.demo_environment import DemoEnvironment, demo_environment
from midstride.cli.demo_runner import cancelled_by_signals
from midstride.cli.example import Demo, matching
from midstride.errors import MidstrideError
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.status_forms import Status
from midstride.simulation.killable_manager import Life

# How long each event is watched at least, and the robot before the first (s); how often it is looked at.
WATCHED, RUN_IN, LOOK = 9.0, 6.0, 0.25
NOTICED, ABSENT = 2.0, 4.0
ORDER = ("full", "slow", "creep", "stop")
RESPAWNED = "restarted by its policy"

Act: TypeAlias = Callable[[DemoEnvironment], Awaitable[Outcome | str]]


async def run(example: Demo, backend: str, out: Console, only: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Run it; what was seen during each event. ``outcome`` is `done` where it came to what it should, and hit nothing.

    ``only``: what has to be in the names of the events. Raises CancelledError on SIGINT and SIGTERM, UsageError.
    """
    events = matching(EVENTS, only)
    world = example.specification.nodes["world"]
    kept = bag.kept()
    with cancelled_by_signals() as interrupted:
        async with demo_environment(example, backend) as environment:
            trace = environment.workspace.path / "trace.jsonl"
            traced = replace(world, parameters=world.parameters.set("trace", str(trace)))
            environment.use(example.specification.with_node(traced))
            recorded = bag.Bag(kept or environment.workspace.path / "bag") if backend == "ros2" else None
            show = Show(environment, trace, out, recorded)
            out.print(f"[bold]{example.title}[/bold]  [dim](examples/patrol, on {backend})[/dim]")
            try:
                async with show.shown():
                    show.words = "coming up"
                    if recorded is not None:
                        await recorded.open()
                    await environment.manager.up()
                    await asyncio.sleep(RUN_IN)
                    for name in events:
                        await show.event(name, *EVENTS[name])
                        if interrupted.is_set():  # while a change was measured, which completes it
                            raise asyncio.CancelledError
                checked = "" if recorded is None else await show.check(recorded)
            finally:
                if recorded is not None:
                    await recorded.end()
            out.print(picture.result(show.rows))
            out.print(checked)
    return show.rows


@dataclass
class Show:
    """Looks at the robot all the time, and keeps what is needed for the table."""

    environment: DemoEnvironment
    trace: Path
    out: Console
    recorded: bag.Bag | None = None
    words: str = ""
    state: dict[str, Any] | None = None
    modes: dict[str, str] = field(default_factory=dict)  # what is not in its normal mode
    rows: list[dict[str, Any]] = field(default_factory=list)
    _read: int = 0
    _row: dict[str, Any] = field(default_factory=dict)

    @contextlib.asynccontextmanager
    async def shown(self) -> AsyncIterator[None]:
        live = Live(console=self.out, auto_refresh=False, transient=True) if self.out.is_terminal else None

        async def look() -> None:
            while True:
                self._follow()
                await self._ask()
                if live is not None:
                    live.update(picture.panel(self.state, self.modes, self.words), refresh=True)
                await asyncio.sleep(LOOK)

        with live or contextlib.nullcontext():
            looking = asyncio.ensure_future(look())
            try:
                yield
            finally:
                looking.cancel()
                await asyncio.gather(looking, return_exceptions=True)

    async def event(self, name: str, act: Act, expected: str) -> None:
        """Carry out ``act``, and watch the robot until it is as good as before, for ``WATCHED`` seconds at least."""
        clock = self.environment.backend.clock
        self.words, begun, at = name, clock.steady(), time.time()
        self._row = {"name": name, "slowest": "full", "degraded": 0.0, "uncommanded": 0.0, "near_misses": 0}
        self._row |= {"collisions": 0, "missed": None}
        try:
            came_to = await act(self.environment)
        except MidstrideError as error:
            came_to = f"failed: {error}"
        seen = came_to
        if isinstance(came_to, Outcome):
            missed = [swap.missed for swap in came_to.swaps if swap.missed is not None]
            self._row["missed"] = sum(missed) if missed else None
            came_to = came_to.outcome
        while clock.steady() < begun + WATCHED or (self.modes and clock.steady() < begun + 3 * WATCHED):
            await asyncio.sleep(LOOK)
        if self.recorded is not None:
            self.recorded.event(name, at, seen)
        self._row["came_to"] = came_to
        self._row["outcome"] = "done" if came_to == expected and not self._row["collisions"] else "failed"
        self.rows.append(self._row)
        if not self.out.is_terminal:
            self.out.print(f"{name}: {came_to}")
        self._row = {}

    async def check(self, recorded: bag.Bag) -> str:
        """Put what the bag says into the rows. An event during which something does not hold has failed."""
        found, whole = await recorded.check()
        for row in self.rows:
            row["bag"] = found[row["name"]]
            counts = any(row["bag"][kind] for kind in ("lost", "interleaved", "silence"))
            if counts or row["bag"]["moved_blind"] > bag.REACTION:
                row["outcome"] = "failed"
        return bag.verdict(whole)

    def _follow(self) -> None:
        """Read what the hall has written since."""
        if not self.trace.exists():
            return
        with self.trace.open(encoding="utf-8") as file:
            file.seek(self._read)
            while (line := file.readline()).endswith("\n"):
                self._read += len(line.encode())
                state, before = json.loads(line), self.state
                if self._row and before is not None:
                    for each in ("collisions", "near_misses"):
                        self._row[each] += state[each] - before[each]
                    self._row["uncommanded"] += 0.0 if state["commanded"] else state["time"] - before["time"]
                self.state = state

    async def _ask(self) -> None:
        manager = self.environment.manager
        with contextlib.suppress(MidstrideError):
            status = await manager.status()
            self.modes = {entry.name: "gone" for entry in status.crashed}
            serving = {component.role: component for component in status.instances if not component.ending}
            for role, component in serving.items():  # of two instances the new one
                for each in component.functionalities:
                    if not each.normal and not _serves(status, role, each.name):
                        self.modes[f"{role}.{each.name}"] = each.mode
        if self._row:
            drive = self.modes.get("controller.drive", "full")
            self._row["slowest"] = max(self._row["slowest"], drive, key=ORDER.index)
            self._row["degraded"] += LOOK * bool(self.modes)


def _serves(status: Status, role: str, functionality: str) -> bool:
    """Whether an instance of ``role`` is in the normal mode: the old one, the new one, or both."""
    of_role = [component for component in status.instances if component.role == role]
    return any(each.normal for one in of_role for each in one.functionalities if each.name == functionality)


# -- what happens -----------------------------------------------------------------------------------------------------


def replaced(*replacements: tuple[str, str]) -> Callable[[DemoEnvironment], Awaitable[Outcome]]:
    async def act(environment: DemoEnvironment) -> Outcome:
        return await environment.manager.change(PlanRequest(replace=replacements))

    return act


def killed(role: str) -> Callable[[DemoEnvironment], Awaitable[str]]:
    async def act(environment: DemoEnvironment) -> str:
        await fault(environment, role, signal.SIGKILL)
        return RESPAWNED

    return act


async def upgraded(environment: DemoEnvironment) -> Outcome:
    """One ``apply``: another driver, another detector, and new processes of the others."""
    target = environment.manager.specification
    for role, component in (("lidar", "Lidar"), ("camera_detector", "CameraDetector")):
        target = target.with_node(replace(target.nodes[role], component=component))
    return await environment.manager.change(PlanRequest(to=target, restart=("camera", "lidar_detector", "fusion")))


async def hung(environment: DemoEnvironment) -> Outcome:
    await fault(environment, "camera_detector", signal.SIGSTOP)
    await asyncio.sleep(NOTICED)
    return await environment.manager.change(PlanRequest(restart=("camera_detector",)), wait=1.0)


async def without_a_manager(environment: DemoEnvironment) -> str:
    """The manager of the demonstration hands over to one that can be killed, which is what happens to it."""
    await environment.manager.close()  # its components keep running
    if isinstance(environment.backend, Simulator):
        life = Life(environment.backend)
        doomed = Manager(environment.manager.specification, life.backend, environment.workspace, environment.folder)
        await doomed.up()
        life.kill()
    else:
        await killed_manager(environment)
    await asyncio.sleep(ABSENT)
    return f"taken over, {(await environment.new_manager()).outcome}"


async def killed_manager(environment: DemoEnvironment) -> None:
    """A manager in its own process takes over, and dies by SIGKILL."""
    arguments = str(environment.workspace.path), environment.backend.name
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(bag.FOLDER / "successor.py"), *arguments, stdout=asyncio.subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        said = (await process.stdout.readline()).decode().strip()
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()
    if said != "done":
        raise MidstrideError(f"the manager that was to be killed did not take over: {said or 'it ended'}")


async def fault(environment: DemoEnvironment, role: str, number: signal.Signals) -> None:
    status = await environment.manager.status()
    component = next(each for each in status.instances if each.role == role)
    if isinstance(environment.backend, Simulator):
        faults = environment.backend.faults
        faults.kill(component.name) if number == signal.SIGKILL else faults.freeze(component.name, 3600.0)
    elif component.pid is not None:
        os.kill(component.pid, number)


# What happens, and what it should come to.
EVENTS: dict[str, tuple[Act, str]] = {
    "the lidar driver is replaced": (replaced(("lidar", "SmoothLidar")), "done"),
    "the detector moves to another": (replaced(("camera_detector", "LargeDetector")), "done"),
    "the perception is upgraded": (upgraded, "done"),
    "the lidar driver dies": (killed("lidar"), RESPAWNED),
    "the detector hangs": (hung, "done"),
    "the planner is killed": (killed("planner"), RESPAWNED),
    "a bad version is deployed": (replaced(("lidar_detector", "BadDetector")), "rolled_back"),
    "the manager dies": (without_a_manager, "taken over, done"),
}

"""One robot in one hall, in virtual time, with the node code that also runs on ROS 2: for the trials and their tests.

A robot runs either under a manager (``Managed``), or as plain processes that a supervisor starts and restarts
(``Supervised``): the same programs, attached to the same topics, in their best modes from start to end.
"""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.lang.load import load
from midstride.model.component import FunctionalitySpec, InputAlternatives
from midstride.model.specification import Node, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.simulation.killable_manager import Life
from midstride.simulation.loop import SeededLoop, run
from midstride.simulation.simulated_disk import SimulatedDisk
from midstride.simulation.threadless import ThreadlessOnceStarted

T = TypeVar("T")

FOLDER = Path(__file__).resolve().parent
# How long a process takes to start (s), besides what its own code takes to load.
STARTING = 0.6
# How often everything is looked at (s).
SAMPLE = 0.1
# What the controller has heard of obstacles is stale when the scan behind it is older than this (s).
STALE = 0.5


def robot() -> Specification:
    """The robot without its hardware. What has crashed is restored by the trial, and by no policy."""
    specification = load(FOLDER / "on_hardware.stride").require()
    for node in list(specification.nodes.values()):
        specification = specification.with_node(replace(node, respawn=None))
    return specification


@dataclass
class Seen:
    """What a run came to. ``lost``: weighted functionality-seconds; ``blind``: seconds driven on stale obstacles."""

    collisions: int = 0
    near_misses: int = 0
    progress: float = 0.0
    lost: float = 0.0
    blind: float = 0.0
    longest_blind: float = 0.0


class Platform(Simulator):
    """Calls the nodes without threads, once they have come up, on a loop without sockets: it can be forked then.

    It also takes a third of the processor time. What happens at the same moment comes in an order drawn from ``seed``.
    """

    def __init__(self, seed: int) -> None:
        super().__init__(starting=STARTING, seed=seed)
        self._seed = seed

    def _on_loop(self, main: Coroutine[Any, Any, T]) -> T:
        loop = SeededLoop(self._seed)  # type: ignore[abstract]  # it has no sockets and no processes
        try:
            return run(loop, main)
        finally:
            gc.collect()  # the next run begins before it would be done otherwise

    def _process(self, launch: Launch, log: Path | None) -> SimulatedProcess:
        return ThreadlessOnceStarted(launch, self._pids, self.time, self._host, self._exited, log)


class Lab:
    """A simulator with the hall in it. ``state`` is the true state of the hall, once :meth:`open_hall` was called."""

    def __init__(self, specification: Specification, seed: int, people: int = 6) -> None:
        self.specification = specification
        self.simulator = Platform(seed)
        self.seen = Seen()
        self._seed, self._people = seed, people
        self._published: dict[str, float] = {}  # by topic, when last (s)
        self._sighted = 0.0  # when the scan was made that the last obstacles are from
        self._blind_for = 0.0
        deliver = self.simulator.network.publish

        def publish(writer: Any, message: Any) -> None:
            self._published[writer.topic] = self.now()
            if writer.topic == "/obstacles/near":
                stamp = message.header.stamp
                self._sighted = stamp.sec + stamp.nanosec / 1e9
            deliver(writer, message)

        self.simulator.network.publish = publish  # type: ignore[method-assign]

    def now(self) -> float:
        return self.simulator.clock.steady()

    @property
    def state(self) -> Any:
        """The :class:`hall.Hall` of the world's process."""
        return self._module("world")["state"]

    def _module(self, instance: str) -> dict[str, Any]:
        return self.simulator.processes[instance]._program._main.__dict__

    def require_no_errors(self) -> None:
        """Raises RuntimeError where a task on the loop raised whose result was not awaited."""
        loop = self.simulator.time.loop
        assert isinstance(loop, SeededLoop)
        if loop.errors:
            raise RuntimeError(f"in virtual time: {loop.errors[0]}") from loop.errors[0].get("exception")

    async def open_hall(self) -> None:
        await self.start("world", "world.py", _OUTLETS, {"seed": self._seed, "people": self._people}, ("normal",))
        await asyncio.sleep(STARTING + 0.5)

    async def start(
        self, instance: str, file: str, topics: dict[str, str], parameters: dict[str, Any], modes: tuple[str, ...] = ()
    ) -> None:
        """Start a node without a manager, attached to ``topics`` (by port)."""
        attached = [f"{port}:={topic}" for port, topic in topics.items()]
        arguments = ("python3", file, "--standalone", *attached)
        await self.simulator.start(Launch(instance, "", arguments, "supervised", FOLDER, parameters))

    def hang(self, instance: str) -> None:
        """The next call of the code of a detector does not return: it writes by ``scan``, which now waits for ever."""
        process = self.simulator.processes[instance]
        assert isinstance(process, ThreadlessOnceStarted)
        process.let_block()
        self._module(instance)["scan"] = lambda *_: time.sleep(3600.0)

    async def watch(self, seconds: float, level: Callable[[str, FunctionalitySpec], int | None]) -> None:
        """Look at everything for ``seconds``. ``level``: the index of a functionality's mode; None: it does not run."""
        for _ in range(round(seconds / SAMPLE)):
            await asyncio.sleep(SAMPLE)
            state, seen = self.state, self.seen
            epoch = self.simulator.time.ros_now() / 1e9
            stale = abs(state.speed) > 0.05 and epoch - self._sighted > STALE
            self._blind_for = self._blind_for + SAMPLE if stale else 0.0
            seen.blind += SAMPLE * stale
            seen.longest_blind = max(seen.longest_blind, self._blind_for)
            for role, node in sorted(self.specification.nodes.items()):  # sums of floats depend on their order
                for each in self.specification.components[node.component]:
                    index = level(role, each)
                    worst = len(each.modes) - 1
                    levels = worst if index is None else max(index, self._supported(node, each))
                    seen.lost += SAMPLE * float(each.weight) * levels
        seen.collisions, seen.near_misses, seen.progress = state.collisions, state.near_misses, state.progress

    def _supported(self, node: Node, functionality: FunctionalitySpec) -> int:
        """The best mode whose inputs have been heard lately, whatever mode it is in."""
        component = self.specification.components[node.component]

        now, published = self.now(), self._published

        def fresh(port: str) -> bool:
            age = STALE + 1.5 / (component.inputs[port].rate or 1.0)
            return any(now - published.get(topic, -99.0) < age for topic in node.attachments.get(port, ()))

        for index, mode in enumerate(functionality.modes):
            named = [each.inputs for each in mode.assumptions if isinstance(each, InputAlternatives)]
            if all(any(map(fresh, alternatives)) for alternatives in named):
                return index
        return len(functionality.modes) - 1


_OUTLETS = {"cmd": "/cmd_vel"} | {name: f"/device/{name}" for name in ("lidar", "camera", "wheels", "bumper", "cells")}


class Managed:
    """The robot under a manager, which plans with ``strategy``."""

    def __init__(self, lab: Lab, folder: Path, strategy: str = "minimal") -> None:
        self.lab, self.strategy = lab, strategy
        self._workspace = Workspace(folder)
        self._disk = SimulatedDisk()
        self.life: Life
        self.manager: Manager

    async def up(self) -> None:
        self.life = self._disk.life = Life(self.lab.simulator)
        saved = StateStore(self._workspace.state, disk=self._disk).load()
        declared = self.lab.specification if saved is None else saved.specification
        self.manager = Manager(declared, self.life.backend, self._workspace, FOLDER, disk=self._disk)
        await self.manager.up()

    async def change(self, *replacements: tuple[str, str]) -> Outcome:
        return await self.manager.change(PlanRequest(replace=replacements, strategy=self.strategy), wait=1.0)

    async def restore(self, role: str, hangs: bool) -> Outcome:
        """What a person does about a node that has died, or hangs."""
        if hangs:
            return await self.manager.change(PlanRequest(restart=(role,), strategy=self.strategy), wait=1.0)
        target = self.manager.specification
        return await self.manager.change(PlanRequest(to=target, strategy=self.strategy), wait=1.0)

    def instance(self, role: str) -> str:
        return next((name for name, each in self.manager.configuration.instances.items() if each.role == role), role)

    def level(self, role: str, functionality: FunctionalitySpec) -> int | None:
        state = (
            self.lab.simulator.state(name) if (name := self.instance(role)) in self.lab.simulator.processes else None
        )
        mode = None if state is None else state.functionalities[functionality.name].mode
        return None if mode is None else functionality.mode_index(mode)

    async def close(self) -> None:
        self.life.kill()
        self.life.bury()


class Supervised:
    """The robot as plain processes: each node attached by its arguments, as by remappings in a launch file.

    ``timeout`` (s; 0: none) is the controller's own: it stops where the last obstacles arrived longer ago.
    """

    def __init__(self, lab: Lab, timeout: float = 0.0) -> None:
        self.lab, self.timeout = lab, timeout

    async def up(self) -> None:
        await self.lab.simulator.open(lambda exited: None)
        for role in self.lab.specification.nodes:
            await self.start(role)
        await asyncio.sleep(7.0)  # what loads longest has come up

    async def start(self, role: str, component: str | None = None) -> None:
        node = self.lab.specification.nodes[role]
        declared = self.lab.specification.components[component or node.component]
        topics = {port: topics[0] for port, topics in node.attachments.items()}
        parameters = {name: each.value for name, each in declared.parameters.items()}
        if role == "controller":
            parameters["timeout"] = self.timeout
        await self.lab.start(role, str(declared.run).split()[-1], topics, parameters)

    async def restart(self, role: str, component: str | None = None) -> None:
        """Kill it, and start it or another one in its place."""
        if role in self.lab.simulator.processes:
            self.lab.simulator.faults.kill(role)
        await self.start(role, component)

    def level(self, role: str, functionality: FunctionalitySpec) -> int | None:
        return 0 if role in self.lab.simulator.processes else None

    async def close(self) -> None:
        """What runs ends with the simulator."""

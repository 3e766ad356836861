"""One mission of SUAVE in virtual time: the manager and the node code that run on a robot, on a simulated platform."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from immutables import Map

from midstride.backends.simulator.backend import Simulator
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.lang import load
from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Handle, Launch
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from midstride.simulation.loop import SeededLoop, run
from midstride.simulation.simulated_disk import SimulatedDisk
from midstride.simulation.threadless import ThreadlessProcess

FOLDER: Final = Path(__file__).parent
# Where the vehicle starts (m): SUAVE's published runs used six positions, for five runs each.
STARTS: Final = (2.80, 3.15, 3.28, 2.59, 3.31, 3.17)
RUNS: Final = 30
TIME_LIMIT: Final = 250.0
# How long a mission may take beyond its limit, until its row is written (s).
REST: Final = 20.0


@dataclass(frozen=True)
class Scenario:
    """``shift``: of the visibility's period (s). ``failure``: when thruster 1 fails, and then 3 (s of the mission)."""

    seed: int
    y: float
    lowest: float = 2.5
    highest: float = 2.5
    shift: float = 0.0
    failure: float | None = None
    time_limit: float = TIME_LIMIT


def scenario(experiment: int, number: int) -> Scenario:
    """Run ``number``, from 0, of experiment 1 (thrusters fail), 2 (visibility changes), or 3 (both)."""
    drawn = random.Random(f"suave {experiment} {number}")
    shift, failure, seed = drawn.uniform(0.0, 120.0), 100.0 + drawn.uniform(-100.0, 100.0), drawn.getrandbits(32)
    each = Scenario(seed, STARTS[number * len(STARTS) // RUNS % len(STARTS)])
    if experiment != 1:
        each = replace(each, lowest=1.25, highest=3.75, shift=shift)
    return each if experiment == 2 else replace(each, failure=failure)


# A component that reads the diagnostics, and its parameters. Only that of Midstride leaves the choice to the model.
Managing = tuple[str, dict[str, Any]]
MIDSTRIDE: Final[Managing] = ("DiagnosticsReader", {})


def managing(system: str, experiment: int, number: int, metacontrol: Path | None = None) -> Managing:
    """What manages the vehicle in that run: ``midstride``, a hand-written ``tree``, ``metacontrol``, or ``none``."""
    if system == "tree":
        return "BehaviourTree", {"phase": random.Random(f"tree {experiment} {number}").uniform(0.0, 0.09)}
    if system == "metacontrol":
        return "Metacontrol", {"folder": str(metacontrol)}
    if system == "none":  # SUAVE's baseline searches at 2 m in the first experiment, and at 1 m in the others
        return "BehaviourTree", {"adapts": False, "fixed": 2.25 if experiment == 1 else 1.25}
    return MIDSTRIDE


def specification(scenario: Scenario, component: str, parameters: dict[str, Any]) -> Specification:
    """The system of ``suave.stride`` with the parameters of that run, and ``component`` as its diagnostics' reader."""
    failure = scenario.failure
    events = [] if failure is None else [f"({thruster}, failure, {failure:.3f})" for thruster in (1, 3)]
    values: dict[str, dict[str, Any]] = {
        "vehicle": {"y": scenario.y},
        "water_visibility": {"lowest": scenario.lowest, "highest": scenario.highest, "shift": scenario.shift},
        "thruster_monitor": {"events": events or [""]},
        "mission_node": {"time_limit": scenario.time_limit},
        "diagnostics_reader": parameters,
    }
    system = load(FOLDER / "suave.stride").require()
    nodes = {name: replace(node, parameters=Map(values.get(name, {}))) for name, node in system.nodes.items()}
    nodes["diagnostics_reader"] = replace(nodes["diagnostics_reader"], component=component)
    return replace(system, nodes=Map(nodes))


class Platform(Simulator):
    """Calls the nodes without threads, and starts them at drawn moments, so that no two of them keep step."""

    async def start(self, launch: Launch) -> Handle:
        self.starting = 0.05 + self.network.random.uniform(0.0, 1.0)
        return await super().start(launch)

    def _process(self, launch: Launch, log: Path | None) -> SimulatedProcess:
        if launch.node == "diagnostics_reader":  # Metacontrol's reasoner sleeps
            return super()._process(launch, log)
        return ThreadlessProcess(launch, self._pids, self.time, self._host, self._exited, log)


async def _mission(system: Specification, simulator: Simulator, time_limit: float) -> dict[str, Any]:
    manager = Manager(system, simulator, Workspace(Path("suave")), FOLDER, disk=SimulatedDisk())
    await manager.up()
    try:
        deadline = simulator.clock.steady() + time_limit + REST
        while "result" not in (log := simulator.log("mission_metrics")):
            if simulator.clock.steady() > deadline:
                raise TimeoutError(f"the mission has not ended: {log}")
            await asyncio.sleep(1.0)
        row: dict[str, Any] = json.loads(log.partition("result ")[2].partition("\n")[0])
        return row
    finally:
        await manager.down()
        await simulator.shutdown()


def simulate(
    scenario: Scenario,
    managing: Managing = MIDSTRIDE,
    watch: Callable[[Simulator], None] = lambda simulator: None,
) -> dict[str, Any]:
    """The row of the mission, as SUAVE's metrics have it. The same scenario is the same run."""
    loop = SeededLoop(scenario.seed)  # type: ignore[abstract]
    simulator = Platform(jitter=0.0005, seed=scenario.seed)
    simulator.time.follow(loop)
    watch(simulator)
    return run(loop, _mission(specification(scenario, *managing), simulator, scenario.time_limit))

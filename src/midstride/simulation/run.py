"""One seed: a system is brought up, faults strike while it is changed, they end, and everything must converge."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import hashlib
import logging
import math
import random
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any, Final

from midstride.errors import BackendError, MidstrideError
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Specification, initial
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.observed_configuration import reported_modes
from midstride.runtime.reports import Event
from midstride.runtime.state_store import SavedState, StateStore
from midstride.runtime.workspace import Workspace
from midstride.simulation import loop as seeded
from midstride.simulation.disk import SimulatedDisk
from midstride.simulation.faults import LATE, OF_THE_MANAGER, Fault, draw, strike
from midstride.simulation.invariants import Invariants
from midstride.simulation.lives import Life, ManagerKilled
from midstride.simulation.oracle import Oracle
from midstride.simulation.platform import Platform
from midstride.simulation.scenario import Scenario, rover
from midstride.simulation.stand_in import StandIn

# How long (s) a change may take that faults strike, and a system to converge once they are over.
LONGEST_CHANGE: Final = 600.0
# How long a functionality may stay in a mode whose assumption is broken, where the manager is free to react (s), and
# where a component has refused what it was asked: it is asked again.
REACTION: Final = 0.25
REACTION_IF_REFUSED: Final = 2.0
# How long to wait after the last command, for reports and messages to arrive (s).
SETTLING: Final = 0.4
# Where a write kills the manager: at any, or at one that records what has just been started or removed, or is done.
TABLES: Final = ("", "", "instances", "changes")
# Names the files of the simulated disk.
_WORKSPACE: Final = Workspace(Path("simulated"))


@dataclass
class Struck:
    """A fault that struck, the kind of the step in progress then, and what the manager did afterwards."""

    fault: str
    step: str
    branches: list[str] = field(default_factory=list)


@dataclass
class _Superseded:
    """A manager that was cut off, and what its lease was. ``acts``: another one has the lease, and it is back."""

    life: Life
    lease: str
    acts: bool = False


@dataclass
class SeedRun:
    """What came of a seed. ``problems`` are the violated invariants; ``digest`` is the same for the same run."""

    seed: int
    problems: list[str]
    timeline: list[str]
    digest: str
    outcomes: list[str]
    struck: list[Struck]
    seconds: float


def simulate(seed: int, scenario: Scenario | None = None) -> SeedRun:
    """Run one seed, of the built-in scenario or another."""
    return Simulation(seed, scenario).run()


class Simulation:
    """One run of one seed."""

    def __init__(self, seed: int, scenario: Scenario | None) -> None:
        self._random = random.Random(seed)
        self._seed = seed
        self._scenario = scenario or rover(self._random)
        # Whether another command waits for each change, which then measures for three periods instead of twenty.
        self._brief = self._random.random() < 0.8
        self._faults = draw(self._random, self._scenario.steps())
        # What it does not implement, sockets and processes, the simulation does not have.
        self._loop = seeded.SeededLoop(self._random.getrandbits(32))  # type: ignore[abstract]
        self._lives: list[Life] = []
        self._platform = Platform(self._random.getrandbits(32), self._on_change)
        oracle = Oracle(self._scenario.specifications())
        self._invariants = Invariants(
            self._platform, oracle, self._reaction, self._punctual, self._uninterrupted, self._violated
        )
        self._platform.network.on_publish = self._invariants.on_publish
        self._platform.control.before_request = self._before_request
        self._disk = SimulatedDisk()
        self._manager: Manager | None = None
        self._step = "none"
        self._since: dict[str, int] = {}  # requests since the change began, and since the first step of each kind
        self._waiting: list[Fault] = []
        self._struck: list[Struck] = []
        self._waiting_command: asyncio.Task[None] | None = None
        self._superseded: _Superseded | None = None
        self._busy = False
        self._faulty = False
        self._problems: list[str] = []
        self._timeline: list[str] = []
        self._outcomes: list[str] = []

    def run(self) -> SeedRun:
        logging.disable(logging.CRITICAL)
        gc.disable()  # finalizers would be called at moments that differ from run to run; and it takes time
        try:
            seeded.run(self._loop, self._supervised())
        except BackendError as error:
            self._violated(str(error))
        finally:
            gc.enable()
            logging.disable(logging.NOTSET)
        text = "\n".join([*self._timeline, str(sorted(self._invariants.heard.items()))])
        return SeedRun(
            self._seed,
            self._problems,
            self._timeline,
            hashlib.sha256(text.encode()).hexdigest()[:16],
            self._outcomes,
            self._struck,
            self._platform.time.steady(),
        )

    # -- what happens ------------------------------------------------------------------------------

    async def _supervised(self) -> None:
        try:
            await self._main()
        except MidstrideError as error:
            self._violated(f"{type(error).__name__}: {error}")
        finally:
            for life in self._lives:
                life.bury()
            await self._platform.shutdown()

    async def _main(self) -> None:
        self._platform.time.follow(self._loop)
        if any(fault.kind == "clock jump" for fault in self._faults):
            self._platform.time.drive(1.0)
        self._loop.after_each = self._invariants.check
        await self._up()
        await asyncio.sleep(0.3)
        self._note("faults", "on: " + "; ".join(map(str, self._faults)))
        self._waiting, self._faulty = list(self._faults), True
        self._since, self._step = {"change": 0}, "none"
        for request in self._scenario.changes:
            await self._change(request)
        self._note("faults", "off")
        self._waiting, self._faulty = [], False
        self._disk.full, self._disk.kill_at = False, None
        self._platform.heal()
        if self._superseded is not None:
            self._superseded.life.kill()
        await self._converge()

    async def _up(self) -> None:
        """A new manager, which brings the system up or takes it over."""
        life = Life(self._platform)
        self._disk.life = life
        manager = Manager(self._declared(), life.backend, _WORKSPACE, _WORKSPACE.path, disk=self._disk)
        self._lives.append(life)
        self._manager = manager
        record = manager.events.on_event

        def on_event(event: Event) -> None:
            record(event)
            if self._superseded is not None and self._superseded.life is life:
                self._on_superseded_event(event, self._superseded)
            elif life.alive:
                self._on_event(event)

        manager.events.on_event = on_event
        try:
            await self._ended(life, manager.up())
        except MidstrideError:
            life.kill()  # its process ends
            raise

    async def _ended(self, life: Life, command: Any) -> Any:
        """The result of a command; None where its manager is killed meanwhile."""
        task = asyncio.ensure_future(command)
        begun = self._platform.time.steady()
        self._busy = True
        try:
            while not task.done():
                await asyncio.wait({task}, timeout=0.1)
                if not life.alive:
                    self._note("manager", "killed")
                    self._reached("manager killed")
                    return None
                if life.cut_off is not None:
                    task.add_done_callback(lambda task: task.cancelled() or task.exception())  # retrieved
                    self._note("manager", "cut off")
                    return None
                if self._platform.time.steady() - begun > LONGEST_CHANGE:
                    self._violated(f"a command has not ended after {LONGEST_CHANGE:g} s")
                    task.cancel()
                    return None
            return task.result()
        except ManagerKilled:
            self._note("manager", "killed")
            self._reached("manager killed")
            return None
        finally:
            self._busy = False

    async def _change(self, request: PlanRequest) -> None:
        assert self._manager is not None
        life, manager = self._lives[-1], self._manager
        outcome = await self._ended(life, manager.change(request, brief=self._brief))
        if outcome is not None:
            self._outcomes.append(outcome.outcome)
            self._note("outcome", f"{outcome.outcome}: {outcome.because}" if outcome.because else outcome.outcome)
            self._reached(outcome.outcome)
            return
        self._outcomes.append("killed" if life.cut_off is None else "superseded")
        await asyncio.sleep(self._random.choice((0.05, 0.5, 2.0)))
        try:
            await self._up()
            self._reached("recovered")
        except MidstrideError as error:
            self._note("up", f"failed: {error}")

    async def _converge(self) -> None:
        """Without faults: the system must be as specified after at most two commands of a user."""
        if not self._lives[-1].alive or not self._is_up():
            try:
                await self._up()
            except MidstrideError as error:  # a process that was started before the faults ended
                self._note("up", f"failed: {error}")
                await self._up()
        await asyncio.sleep(SETTLING)
        manager = self._manager
        assert manager is not None
        if not self._has_struck("full disk"):  # what was refused is written with the next write
            running = {process.instance for process in self._platform.stand_ins()}
            if unrecorded := running - set(self._recorded()):
                self._violated(f"{sorted(unrecorded)} run, and are not saved")
        if self._outcomes[-1] == "rolled_back":
            for name in self._closed():
                self._violated(f"{name} is closed after a roll-back")
        request = self._again(manager)
        outcome = await self._ended(self._lives[-1], manager.change(request, brief=self._brief))
        if outcome is None or outcome.outcome != "done":
            because = "the manager is dead" if outcome is None else outcome.because
            self._violated(f"without faults, `{request.describe()}` is not done: {because}")
            return
        await asyncio.sleep(SETTLING)
        for problem in self._differences(manager):
            self._violated(f"not converged: {problem}")
        for change in (await manager.history(10)).changes:
            if change.outcome is None:
                self._violated(f"not converged: `{change.command}` has no outcome in the journal")
        for problem in self._uncaught():
            self._violated(problem)

    def _again(self, manager: Manager) -> PlanRequest:
        """What a user asks for now: the last change again if it was not done, else what is missing."""
        if self._outcomes[-1] == "done":
            return PlanRequest(to=manager.specification)
        request = self._scenario.changes[-1]
        if request.restart:
            return PlanRequest(to=manager.specification, restart=request.restart)
        return PlanRequest(to=request.target(self._scenario.specification), strategy=request.strategy)

    def _is_up(self) -> bool:
        return self._manager is not None and any(event.kind == "up" for event in self._manager.log())

    # -- what must hold at the end -----------------------------------------------------------------

    def _differences(self, manager: Manager) -> list[str]:
        """Where what runs, the manager's model, its saved state and the specification differ."""
        found = []
        configuration, expected = manager.configuration, initial(manager.specification)
        processes = {process.instance: process for process in self._platform.stand_ins()}
        if sorted(processes) != sorted(configuration.instances):
            found.append(f"{sorted(processes)} run, the model has {sorted(configuration.instances)}")
        roles = {role: len(names) for role, names in configuration.instances_by_role.items() if names}
        if roles != dict.fromkeys(manager.specification.nodes, 1):
            found.append(f"instances by role: {roles}")
        for name, process in processes.items():
            instance = configuration.instances.get(name)
            if instance is None or process.state is None:
                continue
            for ref, index in reported_modes(instance.component, process.state).items():
                if index != configuration.modes[ref]:
                    found.append(f"{ref} is in mode {index}, the model has {configuration.modes[ref]}")
                best = expected.modes[FunctionalityRef(instance.role, ref.functionality)]
                if index != best:
                    found.append(f"{ref} is in mode {index}, the best is {best}")
            shown = {
                (port, topic)
                for port, topics in process.state.ports.items()
                for topic, link in topics.items()
                if link.gate != "closed"
            }
            modelled = {(port.port, configuration.topic(name)) for port, name in configuration.attached_ports(name)}
            if shown != modelled:
                found.append(f"{name} is attached to {sorted(shown)}, the model has {sorted(modelled)}")
        if self._recorded() != sorted(processes):
            found.append(f"saved are {self._recorded()}")
        if (saved := self._saved()) is not None and saved.specification != manager.specification:
            found.append("another specification is saved")
        return found

    def _closed(self) -> list[str]:
        """The outputs whose gate is closed, where no other instance of their role publishes instead."""
        roles = [process.role for process in self._platform.stand_ins()]
        return [
            f"{process.instance}.{port} on {topic}"
            for process in self._platform.stand_ins()
            if process.state is not None and roles.count(process.role) == 1
            for port, topics in process.state.ports.items()
            for topic, link in topics.items()
            if link.gate == "closed"
        ]

    def _recorded(self) -> list[str]:
        """The instances that the next manager would find."""
        saved = self._saved()
        return [] if saved is None else sorted(each.instance.name for each in saved.instances)

    def _uncaught(self) -> list[str]:
        """What no task has caught. Tasks of a process that was killed end where they were."""
        errors = [
            error for error in self._loop.errors if not isinstance(error.get("exception"), (ManagerKilled, NoneType))
        ]
        return [f"uncaught: {error['message']}: {error['exception']!r}" for error in errors]

    # -- what is watched -----------------------------------------------------------------------------

    def _declared(self) -> Specification:
        """The specification that `midstride up` reads: what is saved, else the scenario's."""
        if not self._lives:
            return self._scenario.specification
        saved = self._saved()
        return self._scenario.specification if saved is None else saved.specification

    def _saved(self) -> SavedState | None:
        return StateStore(_WORKSPACE.state, disk=self._disk).load()

    def _reaction(self) -> float:
        if self._busy or self._faulty or not self._lives[-1].alive:
            return math.inf
        return REACTION_IF_REFUSED if self._has_struck("refused request") else REACTION

    def _punctual(self) -> bool:
        return not self._has_struck(*LATE)

    def _uninterrupted(self) -> bool:
        """Whether outputs are handed over, and at most the manager has failed."""
        requests = self._scenario.changes
        handed_over = all(each.strategy == "minimal" and (each.replace or each.restart) for each in requests)
        return handed_over and all(each.fault in OF_THE_MANAGER for each in self._struck)

    def _has_struck(self, *faults: str) -> bool:
        return any(each.fault in faults for each in self._struck)

    def _on_change(self, process: StandIn) -> None:
        self._invariants.on_change(process)
        if process.dead:
            self._note("exit", f"{process.instance} has exited")

    def _on_event(self, event: Event) -> None:
        if event.kind in ("measured", "plan", "command"):
            self._note(event.kind, "")
            return
        self._note(event.kind, event.words)
        if event.kind == "measuring" and self._brief and self._manager is not None:
            self._waiting_command = self._loop.create_task(_refused(self._manager))
        if event.kind == "step" and hasattr(event.step, "action"):
            self._step = event.step.action
            self._since.setdefault(self._step, 0)
        elif event.kind in ("rollback", "rollback_failed", "degraded", "exited"):
            self._reached(event.kind)
        if "internal error" in event.words:
            self._violated(event.words)
        if event.kind in ("step", "up") and self._superseded is not None:
            self._reconnect(self._superseded)

    # -- a manager that another one has superseded ----------------------------------------------------

    def _supersede(self) -> None:
        """Cut the manager off, so that another one is started; once that has the lease, the first is there again."""
        life = self._lives[-1]
        if self._superseded is None and (lease := self._lease()) is not None:
            self._superseded = _Superseded(life, lease)
            life.isolate()

    def _lease(self) -> str | None:
        """Which manager has the lease."""
        database = self._disk.read_only(_WORKSPACE.journal)
        rows = [] if database is None else database.read("SELECT value FROM about WHERE key = 'holder'")
        return rows[0][0] if rows else None

    def _reconnect(self, superseded: _Superseded) -> None:
        """The new manager acts; where it could not take the lease, the first one stays away."""
        if not superseded.acts and self._lease() != superseded.lease:
            superseded.acts = True
            self._loop.call_later(self._random.choice((0.0, 0.05, 0.3)), superseded.life.reconnect)

    def _on_superseded_event(self, event: Event, superseded: _Superseded) -> None:
        """The step in progress may end. After it, nothing may be changed, whatever is begun."""
        self._note("superseded", f"{event.kind} {event.words}")
        if superseded.acts and event.kind in ("step", "step_failed", "step_done", "rollback"):
            superseded.life.on_change = lambda words: self._violated(f"a superseded manager {words}")

    async def _before_request(self, instance: str, op: str) -> None:
        for key in self._since:
            self._since[key] += 1
        for fault in list(self._waiting):
            if self._since.get(fault.step or "change", -1) >= fault.after:
                self._waiting.remove(fault)
                self._strike(fault)

    def _strike(self, fault: Fault) -> None:
        where: str | None = "the manager"
        match fault.kind:
            case "manager killed":
                self._lives[-1].kill()
            case "manager killed at a write":
                self._disk.kill_at = self._random.choice(("before", "after"))
                self._disk.kill_in = self._random.choice(TABLES)
            case "torn write":
                self._disk.kill_at, self._disk.kill_in = "torn", self._random.choice(TABLES)
            case "full disk":
                self._disk.full = True
            case "manager superseded":
                self._supersede()
            case _:
                where = strike(fault, self._platform, self._targets(fault), self._random)
        if where is not None:
            self._note("fault", f"{fault.kind} ({where}, {fault.seconds:g} s, {fault.times} times)")
            self._struck.append(Struck(fault.kind, self._step))

    def _targets(self, fault: Fault) -> list[str]:
        everyone = [process.instance for process in self._platform.stand_ins()]
        roles = {role for request in self._scenario.changes for role in request.roles()}
        involved = [process.instance for process in self._platform.stand_ins() if process.role in roles]
        return involved if fault.involved and involved else everyone

    def _reached(self, branch: str) -> None:
        for struck in self._struck:
            if branch not in struck.branches:
                struck.branches.append(branch)

    def _note(self, kind: str, words: str) -> None:
        self._timeline.append(f"{self._platform.time.steady():10.6f}  {kind:<14} {words}".rstrip())

    def _violated(self, words: str) -> None:
        self._problems.append(words)
        self._note("VIOLATED", words)


async def _refused(manager: Manager) -> None:
    """Another client's command, which is refused when its turn comes."""
    with contextlib.suppress(MidstrideError):
        await manager.set_parameters("no_such_node", {})

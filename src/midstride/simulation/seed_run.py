"""One seed: a system is brought up, faults strike while it is changed, they end, and everything must converge."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import math
import random
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import MidstrideError
from midstride.model.specification import HANDOVER_SECONDS
from midstride.node.author.client_ports import OVERDUE
from midstride.node.control.component_agent import HEARTBEAT
from midstride.plan.forms.step_forms import AttachStep, DetachStep, HandoverStep, RemoveStep
from midstride.plan.request import PlanRequest
from midstride.runtime.handover.arbiter_choice import LEASE
from midstride.runtime.hosts.host_link import LONGEST_PAUSE
from midstride.runtime.manager import Manager
from midstride.runtime.process.component_client import REOPEN_INTERVAL
from midstride.runtime.records.reports import Event
from midstride.simulation.convergence import (
    closed_outputs,
    differences,
    left_attached,
    not_done,
    not_handed_over,
    uncaught,
)
from midstride.simulation.faults import (
    DEAFENING,
    HARMLESS,
    LATE,
    LOSSES,
    OF_LINKS,
    OF_THE_MANAGER,
    PROMPT,
    Fault,
    draw,
    draw_of_hosts,
    draw_of_links,
    strike,
)
from midstride.simulation.invariants import resumes_within
from midstride.simulation.killable_manager import Life, ManagerKilled
from midstride.simulation.request_invariants import NOTICED
from midstride.simulation.scenario import Scenario
from midstride.simulation.stand_in import StandIn
from midstride.simulation.system import System
from midstride.wire.commands import LEASE_SLACK
from midstride.wire.frames import Reply

# How long (s) a change may take that faults strike, and a system to converge once they are over.
LONGEST_CHANGE: Final = 600.0
# How long a functionality may stay in a mode whose assumption is broken, where the manager is free to react (s); where
# a component could not be reached: it is asked again when it next reports, every 0.5 s; and where it has refused.
REACTION: Final = 0.25
REACTION_IF_UNREACHED: Final = REACTION + HEARTBEAT
REACTION_IF_REFUSED: Final = 2.0
# How long after a publisher was replaced a call of its may write that hung meanwhile (s): two periods of the slowest
# topic, and the time of a few messages.
LATE_WRITE: Final = 0.22
# A change is done all the same where calls hang for so long altogether (s): of the instances that it removes, for which
# it waits before it fences them, and of others, which have to do their part within the time-out of a command.
AWAITED: Final = 3.5
AWAITED_OF_OTHERS: Final = 1.0
# How often the processes that a change starts are on two hosts.
TWO_HOSTS: Final = 0.25
# For how long an old side on another host may have to wait besides, as the lease of the new one lasts (s).
LONGEST_LEASE: Final = LEASE * LEASE_SLACK
# How long until every host is reached again (s): the longest pause between two attempts, the attempt and a login; and
# until its components are connected again, which is tried every second.
REACHED_AGAIN: Final = LONGEST_PAUSE + 3.0
CONNECTED_AGAIN: Final = REOPEN_INTERVAL + 0.7
# How long to wait after the last command, for reports and messages to arrive (s).
SETTLING: Final = 0.4
# Where a write kills the manager: at any, or at one that records what has just been started or removed, or is done.
TABLES: Final = ("", "", "instances", "changes")


@dataclass
class Struck:
    """A fault that struck ``where``, the kind of the step in progress then, and what the manager did afterwards.

    ``op``: the kind of the request at which it struck, where that was drawn.
    """

    fault: str
    where: str
    step: str
    seconds: float
    op: str | None
    branches: list[str] = field(default_factory=list)


@dataclass
class _Superseded:
    """A manager that was cut off, and what its lease was. ``acts``: another one has the lease, and it is back."""

    life: Life
    lease: str
    acts: bool = False


@dataclass
class SeedRun:
    """The result of a seed. ``problems`` are the violated invariants; ``digest`` is the same for the same run."""

    seed: int
    problems: list[str]
    timeline: list[str]
    digest: str
    outcomes: list[str]
    struck: list[Struck]
    seconds: float


class Simulation:
    """One run of one seed, by which ``scenario`` is drawn: a change of ``system``, which it brings up unless it is up.

    What is drawn is drawn from the seed alone; the system is what the seeds before it have left.
    """

    def __init__(self, seed: int, system: System, scenario: Scenario, random: random.Random) -> None:
        self._random = random
        self._seed = seed
        self._system = system
        self._scenario = scenario
        # Whether another command waits for each change, which then measures for three periods instead of twenty.
        self._brief = self._random.random() < 0.8
        hosts = bool(scenario.specification.hosts)
        self._faults = draw(self._random, scenario.steps, hosts)
        system.platform.hosts = 2 if self._random.random() < TWO_HOSTS and not hosts else 1
        if system.platform.hosts == 2:
            self._faults += draw_of_links(seed, scenario.steps)
        elif hosts:
            self._faults += draw_of_hosts(self._random, scenario.steps)
        self._loop, self._platform, self._disk = system.loop, system.platform, system.disk
        self._loop.random.seed(self._random.getrandbits(32))
        self._platform.network.random.seed(self._random.getrandbits(32))
        system.on_event, system.on_exit = self._on_manager_event, self._on_exit
        moved = {role for request in scenario.changes for role, _ in request.on}
        moved |= {role for role, node in scenario.specification.nodes.items() if node.respawn and node.respawn.fallback}
        system.invariants.begin(
            self._reaction, self._lateness, self._uninterrupted, self._torn, self._violated, self._deafened, moved
        )
        self._platform.control.before_request = self._before_request
        self._platform.control.on_carried_out_twice = self._on_carried_out_twice
        self._step = "none"
        self._leaving: set[str] = set()  # the instances that the plan removes
        self._fenced: set[str] = set()  # those of them that hang, and were fenced; a fence ends with its change
        self._since: dict[str, int] = {}  # requests since the change began, and since the first step of each kind
        self._waiting: list[Fault] = []
        self._struck: list[Struck] = []
        self._waiting_command: asyncio.Task[None] | None = None
        self._superseded: _Superseded | None = None
        self._busy = False
        self._faulty = False
        self._calm_since = 0.0  # when the faults were off
        self._problems: list[str] = []
        self._timeline: list[str] = []
        self._outcomes: list[str] = []

    def run(self) -> SeedRun:
        """Run it; the system is left up."""
        begun = self._platform.time.steady()
        self._loop.errors.clear()
        try:
            self._system.run(self._main())
        except MidstrideError as error:
            self._violated(f"{type(error).__name__}: {error}")
        text = "\n".join([*self._timeline, str(sorted(self._system.invariants.heard.items()))])
        return SeedRun(
            self._seed,
            self._problems,
            self._timeline,
            hashlib.sha256(text.encode()).hexdigest()[:16],
            self._outcomes,
            self._struck,
            self._platform.time.steady() - begun,
        )

    # -- what happens ------------------------------------------------------------------------------

    async def _main(self) -> None:
        if any(fault.kind == "clock jump" for fault in self._faults) and not self._platform.time.driven:
            self._platform.time.drive(1.0)
        if self._system.manager is None:
            await self._up()
            await asyncio.sleep(SETTLING)
        self._note("faults", "on: " + "; ".join(map(str, self._faults)))
        self._waiting, self._faulty = list(self._faults), True
        self._since, self._step = {"change": 0}, "none"
        for request in self._scenario.changes:
            await self._change(request)
        if self._has_struck(*OF_LINKS) and self._system.hosts:  # what is cut off has time to notice
            await asyncio.sleep(self._random.choice((0.0, 3.0, 12.0)))
        self._note("faults", "off")
        self._waiting, self._faulty, self._calm_since = [], False, self._platform.time.steady()
        self._disk.full, self._disk.kill_at = False, None
        self._platform.heal()
        if self._superseded is not None:
            self._superseded.life.kill()
        await self._converge()

    async def _up(self) -> None:
        """A new manager, which brings the system up or takes it over."""
        manager = self._system.new_manager()
        life = self._system.lives[-1]
        try:
            await self._ended(life, manager.up())
        except MidstrideError:
            life.kill()  # its process ends
            raise

    async def _ended(self, life: Life, command: Any) -> Any:
        """The result of a command; None where its manager is killed meanwhile."""
        task = asyncio.ensure_future(command)
        task.add_done_callback(lambda task: task.cancelled() or task.exception())  # retrieved, also if it is abandoned
        begun = self._platform.time.steady()
        self._busy = True
        try:
            while not task.done():
                await asyncio.wait({task}, timeout=0.1)
                if not life.alive:
                    raise ManagerKilled
                if life.cut_off is not None:
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
        life, manager = self._system.lives[-1], self._manager
        outcome = await self._ended(life, manager.change(request, brief=self._brief))
        if outcome is not None:
            self._outcomes.append(outcome.outcome)
            self._note("outcome", f"{outcome.outcome}: {outcome.because}" if outcome.because else outcome.outcome)
            self._reached(outcome.outcome)
            if outcome.outcome != "done" and self._is_undisturbed():
                self._violated(f"the change is {outcome.outcome} although nothing has failed: {outcome.because}")
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
        if not self._system.lives[-1].alive or not any(event.kind == "up" for event in self._manager.log()):
            try:
                await self._up()
            except MidstrideError as error:  # a process that was started before the faults ended
                self._note("up", f"failed: {error}")
                await self._up()
        await self._reach_hosts()
        await asyncio.sleep(SETTLING)
        manager = self._manager
        if not self._has_struck("full disk"):  # what was refused is written with the next write
            running = {process.instance for process in self._platform.stand_ins()}
            if unrecorded := running - set(self._system.recorded()):
                self._violated(f"{sorted(unrecorded)} run, and are not saved")
        if self._outcomes[-1] == "rolled_back":
            if self._has_struck(*DEAFENING):  # an old side that was not told so waits before it writes again
                await asyncio.sleep(resumes_within(self._system.invariants.oracle.longest_period()) + LONGEST_LEASE)
            for name in closed_outputs(self._platform):
                self._violated(f"{name} is closed after a roll-back")
        for again in (True, False):
            request = self._again(manager) if again else PlanRequest(to=manager.specification)
            outcome = await self._ended(self._system.lives[-1], manager.change(request, brief=True))
            if outcome is None or outcome.outcome != "done":
                because = "the manager is dead" if outcome is None else outcome.because
                self._violated(f"without faults, `{request.describe()}` is not done: {because}")
                return
            await asyncio.sleep(SETTLING)
            # A change leaves the crashes of others as they are, and comes too early for what notices losses later.
            if not manager.system.crashes and not self._notices_late():
                break
            if again:  # the second command of a user comes once nothing notices a loss any more
                await asyncio.sleep(max(0.0, self._noticed_by() - self._platform.time.steady()))
        for problem in differences(manager, self._platform, self._system.saved()):
            self._violated(f"not converged: {problem}")
        for change in (await manager.history(10)).changes:
            if change.outcome is None:
                self._violated(f"not converged: `{change.command}` has no outcome in the journal")
        for problem in uncaught(self._loop.errors):
            self._violated(problem)
        self._system.specification = manager.specification

    async def _reach_hosts(self) -> None:
        """Wait until the manager has its links again, which it makes by itself, and its components are connected."""
        backend, begun = self._system.backend, self._platform.time.steady()
        if backend is None or not self._system.hosts:
            return
        while backend.problems():
            if self._platform.time.steady() - begun > REACHED_AGAIN:
                self._violated(f"not reached again after {REACHED_AGAIN:g} s: {backend.problems()}")
                return
            await asyncio.sleep(0.1)
        await asyncio.sleep(max(0.0, backend.reached_at + CONNECTED_AGAIN - self._platform.time.steady()))

    def _are_reached(self) -> bool:
        """Return whether the manager reaches every host, and has for as long as it needs to reach its components."""
        backend = self._system.backend
        if backend is None or not self._system.hosts:
            return True
        return not backend.problems() and self._platform.time.steady() > backend.reached_at + CONNECTED_AGAIN

    def _notices_late(self) -> bool:
        """Return whether a functionality has noticed only now that a request of its mode was lost while faults struck.

        A request of the mode before is no reason: it must have been in its mode for as long as a client waits.
        """
        for ref, (left_at, was_in) in self._system.invariants.entered.items():
            process = self._platform.standing(ref.instance)
            waits = -math.inf if process is None else _longest_wait(process)
            if was_in > waits > 0 and self._calm_since < left_at < self._calm_since + waits + NOTICED:
                return True
        return False

    def _noticed_by(self) -> float:
        """The time by which every client has noticed which of its requests were lost while faults struck (steady s)."""
        return self._calm_since + max(map(_longest_wait, self._platform.stand_ins()), default=-math.inf) + NOTICED

    def _again(self, manager: Manager) -> PlanRequest:
        """The request of a user now: the last change again if it was not done, else what is missing."""
        if self._outcomes[-1] == "done":
            return PlanRequest(to=manager.specification)
        request = self._scenario.changes[-1]
        if request.restart:
            return PlanRequest(to=manager.specification, restart=request.restart)
        target = request.target(self._scenario.specification)
        return PlanRequest(to=target, strategy=request.strategy, detours=request.detours)

    # -- what is watched -----------------------------------------------------------------------------

    @property
    def _manager(self) -> Manager:
        manager = self._system.manager
        assert manager is not None
        return manager

    def _reaction(self) -> float:
        if self._busy or self._faulty or not self._system.lives[-1].alive or not self._are_reached():
            return math.inf
        if self._manager.watched.commands.is_changing:  # by itself, as a fallback takes over
            return math.inf
        if self._has_struck("refused request"):
            return REACTION_IF_REFUSED
        return REACTION_IF_UNREACHED if self._has_struck(*LOSSES, *OF_LINKS) else REACTION

    def _lateness(self) -> float:
        if not self._has_struck(*LATE):
            # A cut that was passed is cancelled if its manager does not hear so: the old side goes on, on its own grid.
            return LATE_WRITE if self._has_struck(*LOSSES, *OF_LINKS, "refused request") else 0.0
        return LATE_WRITE if {each.fault for each in self._struck} <= PROMPT else math.inf

    def _is_undisturbed(self) -> bool:
        """Return whether nothing has struck that could keep a change from being done."""
        hung = [each for each in self._struck if each.fault == "hang"]
        of_others = sum(each.seconds for each in hung if each.where not in self._leaving)
        # Once the cut is agreed, the old side has to give its state within that time-out.
        longest = HANDOVER_SECONDS["state_timeout"]
        in_cut = any(each.step == "handover" and each.op != "cut_out" and each.seconds > longest for each in hung)
        return not in_cut and (
            all(each.fault in HARMLESS for each in self._struck)
            and sum(each.seconds for each in hung) <= AWAITED
            and of_others <= AWAITED_OF_OTHERS
        )

    def _uninterrupted(self) -> bool:
        """Return whether outputs are handed over, no node is moved away, and at most the manager has failed."""
        requests = self._scenario.changes
        handed_over = all(
            each.strategy == "minimal" and (each.replace or each.restart) and not each.detours for each in requests
        )
        return handed_over and all(each.fault in OF_THE_MANAGER for each in self._struck)

    def _torn(self) -> bool:
        """Return whether an instance may take another one for dead that lives: only what has exited is unreachable."""
        return self._has_struck("unreachable")

    def _deafened(self) -> bool:
        return self._has_struck(*DEAFENING)

    def _has_struck(self, *faults: str) -> bool:
        return any(each.fault in faults for each in self._struck)

    def _on_exit(self, process: StandIn) -> None:
        self._note("exit", f"{process.instance} has exited")

    def _on_manager_event(self, life: Life, event: Event) -> None:
        if self._superseded is not None and self._superseded.life is life:
            self._on_superseded_event(event, self._superseded)
        elif life.alive:
            self._on_event(event)

    def _on_event(self, event: Event) -> None:
        if event.kind in ("measured", "plan", "command"):
            self._note(event.kind, "")
            if event.plan:
                self._leaving = {step.instance for step in event.plan.steps if isinstance(step, RemoveStep)}
                self._fenced.clear()
            return
        self._note(event.kind, event.words)
        if event.kind == "measuring" and self._brief:
            self._waiting_command = self._loop.create_task(_refused(self._manager))
        if event.kind == "step" and hasattr(event.step, "action"):
            self._step = event.step.action
            self._since.setdefault(self._step, 0)
        elif event.kind == "step_done" and isinstance(event.step, (AttachStep, DetachStep)):
            if (words := not_done(event.step, self._manager, self._platform, self._fenced)) is not None:
                self._violated(words)
        elif event.kind == "step_done" and isinstance(event.step, HandoverStep):
            for words in not_handed_over(event.step, self._manager, self._platform):
                self._violated(words)
        elif event.kind == "fenced" and event.instance:
            self._fenced.add(event.instance)
        elif event.kind == "step_failed" and isinstance(event.step, HandoverStep):
            if not self._has_struck(*DEAFENING):
                for words in left_attached(event.step, self._manager, self._platform):
                    self._violated(words)
        elif event.kind in ("rollback", "rollback_failed", "degraded", "exited"):
            self._reached(event.kind)
        if event.kind == "exited":
            life = self._manager.system.life
            for process in self._platform.stand_ins():
                if process.host and life.has_exited(process.instance) and process.instance not in life.silent:
                    self._violated(f"{process.instance} is said to have exited, and runs")
        if "internal error" in event.words:
            self._violated(event.words)
        if event.kind in ("step", "up") and self._superseded is not None:
            self._reconnect(self._superseded)

    # -- a manager that another one has superseded ----------------------------------------------------

    def _supersede(self) -> None:
        """Cut the manager off, so that another one is started; once that has the lease, the first is there again."""
        life = self._system.lives[-1]
        if self._superseded is None and (lease := self._system.lease()) is not None:
            self._superseded = _Superseded(life, lease)
            life.isolate()

    def _reconnect(self, superseded: _Superseded) -> None:
        """The new manager acts; where it could not take the lease, the first one stays away."""
        if not superseded.acts and self._system.lease() != superseded.lease:
            superseded.acts = True
            superseded.life.on_connected = lambda words: self._violated(f"a superseded manager {words}")
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
            if self._since.get(fault.step or "change", -1) >= fault.after and fault.op in (None, op):
                self._waiting.remove(fault)
                self._strike(fault, instance)

    def _on_carried_out_twice(self, instance: str, first: Reply, second: Reply) -> None:
        self._violated(f"{instance} answers a request at revision {first.revision}, and repeated at {second.revision}")

    def _strike(self, fault: Fault, instance: str) -> None:
        """At a request to ``instance``."""
        where: str | None = "the manager"
        match fault.kind:
            case "manager killed":
                self._system.lives[-1].kill()
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
                where = strike(fault, self._platform, self._targets(fault, instance), self._random)
                self._system.invariants.due = True
        if where is not None:
            self._note("fault", f"{fault.kind} ({where}, {fault.seconds:g} s, {fault.times} times)")
            self._struck.append(Struck(fault.kind, where, self._step, fault.seconds, fault.op))

    def _targets(self, fault: Fault, instance: str) -> list[str]:
        if fault.op is not None and fault.involved:
            return [instance]
        running = self._platform.stand_ins()
        roles = {role for request in self._scenario.changes for role in request.roles()}
        involved = [process for process in running if fault.involved and process.role in roles]
        return [process.instance for process in involved or running]

    def _reached(self, branch: str) -> None:
        for struck in self._struck:
            if branch not in struck.branches:
                struck.branches.append(branch)

    def _note(self, kind: str, words: str) -> None:
        self._timeline.append(f"{self._platform.time.steady():10.6f}  {kind:<14} {words}".rstrip())

    def _violated(self, words: str) -> None:
        self._problems.append(words)
        self._note("VIOLATED", words)


def _longest_wait(process: StandIn) -> float:
    """The longest time that a client of ``process`` waits for a response (s); minus infinity without a bound."""
    bounds = (port.within for port in process.clients if port.within is not None)
    return max(bounds, default=-math.inf) + OVERDUE


async def _refused(manager: Manager) -> None:
    """Another client's command, which is refused once it is the next."""
    with contextlib.suppress(MidstrideError):
        await manager.set_parameters("no_such_node", {})

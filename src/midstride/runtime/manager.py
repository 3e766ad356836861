"""The manager: the paper's configuration management node.

It holds the run-time model, takes in what nodes register, starts and ends processes, executes
plans with acknowledgements, and measures every swap. One command runs at a time; others wait
their turn. The robot does not depend on it: components go on when it ends, and the next manager
finds them again (semantics.md section 7).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from midstride.codec.configuration import encode_configuration
from midstride.errors import ManagerError, MidstrideError, PlanRefused, StepFailed
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.plan import Plan
from midstride.plan.registry import planner
from midstride.plan.request import Request
from midstride.runtime import recovery, status
from midstride.runtime.action_driver import ActionDriver
from midstride.runtime.backend import Backend, Exited
from midstride.runtime.component_client import ComponentClient, ComponentEvent, Disconnected, Reported
from midstride.runtime.crash_response import settled
from midstride.runtime.crashes import Crashes
from midstride.runtime.degradation_timer import DegradationTimer
from midstride.runtime.events import Event, EventLog
from midstride.runtime.executor import Executor
from midstride.runtime.launcher import Launcher
from midstride.runtime.observed_configuration import (
    ObservedConfiguration,
    observe,
    own_degradations,
    own_degradations_in,
)
from midstride.runtime.recording import Recording, to_documents
from midstride.runtime.runtime_verification import StepVerifier, Verifier
from midstride.runtime.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.verify.verdict import Verdict
from midstride.wire.state import ComponentState

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Running:
    """The command that is being carried out, and since when (steady s)."""

    words: str
    since: float


class Manager:
    """One running system. Every public coroutine raises MidstrideError kinds only."""

    def __init__(
        self,
        specification: Specification,
        backend: Backend,
        workspace: Workspace,
        directory: Path,
        verifier: Verifier | None = None,
    ) -> None:
        self.specification = specification
        self.configuration = Configuration(context=specification.context)
        self.revision = 0
        self.events = EventLog()
        self._backend = backend
        self._workspace = workspace
        self._directory = directory
        self._verifier = verifier or Verifier()
        self._turn = asyncio.Lock()
        self._running: Running | None = None
        self._measuring = False  # all steps are done, and the command only watches
        self._seeing = asyncio.Lock()  # held while what has happened by itself is seen to
        self._crashes = Crashes()
        self._fell: set[FunctionalityRef] = set()  # by themselves, during the change
        self._pending_degradations: set[FunctionalityRef] = set()  # to be lowered, and not to be reached
        self._tasks: set[asyncio.Task[None]] = set()
        self._connect(secrets.token_hex(16))

    def _connect(self, token: str) -> None:
        self._client = ComponentClient(self._backend.transport, self._backend.clock, token, self._on_component_event)
        self._launcher = Launcher(self._backend, self._client, token, self._directory)
        self._keeper = StateStore(
            self._workspace, self._backend.name, token, self._launcher, lambda words: self._note("note", words)
        )

    # -- coming and going ---------------------------------------------------------------------------

    async def up(self) -> dict[str, Any]:
        """Find again what still runs, and bring the rest of the specification up.

        Raises ManagerError where the system that still runs is another one, StepFailed where a
        component could not be brought up (what this call started is then ended again).
        """
        state = self._workspace.load()
        if state is not None:
            self._connect(str(state["token"]))
        await self._backend.open(self._on_exit)
        async with self._command(f"up {self.specification.name}"):
            if state is not None:
                await self._adopt(state)
            try:
                await self._complete()
            except BaseException:
                if state is None:
                    self._keeper.forget(unless_running=True)
                raise
            many = _so_many(len(self.configuration.instances), "component")
            self.events.add("up", f"{self.specification.name} is up: {many}")
            return {"outcome": "done", "components": sorted(self.configuration.instances)}

    async def _complete(self) -> None:
        """Bring up what the specification has and does not run. Raises StepFailed once that has been taken back."""
        change = Change.between(self.configuration, self.specification, self.specification)
        plan = planner("minimal")(change)
        self._save()  # the token at least, before anything bears it
        if plan.steps:
            outcome = await self._execute(plan, self.specification)
            if outcome["outcome"] != "done":
                raise StepFailed(str(outcome["because"]), outcome["outcome"])

    async def _adopt(self, state: dict[str, Any]) -> None:
        running = recovery.specification_of(state)
        if state["backend"] != self._backend.name:
            raise ManagerError(
                f"{self._workspace.name} runs on {state['backend']}; use that back end, or `midstride down` first"
            )
        if running != self.specification:
            raise ManagerError(
                f"{self._workspace.name} is running with another specification; "
                "`midstride apply` changes a running system, `midstride down` ends it"
            )
        self.configuration = await recovery.adopt(
            state, self.specification, self._launcher, self._client, lambda kind, words: self._note(kind, words)
        )

    async def close(self) -> None:
        """Leave; the components go on."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._client.close()
        await self._backend.close()

    async def down(self) -> None:
        """End every component and forget the system. Raises ManagerError naming what could not be ended."""
        async with self._command("down"):
            names = sorted({*self._launcher.handles, *self.configuration.instances})
            ended = await asyncio.gather(*(self._end(name) for name in names))
            if faults := [fault for fault in ended if fault is not None]:
                raise ManagerError("; ".join(faults))
            self.configuration = Configuration(context=self.specification.context)
            self._keeper.forget()
            self.events.add("down", f"{self.specification.name} is down")

    async def _end(self, name: str) -> str | None:
        if name not in self._launcher.handles:
            try:
                await self._launcher.release(name)
                told = "it is released, and left running"
            except MidstrideError as error:  # not ours to end by force
                told = f"it is left as it is, and could not be released: {error}"
            self.events.add("note", f"{name} was started elsewhere: {told}")
            return None
        try:
            await self._launcher.end(name)
        except MidstrideError as error:
            return f"{name}: {error}"
        self.events.add("ended", f"{name} has ended")
        return None

    # -- asking -------------------------------------------------------------------------------------

    async def status(self) -> dict[str, Any]:
        """What is live, in which modes, and why; each component is asked and one that is silent is shown so."""
        running = None
        if self._running is not None:
            seconds = self._backend.clock.steady() - self._running.since
            running = {"command": self._running.words, "since": round(seconds, 3)}
        document = status.status(self.configuration, self._client, self._crashes.all())
        for row in document["components"]:
            if row["pid"] is None and row["name"] in self._launcher.handles:  # it does not answer: who it is, is known
                row["pid"] = self._launcher.handles[row["name"]].pid
        document["system"] = self.specification.name
        document["backend"] = self._backend.name
        document["revision"] = self.revision
        document["running"] = running
        document["unwritten"] = self._keeper.unwritten
        return document

    async def live(self) -> dict[str, Any]:
        """The configuration as its components themselves tell it; ``silent`` are those that did not answer in time."""
        found = observe(self.configuration, self._client, self._crashes.unsettled)
        document = encode_configuration(found.configuration)
        return {"revision": self.revision, "silent": list(found.silent), "configuration": document}

    async def peek(self, instance: str) -> ComponentState:
        """The state of one component by its own word (wire/commands.py). Raises CallTimeout or Unreachable."""
        return await self._client.peek(instance)

    async def why(self, functionality: str) -> dict[str, Any]:
        """Why a functionality is in the mode it is in. Raises PlanRefused for an unknown one."""
        return status.why(self.configuration, self._client, functionality)

    async def plan(self, request: Request) -> Plan:
        """The plan for ``request`` from the current configuration. Raises PlanRefused."""
        return self._plan(request)[0]

    def _plan(self, request: Request) -> tuple[Plan, Specification]:
        target = request.target(self.specification)
        if request.to is None and len(request.replace) + len(request.remove) + len(request.add) == 1:
            change = Change.of_request(self.configuration, self.specification, request, target)
        else:
            change = Change.between(self.configuration, self.specification, target)
        return planner(request.strategy)(change), target

    def log(self, since: int = 0) -> list[Event]:
        """The events after number ``since``."""
        return self.events.since(since)

    def subscribe(self, since: int = 0) -> AsyncIterator[Event]:
        """The events after number ``since``, and each new one as it comes."""
        return self.events.follow(since)

    # -- changing -----------------------------------------------------------------------------------

    async def change(
        self, request: Request, *, expected: int | None = None, verify: bool = False, id: str | None = None
    ) -> dict[str, Any]:
        """Carry out ``request``: the outcome document of interfaces.md.

        With ``verify``, Alloy judges the plan first, and nothing is begun unless it holds; after each step, what is
        live is judged as well, and a step after which it does not hold has failed.

        ``expected`` is the revision a preview was made at; where the configuration has moved on
        since, the change is refused, since its user has seen another plan. The events by which it waits and begins
        bear ``id``, so that who asked can tell its own events from those of others.
        """
        async with self._command(request.describe(), id):
            if expected is not None and expected != self.revision:
                return _refused("the configuration has changed since the plan was shown; look at the new plan")
            try:
                plan, target = self._plan(request)
                self._keeper.require(self.specification, self.configuration)
            except (PlanRefused, ManagerError) as error:
                return self._refuse(str(error))
            if not verify:
                return await self._execute(plan, target)
            self.events.add("verifying", f"Alloy judges the {len(plan.steps)} steps of the plan")
            verdict = await self._verifier.plan(plan)
            self._verified(verdict)
            if not verdict.holds:
                return {**self._refuse(verdict.words), "verdict": verdict.to_document()}
            outcome = await self._execute(plan, target, self._watch(plan))
            return {**outcome, "verdict": verdict.to_document()}

    def _watch(self, plan: Plan) -> StepVerifier:
        def told(configuration: Configuration) -> ObservedConfiguration:
            return observe(configuration, self._client, self._crashes.unsettled)

        return StepVerifier(self._verifier, tuple(plan.configurations()), told, self._verified)

    def _verified(self, verdict: Verdict) -> None:
        self.events.add("verified", str(verdict), verdict=verdict.to_document())

    def _refuse(self, because: str) -> dict[str, Any]:
        self.events.add("outcome", f"refused: {because}", outcome="refused")
        return _refused(because)

    async def _execute(self, plan: Plan, target: Specification, watch: StepVerifier | None = None) -> dict[str, Any]:
        recording = Recording(self._client, self._backend.clock)
        try:
            return await self._recorded(plan, target, recording, watch)
        finally:
            await recording.stop(self.configuration.instances)

    async def _recorded(
        self, plan: Plan, target: Specification, recording: Recording, watch: StepVerifier | None
    ) -> dict[str, Any]:
        clock = self._backend.clock
        actions = [step.action for step in plan.steps]
        document = plan.to_document()
        preview = {name: value for name, value in document.items() if name not in ("start", "target")}
        self.events.add("plan", f"{_so_many(len(actions), 'step')}, disruption {plan.disruption:g}", plan=preview)
        await recording.begin(self.configuration, actions)
        falls = DegradationTimer(plan.change, clock.steady)
        begun = clock.steady()
        before, missing = self.configuration, dict(self._crashes.missing)
        self._fell.clear()
        self.configuration = plan.change.start
        executor = self._executor(falls)
        executor.performer.before_handover = recording.witness
        executor.after_step = None if watch is None else watch.look
        outcome, because = "done", None
        try:
            await executor.run(actions, plan.step_documents())
            self.specification = target
            self.configuration = plan.change.settled(self.configuration)
            self._crashes.forget(self.configuration, self.specification.nodes)
        except StepFailed as error:
            outcome, because = error.outcome, str(error)
            if outcome == "rolled_back":
                self.configuration = before
        seconds = clock.steady() - begun
        fallen = falls.stop()
        self._save()
        await self._settle_crashes()  # who relies on them is not to wait for the end of the measure
        if recording.subjects:
            self.events.add("measuring", "watching the subscribers for 20 periods more")
        self._measuring = True
        try:
            swaps = await recording.finish(executor.performer.last_numbers)
        finally:
            self._measuring = False
        await self._settle()  # who asked is to hear of what has fallen by itself, too
        documents_of_swaps = to_documents(swaps)
        if documents_of_swaps:
            self.events.add("measured", f"measured at {_so_many(len(swaps), 'subscriber')}", swaps=documents_of_swaps)
        told = f"{outcome}: {because}" if because else outcome
        self.events.add("outcome", told, outcome=outcome)
        return {
            "outcome": outcome,
            "plan": document,
            "seconds": round(seconds, 6),
            "fallen": fallen,
            "swaps": documents_of_swaps,
            "because": because,
            "ended": sorted(name for name, event in self._crashes.missing.items() if missing.get(name) is not event),
            "degraded": sorted(map(str, self._fell)),
        }

    def _executor(self, falls: DegradationTimer | None = None) -> Executor:
        async def moved(configuration: Configuration) -> None:
            self.configuration = configuration
            self.revision += 1
            if falls is not None:
                falls.moved(configuration)
            self._save()

        performer = ActionDriver(
            client=self._client,
            lingering_readers=self._backend.lingering_readers,
            launcher=self._launcher,
            tell=lambda kind, words, details: self._note(kind, words, **details),
            is_gone=lambda name: name in self._crashes.unsettled,
        )
        return Executor(performer, self.configuration, moved, self._started)

    def _started(self, instance: Instance) -> None:
        self._crashes.returned(instance.name)
        self._keeper.started(instance)
        self._save()

    def _save(self) -> None:
        self._keeper.save(self.specification, self.configuration)

    def _note(self, kind: str, words: str, **details: Any) -> None:
        self.events.add(kind, words, **details)

    @contextlib.asynccontextmanager
    async def _command(self, words: str, id: str | None = None) -> AsyncIterator[None]:
        """One command at a time, first come first served; who must wait is told for whom."""
        if self._running is not None:
            self.events.add("waiting", f"`{words}` waits for `{self._running.words}`", command=words, id=id)
        async with self._turn:
            self._running = Running(words, self._backend.clock.steady())
            self.events.add("command", words, id=id)
            try:
                await self._settle()
                yield
                await self._settle()  # what has ended by itself meanwhile
            finally:
                self._running = None
                if self._crashes.unsettled:  # while that was being seen to, or where the command has failed
                    self._settle_soon()

    # -- what happens by itself ------------------------------------------------------------------------

    def _on_exit(self, event: Exited) -> None:
        self._launcher.exited(event)
        if event.instance in self._launcher.handles:
            self._ended(event)

    def _on_component_event(self, event: ComponentEvent) -> None:
        match event:
            case Disconnected(instance):
                live = self.configuration.instances.get(instance)
                if live is not None and instance not in self._launcher.handles:  # else its process tells
                    self._ended(Exited(instance, None))
            case Reported(state):
                idle = self._running is None or self._measuring  # else the command that runs looks at its end
                if idle and own_degradations_in(self.configuration, state):
                    self._settle_soon()

    def _ended(self, event: Exited) -> None:
        self._crashes.ended(event)
        status_words = "" if event.status is None else f" (status {event.status})"
        self.events.add("exited", f"{event.instance} has ended by itself{status_words}", log=event.log_tail)
        if self._running is None or self._measuring:
            self._settle_soon()

    def _settle_soon(self) -> None:
        task = asyncio.get_running_loop().create_task(self._settle_alone())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _settle_alone(self) -> None:
        async with contextlib.nullcontext() if self._measuring else self._turn:
            try:
                await self._settle()
            except Exception as error:  # nobody waits for it: what went wrong is told here or never
                log.exception("what has ended by itself could not be seen to")
                self._note("note", f"what has ended by itself could not be seen to: internal error: {error!r}")

    async def _settle(self) -> None:
        """Bring the model to what is true, and lower whom that leaves without what they assume."""
        async with self._seeing:
            await self._reconcile()

    async def _settle_crashes(self) -> None:
        """The same where somebody has ended and nobody has seen to it to the end."""
        if self._crashes.unsettled or self._seeing.locked():
            await self._settle()

    async def _reconcile(self) -> None:
        gone = self._crashes.settle(self.configuration)
        for name in gone:
            self._launcher.handles.pop(name, None)
            self._client.forget(name)
        configuration = self.configuration
        worse = own_degradations(configuration, self._client, gone)
        if not gone and not worse and not self._pending_degradations:
            return
        because = [f"{name} has ended by itself" for name in sorted(gone)]
        for ref, index in sorted(worse.items()):
            words = f"{ref} has gone to {configuration.functionality(ref).modes[index].name} by itself"
            self.events.add("degraded", words, functionality=str(ref))
            because.append(words)
            self._fell.add(ref)
        self.configuration, fallen = settled(configuration, gone, worse, self._pending_degradations)
        self.revision += 1
        reason = "; ".join(because) or "what it assumes was gone before it could be reached"
        self._pending_degradations = await self._executor().lower(fallen, reason)
        self._save()


def _so_many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _refused(because: str) -> dict[str, Any]:
    return {
        "outcome": "refused",
        "plan": None,
        "seconds": 0.0,
        "fallen": {},
        "swaps": [],
        "because": because,
        "ended": [],
        "degraded": [],
    }

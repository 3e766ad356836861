"""Components, a client and a back end whose behaviour the test writes, in virtual time.

The parts of the runtime are tested on them one by one; :mod:`tests.runtime.systems` runs whole examples.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Collection, Container, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from msgspec import structs

from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.backends.simulator.virtual_loop import run
from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError, CallTimeout, CommandRefused, MidstrideError, Unreachable
from midstride.model.action import Action
from midstride.model.component import ComponentSpec, StopTimes
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import Predicate
from midstride.model.hosts import HostSpec
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.forms.step_forms import step_form
from midstride.plan.overlap import Overlap
from midstride.plan.plan import Plan
from midstride.plan.step import Step
from midstride.runtime.backend_protocol import (
    DescribedProcess,
    Endpoints,
    Exited,
    Handle,
    HostLinkState,
    Launch,
    OtherNodes,
    RemainingProcess,
    TopicListener,
)
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.change.change_phases import ChangeEvent
from midstride.runtime.change.executor import Executor
from midstride.runtime.change.parameter_transfer import ParameterTransfer
from midstride.runtime.change.reconciler import Reconciler
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.handover.fences import DEFAULT_WAIT
from midstride.runtime.instance_life import ConnectionEvent, LatestState, LifeTable
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.launcher import Launcher
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.journal import Journal, JournalEntry
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.records.status_forms import Middleware
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.silence import SilenceMonitor
from midstride.runtime.watch.subscriber_recording import Recording
from midstride.wire.clock_offset import SAME_CLOCK, ClockOffset
from midstride.wire.commands import (
    AnswerCommand,
    AttachCommand,
    AwaitCutCommand,
    AwaitIdleCommand,
    AwaitMatchCommand,
    AwaitRateCommand,
    AwaitReadersCommand,
    AwaitWriteCommand,
    Command,
    CountWritesCommand,
    DetachCommand,
    ExportStateCommand,
    GridCommand,
    ModesCommand,
    ObserveCommand,
    PrepareStateCommand,
    RecordCommand,
    RecordsCommand,
    SetParametersCommand,
    WelcomeCommand,
)
from midstride.wire.frames import PROTOCOL, Greeting, Registration
from midstride.wire.pipe import PipeNetwork
from midstride.wire.replies import (
    Answers,
    Attached,
    CountedWrites,
    CutResult,
    Detached,
    Done,
    ExportedState,
    GatedWrites,
    Grid,
    Idle,
    PreviousModes,
    PreviousParameters,
    RateVerdict,
    RecordingSwitched,
    Records,
    StateOffer,
)
from midstride.wire.state import ComponentState, Endpoint, FunctionalityState, LinkState
from midstride.wire.transport import Transport
from tests.model import build

R = TypeVar("R")
T = TypeVar("T")
C = TypeVar("C", bound=Command[Any])

TOKEN = "the token of the system"

REFUSED = CommandRefused("the component refused it")
TIMEOUT = CallTimeout("the component did not answer")
UNREACHABLE = Unreachable("the component cannot be reached")


# What a component replies where the test says nothing else.
REPLIES: dict[type[Command[Any]], Any] = {
    AnswerCommand: Answers(),
    AttachCommand: Attached(matched=1),
    AwaitCutCommand: CutResult(outcome="done"),
    AwaitIdleCommand: Idle(busy=None),
    AwaitMatchCommand: lambda command: Attached(matched=command.peers),
    AwaitRateCommand: RateVerdict(reached=True, rate=10.0, pause=0.1),
    AwaitReadersCommand: Attached(matched=1),
    AwaitWriteCommand: GatedWrites(gated=1, wrong_type=None),
    CountWritesCommand: CountedWrites(written=1),
    DetachCommand: Detached(acknowledged=True, last=None),
    ExportStateCommand: ExportedState(state=None),
    GridCommand: Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=1),
    ModesCommand: PreviousModes(before={}),
    PrepareStateCommand: StateOffer(exports="nothing"),
    RecordCommand: RecordingSwitched(now=0),
    RecordsCommand: Records(rows=[], publisher_identity=True, now=0),
    SetParametersCommand: PreviousParameters(before={}),
}


class Sent(NamedTuple):
    """One command and how the client was asked to send it."""

    how: Literal["read", "change", "undo", "observe", "peek"]
    instance: str
    command: Command[Any]


class ScriptedLife(LifeTable):
    """A component is in the state that ``states`` has, and never silent, however much virtual time passes."""

    def __init__(self, clock: Clock, states: dict[str, ComponentState]) -> None:
        super().__init__(clock)
        self.states = states

    def latest(self, name: str) -> LatestState | None:
        state = self.states.get(name)
        return None if state is None else LatestState(state, 0.0)

    def responsive(self, name: str) -> ComponentState | None:
        return self.states.get(name)


class ScriptedClient(ComponentClient):
    """Records each command, and replies as the test says: a value, an exception, or a function of the command.

    A component is in the modes that it was sent last and attached where it was sent to be, answers if it was asked to,
    and is otherwise in the state that it reported last.
    """

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__(PipeNetwork(), clock, TOKEN)
        self.sent: list[Sent] = []
        self.states: dict[str, ComponentState] = {}
        self.present: dict[str, tuple[Greeting, Registration]] = {}
        self.disconnected: list[str] = []
        self.accepted: list[str] = []
        self.life = ScriptedLife(clock, self.states)
        self._replies: dict[tuple[str, type[Command[Any]]], list[Any]] = {}
        self._registered: dict[str, asyncio.Event] = {}

    # -- the script --------------------------------------------------------------------------------

    def reply(self, instance: str, command: type[Command[Any]], *replies: Any) -> None:
        """``instance`` replies to the next commands of this class with ``replies``, the last one for ever."""
        self._replies[instance, command] = list(replies)

    def report(self, state: ComponentState) -> None:
        """The component reports ``state`` by itself."""
        self.states[state.instance] = state
        for listener in self.listeners:
            listener(state)

    def lose(self, instance: str) -> None:
        """The component has ended its connection, and does not listen any more."""
        self.life.record(instance, ConnectionEvent.REFUSED)

    def register(self, instance: Instance, *, token: str = TOKEN, **options: Any) -> None:
        """The component of ``instance`` is up, and has said what it is."""
        self.present[instance.name] = (greeting(instance.name, token), registration(instance.component, **options))
        self.states.setdefault(instance.name, reported(instance))
        self._event(instance.name).set()

    def commands(self, instance: str | None = None) -> list[Command[Any]]:
        """What was sent, to ``instance`` where given."""
        return [sent.command for sent in self.sent if instance in (None, sent.instance)]

    def of(self, kind: type[C], instance: str | None = None) -> list[C]:
        """The commands of that class among these."""
        return [command for command in self.commands(instance) if isinstance(command, kind)]

    @property
    def changes(self) -> list[tuple[str, str]]:
        """The commands that change something, in order: instance and name, ``undo`` before the name of one."""
        return [
            (sent.instance, sent.command.name if sent.how == "change" else f"undo {sent.command.name}")
            for sent in self.sent
            if sent.how in ("change", "undo")
        ]

    def assert_order(self, *wanted: tuple[str, str]) -> None:
        """Each command of ``wanted``, as in ``changes`` (or a reading one), was sent after the one before it.

        What else was sent, before, between or after them, is left to the tests that are about it.
        """
        sent = [
            (each.instance, f"undo {each.command.name}" if each.how == "undo" else each.command.name)
            for each in self.sent
        ]
        rest = iter(sent)
        for command in wanted:
            assert command in rest, f"{command} is not sent, or not after those before it in {wanted}: {sent}"

    def _event(self, instance: str) -> asyncio.Event:
        return self._registered.setdefault(instance, asyncio.Event())

    async def _reply(self, how: Any, instance: str, command: Command[Any]) -> Any:
        self.sent.append(Sent(how, instance, command))
        await asyncio.sleep(0)
        script = self._replies.get((instance, type(command)))
        if script:
            answer = script.pop(0) if len(script) > 1 else script[0]
        elif isinstance(command, (ObserveCommand, WelcomeCommand)):
            answer = self.states.get(instance, UNREACHABLE)
        else:
            answer = REPLIES.get(type(command), Done())
        if callable(answer):
            answer = answer(command)
        if isinstance(answer, Coroutine):
            answer = await answer
        if isinstance(answer, BaseException):
            raise answer
        if isinstance(command, ModesCommand) and instance in self.states:
            state = self.states[instance]
            modes = {name: _functionality(mode) for name, mode in command.modes.items()}
            self.states[instance] = structs.replace(state, functionalities=state.functionalities | modes)
        if isinstance(command, (AttachCommand, DetachCommand)) and instance in self.states:
            state = self.states[instance]
            links = {topic: link for topic, link in state.ports.get(command.port, {}).items() if topic != command.topic}
            if isinstance(command, AttachCommand):
                links[command.topic] = LinkState(gate=None, count=0)
            self.states[instance] = structs.replace(state, ports={**state.ports, command.port: links})
        if isinstance(command, AnswerCommand) and instance in self.states:
            self.states[instance] = structs.replace(self.states[instance], answers=True)
        return answer

    # -- the client --------------------------------------------------------------------------------

    async def connect(self, instance: str) -> Greeting:
        await self._event(instance).wait()
        return self.present[instance][0]

    async def registered(self, instance: str) -> tuple[Greeting, Registration]:
        await self._event(instance).wait()
        return self.present[instance]

    def disconnect(self, instance: str) -> None:
        self.disconnected.append(instance)
        self.life.record(instance, ConnectionEvent.DISCONNECTED)
        self.states.pop(instance, None)
        self.present.pop(instance, None)
        self._registered.pop(instance, None)

    def accept(self, instance: str) -> None:
        self.accepted.append(instance)

    async def read(self, instance: str, command: Command[R]) -> R:
        reply: R = await self._reply("read", instance, command)
        return reply

    async def change(self, instance: str, command: Command[R]) -> R:
        reply: R = await self._reply("change", instance, command)
        return reply

    async def observe(self, instance: str) -> ComponentState:
        state: ComponentState = await self._reply("observe", instance, ObserveCommand())
        return state

    async def peek(self, instance: str, look: float = 0.0) -> ComponentState:
        state: ComponentState = await self._reply("peek", instance, ObserveCommand())
        return state

    async def share_locks(self, instance: str, other: str) -> bool:
        return True

    async def undo(self, instance: str, command: Command[Any]) -> bool:
        try:
            await self._reply("undo", instance, command)
        except MidstrideError:
            return False
        return True


class ScriptedBackend:
    """A back end (:mod:`midstride.runtime.backend_protocol`) whose components register at once unless told not to."""

    def __init__(self, clock: Clock, client: ScriptedClient) -> None:
        self.name = "scripted"
        self.shares_processes = False
        self.reaches_hosts = False
        self.clock = clock
        self.transport: Transport = PipeNetwork()
        self.launches: list[Launch] = []
        self.links: list[HostLinkState] = []
        self.running: set[str] = set()
        self.ended: list[tuple[str, StopTimes]] = []
        self.disconnections: list[str] = []
        self.fail_start: dict[str, BaseException] = {}
        self.fail_end: dict[str, Exception] = {}
        self.killed: dict[str, list[RemainingProcess]] = {}  # what of an instance has to be killed
        self.lingering: dict[str, int] = {}
        # By topic and instance.
        self.publishers: dict[tuple[str, str], frozenset[str] | None] = {}
        self.offsets: dict[str, ClockOffset] = {}  # of the clocks of hosts
        self.instances: dict[str, Instance] = {}  # those that register when they are started
        self._client = client

    def other_nodes(self, instances: Collection[str]) -> dict[str, OtherNodes]:
        return {}

    async def open(self, on_exit: Callable[[Exited], None]) -> None: ...

    async def close(self) -> None: ...

    async def reach_hosts(
        self,
        hosts: Mapping[str, HostSpec],
        token: str,
        note: Callable[[str], object],
        superseded: Callable[[], bool],
    ) -> Mapping[str, str]:
        return {}

    async def try_again(self, hosts: Collection[str]) -> None:
        pass

    async def leave_hosts(self, needed: Container[str]) -> None:
        pass

    def host_links(self) -> Sequence[HostLinkState]:
        return self.links

    async def clock_offset(self, host: str) -> ClockOffset:
        return self.offsets.get(host, SAME_CLOCK)

    def describe(self, launch: Launch) -> DescribedProcess:
        return DescribedProcess(launch.arguments)

    async def start(self, launch: Launch) -> Handle:
        self.launches.append(launch)
        if launch.instance in self.fail_start:
            raise self.fail_start[launch.instance]
        self.running.add(launch.instance)
        if launch.instance in self.instances:
            self._client.register(self.instances[launch.instance])
        return Handle(launch.instance, 100 + len(self.launches), 1.0, f"/logs/{launch.instance}.log")

    async def adopt(self, handle: Handle) -> bool:
        return handle.instance in self.running

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        self.ended.append((instance, stop))
        if instance in self.fail_end:
            raise self.fail_end[instance]
        self.running.discard(instance)
        return self.killed.get(instance, [])

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        return []

    def is_stopped(self, instance: str) -> bool:
        return False

    def executable(self, package: str, name: str, *, composable: bool = False) -> str | None:
        return None

    @contextlib.asynccontextmanager
    async def probe(self) -> AsyncIterator[str | None]:
        yield None

    def keep_spares(self, number: int, token: str) -> None:
        pass

    def spares(self) -> int:
        return 0

    def takes_spare(self, arguments: Sequence[str], directory: Path) -> bool:
        return False

    def disconnected(self, instance: str) -> None:
        self.disconnections.append(instance)

    def reported(self, state: ComponentState) -> None:
        pass

    def listen(self, topic: str, assumption: Predicate) -> TopicListener:
        raise BackendError(f"nothing is published on {topic}")

    def unwritten(self) -> str | None:
        return None

    def hanging(self) -> list[str]:
        return []

    def middleware(self) -> Middleware:
        return Middleware(name="scripted")

    def reach(self) -> dict[str, str]:
        return {}

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        return Endpoints()

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str] | None:
        return self.publishers.get((topic, instance))

    async def lingering_readers(self, topic: str) -> int:
        return self.lingering.get(topic, 0)


@dataclass
class Bench:
    """The parts that carry steps out, on a scripted client and back end."""

    configuration: Configuration
    path: Path
    specification: Specification = field(default_factory=lambda: Specification("bench"))

    def __post_init__(self) -> None:
        self.clock = SimulatedClock()
        self.clock.follow(asyncio.get_running_loop())
        self.client = ScriptedClient(self.clock)
        self.backend = ScriptedBackend(self.clock, self.client)
        self.events = EventLog()
        self.launcher = Launcher(self.backend, self.client, self.path)
        self.system = RunningSystem(self.specification, self.configuration, self.client.life)
        self.store = StateStore(self.path / "state.db")
        self.store.begin(self.backend.name, TOKEN, self.specification)
        self.journal = Journal(self.path / "journal.db", self.backend.name)
        self.entry = JournalEntry(self.journal, None)
        self.observers: list[ChangeObserver] = []
        self.begin()
        for instance in self.configuration.instances.values():
            self.attend(instance)

    def begin(self, *actions: Action) -> None:
        """A change with these actions, which the driver and the executor are about to carry out."""
        specification, start = self.specification, self.system.configuration
        change = Change(specification, specification, start, start, start, start)
        steps = tuple(Step(action, 0.0, ()) for action in actions)
        preview = PlanPreview(
            strategy="test",
            proved_minimal=False,
            disruption=0.0,
            lower_bound=0.0,
            makespan=0.0,
            seconds=0.0,
            degraded=[],
            steps=[step_form(step) for step in steps],
        )
        self.change = RunningChange(
            Plan("test", change, steps, 0.0, 0.0, False, 0.0, 0.0, ()),
            specification,
            preview,
            self.entry,
            Recording(self.client, self.clock),
            ParameterTransfer(self.client, self.system.values, change, (), keep=True),
            DEFAULT_WAIT,
            start,
            observers=[*self.observers],
        )
        self.driver = ActionDriver(self.client, self.launcher, self.backend, self.system, self.events, self.change)
        self.executor = Executor(self.driver, self.store)

    def roll_back(self) -> None:
        """From now on, the driver undoes what was done."""
        self.change.happened(ChangeEvent.BEGUN)
        self.change.happened(ChangeEvent.STEP_FAILED)

    async def carry_out(self, actions: Sequence[Action], overlap: Overlap | None = None) -> None:
        """A change with these actions, from its first step to its last."""
        self.begin(*actions)
        await self.executor.run(overlap)

    def attend(self, *instances: Instance) -> None:
        """These run already, as the configuration has them."""
        for instance in instances:
            live = instance.name in self.configuration.instances
            self.client.report(reported(instance, self.configuration if live else None))
            self.client.register(instance)
            by_hand = instance.component.run is None
            self.client.life.adopted(instance.name, None if by_hand else Handle(instance.name, 7, 1.0))
            self.client.life.record(instance.name, ConnectionEvent.OPENED)
            if not by_hand:
                self.backend.running.add(instance.name)

    def startable(self, *instances: Instance) -> None:
        """These register as soon as they are started."""
        self.backend.instances.update({instance.name: instance for instance in instances})

    def crash(self, name: str) -> None:
        """The process of an instance has exited unexpectedly; the model still has it."""
        self.system.life.exited(Exited(name, -9))

    def words(self, kind: str | None = None) -> list[str]:
        """What the events say, of that kind where given."""
        return [event.words for event in self.events.since() if kind in (None, event.kind)]

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events.since()]

    def saved(self) -> list[str]:
        """The names of the instances that the next manager would find."""
        return [instance.name for instance in self.saved_instances()]

    def saved_instances(self) -> list[Instance]:
        state = StateStore(self.store.path).load()
        assert state is not None
        return [entry.instance for entry in state.instances]


@dataclass
class ReconcilingBench(Bench):
    """A bench with a reconciler, and commands that the test decides on."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.commands = CommandQueue(self.clock, self.events)
        self.monitor = SilenceMonitor(self.client.life, self.clock, self.events)
        self.reconciler = Reconciler(
            self.system,
            self.client,
            self.monitor,
            self.launcher,
            self.events,
            self.store,
            self.commands,
        )
        self.client.listeners.append(self.reconciler.on_component_event)
        for live in self.configuration.instances.values():
            self.store.write_instance(live, self.client.life[live.name].handle)

    @property
    def busy(self) -> bool:
        """Whether a command is in progress."""
        return self.commands.current is not None

    @busy.setter
    def busy(self, busy: bool) -> None:
        self.commands.current = "a command of the test" if busy else None

    def exits(self, event: Exited) -> None:
        """The process of a component ends."""
        self.client.states.pop(event.instance, None)
        self.reconciler.on_exit(event)

    def degrades(self, instance: str) -> None:
        """A component reports that its functionality has degraded."""
        found = self.configuration.instances[instance]
        self.client.report(reported(found, self.system.configuration, modes={"work": "degraded"}))


@dataclass
class Moves(ChangeObserver):
    """Notes each configuration that a change leads to; ``on_move`` is called then."""

    on_move: Callable[[], object] = lambda: None
    seen: list[tuple[Configuration, list[str]]] = field(default_factory=list)

    def moved(self, configuration: Configuration, instances: Collection[str]) -> None:
        self.seen.append((configuration, sorted(instances)))
        self.on_move()


def bench(
    configuration: Configuration, path: Path, body: Callable[[Bench], Coroutine[Any, Any, T]], **options: Any
) -> T:
    """Run ``body`` in virtual time on a bench where ``configuration`` is live."""

    async def main() -> T:
        b = Bench(configuration, path, **options)
        try:
            return await body(b)
        finally:
            b.journal.close()

    return run(main())


# -- values --------------------------------------------------------------------------------------------


def started(component: ComponentSpec, run: str = "python3 node.py") -> ComponentSpec:
    """``component`` as one that the manager starts; without a command it is started by hand."""
    return changed(component, run=run)


def instance(name: str, component: ComponentSpec, role: str | None = None) -> Instance:
    return Instance(name, role or name, component)


TALKER = started(build.source("Talker"))
LISTENER = started(build.sink("Listener"))


def talking(**instances: ComponentSpec) -> Configuration:
    """``talker`` publishes on /chatter at 10 Hz, ``listener`` relies on it at 5 Hz, both in their normal modes."""
    live = {"talker": TALKER, "listener": LISTENER} | instances
    modes = {"talker.work": 0, "listener.work": 0}
    return build.system(live, ["talker.out /chatter", "listener.in /chatter"], modes=modes)


def greeting(name: str, token: str = TOKEN) -> Greeting:
    return Greeting(protocol=PROTOCOL, instance=name, uuid=f"uuid of {name}", pid=7, start_token=token)


def registration(component: ComponentSpec, endpoints: tuple[Endpoint, ...] = ()) -> Registration:
    return Registration(declaration=NamedComponentForm.of(component), endpoints=list(endpoints))


def reported(
    instance: Instance,
    configuration: Configuration | None = None,
    *,
    modes: dict[str, str] | None = None,
    gates: dict[str, Literal["open", "closed"]] | None = None,
    **fields: Any,
) -> ComponentState:
    """The state of ``instance`` as ``configuration`` has it (in its last modes and unattached without one).

    ``modes`` (by functionality) and ``gates`` (``"port topic"``) are other than there; further fields are as given.
    """
    functionalities = {}
    for ref in instance.functionality_refs():
        spec = instance.component.functionalities[ref.functionality]
        mode = spec.modes[spec.last_mode] if configuration is None else configuration.mode(ref)
        functionalities[ref.functionality] = _functionality((modes or {}).get(ref.functionality, mode.name))
    ports: dict[str, dict[str, LinkState]] = {}
    for port, connector in [] if configuration is None else configuration.attached_ports(instance.name):
        topic = configuration.context.connectors[connector].topic if configuration is not None else connector
        ports.setdefault(port.port, {})[topic] = LinkState(
            gate="open" if instance.component.has_output(port.port) else None, count=0
        )
    for where, gate in (gates or {}).items():
        name, topic = where.split()
        ports.setdefault(name, {})[topic] = LinkState(gate=gate, count=0)
    found: dict[str, Any] = {
        "uuid": f"uuid of {instance.name}",
        "pid": 7,
        "revision": 1,
        "parameters": {},
        "stopping": 0.0,
    } | fields
    return ComponentState(instance=instance.name, functionalities=functionalities, ports=ports, **found)


def _functionality(mode: str) -> FunctionalityState:
    return FunctionalityState(mode=mode, since=0.0, because=f"it entered {mode}")

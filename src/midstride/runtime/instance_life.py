"""The life of each instance, as the manager knows it: the one place that answers whether an instance is alive.

Three facts are independent of each other: a process that runs may be cut off from the manager, and fenced as well. So
each has a state, and a table of the events that change it (docs/protocols/life.md):

- the *process*, known from the manager's own commands, the back end and the model;
- the *connection*, known from the control connection;
- the *fence* of the change in progress.

Silence is a fourth fact and no state: it is the time since the last report of a component that is connected. Up to
``SILENCE`` it is responsive, then silent, and from ``STOPPED`` on it counts as stopped. That an instance has a handle
is a fifth: this manager or an earlier one has started its process, and may terminate it.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, NamedTuple

from midstride.model.configuration import Instance
from midstride.runtime.backend_protocol import Exited, Handle
from midstride.runtime.manager_clock import Clock
from midstride.runtime.records.reports import FencedInstance
from midstride.transitions import Transitions
from midstride.wire.state import ComponentState

log = logging.getLogger(__name__)

# How long a component may take to answer what needs no user code (s), on top of a command's own time-out.
ANSWER_TIMEOUT: Final = 3.0
# A component that has reported nothing for this long (s) is silent; components report twice a second.
SILENCE: Final = 2.0
# After so long (s) it counts as stopped, and a command has failed, however long that may take itself.
STOPPED: Final = SILENCE + ANSWER_TIMEOUT
# How many transitions of an instance are kept, for the log.
KEPT: Final = 8


class ProcessState(Enum):
    ABSENT = "no process of that name is known"
    STARTING = "it has been started, here or by hand, and has not been accepted"
    RUNNING = "it runs, as far as is known"
    DONE = "its program has ended, as it should"
    STOPPING = "it has been asked to exit"
    STUCK = "it has been asked to exit, and could not be terminated"
    EXITED = "it has exited unexpectedly, and the model may still have it"
    MISSING = "it has exited unexpectedly, and its role has no instance"


class ProcessEvent(Enum):
    STARTED = "its process was started, or is awaited"
    REGISTERED = "it has registered, and was accepted"
    COMPLETED = "its program has done its work, here or before"
    ADOPTED = "an earlier manager knew it, and it still runs"
    END_BEGUN = "it was asked to exit"
    END_FAILED = "it could not be terminated"
    ENDED = "it has exited as it was asked to"
    KILLED = "it was killed, since it did not answer"
    RELEASED = "it was started by hand, and is left to the next manager"
    EXITED = "it exited unexpectedly"
    MISSED = "its role is without it"
    REPLACED = "its role has an instance again, or needs none"
    SUPPLANTED = "it is silent on a host that cannot be reached, and its role has another instance, or needs none"


class ConnectionState(Enum):
    NONE = "there is no control connection"
    OPEN = "the control connection is open"
    CLOSED = "it has closed, and is being reopened"
    GONE = "it has closed, and the component has exited, as far as that shows"


class ConnectionEvent(Enum):
    OPENED = "connected"
    BROKEN = "the component, or what forwards the connection, has closed it"
    REFUSED = "nothing listens there any more, or another component"
    DISCONNECTED = "the manager has closed it"


class FenceState(Enum):
    NONE = "not fenced"
    GATE = "its outputs were closed inside a call"
    KILLED = "its process was killed"


class FenceEvent(Enum):
    CLOSED = "it hangs, and its outputs were closed"
    KILLED = "it does not answer, and was killed"
    LIFTED = "no successor took over, and it may publish again"
    CHANGE_BEGUN = "another change begins"


# What has a handle can be ended in every state: children of a process that has exited may be left. `exited` in
# stopping: the back end notices late. `registered` in exited: it was quicker than the control connection.
PROCESSES: Final = Transitions.read(
    ProcessState,
    ProcessEvent,
    """
    event       absent   starting running  done     stopping stuck    exited   missing
    started     starting .        .        .        .        starting starting starting
    registered  .        running  .        .        .        .        exited   .
    completed   done     done     .        .        .        .        .        .
    adopted     running  .        running  .        .        .        .        .
    end_begun   absent   stopping stopping .        .        stopping exited   missing
    end_failed  absent   .        .        .        stuck    .        exited   missing
    ended       absent   .        .        absent   absent   .        exited   missing
    killed      .        .        .        .        exited   .        exited   .
    released    absent   absent   absent   .        .        .        exited   missing
    exited      .        exited   exited   .        exited   exited   exited   missing
    missed      missing  .        .        .        .        missing  missing  missing
    replaced    .        .        .        .        .        .        absent   absent
    supplanted  .        .        .        .        .        .        .        stuck
    """,
)
# `refused` in open: the connection has been reopened, and leads to another process.
CONNECTIONS: Final = Transitions.read(
    ConnectionState,
    ConnectionEvent,
    """
    event         none   open   closed gone
    opened        open   .      open   open
    broken        .      closed .      gone
    refused       .      gone   gone   gone
    disconnected  none   none   none   none
    """,
)
# `closed` in gate: other outputs of it, in another step.
FENCES: Final = Transitions.read(
    FenceState,
    FenceEvent,
    """
    event         none   gate   killed
    closed        gate   gate   .
    killed        killed killed .
    lifted        .      none   .
    change_begun  .      none   none
    """,
)

LifeEvent = ProcessEvent | ConnectionEvent | FenceEvent


class Transition(NamedTuple):
    """``at``: when it happened (steady s)."""

    at: float
    event: LifeEvent
    because: str


@dataclass(frozen=True, slots=True)
class LatestState:
    """The last state a component reported, and when it arrived (steady s)."""

    state: ComponentState
    at: float


@dataclass(slots=True)
class InstanceLife:
    """The life of one instance: its states, and what belongs to them.

    ``handle``: how its process is found, if a manager started it. ``latest``: what it reported last, while it is
    connected; ``keeps_state``: whether it exports state, by what it reported last. ``exit``: of one that has exited or
    is missing; ``role``: of one that is missing, or was. ``fenced``: of one that is, what was done and why; ``closed``:
    the ports and topics of its outputs that were closed. ``silent``: its host cannot be reached, and its lease is over:
    it writes nothing, and is to be ended once it can be. ``history``: the latest transitions, with their reasons.
    """

    process: ProcessState = ProcessState.ABSENT
    connection: ConnectionState = ConnectionState.NONE
    fence: FenceState = FenceState.NONE
    handle: Handle | None = None
    latest: LatestState | None = None
    keeps_state: bool = False
    exit: Exited | None = None
    role: str | None = None
    fenced: FencedInstance | None = None
    closed: list[tuple[str, str]] = field(default_factory=list)
    silent: bool = False
    history: deque[Transition] = field(default_factory=lambda: deque(maxlen=KEPT))

    @property
    def is_owned(self) -> bool:
        """True if a manager has started the process, so that this one may terminate it."""
        return self.handle is not None

    @property
    def is_over(self) -> bool:
        """True if the life need not be kept."""
        states = self.process is ProcessState.ABSENT, self.connection is ConnectionState.NONE
        return all(states) and self.fence is FenceState.NONE and not self.is_owned and self.role is None


_UNKNOWN: Final = InstanceLife()


class LifeTable:
    """The lives of the instances of one system, by name, in the order in which their processes have changed.

    What has happened is passed to :meth:`record`, or to one of the methods that record more than the event. Each raises
    ForbiddenTransition where that is the policy (:mod:`.transitions`).
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lives: dict[str, InstanceLife] = {}

    # -- what has happened -------------------------------------------------------------------------------

    def record(self, name: str, event: LifeEvent, because: str | None = None) -> None:
        """``event`` has happened to an instance; ``because``: more than the event says."""
        life, because = self._of(name), because or f"{name}: {event.value}"
        life.history.append(Transition(self._clock.steady(), event, because))
        match event:
            case ProcessEvent():
                before, life.process = life.process, PROCESSES.after(life.process, event, name)
                if event in {ProcessEvent.ENDED, ProcessEvent.KILLED, ProcessEvent.COMPLETED}:
                    life.handle, life.silent = None, False
                if event in {ProcessEvent.REPLACED, ProcessEvent.SUPPLANTED}:
                    life.role = None
                if life.process not in {ProcessState.EXITED, ProcessState.MISSING}:
                    life.exit = None  # of an earlier process of that name
                if life.process is not before:
                    self._lives[name] = self._lives.pop(name)
            case ConnectionEvent():
                life.connection = CONNECTIONS.after(life.connection, event, name)
                if event in {ConnectionEvent.BROKEN, ConnectionEvent.DISCONNECTED}:
                    life.latest = None
            case FenceEvent():
                life.fence = FENCES.after(life.fence, event, name)
                if life.fence is FenceState.NONE:
                    life.fenced = None
        log.debug("%s (process %s, connection %s)", because, life.process.name, life.connection.name)
        if life.is_over:
            del self._lives[name]

    def started(self, name: str, handle: Handle | None) -> None:
        """Record that a process was started or, without ``handle``, is started by hand and awaited."""
        self._of(name).handle = handle
        self.record(name, ProcessEvent.STARTED)

    def adopted(self, name: str, handle: Handle | None) -> None:
        """Record that an instance still runs; with ``handle``, a manager started it and may end it."""
        self._of(name).handle = handle
        self.record(name, ProcessEvent.ADOPTED)

    def exited(self, exit: Exited, event: ProcessEvent = ProcessEvent.EXITED) -> None:
        """Record that an instance has exited without being asked to, or was ``KILLED``."""
        self._of(exit.instance).exit = exit
        self.record(exit.instance, event, exit.words)

    def fell_silent(self, exit: Exited) -> None:
        """Record that the host of an instance cannot be reached, and its lease is over: it counts as exited."""
        self._of(exit.instance).silent = True
        self.exited(exit)

    def left_silent(self, handle: Handle, role: str, because: str) -> None:
        """Record that one which an earlier manager took for exited still cannot be reached on its host."""
        exit = Exited(handle.instance, None, because=because, silent=True)
        self.adopted(handle.instance, handle)
        self.fell_silent(exit)
        self.missed(handle.instance, role, exit)

    def give_up(self, name: str) -> None:
        """Record that one which could not be terminated counts as exited: a person says that its host is dead."""
        self._of(name).silent = True

    def missed(self, name: str, role: str | None, exit: Exited) -> None:
        """Record that a role is without an instance: ``name`` has exited unexpectedly, or could not be started."""
        life = self._of(name)
        life.role, life.exit = role, exit
        self.record(name, ProcessEvent.MISSED, exit.words)

    def miss_again(self, exits: Mapping[str, Exited], instances: Container[str]) -> None:
        """Record that these are missing again, but for ``instances`` of the model: what restored them was undone."""
        for name, exit in exits.items():
            if name not in instances and self[name].process is not ProcessState.MISSING:
                self.missed(name, self[name].role, exit)
        self._lives = {name: self._lives[name] for name in exits if name in self._lives} | self._lives

    def take_exited(self, instances: Mapping[str, Instance]) -> list[str]:
        """Return the names of the exited ``instances`` of the model, whose roles miss them from now on.

        The caller takes them out of the model.
        """
        found = self.exits
        for name, exit in found.items():
            if name in instances:
                if not self[name].silent:
                    self._of(name).handle = None
                self.missed(name, instances[name].role, exit)
            else:
                if (life := self[name]).silent:  # it has exited by now, and needs no end
                    life.handle, life.silent = None, False
                self.record(name, ProcessEvent.REPLACED)
        return sorted(found.keys() & instances.keys())

    def fence(self, fenced: FencedInstance, closed: list[tuple[str, str]]) -> None:
        """Record a fence of the change in progress; ``closed``: the outputs that were closed, none after a kill."""
        life = self._of(fenced.instance)
        life.fenced, life.closed = fenced, closed
        self.record(fenced.instance, FenceEvent.CLOSED if fenced.how == "gate" else FenceEvent.KILLED, fenced.words)

    def begin_change(self) -> None:
        """Another change begins, which may fence again what the one before has fenced."""
        for name in self.fenced:
            self.record(name, FenceEvent.CHANGE_BEGUN)

    def reported(self, state: ComponentState) -> None:
        """A component has reported its state."""
        life = self._of(state.instance)
        life.latest, life.keeps_state = LatestState(state, self._clock.steady()), state.keeps_state

    # -- what is the case --------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> InstanceLife:
        """The life of an instance; that of an unknown one is empty."""
        return self._lives.get(name, _UNKNOWN)

    @property
    def handles(self) -> dict[str, Handle]:
        """The handles of the processes that a manager started, which this one may terminate."""
        return {name: life.handle for name, life in self._lives.items() if life.handle is not None}

    @property
    def exits(self) -> dict[str, Exited]:
        """The exits of instances that the model may still have and that were unexpected, the earliest first."""
        return self._exits(ProcessState.EXITED)

    @property
    def missing(self) -> dict[str, Exited]:
        """The unexpected exits of instances whose roles have none since, the earliest first."""
        return self._exits(ProcessState.MISSING)

    def left_on_hosts(self, instances: Container[str]) -> list[str]:
        """The names of those that could not be terminated on another host, and are not among ``instances``."""
        left = {ProcessState.STUCK, ProcessState.MISSING}
        return [
            name
            for name, life in self._lives.items()
            if life.process in left and life.handle is not None and life.handle.host and name not in instances
        ]

    def may_run(self, name: str) -> bool:
        """True if an instance could not be terminated on another host, where it may run and publish."""
        life = self[name]
        return life.process is ProcessState.STUCK and life.handle is not None and bool(life.handle.host)

    @property
    def silent(self) -> set[str]:
        """The instances that may run on a host that cannot be reached, and whose lease is over."""
        return {name for name, life in self._lives.items() if life.silent}

    @property
    def fenced(self) -> dict[str, FencedInstance]:
        """The instances that the change in progress, or the last one, has fenced, and why."""
        return {name: life.fenced for name, life in self._lives.items() if life.fenced is not None}

    def is_ending(self, name: str) -> bool:
        """True once an instance has been asked to exit: it need not answer any more."""
        return self[name].process is ProcessState.STOPPING

    def has_exited(self, name: str) -> bool:
        """True if an instance has exited unexpectedly, while the model may still have it."""
        return self[name].process is ProcessState.EXITED

    def is_done(self, name: str) -> bool:
        """True if the program of an instance has ended as it should: nothing runs, and nothing is missing."""
        return self[name].process is ProcessState.DONE

    def is_gone(self, name: str) -> bool:
        """True if a process has exited, or is about to: the end of its connection is known first."""
        life = self[name]
        return life.process is ProcessState.EXITED or life.connection is ConnectionState.GONE

    def is_gone_or_fenced(self, name: str) -> bool:
        """True if an instance is sent no commands any more."""
        return self.is_gone(name) or self[name].fence is not FenceState.NONE

    def latest(self, name: str) -> LatestState | None:
        """The state that the component last reported, while it is connected."""
        return self[name].latest

    @property
    def latest_states(self) -> dict[str, LatestState]:
        """The last report of each component that is connected."""
        return {name: life.latest for name, life in self._lives.items() if life.latest is not None}

    def responsive(self, name: str) -> ComponentState | None:
        """The state that the component last reported; None if it is not connected or silent for over ``SILENCE``."""
        latest = self.latest(name)
        return None if latest is None or self.is_silent(name) else latest.state

    def is_unreported(self, name: str) -> bool:
        """True if a component runs that has reported nothing since its connection was lost."""
        life = self[name]
        lost = life.connection in {ConnectionState.OPEN, ConnectionState.CLOSED} and life.latest is None
        return lost and life.process in {ProcessState.RUNNING, ProcessState.STUCK}

    def is_silent(self, name: str) -> bool:
        """True if a component that is connected has not reported for over ``SILENCE``."""
        latest = self.latest(name)
        return latest is not None and self._clock.steady() - latest.at > SILENCE

    def is_stopped(self, name: str) -> bool:
        """True if a connected component has reported nothing for so long that it counts as stopped."""
        latest = self.latest(name)
        return latest is not None and self._clock.steady() - latest.at >= STOPPED

    def _of(self, name: str) -> InstanceLife:
        return self._lives.setdefault(name, InstanceLife())

    def _exits(self, state: ProcessState) -> dict[str, Exited]:
        lives = self._lives.items()
        return {name: life.exit for name, life in lives if life.process is state and life.exit is not None}

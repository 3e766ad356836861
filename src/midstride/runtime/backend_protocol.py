"""The back-end protocol: all that the manager needs from a platform.

A back end starts and ends the processes of components, says where their control sockets are, and shows the graph as
the middleware sees it. Commands travel over :mod:`midstride.wire`, the same way on every platform. Foreign exceptions
are translated here: a back end raises ``BackendError`` and its kinds only.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from midstride.errors import BackendError
from midstride.model.component import DEFAULT_STOP, ComponentSpec, ParameterSection, StopTimes
from midstride.model.contract import Predicate
from midstride.model.hosts import OWN_HOST, HostSpec
from midstride.model.load_words import LoadWords
from midstride.model.wording import exception_in
from midstride.runtime.manager_clock import Clock
from midstride.runtime.records.status_forms import Middleware
from midstride.wire.clock_offset import SAME_CLOCK, ClockOffset
from midstride.wire.state import ComponentState
from midstride.wire.transport import Transport

# What the name of a relay's node has after the name of its instance, which is that of the program's node.
RELAY_SUFFIX: Final = "_relay"
# Why nodes of one process have one name, and what to write. The preloaded library names one node alone.
NAMES_ALL: Final = (
    "`__node:=` names all nodes of a process: state `renames NAME` with what the program calls the one that is meant, "
    "or `unnamed`"
)


@dataclass(frozen=True, slots=True)
class Launch:
    """The command that starts one component (split as a shell would) and the name of its instance.

    ``set_parameters`` are values that were set while its predecessor ran; they take precedence over ``parameters``.
    ``node`` is the name of its ROS node where the platform allows two nodes of one name, by default the instance's.
    ``standby``: another instance of that node answers requests until the new one is sent ``answer``. ``patience``: for
    how long its goals go on once its own successor takes new ones (s). ``predecessor``: the instance that it is to
    replace, which runs until then; empty where there is none.
    ``package``: the program is an executable of that package, where the platform has such.
    ``prefix``: words before the program; ``environment``: variables that its process has besides, None for one that it
    does not inherit.
    ``role``: what it is an instance of. ``sections``: parameters of further nodes in the process, where its program
    does not use Midstride's API. ``foreign``: the component, where its program does not use Midstride's API;
    ``topics`` then has those of its ports. ``load``: what is loaded into the process once it runs, where the program is
    a component container. ``process``: the name of that container, where others are loaded into it as well; the first
    of them starts it. Empty where it has one for itself. ``returns``: a roll-back starts it again, as it was.
    ``host``: the one that its process is to run on.
    """

    instance: str
    namespace: str
    arguments: tuple[str, ...]
    token: str
    directory: Path
    parameters: dict[str, object] = field(default_factory=dict)
    set_parameters: dict[str, object] = field(default_factory=dict)
    node: str = ""
    standby: bool = False
    patience: float = DEFAULT_STOP.patience
    foreign: ComponentSpec | None = None
    topics: dict[str, str] = field(default_factory=dict)
    package: str | None = None
    prefix: tuple[str, ...] = ()
    environment: dict[str, str | None] = field(default_factory=dict)
    sections: tuple[ParameterSection, ...] = ()
    predecessor: str = ""
    role: str = ""
    load: LoadWords | None = None
    process: str = ""
    returns: bool = False
    host: str = OWN_HOST


@dataclass(frozen=True, slots=True)
class Handle:
    """Identifies the process of a started component, so that a later manager finds it again.

    ``host``: the one that it runs on, where the number, the start and the log are those of that host.
    """

    instance: str
    pid: int | None = None
    started: float | None = None
    log: str | None = None
    host: str = OWN_HOST

    @property
    def log_file(self) -> str | None:
        """The log as `scp` takes it: on another host, after the name of the host."""
        return f"{self.host}:{self.log}" if self.host and self.log is not None else self.log


@dataclass(frozen=True, slots=True)
class DescribedProcess:
    """The start of a process, described: its command, the variables of its environment that differ from this process's
    (None: not inherited), and the texts of the files that would be written for it. ``load``: the command that would
    load the composable node into it, as one could type it.
    """

    command: tuple[str, ...]
    environment: dict[str, str | None] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    load: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Exited:
    """A component's process exited. ``status`` is negative for a signal, None if unknown.

    ``because``: why it is missing, where there is more to say: why it could not be started, or what to state.
    ``loading``: the process of a container has exited, or has not answered, while it was loading the instance.
    ``silent``: nothing is known of the process, since its host cannot be reached; but its lease is over.
    """

    instance: str
    status: int | None
    log_tail: str = ""
    because: str | None = None
    loading: bool = False
    silent: bool = False

    @property
    def words(self) -> str:
        """The reason why the instance is missing."""
        return self.because or f"{self.instance} exited unexpectedly"

    @property
    def details(self) -> str:
        """The reason why the instance is missing, with the exit status and the exception that its log ends with."""
        status = "" if self.status is None else f" (status {self.status})"
        exception = exception_in(self.log_tail)
        return self.because or f"{self.words}{status}{'' if exception is None else f': {exception}'}"


class RemainingProcess(NamedTuple):
    """A process that still ran ``seconds`` after it was asked to end, and was killed.

    ``program`` as the kernel names it; ``pid`` is None for the program behind a relay.
    """

    pid: int | None
    program: str
    seconds: float


@dataclass(frozen=True, slots=True)
class OtherNode:
    """A ROS node that ends with an instance, as it is in its process, or in one that this has started.

    ``name`` is its full name. ``publishes``: the topics; ``serves``: its services and ROS actions, in words. Both are
    empty where not known. ``namesake``: it has the name of the instance's own node, as ``__node:=`` gives all nodes of
    a process one name.
    """

    name: str
    publishes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    namesake: bool = False

    @property
    def words(self) -> str:
        """The name of the node, and what others may rely on."""
        does = ["a second one of that name"] if self.namesake else []
        does += [f"publishes on {', '.join(self.publishes)}"] if self.publishes else []
        does += [f"serves {', '.join(self.serves)}"] if self.serves else []
        return f"{self.name} ({'; '.join(does)})" if does else self.name


@dataclass(frozen=True, slots=True)
class OtherNodes:
    """The nodes that end with an instance, besides its own; ``unknown``: why some may not be known.

    ``without_own``: its process has these, and none of the name that its own one is to have.
    """

    nodes: tuple[OtherNode, ...] = ()
    unknown: str | None = None
    without_own: bool = False

    @property
    def names(self) -> list[str]:
        """The full names, sorted."""
        return sorted(node.name for node in self.nodes)

    @property
    def in_words(self) -> str:
        """The nodes in words, such as `node /a` or `nodes /a, /b`."""
        return f"node{'s' if len(self.nodes) > 1 else ''} {', '.join(self.names)}"


@dataclass(frozen=True, slots=True)
class Endpoints:
    """The graph as the middleware reports it: nodes, and publishers and subscribers as (node, topic) pairs.

    Nodes whose process has exited are excluded, even while the middleware still lists them.
    """

    nodes: frozenset[str] = frozenset()
    publishers: tuple[tuple[str, str], ...] = ()
    subscribers: tuple[tuple[str, str], ...] = ()


class HeardMessage(NamedTuple):
    """The last message, as far as it is known, on a topic that the manager listens to.

    ``at``: when it arrived (steady s); None where none has, or the publisher that wrote it is gone. ``unmet``: the
    fields that do not meet what is assumed, with their values. ``publishers``: how many there are now. ``problem``: why
    it cannot be known, in words.
    """

    at: float | None = None
    unmet: tuple[str, ...] = ()
    publishers: int = 0
    problem: str | None = None


class TopicListener(Protocol):
    """The manager's subscription to one topic."""

    def heard(self) -> HeardMessage:
        """The last message, as far as it is known now."""
        ...

    def close(self) -> None:
        """Listen no more."""


class HostLinkState(NamedTuple):
    """The link to another host. ``destination``: as `ssh` takes it.

    ``problem``: why it cannot be reached now, and what to do; None while it is connected. ``since``: from when on that
    has been so (unix s). ``version``: that of Midstride there, once it is known. ``clock``: as it was measured last.
    """

    host: str
    destination: str
    since: float
    problem: str | None
    version: str = ""
    clock: ClockOffset | None = None


class Backend(Protocol):
    """A platform. One without spare processes, or that need not know what a component reports, inherits its methods.

    ``shares_processes``: a process may have several nodes, so that :meth:`other_nodes` has to be asked now and then.
    ``reaches_hosts``: it can start processes on hosts other than the manager's.
    """

    name: str
    shares_processes: bool = False
    reaches_hosts: bool = False
    clock: Clock
    transport: Transport

    async def open(self, on_exit: Callable[[Exited], None]) -> None:
        """Join the platform. ``on_exit`` is called on the manager's loop for each component that exits unexpectedly."""

    async def close(self) -> None:
        """Leave the platform; components keep running."""

    async def reach_hosts(
        self,
        hosts: Mapping[str, HostSpec],
        token: str,
        note: Callable[[str], object],
        superseded: Callable[[], bool],
    ) -> Mapping[str, str]:
        """Connect to these hosts besides: components may be started there from now on. To be called after ``open``.

        ``token`` identifies the system; ``note`` is called with words when a host is lost or reached again. Once
        another manager has taken over, as ``superseded`` says, no connection is made any more: it would end that one's.
        Returns once each has been tried: by host that cannot be reached now, why, and what to do. Raises BackendError
        where the platform has no other hosts.
        """
        return {}

    async def leave_hosts(self, needed: Container[str]) -> None:
        """Leave the hosts on which nothing was started that may still run, but those that are ``needed``."""
        return

    def host_links(self) -> Sequence[HostLinkState]:
        """The link to each host that :meth:`reach_hosts` was called with, and that was not left since, by name."""
        return ()

    async def try_again(self, hosts: Collection[str]) -> None:
        """Connect at once to those of ``hosts`` that cannot be reached; returns once each was tried, or in a while."""
        return

    async def clock_offset(self, host: str) -> ClockOffset:
        """By how much the system clock of a host is ahead of the one here, as measured now. Raises BackendError."""
        return SAME_CLOCK

    def describe(self, launch: Launch) -> DescribedProcess:
        """Describe the process that :meth:`start` would start, also before ``open``; nothing is started or written.

        Raises StartFailed.
        """

    async def start(self, launch: Launch) -> Handle:
        """Start a component's process; it listens on its control address later. Raises StartFailed."""

    async def adopt(self, handle: Handle) -> bool:
        """Take over a component that an earlier manager started. False if it is no longer running."""

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        """End a started component, with all that it has started. Returns once it has exited: what had to be killed.

        ``stop``: how long each request to exit may take before that. What the graph still shows of it is ignored from
        then on, even if its process had exited before. Raises BackendError where its process has other nodes, and it
        alone could not be ended, so that it keeps running; EndUnknown where that is not known.
        """

    def keep_spares(self, number: int, token: str) -> None:
        """Keep so many processes ready for later starts: what is missing starts in the background.

        To be called when nothing else is going on, or before many starts. A platform without processes, or that cannot
        start them, has none.
        """
        return

    def spares(self) -> int:
        """The number of processes that are ready."""
        return 0

    def takes_spare(self, arguments: Sequence[str], directory: Path) -> bool:
        """Return whether a spare process can run a command in ``directory``; others get a new process."""
        return False

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        """Terminate the system's processes whose instance is not ``known``; returns the names of those instances.

        An earlier manager started them, but could not record them before it was killed; ``token`` identifies them.
        Raises BackendError.
        """

    def is_stopped(self, instance: str) -> bool:
        """Return whether the process of a started component is stopped (SIGSTOP), so that nothing in it runs."""

    def disconnected(self, instance: str) -> None:
        """A component that was started by hand has exited, as its control connection shows."""
        return

    def reported(self, state: ComponentState) -> None:
        """A component has reported its state."""
        return

    def unwritten(self) -> str | None:
        """The reason why what the next manager needs to know of the components could not be written to disk."""
        return None

    def hanging(self) -> list[str]:
        """The requests to load or unload one of several components that its process has not answered, in words.

        Each with what follows from it.
        """
        return []

    def executable(self, package: str, name: str, *, composable: bool = False) -> str | None:
        """The file of an executable of a package, where the platform has packages, and this one is installed.

        ``composable``: ``name`` is the class of a composable node, and the file is the library that has it.
        """
        return None

    def middleware(self) -> Middleware:
        """The middleware, and what is set for it. To be asked after ``open``."""

    async def endpoints(self, topics: Collection[str] | None = None) -> Endpoints:
        """The nodes, and the endpoints on each of ``topics`` (None: on every one), as the middleware sees them."""

    def reach(self) -> dict[str, str]:
        """The variables that decide which nodes this process can reach, such as `ROS_DOMAIN_ID`, as they take effect.

        A manager with others than the one that started the components could not reach them.
        """
        return {}

    def other_nodes(self, instances: Collection[str]) -> dict[str, OtherNodes]:
        """For each of these instances, the nodes that its end would end as well, as they are now.

        Those whose processes have no other node, as far as is known, are left out. A platform where a process is one
        node has none.
        """
        return {}

    def probe(self) -> AbstractAsyncContextManager[str | None]:
        """A new endpoint of the manager, while the context is open: a publisher that every component should discover.

        Its topic; None where there is no discovery that could stop, or where the manager's own has.
        """

    def listen(self, topic: str, assumption: Predicate) -> TopicListener:
        """Listen to a topic as the manager: by each message's fields, it meets ``assumption`` or does not.

        Publishers of every QoS are heard, and what those have kept that are transient local. Raises BackendError where
        the platform cannot, or the message type is not installed.
        """
        raise BackendError(f"on {self.name}, the manager cannot listen to topics")

    async def publisher_ids(self, topic: str, instance: str) -> frozenset[str] | None:
        """The identities of the publishers of a running instance on ``topic``, by which other processes know them too.

        Empty where none is seen yet; None where the middleware does not tell which process has a publisher.
        """
        return None

    async def lingering_readers(self, topic: str) -> int:
        """The number of subscriptions on ``topic`` that the middleware still counts for processes known to be dead."""
        return 0

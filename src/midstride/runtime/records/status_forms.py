"""The status of a running system and the other answers about it, as they go out in JSON.

Apart from :mod:`.reports`, so that a client that only looks need not import what a plan is made of.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from msgspec import UNSET, Meta, UnsetType

from midstride.codec.form import Report
from midstride.codec.parameter import ValueForm
from midstride.plan.runtime_values import time_of
from midstride.verdicts.conditions import SystemCondition

Phase: TypeAlias = Literal["starting", "up", "failed", "down"]
UnixTime: TypeAlias = Annotated[float, Meta(description="seconds since 1970")]
SilenceKind: TypeAlias = Literal[
    "unreachable", "not_answering", "not_discovering", "not_publishing", "not_receiving", "not_responding"
]


class SilenceFault(Report, frozen=True, kw_only=True):
    """A component that does not answer, or a port that has been silent for so long (null: unknown)."""

    kind: SilenceKind
    instance: str
    port: str | None = None
    topic: str | None = None
    seconds: float | UnsetType | None = UNSET
    words: str


class Service(Report, frozen=True):
    """The manager that answers, and whether its system is up."""

    system: str
    backend: str
    version: str
    pid: int
    phase: Phase
    protocol: Annotated[int, Meta(description="the version of the control protocol; 0: of one that does not say")] = 0


class HostStatus(Report, frozen=True, kw_only=True):
    """The link to another host than the manager's, where the manager has started nodes, or may.

    While it is down, nothing is known of the nodes there, and nothing but ``fallbacks`` is started elsewhere. The
    manager connects again by itself.
    """

    name: str
    destination: Annotated[str, Meta(description="as `ssh` takes it")]
    connected: bool
    since: Annotated[UnixTime, Meta(description="from when on that has been so")]
    because: Annotated[str | None, Meta(description="why it cannot be reached, and what to do; null: it is connected")]
    version: Annotated[str, Meta(description="of Midstride there; empty: not known")]
    clock_ahead: Annotated[
        float | None, Meta(description="of the manager's clock, as measured last (s); null: not measured yet")
    ] = None
    clock_uncertainty: Annotated[
        float | None,
        Meta(description="of that when it was measured, give or take (s); the clocks may have drifted apart"),
    ] = None
    instances: Annotated[list[str], Meta(description="that run there, as far as is known")]
    fallbacks: Annotated[
        list[str], Meta(description="while it is down: what takes the place of which of them, and when")
    ] = []


class FunctionalityStatus(Report, frozen=True, kw_only=True):
    """A functionality of an instance, in the mode that its component reports, else in that of the manager's model."""

    name: str
    mode: str
    modes: Annotated[list[str], Meta(description="best first")]
    modelled: Annotated[str, Meta(description="the mode in the manager's model")]
    normal: Annotated[bool, Meta(description="it is in its best mode")]
    because: Annotated[str | None, Meta(description="why it is in this mode")]
    reflex: Annotated[bool, Meta(description="the component's local reflex has led to this mode")]
    restoring: Annotated[
        str | None, Meta(description="whether and when it is restored after that, in words; null: by a command only")
    ]
    since: Annotated[UnixTime | None, Meta(description="when it entered this mode; null: not known")]
    busy: Annotated[
        float | UnsetType | None, Meta(description="how long the current call of user code has taken, in seconds")
    ] = UNSET


class FieldStatus(Report, frozen=True, kw_only=True):
    """Samples of one field that the contract constrains."""

    field: str
    constraint: str
    checked: int
    violations: int
    run: Annotated[int, Meta(description="how many of the latest samples violate it, without one that meets it")]
    last: Annotated[bool | int | float | str | None, Meta(description="the last value that violated it")]


class PortStatus(Report, frozen=True, kw_only=True):
    """A port of an instance on a topic, or on none, with what its component measures there on its ROS clock.

    In the stream, measurements are rounded, and refreshed where they change noticeably.
    """

    name: str
    direction: Literal["in", "out"]
    functionalities: Annotated[list[str], Meta(description="that write to it, or use it")]
    topic: Annotated[str | None, Meta(description="the `name` in `topics`; null: it is attached to none")]
    type: str | None
    gate: Annotated[Literal["open", "closed"] | None, Meta(description="null: an input, or not known")]
    declared: Annotated[float | None, Meta(description="the rate (Hz) that is guaranteed or assumed now")]
    rate: Annotated[float | None, Meta(description="as measured (Hz)")]
    met: Annotated[
        bool | None,
        Meta(description="the rate is at least 90 % of the declared one; null until a whole window is measured"),
    ]
    age: Annotated[float | None, Meta(description="of the last message (s)")]
    jitter: Annotated[float | None, Meta(description="standard deviation of the times between messages (s)")]
    longest: Annotated[float | None, Meta(description="the longest time between messages, or since the last one (s)")]
    window: Annotated[
        float | UnsetType | None, Meta(description="over which all of this is measured (s); null: nothing is")
    ] = UNSET
    fields: list[FieldStatus] | UnsetType = UNSET
    kept_out: Annotated[
        bool, Meta(description="it would use intra-process communication, which goes past a gate, without one")
    ] = False


class EndpointStatus(Report, frozen=True, kw_only=True):
    """A service, ROS action or topic of an instance's node that is no port, as its component allows it."""

    kind: Literal["topic", "service", "ROS action"]
    name: Annotated[str, Meta(description="in full, as `/map/save`")]
    serves: Annotated[
        bool | None, Meta(description="it is the server; false: it calls it; null: a topic, or not known")
    ]


class ProgramStatus(Report, frozen=True, kw_only=True):
    """The program of an instance, as far as it is known."""

    name: str
    role: str
    files: Annotated[list[str], Meta(description="its script, the modules that it has imported, and what `run` names")]
    changed: Annotated[list[str], Meta(description="those that have changed on disk since it started")]
    unknown: Annotated[str | None, Meta(description="what is not known of it")]
    startable: Annotated[bool, Meta(description="whether the manager can start it: its component has a `run` command")]
    executable: Annotated[
        str | None,
        Meta(description="the file of the package's executable that its `run` names, as the manager finds it"),
    ] = None


class ParameterStatus(Report, frozen=True):
    """A parameter of a component. Where it was set at run time, `declared` is the value that it was started with.

    `origin`: `unknown` where a ROS tool has set it, or the node itself; `node` where it is known that the node itself
    has, as nothing has asked it to set that parameter; absent otherwise. `set_at`: when a request has set it
    (Unix time, s), where that was noted.
    """

    name: str
    value: ValueForm
    declared: ValueForm
    set_at_run_time: bool
    origin: Literal["unknown", "node"] | UnsetType = UNSET
    set_at: float | UnsetType = UNSET


class ParametersReport(Report, frozen=True):
    """Parameters of an instance, as it has them now.

    `unread`: why its node has not said them; `parameters` are then those that it said last. Absent if it has.
    """

    instance: str
    parameters: list[ParameterStatus]
    unread: str | UnsetType = UNSET


class OtherNodeStatus(Report, frozen=True):
    """A ROS node that ends with an instance, since it is in its process, or in one that this has started."""

    name: Annotated[str, Meta(description="its full name")]
    publishes: Annotated[list[str], Meta(description="topics")] = []
    serves: Annotated[list[str], Meta(description="services and ROS actions, in words")] = []
    namesake: Annotated[bool, Meta(description="it has the name of the program's own node")] = False


class InstanceStatus(Report, frozen=True, kw_only=True):
    """An instance, as it last reported itself."""

    name: str
    role: str
    component: str
    container: Annotated[str | None, Meta(description="of the system, that loads its node beside others")] = None
    process: Annotated[
        str | None,
        Meta(description="the process of that container which it shares; null: it has one for itself"),
    ] = None
    namespace: Annotated[str, Meta(description="of its role: `/` or `/front`")]
    host: Annotated[
        str | None,
        Meta(description="of the specification, else the computer or container that reports it; null: the manager's"),
    ]
    node: Annotated[str | None, Meta(description="the full name of its ROS node; null where there is none")]
    pid: int | None
    reachable: Annotated[bool, Meta(description="it has reported its state in the last 2 s")]
    unreachable: Annotated[bool, Meta(description="its host cannot be reached: whether it runs is not known")] = False
    answers: Annotated[bool, Meta(description="it answers requests to its node's services")]
    ending: Annotated[bool, Meta(description="it has been asked to end")]
    done: Annotated[bool, Meta(description="its program has ended as it should (`once`)")] = False
    waiting: Annotated[str | None, Meta(description="what it is waiting for")]
    as_modelled: Annotated[bool, Meta(description="its modes are those of the manager's model")]
    differences: Annotated[list[str], Meta(description="in which way its node is not what is declared")]
    undeclared: Annotated[list[str], Meta(description="the topics of its node that are no ports")]
    other_nodes: Annotated[list[OtherNodeStatus], Meta(description="that end with it, besides its own")] = []
    other_nodes_unknown: Annotated[str | None, Meta(description="why some of them may not be known")] = None
    deviation: Annotated[str | None, Meta(description="in which way it is not as specified, in words; null: it is")]
    simulated_time: Annotated[bool, Meta(description="/clock drives its ROS clock")]
    run: Annotated[str | None, Meta(description="the command it was started with; null: it was started elsewhere")]
    log_file: str | None
    functionalities: list[FunctionalityStatus]
    ports: list[PortStatus]
    parameters: Annotated[list[ParameterStatus], Meta(description="none where it is not reachable")]
    endpoints: Annotated[list[EndpointStatus], Meta(description="that are no ports, by kind and name")]
    changed_files: Annotated[
        list[str] | UnsetType, Meta(description="of its program: changed on disk since it started")
    ] = UNSET
    unknown_files: Annotated[str | UnsetType | None, Meta(description="what is not known of its program's files")] = (
        UNSET
    )
    executable: Annotated[
        str | UnsetType | None, Meta(description="the file of the package's executable that its `run` names")
    ] = UNSET


class RespawnStatus(Report, frozen=True, kw_only=True):
    """The state of the restart policy of a crashed node: how many of its restarts are used up, and what is next."""

    restarting: Annotated[bool, Meta(description="false: its restarts are used up")]
    seconds: Annotated[float | None, Meta(description="until the next restart; null: it has begun, or there is none")]
    restarts: int
    max_retries: Annotated[int | None, Meta(description="in the window; null: no limit")]
    window: Annotated[float, Meta(description="the time in which restarts count, in seconds")]
    words: str


class CrashedInstance(Report, frozen=True):
    """An instance that exited unexpectedly, or could not be started.

    `status` is negative for a signal, null where it is not known.
    """

    name: str
    status: int | None
    log: str
    remedy: Annotated[str | None, Meta(description="what to do, in words")] = None
    respawn: Annotated[RespawnStatus | None, Meta(description="null: the node has no restart policy")] = None
    role: Annotated[str | None, Meta(description="null: the specification does not have it any more")] = None
    words: Annotated[str, Meta(description="why it does not run")] = ""
    container: Annotated[str | None, Meta(description="of the system, that loads its node beside others")] = None


class OtherEndpoints(Report, frozen=True, kw_only=True):
    """The nodes, by their full names, with endpoints on a topic that are no ports, as ROS's graph shows them."""

    publishers: Annotated[list[str], Meta(description="empty where a port publishes")]
    subscribers: Annotated[list[str], Meta(description="empty where a port listens")]


class TopicStatus(Report, frozen=True, kw_only=True):
    """A topic, service or ROS action.

    `topic` is its name in ROS, which differs from `name` only while its contract is being changed.
    """

    name: str
    topic: str
    type: str
    rate: Annotated[float | None, Meta(description="that its contract guarantees (Hz)")]
    satisfied: Annotated[bool, Meta(description="its contract, in the manager's model")]
    publishers: Annotated[list[str], Meta(description="attached outputs, as `talker.out`; of a service, its server")]
    subscribers: Annotated[list[str], Meta(description="attached inputs; of a service, its clients")]
    outside: Annotated[list[str], Meta(description="publishers outside the system, that the specification declares")]
    others: Annotated[
        OtherEndpoints | UnsetType | None,
        Meta(
            description="the nodes that publish or listen where no port does; null: ports do both, or it is not known"
        ),
    ] = UNSET


class RunningCommand(Report, frozen=True):
    """The command that is being carried out, and for how long."""

    command: str
    seconds: float | UnsetType = UNSET


class SpareStatus(Report, frozen=True, kw_only=True):
    """The processes that are kept ready for the next components."""

    kept: int
    ready: int
    unused_by: Annotated[list[str], Meta(description="instances whose command no spare can run")]


class ChangeLock(Report, frozen=True, kw_only=True):
    """A lock: no command changes the system, but `down`, until it is unlocked."""

    reason: str
    by: Annotated[str, Meta(description="who has locked it, as `alice@robot`")]
    since: Annotated[float, Meta(description="in unix seconds")]
    until: Annotated[float | None, Meta(description="when it ends, in unix seconds; null: when it is unlocked")]
    holds_recovery: Annotated[
        bool, Meta(description="nor does the manager restart what has crashed, and restore what has degraded")
    ] = False

    @property
    def words(self) -> str:
        """The holder of the lock, until when, and why."""
        end = "until it is unlocked" if self.until is None else f"until {time_of(self.until)}"
        return f"the system is locked by {self.by} since {time_of(self.since)}, {end}: {self.reason}"


class RequirementStatus(Report, frozen=True, kw_only=True):
    """A requirement for changes of a topic, and whether it holds now; what is unknown does not hold."""

    requirement: Annotated[str, Meta(description="as the specification states it")]
    topic: str
    recovery: Annotated[bool, Meta(description="restarts of what has crashed, and restoring, require it as well")]
    holds: bool
    because: Annotated[str | None, Meta(description="why it does not hold")]

    @property
    def words(self) -> str:
        """The requirement, and whether it holds."""
        return f"{self.requirement}: {'it holds' if self.holds else self.because}"


class Middleware(Report, frozen=True, kw_only=True):
    """The middleware, and the variables of it that a back end sets for the processes it starts, and those it leaves.

    ``domain`` (of ROS 2), ``master`` (of ROS 1) and ``distribution`` are empty where a back end has none, or does not
    know. ``problem``: what kept nodes from finding each other as the manager was started; empty where nothing did.
    """

    name: str
    domain: str = ""
    master: str = ""
    distribution: str = ""
    problem: str = ""
    set: dict[str, str] = {}
    kept: dict[str, str] = {}
    notes: list[str] = []

    @property
    def where(self) -> str:
        """The middleware, its domain or master, and the distribution, in words; empty where only the name is known."""
        domain = f" in domain {self.domain}" if self.domain else ""
        master = f" at the master {self.master}" if self.master else ""
        distribution = f" on ROS {1 if self.master else 2} {self.distribution}" if self.distribution else ""
        return f"{self.name}{domain}{master}{distribution}" if domain or master or distribution else ""


class Status(Report, frozen=True, kw_only=True):
    """The running system. Instances and topics are sorted by name.

    It is a part of the live view, SystemView, whose stream leaves out what changes with every look: fields that may be
    absent.
    """

    system: str
    backend: str
    revision: int
    running: Annotated[RunningCommand | None, Meta(description="the command in progress")]
    lock: Annotated[ChangeLock | None, Meta(description="null: the system is not locked")] = None
    requirements: Annotated[list[RequirementStatus], Meta(description="what changes require")] = []
    condition: Annotated[SystemCondition, Meta(description="what runs, and what is missing or worse than it should be")]
    valid: Annotated[bool, Meta(description="the configuration is, and its components report what the model has")]
    violations: list[str]
    instances: list[InstanceStatus]
    topics: list[TopicStatus]
    crashed: list[CrashedInstance]
    silences: list[SilenceFault]
    unwritten: Annotated[str | None, Meta(description="why the state or the journal could not be written to disk")]
    damaged: Annotated[str | None, Meta(description="where a damaged journal is kept, and what was wrong with it")]
    file: Annotated[str | None, Meta(description="the file that was brought up, or applied last")]
    changed_since: Annotated[bool, Meta(description="another command has changed the specification since then")]
    middleware: Middleware
    spares: SpareStatus
    hosts: Annotated[list[HostStatus], Meta(description="other than the manager's")] = []


class Why(Report, frozen=True, kw_only=True):
    """The reason why a functionality of a node is in its mode: its own, what each better mode lacks, and what to do."""

    functionality: str
    instance: Annotated[str, Meta(description="of the node: the one that was looked at")]
    host: Annotated[str | UnsetType, Meta(description="of the specification; left out: that of the manager")] = UNSET
    mode: str
    normal: bool
    because: str | None
    chain: list[str]
    inputs: Annotated[dict[str, bool], Meta(description="whether each input is satisfied")]
    remedies: Annotated[list[str], Meta(description="what comes next, or what to do, for each root cause")] = []

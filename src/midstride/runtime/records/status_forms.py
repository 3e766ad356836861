"""The status of a running system and the other answers about it, as they go out in JSON.

Apart from :mod:`.reports`, so that a client that only looks need not import what a plan is made of.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from midstride.codec.form import Report
from midstride.codec.parameter import ValueForm

Phase: TypeAlias = Literal["starting", "up", "failed", "down"]
SilenceKind: TypeAlias = Literal["not_answering", "not_discovering", "not_publishing", "not_receiving"]


class SilenceFault(Report, frozen=True, kw_only=True):
    """A component that does not answer, or a port that has been silent for so long, in seconds (null: unknown)."""

    kind: SilenceKind
    instance: str
    port: str | None = None
    topic: str | None = None
    seconds: float | None
    words: str


class Service(Report, frozen=True):
    """The manager that answers, and whether its system is up."""

    system: str
    backend: str
    version: str
    pid: int
    phase: Phase


class FunctionalityStatus(Report, frozen=True):
    """A functionality: the mode it is in and the one it should be in. Null: its component did not answer."""

    name: str
    mode: str
    modelled: str
    normal: bool
    because: str | None
    since: Annotated[float | None, Meta(description="how long it has been in this mode, in seconds")]
    busy: Annotated[float | None, Meta(description="how long the current call of user code has taken, in seconds")]
    restoring: Annotated[
        str | None, Meta(description="whether and when it is restored after the local reflex; null: by a command only")
    ] = None


class FieldStatus(Report, frozen=True, kw_only=True):
    """Samples of one field that the contract constrains."""

    field: str
    constraint: str
    checked: int
    violations: int
    run: Annotated[int, Meta(description="how many of the latest samples violate it, without one that meets it")]
    last: Annotated[bool | int | float | str | None, Meta(description="the last value that violated it")]


class MeasuredStatus(Report, frozen=True, kw_only=True):
    """The messages of an attachment as its component measures them, on its ROS clock, against what is declared.

    Rates are in Hz, times in seconds. Null: not known yet, or nothing is declared.
    """

    declared: Annotated[float | None, Meta(description="the rate that the mode guarantees, or that the input assumes")]
    rate: float | None
    met: Annotated[
        bool | None,
        Meta(description="the rate is at least 90 % of the declared one; null until a whole window is measured"),
    ]
    window: Annotated[float, Meta(description="the length of the window over which the rate is measured")]
    age: Annotated[float | None, Meta(description="how old the last message is")]
    jitter: Annotated[float | None, Meta(description="standard deviation of the times between messages")]
    longest: Annotated[float | None, Meta(description="the longest time between two messages, or since the last one")]
    fields: list[FieldStatus]


class AttachmentStatus(Report, frozen=True):
    """A port on a topic; the gate of an output lets its messages through or not."""

    port: str
    topic: str
    gate: Literal["open", "closed"] | None
    measured: Annotated[MeasuredStatus | None, Meta(description="null where its component does not answer")] = None


class ProgramStatus(Report, frozen=True, kw_only=True):
    """The program of an instance, as far as it is known."""

    name: str
    role: str
    files: Annotated[list[str], Meta(description="its script, the modules that it has imported, and what `run` names")]
    changed: Annotated[list[str], Meta(description="those that have changed on disk since it started")]
    unknown: Annotated[str | None, Meta(description="what is not known of it")]
    startable: Annotated[bool, Meta(description="whether the manager can start it: its component has a `run` command")]


class ParameterStatus(Report, frozen=True):
    """A parameter of a component. Where it was set at run time, `declared` is the value that it was started with."""

    name: str
    value: ValueForm
    declared: ValueForm
    set_at_run_time: bool


class ParametersReport(Report, frozen=True):
    """The parameters that were set, as the instance has them now."""

    instance: str
    parameters: list[ParameterStatus]


class ComponentStatus(Report, frozen=True, kw_only=True):
    """An instance, as it reports itself where it is reachable."""

    name: str
    role: str
    component: str
    pid: int | None
    node: Annotated[str | None, Meta(description="the full name of its ROS node; null where there is none")]
    answers: Annotated[bool, Meta(description="it answers requests to its node's services")]
    reachable: bool
    ending: Annotated[bool, Meta(description="it has been asked to end")]
    waiting: Annotated[str | None, Meta(description="what it is waiting for")]
    differences: Annotated[list[str], Meta(description="in which way its node is not what is declared")]
    undeclared: Annotated[
        list[str], Meta(description="the topics of its node that are no ports: they have no gate")
    ] = []
    as_modelled: bool
    changed_files: Annotated[list[str], Meta(description="of its program: changed on disk since it started")]
    unknown_files: Annotated[str | None, Meta(description="what is not known of its program's files")]
    functionalities: list[FunctionalityStatus]
    attachments: list[AttachmentStatus]
    parameters: Annotated[list[ParameterStatus], Meta(description="none where it does not answer")] = []
    simulated_time: Annotated[bool, Meta(description="/clock drives its ROS clock")] = False
    run: Annotated[str | None, Meta(description="the command it was started with; null: it was started elsewhere")] = (
        None
    )
    log_file: str | None = None


class RespawnStatus(Report, frozen=True, kw_only=True):
    """What the restart policy of a crashed node comes to: how many of its restarts are used up, and what is next."""

    restarting: Annotated[bool, Meta(description="false: its restarts are used up")]
    seconds: Annotated[float | None, Meta(description="until the next restart; null: it has begun, or there is none")]
    restarts: int
    max_retries: int
    window: Annotated[float, Meta(description="the time in which restarts count, in seconds")]
    words: str


class CrashedInstance(Report, frozen=True):
    """An instance that exited unexpectedly; `status` is negative for a signal, null where it is not known."""

    name: str
    status: int | None
    log: str
    remedy: Annotated[str | None, Meta(description="what to do, in words")] = None
    respawn: Annotated[RespawnStatus | None, Meta(description="null: the node has no restart policy")] = None
    role: Annotated[str | None, Meta(description="null: the specification does not have it any more")] = None


class TopicStatus(Report, frozen=True):
    """A topic, whether its contract is satisfied, and its ports."""

    name: str
    satisfied: bool
    publishers: list[str]
    subscribers: list[str]


class RunningCommand(Report, frozen=True):
    """The command that is being carried out, and for how long, in seconds."""

    command: str
    since: float


class SpareStatus(Report, frozen=True, kw_only=True):
    """The processes that are kept ready for the next components."""

    kept: int
    ready: int
    unused_by: Annotated[list[str], Meta(description="instances whose command no spare can run")]


class Middleware(Report, frozen=True, kw_only=True):
    """What a back end sets in the environment of the processes that it starts, and what it leaves as set."""

    name: str
    set: dict[str, str] = {}
    kept: dict[str, str] = {}
    notes: list[str] = []


class Status(Report, frozen=True, kw_only=True):
    """The running system."""

    valid: bool
    violations: list[str]
    components: list[ComponentStatus]
    crashed: list[CrashedInstance]
    silences: list[SilenceFault]
    topics: list[TopicStatus]
    system: str
    backend: str
    revision: int
    running: RunningCommand | None
    unwritten: Annotated[str | None, Meta(description="why the state or the journal could not be written to disk")]
    damaged: Annotated[str | None, Meta(description="where a damaged journal is kept, and what was wrong with it")]
    middleware: Middleware
    spares: SpareStatus
    file: Annotated[str | None, Meta(description="the file that was brought up, or applied last")] = None
    changed_since: Annotated[bool, Meta(description="another command has changed the specification since then")] = False


class Why(Report, frozen=True, kw_only=True):
    """Why a functionality of a node is in its mode: its own reason, what each better mode lacks, and what to do."""

    functionality: str
    instance: Annotated[str, Meta(description="of the node: the one that was looked at")]
    mode: str
    normal: bool
    because: str | None
    chain: list[str]
    inputs: Annotated[dict[str, bool], Meta(description="whether each input is satisfied")]
    remedies: Annotated[list[str], Meta(description="what comes next, or what to do, for each root cause")] = []

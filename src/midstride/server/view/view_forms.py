"""The forms of the live view (docs/http.md): the whole view, the patches to it, and the timeline of the past."""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from msgspec import UNSET, Meta, UnsetType

from midstride.codec.form import Report
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.mode_recorder import ModeInterval
from midstride.runtime.records.reports import Event, OutcomeKind
from midstride.runtime.records.status_forms import ParameterStatus, Phase, SilenceKind

# The version of these forms. A later version may add fields; what is there keeps its meaning.
VERSION: Final = 1

UnixTime: TypeAlias = Annotated[float, Meta(description="seconds since 1970")]
ChangeState: TypeAlias = Literal["planning", "verifying", "executing", "rolling_back", "measuring", "ended"]


class FunctionalityView(Report, frozen=True, kw_only=True):
    """A functionality of an instance, in the mode that its component reports."""

    name: str
    mode: str
    modes: Annotated[list[str], Meta(description="best first")]
    modelled: Annotated[str, Meta(description="the mode in the manager's model")]
    normal: Annotated[bool, Meta(description="it is in its best mode")]
    because: Annotated[str | None, Meta(description="why it is in this mode")]
    reflex: Annotated[bool, Meta(description="the component's local reflex has led to this mode")]
    restoring: Annotated[str | None, Meta(description="whether and when it is restored after that, in words")]
    since: Annotated[UnixTime | None, Meta(description="when it entered this mode; null: not known")]


class PortView(Report, frozen=True, kw_only=True):
    """A port of an instance on a topic, or on none. Figures are rounded, and refreshed where they change noticeably."""

    name: str
    direction: Literal["in", "out"]
    functionalities: Annotated[list[str], Meta(description="that write to it, or use it")]
    topic: Annotated[str | None, Meta(description="the `name` in `topics`; null: it is attached to none")]
    type: str | None
    gate: Annotated[Literal["open", "closed"] | None, Meta(description="null: an input, or not known")]
    declared: Annotated[float | None, Meta(description="the rate (Hz) that is guaranteed or assumed now")]
    rate: Annotated[float | None, Meta(description="as measured (Hz), to within 1 %")]
    met: Annotated[bool | None, Meta(description="the rate is at least 90 % of the declared one; null: not known")]
    age: Annotated[float | None, Meta(description="of the last message (s); coarse: to within a half, and 1 s")]
    jitter: Annotated[float | None, Meta(description="standard deviation of the times between messages (s), coarse")]
    longest: Annotated[float | None, Meta(description="the longest time between messages (s), coarse")]


class EndpointView(Report, frozen=True, kw_only=True):
    """A service, ROS action or topic of an instance's node that is no port, as its component allows it."""

    kind: Literal["topic", "service", "ROS action"]
    name: Annotated[str, Meta(description="in full, as `/map/save`")]
    serves: Annotated[
        bool | None, Meta(description="it is the server; false: it calls it; null: a topic, or not known")
    ]


class ComponentView(Report, frozen=True, kw_only=True):
    """An instance, as it last reported itself."""

    name: str
    role: str
    component: str
    namespace: Annotated[str, Meta(description="of its role: `/` or `/front`")]
    host: Annotated[str | None, Meta(description="the computer or container that reports it; null: the manager's")]
    node: Annotated[str | None, Meta(description="the full name of its ROS node")]
    pid: int | None
    answers: Annotated[bool, Meta(description="it has reported its state in the last 2 s")]
    ending: Annotated[bool, Meta(description="it has been asked to end")]
    waiting: Annotated[str | None, Meta(description="what it is waiting for")]
    as_modelled: Annotated[bool, Meta(description="its modes are those of the manager's model")]
    differences: Annotated[list[str], Meta(description="in which way its node is not what is declared")]
    undeclared: Annotated[list[str], Meta(description="the topics of its node that are no ports")]
    deviation: Annotated[str | None, Meta(description="in which way it is not as specified, in words; null: it is")]
    functionalities: list[FunctionalityView]
    ports: list[PortView]
    parameters: list[ParameterStatus]
    endpoints: Annotated[list[EndpointView], Meta(description="that are no ports, by kind and name")]


class TopicView(Report, frozen=True, kw_only=True):
    """A topic. `topic` is its name in ROS, which differs from `name` only while its contract is being changed."""

    name: str
    topic: str
    type: str
    rate: Annotated[float | None, Meta(description="that its contract guarantees (Hz)")]
    satisfied: Annotated[bool, Meta(description="its contract, in the manager's model")]
    publishers: Annotated[list[str], Meta(description="attached outputs, as `talker.out`")]
    subscribers: list[str]
    outside: Annotated[list[str], Meta(description="publishers outside the system, that the specification declares")]


class CrashView(Report, frozen=True, kw_only=True):
    """An instance that exited unexpectedly."""

    name: str
    role: str | None
    status: Annotated[int | None, Meta(description="its exit status, negative for a signal")]
    log: Annotated[str, Meta(description="the last lines of its output")]
    remedy: Annotated[str | None, Meta(description="what to do, in words")]
    respawn: Annotated[str | None, Meta(description="what its restart policy does next, in words")]


class SilenceView(Report, frozen=True, kw_only=True):
    """A component that does not answer, or a port that has been silent for too long."""

    kind: SilenceKind
    instance: str
    port: str | None
    topic: str | None
    words: str


class StepView(Report, frozen=True, kw_only=True):
    """A step of a change: when it began, and when it was done. Steps that overlap were taken at once."""

    index: Annotated[int, Meta(description="from 0, in `plan.steps`")]
    words: str
    began: UnixTime
    ended: UnixTime | None
    failed: bool


class ChangeView(Report, frozen=True, kw_only=True):
    """The change in progress, or the last one that ended."""

    id: Annotated[str | None, Meta(description="the one in its request")]
    command: str
    state: ChangeState
    plan: Annotated[PlanPreview | None, Meta(description="null until it is planned")]
    index: Annotated[int | None, Meta(description="the latest step that has begun, from 0")]
    total: Annotated[int | None, Meta(description="how many steps the plan has")]
    began: UnixTime
    ended: UnixTime | None
    steps: list[StepView]
    swaps: Annotated[list[SwapReport], Meta(description="what each subscriber saw, as measured")]
    outcome: OutcomeKind | None
    because: Annotated[str | None, Meta(description="how it ended, in words")]


class SystemView(Report, frozen=True, kw_only=True):
    """The running system. Components and topics are sorted by name."""

    version: int
    manager: Annotated[str, Meta(description="of this run of the manager: numbers of another one mean nothing to it")]
    n: Annotated[int, Meta(description="the number of this state: it grows with each that differs")]
    at: UnixTime
    system: str
    backend: str
    phase: Phase
    revision: int
    running: Annotated[str | None, Meta(description="the command in progress")]
    valid: bool
    violations: list[str]
    components: list[ComponentView]
    topics: list[TopicView]
    crashed: list[CrashView]
    silences: list[SilenceView]
    change: ChangeView | None


class Patch(Report, frozen=True, kw_only=True):
    """What has changed in a view since what the client was last sent. What is absent is as before.

    `components` and `topics` have the entries that changed, by name; null for one that is gone.
    """

    n: int
    at: UnixTime
    system: str | UnsetType = UNSET
    backend: str | UnsetType = UNSET
    phase: Phase | UnsetType = UNSET
    revision: int | UnsetType = UNSET
    running: str | UnsetType | None = UNSET
    valid: bool | UnsetType = UNSET
    violations: list[str] | UnsetType = UNSET
    components: dict[str, ComponentView | None] | UnsetType = UNSET
    topics: dict[str, TopicView | None] | UnsetType = UNSET
    crashed: list[CrashView] | UnsetType = UNSET
    silences: list[SilenceView] | UnsetType = UNSET
    change: ChangeView | UnsetType | None = UNSET


class PastChange(Report, frozen=True, kw_only=True):
    """A change that this manager has carried out, or carries out."""

    id: str | None
    command: str
    began: UnixTime
    ended: UnixTime | None
    outcome: OutcomeKind | None
    because: str | None


class Timeline(Report, frozen=True, kw_only=True):
    """What happened between two times, as far as this manager remembers it; GET /history knows of earlier ones."""

    manager: str
    since: UnixTime
    until: UnixTime
    oldest: Annotated[UnixTime, Meta(description="the view of no earlier time than this is known: GET /view/at")]
    modes: Annotated[list[ModeInterval], Meta(description="those that overlap the time, by their beginning")]
    changes: list[PastChange]
    events: Annotated[list[Event], Meta(description="all kinds, also crashes (`exited`)")]

"""The forms of the live view (docs/http.md): the whole view, the patches to it, and the timeline of the past."""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from msgspec import UNSET, Meta, UnsetType

from midstride.codec.form import Report
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.mode_recorder import ModeInterval
from midstride.runtime.records.reports import Event, OutcomeKind
from midstride.runtime.records.status_forms import (
    ChangeLock,
    CrashedInstance,
    HostStatus,
    InstanceStatus,
    Middleware,
    Phase,
    RequirementStatus,
    RunningCommand,
    SilenceFault,
    SpareStatus,
    Status,
    TopicStatus,
    UnixTime,
)
from midstride.verdicts.conditions import SystemCondition

# The version of these forms. A later version may add fields; what is there keeps its meaning.
VERSION: Final = 1

ChangeState: TypeAlias = Literal["planning", "verifying", "executing", "rolling_back", "measuring", "ended"]


class StepView(Report, frozen=True, kw_only=True):
    """A step of a change: when it began, and when it was done. Steps that overlap were carried out at once."""

    index: Annotated[int, Meta(description="from 0, in `plan.steps`")]
    words: str
    began: UnixTime
    ended: UnixTime | None
    failed: bool


class PastChange(Report, frozen=True, kw_only=True):
    """A change that this manager has carried out, or carries out."""

    id: Annotated[str | None, Meta(description="the one in its request")]
    command: str
    began: UnixTime
    ended: UnixTime | None
    outcome: OutcomeKind | None
    because: Annotated[str | None, Meta(description="how it ended, in words")]


class ChangeView(PastChange, frozen=True, kw_only=True):
    """The change in progress, or the last one that ended."""

    state: ChangeState
    plan: Annotated[PlanPreview | None, Meta(description="null until it is planned")]
    index: Annotated[int | None, Meta(description="the latest step that has begun, from 0")]
    total: Annotated[int | None, Meta(description="how many steps the plan has")]
    steps: list[StepView]
    swaps: Annotated[list[SwapReport], Meta(description="what each subscriber saw, as measured")]


class SystemView(Status, frozen=True, kw_only=True):
    """The running system, and the change in it."""

    version: int
    manager: Annotated[str, Meta(description="of this run of the manager: numbers of another one mean nothing to it")]
    n: Annotated[int, Meta(description="the number of this state: it grows with each that differs")]
    at: UnixTime
    phase: Phase
    change: ChangeView | None


class Patch(Report, frozen=True, kw_only=True):
    """The changes of a view since what the client was last sent. What is absent is as before.

    `instances` and `topics` have the entries that changed, by name; null for one that is gone.
    """

    n: int
    at: UnixTime
    system: str | UnsetType = UNSET
    backend: str | UnsetType = UNSET
    phase: Phase | UnsetType = UNSET
    revision: int | UnsetType = UNSET
    running: RunningCommand | UnsetType | None = UNSET
    lock: ChangeLock | UnsetType | None = UNSET
    requirements: list[RequirementStatus] | UnsetType = UNSET
    condition: SystemCondition | UnsetType = UNSET
    valid: bool | UnsetType = UNSET
    violations: list[str] | UnsetType = UNSET
    instances: dict[str, InstanceStatus | None] | UnsetType = UNSET
    topics: dict[str, TopicStatus | None] | UnsetType = UNSET
    crashed: list[CrashedInstance] | UnsetType = UNSET
    silences: list[SilenceFault] | UnsetType = UNSET
    unwritten: str | UnsetType | None = UNSET
    damaged: str | UnsetType | None = UNSET
    file: str | UnsetType | None = UNSET
    changed_since: bool | UnsetType = UNSET
    middleware: Middleware | UnsetType = UNSET
    spares: SpareStatus | UnsetType = UNSET
    hosts: list[HostStatus] | UnsetType = UNSET
    change: ChangeView | UnsetType | None = UNSET


class Timeline(Report, frozen=True, kw_only=True):
    """The events between two times, as far as this manager remembers it; GET /history knows of earlier ones."""

    manager: str
    since: UnixTime
    until: UnixTime
    oldest: Annotated[UnixTime, Meta(description="the view of no earlier time than this is known: GET /view/at")]
    modes: Annotated[list[ModeInterval], Meta(description="those that overlap the time, by their beginning")]
    changes: list[PastChange]
    events: Annotated[list[Event], Meta(description="all kinds, also crashes (`exited`)")]

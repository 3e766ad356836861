"""The reports of the manager, as they go out in JSON: outcomes, events, and the live configuration.

What it says of the running system is in :mod:`.status_forms`. The answers of the HTTP API are instances of these
classes, and its OpenAPI document describes them. A client ignores fields that it does not know: later versions may add
some.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, TypeAlias

from msgspec import UNSET, Meta, UnsetType, field

from midstride.codec.configuration_form import ConfigurationForm
from midstride.codec.form import Form, Report
from midstride.plan.forms.plan_forms import PlanForm, PlanPreview
from midstride.plan.forms.step_forms import AnyStep
from midstride.plan.runtime_values import RuntimeValue
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.status_forms import RequirementStatus, SilenceFault
from midstride.verdicts.assessment import Assessments
from midstride.verify.verdict import Verdict

OutcomeKind: TypeAlias = Literal["done", "incomplete", "refused", "rolled_back", "failed"]


class DegradedFunctionality(Report, frozen=True, kw_only=True):
    """A functionality of a role that is in a worse mode than before the change, or if it is new, than its normal one.

    `planned`: the plan led there. Otherwise its code raised, say, or what it relies on has exited.
    """

    functionality: str
    before: Annotated[str | None, Meta(description="the better mode")] = field(name="from")
    after: Annotated[str | None, Meta(description="the mode now; null: no instance serves it")] = field(name="to")
    planned: bool
    because: str | None


class UpReport(Report, frozen=True):
    """The system is up, with these instances; `incomplete`: without those that are `missing`."""

    outcome: Literal["done", "incomplete"]
    instances: list[str]
    degraded: Annotated[list[DegradedFunctionality], Meta(description="what is not in its normal mode")] = []
    missing: Annotated[dict[str, str], Meta(description="why nodes could not be started")] = {}
    half_done: Annotated[
        list[str], Meta(description="what an earlier manager had left half done and was ended, and what that has cost")
    ] = []


class KilledProcess(Report, frozen=True, kw_only=True):
    """A process whose end was cut short: it had to be killed, or its `on_stop` has failed. What it does then is lost.

    ``seconds``: how long it had. ``unfinished``: it was not killed, and it left undone what ``words`` says.
    """

    instance: str
    seconds: Annotated[float, Meta(description="how long it had, from when it was asked to end")]
    words: str
    unfinished: Annotated[bool, Meta(description="it was not killed, and left undone what `words` says")] = False


class DownReport(Report, frozen=True):
    """The system is down. `killed`: the processes that did not end when they were asked to, or not in order."""

    outcome: Literal["done"] = "done"
    killed: list[KilledProcess] = []


class DeadHost(Report, frozen=True, kw_only=True):
    """A host that a person has declared dead. Nothing is known of the ``instances`` of ``nodes`` that ran there."""

    host: str
    instances: list[str]
    nodes: list[str]


class FencedInstance(Report, frozen=True, kw_only=True):
    """An instance that hung, was stopped or too slow, and was replaced inside a call of its user code."""

    instance: str
    how: Annotated[Literal["gate", "killed"], Meta(description="its outputs were closed, or its process was killed")]
    because: str
    words: str


class StepTime(Report, frozen=True):
    """The duration of a step, and its begin after the first one, in seconds. Steps that overlap are in one round."""

    step: Annotated[int, Meta(description="its number in the plan, from 1")]
    began: float
    seconds: float


class ModeSkew(Report, frozen=True):
    """Functionalities of several instances that support each other, and so changed their modes in one step."""

    kind: Annotated[str, Meta(description="`degrade` or `upgrade`")]
    functionalities: list[str]
    seconds: Annotated[float, Meta(description="between the first and the last of them, as measured")]


class StateMove(Report, frozen=True, kw_only=True):
    """State has moved to a replacement, from or to a node without Midstride's API, and what waited for it."""

    bytes: int
    silent: Annotated[
        float | None,
        Meta(description="seconds from the last message of the old node to the first of the new one; null: none"),
    ]
    held: Annotated[float, Meta(description="seconds for which requests to its services were held")]
    words: str


class GoalTally(Report, frozen=True, kw_only=True):
    """The goals of the ROS actions of a node that was replaced, and of its replacement, by what became of them.

    As both have counted, from the beginning of the change to its report.
    """

    old: str
    new: str
    accepted: Annotated[int, Meta(description="in progress at the beginning, or accepted since")]
    ended_at_old: Annotated[int, Meta(description="that succeeded or were aborted, at the replaced instance")]
    ended_at_new: Annotated[int, Meta(description="the same, at its replacement")]
    cancelled: Annotated[int, Meta(description="that ended as they were cancelled, at either")]
    in_progress: Annotated[int, Meta(description="that go on at the time of the report")]
    lost: Annotated[int, Meta(description="that had not ended when their instance did")]
    unknown: Annotated[int, Meta(description="requests about goals that neither knew, which were answered so")]
    words: str


class Outcome(Report, frozen=True, kw_only=True):
    """The result of a change; `refused`: nothing was changed."""

    outcome: OutcomeKind
    plan: PlanForm | None = None
    seconds: float = 0.0
    steps: Annotated[list[StepTime], Meta(description="those that were done, as measured")] = []
    skews: list[ModeSkew] = []
    below_baseline_seconds: Annotated[dict[str, float], Meta(description="as measured, by functionality")] = {}
    swaps: list[SwapReport] = []
    late: Annotated[
        dict[str, float],
        Meta(description="seconds by which a new component's first slot waited for its state, over a period"),
    ] = {}
    own_state: Annotated[
        dict[str, str],
        Meta(description="new components that continue without the state of the old one: what is lost, and why"),
    ] = {}
    moved: Annotated[
        dict[str, StateMove],
        Meta(description="by new node, where it or the old one has no API: the state that has moved to it"),
    ] = {}
    goals: Annotated[
        dict[str, GoalTally], Meta(description="by role that was replaced: what became of the goals of its ROS actions")
    ] = {}
    because: str | None = None
    parameters: Annotated[list[RuntimeValue], Meta(description="what became of values that were set at run time")] = []
    unexpected_exits: Annotated[list[str], Meta(description="of instances, meanwhile")] = []
    unexpected_degradations: Annotated[list[str], Meta(description="of functionalities, meanwhile")] = []
    fenced: Annotated[list[FencedInstance], Meta(description="replaced although they hung")] = []
    killed: Annotated[list[KilledProcess], Meta(description="processes that did not end when they were asked to")] = []
    silences: Annotated[list[SilenceFault], Meta(description="faults that began meanwhile, and last")] = []
    remaining_degradations: Annotated[
        list[DegradedFunctionality], Meta(description="what is in a worse mode afterwards")
    ] = []
    verdict: Annotated[Verdict | UnsetType, Meta(description="what Alloy found, where requested")] = UNSET
    continuity: Annotated[
        Assessments | None, Meta(description="what was kept, what was lost, and what is not measurable; null: refused")
    ] = None


class PlannedChange(PlanForm, frozen=True, kw_only=True):
    """A plan, and the revision of the configuration that it was made for: `expected` of a change.

    `forbidden`: why it may not be carried out now; absent: it may. `requires`: what has to hold for that, and
    whether it does.
    """

    revision: int
    forbidden: str | UnsetType = UNSET
    requires: list[RequirementStatus] | UnsetType = UNSET


class LiveConfiguration(Report, frozen=True):
    """The configuration as its components report it; those in `silent` are as in the manager's model."""

    revision: int
    silent: list[str]
    configuration: ConfigurationForm


def killed_processes(events: Iterable[Event]) -> list[KilledProcess]:
    """The processes that were killed, by the events of a change or of the end of a system."""
    return [
        KilledProcess(
            instance=event.instance, seconds=event.seconds, words=event.words, unfinished=event.unfinished is True
        )
        for event in events
        if event.kind == "killed" and event.instance is not UNSET and event.seconds is not UNSET
    ]


class Event(Form, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """An event: numbered from 1, at a time (unix seconds), its kind, in words, with the details of that kind."""

    n: int
    at: float
    kind: str
    words: str
    command: Annotated[str | UnsetType, Meta(description="waiting: the command that waits")] = UNSET
    id: Annotated[str | UnsetType | None, Meta(description="waiting, command: the id in its request")] = UNSET
    index: Annotated[int | UnsetType, Meta(description="step…: which step, from 0")] = UNSET
    total: Annotated[int | UnsetType, Meta(description="step…, rollback: how many steps there are")] = UNSET
    step: Annotated[AnyStep | UnsetType, Meta(description="step…: the step of the plan")] = UNSET
    plan: Annotated[PlanPreview | UnsetType, Meta(description="plan: what will be done")] = UNSET
    swaps: Annotated[list[SwapReport] | UnsetType, Meta(description="measured: what each subscriber saw")] = UNSET
    verdict: Annotated[Verdict | UnsetType, Meta(description="verified: what Alloy found")] = UNSET
    outcome: Annotated[OutcomeKind | UnsetType, Meta(description="outcome, parameters: how the command ended")] = UNSET
    functionality: Annotated[str | UnsetType, Meta(description="degraded: which functionality")] = UNSET
    instance: Annotated[str | UnsetType, Meta(description="fenced, killed: which instance")] = UNSET
    seconds: Annotated[float | UnsetType, Meta(description="killed: how long it had to end")] = UNSET
    unfinished: Annotated[bool | UnsetType, Meta(description="killed: whether it has ended by itself")] = UNSET
    log: Annotated[str | UnsetType, Meta(description="exited: the last of the instance's output")] = UNSET

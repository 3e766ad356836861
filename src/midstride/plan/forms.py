"""The JSON form of a plan (`midstride plan --json`); :mod:`midstride.plan.decoding` leads back.

In it ``component`` is the name of an instance, as users know it, and ``of`` its component.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, TypeAlias

import msgspec
from msgspec import UNSET, UnsetType

from midstride.codec.form import Document, FiniteNumber, Form, encode, field
from midstride.codec.parameter import Value, values_form
from midstride.codec.specification import SpecificationForm
from midstride.model.action import Attach, Create, Degrade, Detach, Handover, Remove, SetParameters, Upgrade
from midstride.model.best import best
from midstride.model.configuration import Configuration
from midstride.plan.change import Change
from midstride.plan.explain import Degradation, LevelShift
from midstride.plan.plan import Plan
from midstride.plan.step import Step


class PlanPart(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """Everything in a plan is written out; keys of later versions are passed over."""


class ModeChangeForm(PlanPart, frozen=True):
    """The mode that a functionality leaves, and the one that it enters."""

    what: ClassVar[str] = "a change of mode"

    before: str = msgspec.field(name="from")
    after: str = msgspec.field(name="to")


class SwapForm(PlanPart, frozen=True):
    """A topic, the output that stops publishing on it and the one that starts."""

    what: ClassVar[str] = "a swap"

    connector: str
    old: str
    new: str


class StepForm(PlanPart, frozen=True, tag_field="action"):
    """One step of a plan; the value of ``action`` is its kind."""

    what: ClassVar[str] = "a step"

    @property
    def action(self) -> str:
        return str(self.__struct_config__.tag)


class CreateStep(StepForm, frozen=True, kw_only=True, tag="create"):
    """A new instance is started."""

    instance: str = msgspec.field(name="component")
    role: str
    component: str = msgspec.field(name="of")
    parameters: dict[str, Value] = {}
    seconds: FiniteNumber


class RemoveStep(StepForm, frozen=True, tag="remove"):
    """An instance is ended."""

    instance: str = msgspec.field(name="component")
    seconds: FiniteNumber


class AttachStep(StepForm, frozen=True, tag="attach"):
    """A port of an instance is attached to a topic."""

    port: str
    connector: str
    seconds: FiniteNumber


class DetachStep(StepForm, frozen=True, tag="detach"):
    """A port of an instance is detached from a topic."""

    port: str
    connector: str
    seconds: FiniteNumber


class DegradeStep(StepForm, frozen=True, tag="degrade"):
    """Functionalities enter worse modes."""

    modes: dict[str, ModeChangeForm]
    seconds: FiniteNumber


class UpgradeStep(StepForm, frozen=True, tag="upgrade"):
    """Functionalities enter better modes."""

    modes: dict[str, ModeChangeForm]
    seconds: FiniteNumber


class HandoverStep(StepForm, frozen=True, tag="handover"):
    """Topics change their publisher at one moment."""

    swaps: list[SwapForm]
    seconds: FiniteNumber


class SetStep(StepForm, frozen=True, tag="set"):
    """Parameters of a live instance are set in place."""

    instance: str = msgspec.field(name="component")
    parameters: dict[str, Value]
    seconds: FiniteNumber


AnyStep: TypeAlias = (
    CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep
)


def step_form(step: Step) -> AnyStep:
    """The JSON form of one step."""
    action, seconds = step.action, step.seconds
    modes = {str(each.functionality): ModeChangeForm(before=each.before, after=each.after) for each in step.modes}
    match action:
        case Create(instance=new):
            values = values_form(new.parameters)
            return CreateStep(
                instance=new.name, role=new.role, component=new.component.name, parameters=values, seconds=seconds
            )
        case Remove():
            return RemoveStep(instance=action.instance, seconds=seconds)
        case Attach():
            return AttachStep(port=str(action.port), connector=action.connector, seconds=seconds)
        case Detach():
            return DetachStep(port=str(action.port), connector=action.connector, seconds=seconds)
        case Degrade():
            return DegradeStep(modes=modes, seconds=seconds)
        case Upgrade():
            return UpgradeStep(modes=modes, seconds=seconds)
        case Handover():
            swaps = [SwapForm(connector=swap.connector, old=str(swap.old), new=str(swap.new)) for swap in action.swaps]
            return HandoverStep(swaps=swaps, seconds=seconds)
        case SetParameters():
            return SetStep(instance=action.instance, parameters=values_form(action.parameters), seconds=seconds)
    raise TypeError(f"a {action.kind} has no JSON form")


Steps: TypeAlias = Annotated[list[AnyStep], field("a list of steps")]
Running: TypeAlias = Annotated[
    dict[str, str | None],
    field("an object of instances", "by role, at the start: instances without their role's name; null: none is live"),
]
Standing: TypeAlias = Annotated[
    dict[str, str], field("an object of modes", "at the start: the modes that are not the best possible")
]


class PlanCosts(PlanPart, frozen=True, kw_only=True):
    """What a plan costs and why."""

    what: ClassVar[str] = "a plan"

    strategy: str
    proved_minimal: bool
    disruption: Annotated[FiniteNumber, field("a disruption", "in weighted functionality-seconds")]
    lower_bound: FiniteNumber
    makespan: Annotated[FiniteNumber, field("a makespan", "the critical path of the steps, in seconds")]
    seconds: Annotated[FiniteNumber, field("a number of seconds", "one step after another")]
    fallen: Annotated[list[str], field("a list of functionalities", "of roles, ever below their baseline")]
    falls: Annotated[list[Degradation], field("a list", "why each functionality falls")] = []
    afterwards: Annotated[list[LevelShift], field("a list", "what is in another mode for good")] = []


class PlanPreview(PlanCosts, frozen=True, kw_only=True):
    """A plan without the specifications that it starts from and leads to."""

    steps: Steps
    running: Running | UnsetType = UNSET
    standing: Standing | UnsetType = UNSET

    @classmethod
    def of(cls, plan: Plan) -> PlanPreview:
        return cls(**_costs(plan), **_steps(plan))


class PlanForm(PlanCosts, frozen=True, kw_only=True):
    """A plan, whole: it can be verified alone."""

    start: SpecificationForm
    target: SpecificationForm
    steps: Steps
    running: Running | UnsetType = UNSET
    standing: Standing | UnsetType = UNSET

    @classmethod
    def of(cls, plan: Plan, **more: Any) -> PlanForm:
        """Linear in the system, since both specifications are written."""
        start, target = (SpecificationForm.of(found) for found in (plan.change.specification, plan.change.target))
        return cls(**_costs(plan), start=start, target=target, **_steps(plan), **more)


def _costs(plan: Plan) -> dict[str, Any]:
    return {
        "strategy": plan.strategy,
        "proved_minimal": plan.proved_minimal,
        "disruption": plan.disruption,
        "lower_bound": plan.lower_bound,
        "makespan": plan.makespan,
        "seconds": plan.seconds,
        "fallen": [str(ref) for ref in plan.fallen],
        "falls": list(plan.degradations),
        "afterwards": list(plan.level_shifts),
    }


def _steps(plan: Plan) -> dict[str, Any]:
    return {
        "steps": [step_form(step) for step in plan.steps],
        "running": _running(plan.change) or UNSET,
        "standing": _standing(plan.change.origin) or UNSET,
    }


def _running(change: Change) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for role in sorted({*change.specification.nodes, *change.origin.instances_by_role}):
        names = [instance.name for instance in change.origin.instances_of(role)]
        if names != [role]:
            found[role] = names[0] if names else None
    return found


def _standing(configuration: Configuration) -> dict[str, str]:
    highest = best(configuration).modes
    modes = configuration.modes
    return {str(ref): configuration.mode(ref).name for ref in sorted(modes) if modes[ref] != highest[ref]}


def encode_plan(plan: Plan) -> Document:
    """The document of the whole plan, both specifications included."""
    return encode(PlanForm.of(plan))

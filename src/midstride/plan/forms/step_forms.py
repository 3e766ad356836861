"""The JSON form of a step of a plan, written from a step and read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, TypeAlias

import msgspec
from immutables import Map
from msgspec import UNSET, UnsetType

from midstride.codec.configuration_form import SharedContainerForm
from midstride.codec.form import FiniteNumber, Form, field, given
from midstride.codec.parameter import SectionForm, SectionsForm, ValueForm, values_form, values_of
from midstride.errors import PlanRefused
from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Swap,
    Upgrade,
)
from midstride.model.component import ComponentSpec, FunctionalityRef, PortRef
from midstride.model.configuration import Instance
from midstride.model.hosts import OWN_HOST
from midstride.plan.change import Change
from midstride.plan.step import ModeChange, Step

Between: TypeAlias = Annotated[
    tuple[FiniteNumber, FiniteNumber], field("two durations", "the shortest and the longest, as measured or stated (s)")
]


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

    topic: str
    old: str
    new: str


class StepForm(PlanPart, frozen=True, kw_only=True, tag_field="action"):
    """One step of a plan; the value of ``action`` is its kind."""

    what: ClassVar[str] = "a step"

    between: Between | UnsetType = UNSET

    @property
    def action(self) -> str:
        return str(self.__struct_config__.tag)


class CreateStep(StepForm, frozen=True, kw_only=True, tag="create"):
    """A new instance is started."""

    instance: str
    role: str
    component: str
    parameters: dict[str, ValueForm] = {}
    sections: SectionsForm | UnsetType = UNSET
    container: SharedContainerForm | UnsetType = UNSET
    process: str | UnsetType = UNSET
    host: str | UnsetType = UNSET
    seconds: FiniteNumber


class RemoveStep(StepForm, frozen=True, tag="remove"):
    """An instance is ended."""

    instance: str
    seconds: FiniteNumber


class AttachStep(StepForm, frozen=True, tag="attach"):
    """A port of an instance is attached to a topic."""

    port: str
    topic: str
    seconds: FiniteNumber


class DetachStep(StepForm, frozen=True, tag="detach"):
    """A port of an instance is detached from a topic."""

    port: str
    topic: str
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
    """Parameters of a live instance are set in place: `before` has the values it has, if they are set at run time."""

    instance: str
    parameters: dict[str, ValueForm]
    seconds: FiniteNumber
    before: dict[str, ValueForm] | UnsetType = UNSET


AnyStep: TypeAlias = (
    CreateStep | RemoveStep | AttachStep | DetachStep | DegradeStep | UpgradeStep | HandoverStep | SetStep
)


def step_form(step: Step) -> AnyStep:
    """The JSON form of one step."""
    form = _form(step)
    return form if step.between is None else msgspec.structs.replace(form, between=step.between)


def _form(step: Step) -> AnyStep:
    action, seconds = step.action, step.seconds
    modes = {str(each.functionality): ModeChangeForm(before=each.before, after=each.after) for each in step.modes}
    match action:
        case Create(instance=new):
            values = values_form(new.parameters)
            return CreateStep(
                instance=new.name,
                role=new.role,
                component=new.component.name,
                parameters=values,
                sections=[SectionForm.of(section) for section in new.sections] or UNSET,
                container=UNSET if new.container is None else SharedContainerForm.shared(new.container),
                process=UNSET if new.container is None else new.process,
                host=new.host or UNSET,
                seconds=seconds,
            )
        case Remove():
            return RemoveStep(instance=action.instance, seconds=seconds)
        case Attach():
            return AttachStep(port=str(action.port), topic=action.connector, seconds=seconds)
        case Detach():
            return DetachStep(port=str(action.port), topic=action.connector, seconds=seconds)
        case Degrade():
            return DegradeStep(modes=modes, seconds=seconds)
        case Upgrade():
            return UpgradeStep(modes=modes, seconds=seconds)
        case Handover():
            swaps = [SwapForm(topic=swap.connector, old=str(swap.old), new=str(swap.new)) for swap in action.swaps]
            return HandoverStep(swaps=swaps, seconds=seconds)
        case SetParameters():
            before = UNSET if action.before is None else values_form(action.before)
            values = values_form(action.parameters)
            return SetStep(instance=action.instance, parameters=values, before=before, seconds=seconds)
    raise TypeError(f"a {action.kind} has no JSON form")


def decode_step(number: int, change: Change, known: dict[str, Instance], form: AnyStep) -> Step:
    """The step of that number; ``known`` are the instances so far, to which one that it creates is added.

    Raises PlanRefused where it is about something that does not exist.
    """
    try:
        action = _action(change, known, form)
    except PlanRefused as error:
        raise PlanRefused(f"step {number}: {error}") from None
    if isinstance(action, Create):
        known.setdefault(action.instance.name, action.instance)
    roles = tuple(dict.fromkeys(known[name].role for name in action.instances() if name in known))
    modes = form.modes if isinstance(form, (DegradeStep, UpgradeStep)) else {}
    changes = tuple(
        ModeChange(FunctionalityRef.parse(text), each.before, each.after) for text, each in sorted(modes.items())
    )
    return Step(action, form.seconds, roles, changes, None if form.between is UNSET else form.between)


def mode_index(known: Mapping[str, Instance], ref: FunctionalityRef, mode: str) -> int:
    """The index of a mode of a known instance. Raises PlanRefused for one that does not exist."""
    try:
        return known[ref.instance].component.functionalities[ref.functionality].mode_index(mode)
    except KeyError:
        raise PlanRefused(f"there is no {ref} with a mode {mode}") from None


def _action(change: Change, known: Mapping[str, Instance], form: AnyStep) -> Action:
    match form:
        case CreateStep():
            component = _component(change, form.component)
            sections = () if form.sections is UNSET else tuple(each.section() for each in form.sections)
            container = None if form.container is UNSET else form.container.container()
            process = "" if form.process is UNSET else form.process
            host = given(form.host) or OWN_HOST
            values = values_of(form.parameters)
            return Create(Instance(form.instance, form.role, component, values, sections, container, process, host))
        case RemoveStep():
            return Remove(form.instance)
        case AttachStep():
            return Attach(PortRef.parse(form.port), form.topic)
        case DetachStep():
            return Detach(PortRef.parse(form.port), form.topic)
        case DegradeStep() | UpgradeStep():
            refs = ((FunctionalityRef.parse(text), each.after) for text, each in form.modes.items())
            to: Map[FunctionalityRef, int] = Map({ref: mode_index(known, ref, mode) for ref, mode in refs})
            return Degrade(to) if isinstance(form, DegradeStep) else Upgrade(to)
        case HandoverStep():
            swaps = (Swap(each.topic, PortRef.parse(each.old), PortRef.parse(each.new)) for each in form.swaps)
            return Handover(tuple(swaps))
        case SetStep():
            before = None if form.before is UNSET else values_of(form.before)
            return SetParameters(form.instance, values_of(form.parameters), before)


def _component(change: Change, name: str) -> ComponentSpec:
    for specification in (change.target, change.specification):
        if name in specification.components:
            return specification.components[name]
    raise PlanRefused(f"it creates a {name}, a component that neither of its specifications has")

"""The JSON form of a plan (`midstride plan --json`), written from a plan and read back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Annotated, Any, ClassVar, TypeAlias

from msgspec import UNSET, UnsetType, structs

from midstride.codec.form import Document, FiniteNumber, encode, field
from midstride.codec.parameter import values_of
from midstride.codec.reading import decode, under
from midstride.codec.specification_form import SpecificationForm
from midstride.errors import PlanRefused
from midstride.model.best import best
from midstride.model.component import FunctionalityRef
from midstride.model.component_rules import component_rules
from midstride.model.configuration import Configuration, configure
from midstride.model.diagnostics import Problem
from midstride.model.name_checks import specification_names
from midstride.model.specification import Specification
from midstride.plan.alternatives import Alternative, alternatives
from midstride.plan.change import Change, Detour
from midstride.plan.change_builder import change_between
from midstride.plan.core.detours import with_detours
from midstride.plan.estimate import Estimate
from midstride.plan.expected_losses import expected_losses
from midstride.plan.explain import Degradation, LevelShift
from midstride.plan.forms.step_forms import (
    AnyStep,
    Between,
    CreateStep,
    PlanPart,
    SetStep,
    decode_step,
    mode_index,
    step_form,
)
from midstride.plan.overlap import duration
from midstride.plan.plan import BoundPart, Plan, ProofSpace
from midstride.plan.runtime_values import RuntimeValue
from midstride.plan.state_continuity import left_behind
from midstride.verdicts.assessment import Assessments

Steps: TypeAlias = Annotated[list[AnyStep], field("a list of steps")]
StartInstances: TypeAlias = Annotated[
    dict[str, str | None],
    field("an object of instances", "by role, at the start: instances without their role's name; null: none is live"),
]
RuntimeValues: TypeAlias = Annotated[
    list[RuntimeValue], field("a list of values", "of parameters, set at run time, and what becomes of them")
]
OwnState: TypeAlias = Annotated[
    dict[str, str], field("an object of reasons", "by new instance: why it starts with its own state")
]
Remarks: TypeAlias = Annotated[list[str], field("a list of texts", "what is done besides, and why")]
StartModes: TypeAlias = Annotated[
    dict[str, str], field("an object of modes", "at the start: the modes that are not the best possible")
]


class DetourForm(PlanPart, frozen=True, kw_only=True):
    """The steps of one role beyond the change: it moves away and back, or has a stand-in, or both."""

    what: ClassVar[str] = "a detour"

    role: str
    moved: Annotated[bool, field("a boolean", "a node that stays is replaced by one like it")]
    stand_in: Annotated[str | None, field("a component", "of the instance that exists during the plan only")]


class BoundPartForm(PlanPart, frozen=True, kw_only=True):
    """The least loss by the creations and removals of some roles, whatever the others do."""

    what: ClassVar[str] = "a part of a bound"

    roles: Annotated[list[str], field("a list of nodes")]
    bound: Annotated[FiniteNumber, field("a disruption", "in weighted functionality-seconds")]


Certificate: TypeAlias = Annotated[
    list[BoundPartForm], field("a list of parts", "of the lower bound, which add up to it; absent where there is none")
]
MeasuredSeconds: TypeAlias = Annotated[
    dict[str, tuple[FiniteNumber, FiniteNumber, FiniteNumber]],
    field(
        "a table of durations",
        "how long steps took in earlier runs: what is expected, the shortest and the longest (s); only of a plan whose "
        "proof covers detours, since it rests on steps that the plan does not take",
    ),
]
Detours: TypeAlias = Annotated[list[DetourForm], field("a list of detours", "what is done beyond the change itself")]


class PlanCosts(PlanPart, frozen=True, kw_only=True):
    """The costs of a plan, and their reasons."""

    what: ClassVar[str] = "a plan"

    strategy: str
    proved_minimal: bool
    disruption: Annotated[FiniteNumber, field("a disruption", "in weighted functionality-seconds")]
    lower_bound: FiniteNumber
    proof_space: Annotated[ProofSpace, field("`direct` or `detours`", "the plans that the lower bound speaks of")] = (
        "direct"
    )
    makespan: Annotated[FiniteNumber, field("a makespan", "the critical path of the steps, in seconds")]
    seconds: Annotated[FiniteNumber, field("a number of seconds", "one step after another")]
    duration: (
        Annotated[
            FiniteNumber,
            field("a number of seconds", "as the plan is carried out: what can start or end at once, does"),
        ]
        | UnsetType
    ) = UNSET
    between: Between | UnsetType = UNSET
    degraded: Annotated[list[str], field("a list of functionalities", "of roles, ever below their baseline")]
    degradations: Annotated[list[Degradation], field("a list", "when and why each of them is below its baseline")] = []
    level_shifts: Annotated[list[LevelShift], field("a list", "what is in another mode for good")] = []
    continuity: (
        Annotated[Assessments, field("an assessment", "what is kept, what is lost, and what is not measurable")]
        | UnsetType
    ) = UNSET


Alternatives: TypeAlias = Annotated[
    list[Alternative], field("a list", "what it would cost to keep what degrades, where that was asked for")
]


class PlanPreview(PlanCosts, frozen=True, kw_only=True):
    """A plan without the specifications that it starts from and leads to."""

    steps: Steps
    start_instances: StartInstances | UnsetType = UNSET
    start_modes: StartModes | UnsetType = UNSET
    parameters: RuntimeValues | UnsetType = UNSET
    own_state: OwnState | UnsetType = UNSET
    remarks: Remarks | UnsetType = UNSET
    detours: Detours | UnsetType = UNSET
    certificate: Certificate | UnsetType = UNSET
    measured: MeasuredSeconds | UnsetType = UNSET

    @classmethod
    def of(cls, plan: Plan) -> PlanPreview:
        return cls(**_fields(plan))


class PlanForm(PlanCosts, frozen=True, kw_only=True):
    """A plan, whole: it can be verified alone."""

    # The fields of a preview again: the specifications are written before the steps, and inherited fields come first.
    start: SpecificationForm
    target: SpecificationForm
    alternatives: Alternatives | UnsetType = UNSET
    steps: Steps
    start_instances: StartInstances | UnsetType = UNSET
    start_modes: StartModes | UnsetType = UNSET
    parameters: RuntimeValues | UnsetType = UNSET
    own_state: OwnState | UnsetType = UNSET
    remarks: Remarks | UnsetType = UNSET
    detours: Detours | UnsetType = UNSET
    certificate: Certificate | UnsetType = UNSET
    measured: MeasuredSeconds | UnsetType = UNSET

    @classmethod
    def of(cls, plan: Plan, preview: PlanPreview | None = None, **more: Any) -> PlanForm:
        """Linear in the system, since both specifications are written. ``preview``: that of ``plan``, if known."""
        start, target = (SpecificationForm.of(found) for found in (plan.change.specification, plan.change.target))
        fields = _fields(plan) if preview is None else structs.asdict(preview)
        return cls(**fields, start=start, target=target, **more)


def _fields(plan: Plan) -> dict[str, Any]:
    planned = duration(plan)
    return {
        "strategy": plan.strategy,
        "proved_minimal": plan.proved_minimal,
        "disruption": plan.disruption,
        "lower_bound": plan.lower_bound,
        "proof_space": plan.proof_space,
        "makespan": plan.makespan,
        "seconds": plan.seconds,
        "duration": planned.seconds,
        "between": planned.between or UNSET,
        "degraded": [str(ref) for ref in plan.degraded],
        "degradations": list(plan.degradations),
        "level_shifts": list(plan.level_shifts),
        "continuity": expected_losses(plan),
        "steps": [step_form(step) for step in plan.steps],
        "start_instances": _start_instances(plan.change) or UNSET,
        "start_modes": _start_modes(plan.change.origin) or UNSET,
        "parameters": list(plan.parameters) or UNSET,
        "remarks": list(plan.remarks) or UNSET,
        "certificate": [BoundPartForm(roles=[*each.roles], bound=each.bound) for each in plan.certificate] or UNSET,
        "detours": [DetourForm(**asdict(detour)) for detour in plan.change.detours] or UNSET,
        "measured": _measured(plan) or UNSET,
        "own_state": left_behind(plan.change, (step.action for step in plan.steps)) or UNSET,
    }


def _measured(plan: Plan) -> dict[str, tuple[float, float, float]]:
    if plan.proof_space != "detours":
        return {}
    measured = plan.change.measured
    return {key: (each.seconds, each.shortest, each.longest) for key, each in sorted(measured.items())}


def _start_instances(change: Change) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for role in sorted({*change.specification.nodes, *change.origin.instances_by_role}):
        names = [instance.name for instance in change.origin.instances_of(role)]
        if names != [role]:
            found[role] = names[0] if names else None
    return found


def _start_modes(configuration: Configuration) -> dict[str, str]:
    highest = best(configuration).modes
    modes = configuration.modes
    return {str(ref): configuration.mode(ref).name for ref in sorted(modes) if modes[ref] != highest[ref]}


def plan_form(plan: Plan, *, explain: bool = False) -> PlanForm:
    """The form of the whole plan, both specifications included; ``explain`` adds the alternatives."""
    return PlanForm.of(plan, alternatives=alternatives(plan) if explain else UNSET)


def encode_plan(plan: Plan, *, explain: bool = False) -> Document:
    """The document of :func:`plan_form`."""
    return encode(plan_form(plan, explain=explain))


def decode_plan(document: object) -> Plan:
    """The plan that a document states, its costs taken over as they are written.

    Nothing is judged: a replay does that (``tests/replay``). Raises SpecificationError with every fault of form,
    and PlanRefused where start and target do not meet, or a step is about something that does not exist.
    """
    form, start, target = decode(document, PlanForm, _parts, _names)
    standing = {} if form.start_modes is UNSET else form.start_modes
    origin = _started(start, {} if form.start_instances is UNSET else form.start_instances, standing)
    measured = {key: Estimate(*each) for key, each in (form.measured or {}).items()}
    created = {step.role for step in form.steps if isinstance(step, CreateStep)}
    away = [role for role in start.nodes if not origin.instances_of(role) and role not in created]
    creating = (step for step in form.steps if isinstance(step, CreateStep) and not step.process)
    apart = {step.role: step.container.name for step in creating if step.container is not UNSET}
    change = change_between(origin, start, target, measured, away=away, apart=apart)
    try:
        detours = (Detour(each.role, each.moved, each.stand_in) for each in form.detours or ())
        change = with_detours(change, detours)
    except KeyError as error:
        raise PlanRefused(f"a detour is about {error.args[0]}, which is not there") from None
    known = dict(change.start.instances)
    return Plan(
        strategy=form.strategy,
        change=change,
        steps=tuple(decode_step(number, change, known, step) for number, step in enumerate(form.steps, start=1)),
        disruption=form.disruption,
        lower_bound=form.lower_bound,
        proved_minimal=form.proved_minimal,
        makespan=form.makespan,
        seconds=form.seconds,
        degraded=tuple(FunctionalityRef.parse(text) for text in form.degraded),
        parameters=() if form.parameters is UNSET else tuple(form.parameters),
        remarks=() if form.remarks is UNSET else tuple(form.remarks),
        proof_space=form.proof_space,
        certificate=tuple(BoundPart(tuple(each.roles), each.bound) for each in form.certificate or ()),
    )


def _parts(form: PlanForm) -> tuple[PlanForm, Specification, Specification]:
    for step in form.steps:
        if isinstance(step, (CreateStep, SetStep)):
            values_of(step.parameters)
        if isinstance(step, SetStep) and step.before is not UNSET:
            values_of(step.before)
    return form, form.start.specification(), form.target.specification()


def _names(parts: tuple[PlanForm, Specification, Specification]) -> Iterable[Problem]:
    _, start, target = parts
    for key, specification in (("start", start), ("target", target)):
        yield from under(key, specification_names(specification))
        for name, component in specification.components.items():  # no configuration has a functionality without modes
            rules = component_rules(component, ("components", name))
            yield from under(key, (problem for problem in rules if problem.code == "E015"))


def _started(
    specification: Specification, running: Mapping[str, str | None], standing: Mapping[str, str]
) -> Configuration:
    """The configuration a plan starts from: instances under their names, in ``best`` but where stated otherwise."""
    names = {role: running.get(role, role) for role in specification.nodes}
    live = {role: name for role, name in names.items() if name is not None}
    configuration = best(
        configure(
            specification.context,
            (specification.instance(role, name) for role, name in live.items()),
            (pair for role, name in live.items() for pair in specification.attachments_of(role, name)),
        )
    )
    refs = ((FunctionalityRef.parse(text), mode) for text, mode in standing.items())
    return configuration.with_modes({ref: mode_index(configuration.instances, ref, mode) for ref, mode in refs})

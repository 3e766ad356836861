"""A plan from its JSON form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from immutables import Map
from msgspec import UNSET

from midstride.codec.parameter import PlainValue, value_of
from midstride.codec.reading import decode, under
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
from midstride.model.best import best
from midstride.model.component import ComponentSpec, FunctionalityRef, PortRef
from midstride.model.component_rules import component_rules
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.diagnostics import Problem
from midstride.model.name_checks import specification_names
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between
from midstride.plan.forms import (
    AnyStep,
    AttachStep,
    CreateStep,
    DegradeStep,
    DetachStep,
    HandoverStep,
    PlanForm,
    RemoveStep,
    SetStep,
    UpgradeStep,
)
from midstride.plan.plan import Plan
from midstride.plan.step import ModeChange, Step


def decode_plan(document: object) -> Plan:
    """The plan that a document states, its costs taken over as they are written.

    Nothing is judged: :mod:`midstride.plan.validate` does that. Raises SpecificationError with every fault of form,
    and PlanRefused where start and target do not meet, or a step is about something that does not exist.
    """
    form, start, target = decode(document, PlanForm, _parts, _names)
    standing = {} if form.standing is UNSET else form.standing
    origin = _started(start, {} if form.running is UNSET else form.running, standing)
    change = change_between(origin, start, target)
    known = dict(change.start.instances)
    return Plan(
        strategy=form.strategy,
        change=change,
        steps=tuple(_numbered(number, change, known, step) for number, step in enumerate(form.steps, start=1)),
        disruption=form.disruption,
        lower_bound=form.lower_bound,
        proved_minimal=form.proved_minimal,
        makespan=form.makespan,
        seconds=form.seconds,
        fallen=tuple(FunctionalityRef.parse(text) for text in form.fallen),
    )


def _parts(form: PlanForm) -> tuple[PlanForm, Specification, Specification]:
    for step in form.steps:
        if isinstance(step, (CreateStep, SetStep)):
            _values(step.parameters)
    return form, form.start.specification(), form.target.specification()


def _names(parts: tuple[PlanForm, Specification, Specification]) -> Iterable[Problem]:
    _, start, target = parts
    for key, specification in (("start", start), ("target", target)):
        yield from under(key, specification_names(specification))
        for name, component in specification.components.items():  # no configuration has a functionality without modes
            rules = component_rules(component, ("components", name))
            yield from under(key, (problem for problem in rules if problem.code == "E015"))


def _values(parameters: Mapping[str, PlainValue]) -> Map[str, Any]:
    return Map({name: value_of(value) for name, value in parameters.items()})


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
    return configuration.with_modes({ref: _mode_index(configuration.instances, ref, mode) for ref, mode in refs})


def _numbered(number: int, change: Change, known: dict[str, Instance], form: AnyStep) -> Step:
    """One step. ``known`` are the instances there have been so far, those that steps create included."""
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
    return Step(action, form.seconds, roles, changes)


def _mode_index(known: Mapping[str, Instance], ref: FunctionalityRef, mode: str) -> int:
    try:
        return known[ref.instance].component.functionalities[ref.functionality].mode_index(mode)
    except KeyError:
        raise PlanRefused(f"there is no {ref} with a mode {mode}") from None


def _action(change: Change, known: Mapping[str, Instance], form: AnyStep) -> Action:
    match form:
        case CreateStep():
            component = _component(change, form.component)
            return Create(Instance(form.instance, form.role, component, _values(form.parameters)))
        case RemoveStep():
            return Remove(form.instance)
        case AttachStep():
            return Attach(PortRef.parse(form.port), form.connector)
        case DetachStep():
            return Detach(PortRef.parse(form.port), form.connector)
        case DegradeStep() | UpgradeStep():
            refs = ((FunctionalityRef.parse(text), each.after) for text, each in form.modes.items())
            to: Map[FunctionalityRef, int] = Map({ref: _mode_index(known, ref, mode) for ref, mode in refs})
            return Degrade(to) if isinstance(form, DegradeStep) else Upgrade(to)
        case HandoverStep():
            swaps = (Swap(each.connector, PortRef.parse(each.old), PortRef.parse(each.new)) for each in form.swaps)
            return Handover(tuple(swaps))
        case SetStep():
            return SetParameters(form.instance, _values(form.parameters))


def _component(change: Change, name: str) -> ComponentSpec:
    for specification in (change.target, change.specification):
        if name in specification.components:
            return specification.components[name]
    raise PlanRefused(f"it creates a {name}, a component that neither of its specifications has")

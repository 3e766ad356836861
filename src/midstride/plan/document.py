"""The JSON form of a plan (interfaces.md), and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from immutables import Map

from midstride.errors import PlanRefused, SpecificationError
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
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.document import specification_from_document, specification_to_document
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import instances_touched
from midstride.plan.plan import Plan
from midstride.plan.step import ModeChange, Step

# What reading a document raises that has another form than was expected.
_MALFORMED = (KeyError, TypeError, ValueError, AttributeError)


def plan_to_document(plan: Plan) -> dict[str, Any]:
    """The plan as interfaces.md writes it.

    Beyond what is fixed there: ``falls`` says why each functionality falls; ``afterwards`` which stand otherwise
    for good; ``running`` names the instances at the start that do not bear their role's name (null: the role has
    none), and ``standing`` the modes at the start that are not those of ``best``.
    """
    change = plan.change
    document: dict[str, Any] = {
        "strategy": plan.strategy,
        "proved_minimal": plan.proved_minimal,
        "disruption": plan.disruption,
        "lower_bound": plan.lower_bound,
        "makespan": plan.makespan,
        "seconds": plan.seconds,
        "fallen": [str(ref) for ref in plan.fallen],
        "falls": [fall.to_document() for fall in plan.falls],
        "afterwards": [shift.to_document() for shift in plan.shifts],
        "start": specification_to_document(change.specification),
        "target": specification_to_document(change.target),
        "steps": plan.step_documents(),
    }
    if running := _running(change):
        document["running"] = running
    if standing := _standing(change.origin):
        document["standing"] = standing
    return document


def _running(change: Change) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for role in sorted({*change.specification.nodes, *change.origin.instances_by_role}):
        names = [instance.name for instance in change.origin.instances_of(role)]
        if names != [role]:
            found[role] = names[0] if names else None
    return found


def _standing(configuration: Configuration) -> dict[str, str]:
    highest = best(configuration).modes
    return {
        str(ref): configuration.mode(ref).name
        for ref in sorted(configuration.modes)
        if configuration.modes[ref] != highest[ref]
    }


def plan_from_document(document: Mapping[str, Any]) -> Plan:
    """The plan that a document says, its figures taken over as they stand there.

    Nothing is judged: :mod:`midstride.plan.validate` does that. Raises SpecificationError where the document is no
    plan, PlanRefused where its start and target do not meet, or a step speaks of what there is not.
    """
    try:
        start = specification_from_document(document["start"])
        target = specification_from_document(document["target"])
        running = _started(start, document.get("running") or {}, document.get("standing") or {})
        change = Change.between(running, start, target)
        known = dict(change.start.instances)
        steps = [_numbered(number, change, known, entry) for number, entry in enumerate(document["steps"], start=1)]
        return Plan(
            strategy=str(document["strategy"]),
            change=change,
            steps=tuple(steps),
            disruption=float(document["disruption"]),
            lower_bound=float(document["lower_bound"]),
            proved_minimal=bool(document["proved_minimal"]),
            makespan=float(document["makespan"]),
            seconds=float(document["seconds"]),
            fallen=tuple(FunctionalityRef.parse(text) for text in document["fallen"]),
        )
    except _MALFORMED as error:
        raise SpecificationError(f"not a plan: {_told(error)}") from error


def _started(
    specification: Specification, running: Mapping[str, str | None], standing: Mapping[str, str]
) -> Configuration:
    """The configuration a plan starts from: instances under their names, in ``best`` but where said otherwise."""
    names = {role: running.get(role, role) for role in specification.nodes}
    live = {role: name for role, name in names.items() if name is not None}
    configuration = best(
        configure(
            specification.context,
            (specification.instance(role, name) for role, name in live.items()),
            (pair for role, name in live.items() for pair in specification.attachments_of(role, name)),
        )
    )
    lower = {ref: configuration.functionality(ref).mode_index(mode) for ref, mode in _refs(standing)}
    return configuration.with_modes(lower)


def _refs(named: Mapping[str, str]) -> list[tuple[FunctionalityRef, str]]:
    return [(FunctionalityRef.parse(text), mode) for text, mode in named.items()]


def _numbered(number: int, change: Change, known: dict[str, Instance], entry: object) -> Step:
    if not isinstance(entry, Mapping):
        raise SpecificationError(f"not a plan: step {number} is no object but {entry!r}")
    try:
        return _step(change, known, entry)
    except PlanRefused as error:
        raise PlanRefused(f"step {number}: {error}") from None
    except _MALFORMED as error:
        raise SpecificationError(f"not a plan: step {number}: {_told(error)}") from error


def _told(error: Exception) -> str:
    """What Python says of a document that has another form than was expected, for people."""
    return f"`{error.args[0]}` is missing" if isinstance(error, KeyError) else str(error)


def _step(change: Change, known: dict[str, Instance], entry: Mapping[str, Any]) -> Step:
    """One step. ``known`` are the instances there have been so far, those that steps create included."""
    action = _action(change, known, entry)
    if isinstance(action, Create):
        known.setdefault(action.instance.name, action.instance)
    roles = tuple(dict.fromkeys(known[name].role for name in instances_touched(action) if name in known))
    changes = tuple(
        ModeChange(FunctionalityRef.parse(text), str(modes["from"]), str(modes["to"]))
        for text, modes in sorted(entry.get("modes", {}).items())
    )
    return Step(action, float(entry["seconds"]), roles, changes)


def _mode_index(known: Mapping[str, Instance], ref: FunctionalityRef, mode: str) -> int:
    try:
        return known[ref.instance].component.functionalities[ref.functionality].mode_index(mode)
    except KeyError:
        raise PlanRefused(f"there is no {ref} with a mode {mode}") from None


def _action(change: Change, known: Mapping[str, Instance], entry: Mapping[str, Any]) -> Action:
    kind = entry["action"]
    match kind:
        case "create":
            component = _component(change, str(entry["of"]))
            parameters = Map(entry.get("parameters") or {})
            return Create(Instance(str(entry["component"]), str(entry["role"]), component, parameters))
        case "remove":
            return Remove(str(entry["component"]))
        case "attach":
            return Attach(PortRef.parse(entry["port"]), str(entry["connector"]))
        case "detach":
            return Detach(PortRef.parse(entry["port"]), str(entry["connector"]))
        case "degrade" | "upgrade":
            named = {text: str(modes["to"]) for text, modes in entry["modes"].items()}
            to: Map[FunctionalityRef, int] = Map({ref: _mode_index(known, ref, mode) for ref, mode in _refs(named)})
            return Degrade(to) if kind == "degrade" else Upgrade(to)
        case "handover":
            return Handover(
                tuple(
                    Swap(str(swap["connector"]), PortRef.parse(swap["old"]), PortRef.parse(swap["new"]))
                    for swap in entry["swaps"]
                )
            )
        case "set":
            return SetParameters(str(entry["component"]), Map(entry["parameters"]))
    raise ValueError(f"there is no action {kind}")


def _component(change: Change, name: str) -> ComponentSpec:
    for specification in (change.target, change.specification):
        if name in specification.components:
            return specification.components[name]
    raise PlanRefused(f"it creates a {name}, a component that neither of its specifications has")

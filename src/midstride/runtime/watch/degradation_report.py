"""The modes that are lower after a change than before it, role by role: as planned, and unexpectedly."""

from __future__ import annotations

from collections.abc import Iterable

from midstride.model import wording
from midstride.model.component import FunctionalityRef, FunctionalitySpec, PortRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification
from midstride.runtime.records.reports import DegradedFunctionality
from midstride.runtime.running_system import RunningSystem


def remaining_degradations(
    system: RunningSystem, start: Configuration, planned: Configuration
) -> list[DegradedFunctionality]:
    """The functionalities that are in a worse mode now than in ``start``, and new ones below their normal mode.

    Not ``planned``: those in a worse mode than in that configuration. Roles that neither configuration has are left
    out. Walks the system.
    """
    now, found = system.configuration, []
    for role in system.specification.roles():
        if not (start.instances_by_role.get(role) or planned.instances_by_role.get(role)):
            continue
        for functionality in system.specification.component_of(role):
            ref = FunctionalityRef(role, functionality.name)
            was, current, intended = (_best(system.specification, c, ref, functionality) for c in (start, now, planned))
            before = 0 if was is None else start.modes[was]
            level = _level(now, current)
            if level <= before:
                continue
            unexpected = level > _level(planned, intended)
            found.append(
                DegradedFunctionality(
                    functionality=str(ref),
                    before=functionality.modes[0].name if was is None else start.mode(was).name,
                    after=None if current is None else now.mode(current).name,
                    planned=not unexpected,
                    because=_because(system, role, current) if unexpected else None,
                )
            )
    return found


def _best(
    specification: Specification, configuration: Configuration, ref: FunctionalityRef, declared: FunctionalitySpec
) -> FunctionalityRef | None:
    """The functionality of the instance that serves a role best: all outputs that the role attaches are attached."""
    attached = [name for name in declared.outputs if specification.nodes[ref.instance].attachments.get(name)]
    serving = [
        live
        for instance in configuration.instances_by_role.get(ref.instance, ())
        if (live := FunctionalityRef(instance, ref.functionality)) in configuration.modes
        and all(PortRef(instance, name) in configuration.connectors_of for name in attached)
    ]
    return min(serving, key=lambda live: (configuration.modes[live], live), default=None)


def _level(configuration: Configuration, ref: FunctionalityRef | None) -> float:
    return float("inf") if ref is None else configuration.modes[ref]


def _because(system: RunningSystem, role: str, ref: FunctionalityRef | None) -> str | None:
    if ref is None:
        return system.why_missing(role)
    latest = system.life.latest(ref.instance)
    return None if latest is None else latest.state.functionalities[ref.functionality].because.strip()


def degradations_in_words(degradations: Iterable[DegradedFunctionality]) -> str:
    """The degradations in words, for an event."""
    return ", ".join(wording.lowered(each.functionality, each.after, each.before) for each in degradations)

"""Detours: structure that neither start nor target asks for, and that may make a change cheaper.

Two kinds (docs/semantics.md section 6): a node that stays is moved, so that what it holds is free for a time; and a
role has a stand-in, an instance of another declared component that exists during the plan only. A change with detours
is a change as any other, in which the detours are part of what has to be done.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.instance_names import fresh_name
from midstride.model.rules import attachment_shortfall
from midstride.model.specification import Constraint
from midstride.plan.change import Change, Detour, PortAttachment
from midstride.plan.core.conflict_core import full_topics, parts, scarce_resources
from midstride.plan.core.core_losses import cone, fullest

# How many roles make a detour in one plan, at most.
MOST: Final = 2


def with_detours(change: Change, detours: Iterable[Detour]) -> Change:
    """``change``, in which these detours are made as well. Raises KeyError for an unknown role or component."""
    direct = change.direct or change
    for detour in detours:
        if detour.moved:
            change = _with_moved(change, detour.role)
        if detour.stand_in is not None:
            change = _with_stand_in(change, detour.role, detour.stand_in)
        change = replace(change, detours=(*change.detours, detour), direct=direct)
    return change


def kept_instance(change: Change, role: str) -> Instance | None:
    """The instance of a role that stays."""
    return next((each for each in change.final.instances_of(role) if each.name in change.start.instances), None)


def _with_moved(change: Change, role: str) -> Change:
    old = kept_instance(change, role)
    if old is None:
        raise KeyError(role)
    new = change.target.instance(role, _fresh(change, role))
    wanted = _attachments(change, change.target.attachments_of(role, new.name))
    final = change.final.without_instance(old.name).with_instance(new)
    for port, connector in wanted:
        final = final.with_attachment(port, connector)
    modes = {FunctionalityRef(new.name, ref.functionality): change.final.modes[ref] for ref in old.functionality_refs()}
    return replace(
        change,
        final=final.with_modes(modes),
        leaving=(*change.leaving, old.name),
        coming=(*change.coming, new),
        replaced=change.replaced.set(old.name, new.name),
        detached=(*_without(change.detached, old.name), *change.start.attached_ports(old.name)),
        attached=(*_without(change.attached, old.name), *wanted),
        parameters=tuple(each for each in change.parameters if each[0] != old.name),
        renamed=tuple(each for each in change.renamed if each.name != old.name),
    )


def _with_stand_in(change: Change, role: str, component: str) -> Change:
    target = change.target
    if component not in target.components:
        declared = change.specification.components[component]
        target = replace(target, components=target.components.set(component, declared))
    target = target.with_replaced(role, component)
    stand_in = target.instance(role, _fresh(change, role))
    wanted = _attachments(change, target.attachments_of(role, stand_in.name))
    replaced = change.replaced
    for old, new in change.replaced.items():
        if change.role_of(old) == role:  # it takes over from the old one, and the new one from it
            replaced = replaced.set(old, stand_in.name).set(stand_in.name, new)
    return replace(
        change,
        leaving=(*change.leaving, stand_in.name),
        coming=(stand_in, *change.coming),
        replaced=replaced,
        detached=(*change.detached, *wanted),
        attached=(*change.attached, *wanted),
        stand_ins=change.stand_ins.set(stand_in.name, stand_in),
    )


def _fresh(change: Change, role: str) -> str:
    known = {*(each.name for each in change.coming), *change.specification.nodes, *change.target.nodes}
    return fresh_name(role, known, change.start.instances)


def _attachments(change: Change, pairs: Iterable[PortAttachment]) -> list[PortAttachment]:
    return [(port, change.identities.get(connector, connector)) for port, connector in pairs]


def _without(pairs: Iterable[PortAttachment], instance: str) -> list[PortAttachment]:
    return [pair for pair in pairs if pair[0].instance != instance]


# -- which there are -----------------------------------------------------------------------------------------


def stand_ins(change: Change, role: str) -> Iterator[str]:
    """The components of which a role may have a stand-in: other ones with its functionalities that fit its topics."""
    start, target = change.specification, change.target
    if role not in start.nodes or role not in target.nodes:
        return
    own, attachments = (start.component_of(role), target.component_of(role)), target.nodes[role].attachments
    needed = set(own[0].functionalities).intersection(own[1].functionalities)
    for name, component in sorted({**start.components, **target.components}.items()):
        if not (needed <= set(component.functionalities) and set(attachments) <= set(component.ports())):
            continue
        if not needed or any(component.same_body(each) for each in own):
            continue
        pairs = ((port, target.connectors[topic]) for port, topics in attachments.items() for topic in topics)
        if not any(attachment_shortfall(component, PortRef(role, port), topic)[1] for port, topic in pairs):
            yield name


def further(change: Change, constraints: Sequence[Constraint]) -> list[Detour]:
    """The detours that may make ``change`` cheaper, of the roles that make none yet.

    Of the others, none does, whatever else is done besides: what they free is not scarce, and what they serve is never
    lost (docs/decisions/detours.md).
    """
    done = {detour.role for detour in change.detours}
    full = fullest(change)
    tied = dict.fromkeys(name for part in parts(change, constraints) for name in part.of_instance)
    lowered = cone(full, tied)
    served = {full.instances[ref.instance].role for ref in (*lowered, *_helpers(full, lowered))}
    movable = set(_movable(change))
    found: list[Detour] = []
    for role in sorted((served | movable) - done):
        if role in movable:
            found.append(Detour(role, moved=True))
        for component in stand_ins(change, role):
            beside = Detour(role, stand_in=component)
            if role in served:
                found.append(beside)
            if role in movable or role in _movable(with_detours(change, [beside])):
                found.append(replace(beside, moved=True))
    return found


def _movable(change: Change) -> Iterator[str]:
    """The roles whose instance stays and holds what is scarce, or publishes on a topic that is full."""
    start = change.start
    names = {name for resource in scarce_resources(change) for name in start.holders.get(resource, ())}
    for topic in full_topics(change):
        for connector in filter(None, (topic, change.sibling(topic))):
            names.update(port.instance for port in start.publishers_on(connector))
    leaving = set(change.leaving)
    for name in sorted(names - leaving):
        if (role := start.instances[name].role) in change.target.nodes and role in change.specification.nodes:
            yield role


def _helpers(full: Configuration, lowered: Collection[FunctionalityRef]) -> Iterator[FunctionalityRef]:
    """The functionalities that supply those which can be lowered, at any distance, and could supply more than now."""
    seen, pending = set(lowered), list(lowered)
    while pending:
        ref = pending.pop()
        for name in full.functionality(ref).inputs:
            for connector in full.attached_to(PortRef(ref.instance, name)):
                for port in full.publishers_on(connector):
                    owner = full.component(port.instance).owner(port.port)
                    supplier = FunctionalityRef(port.instance, owner.name)
                    if supplier not in seen:
                        seen.add(supplier)
                        pending.append(supplier)
                        if full.modes[supplier]:
                            yield supplier


def describe(change: Change) -> Iterator[str]:
    """Each detour of a change, in words."""
    for detour in change.detours:
        stand_in = next((name for name, each in change.stand_ins.items() if each.role == detour.role), None)
        if detour.moved:
            new = next(each.name for each in change.coming if each.role == detour.role and each.name != stand_in)
            old = next(name for name in change.leaving if change.role_of(name) == detour.role and name != stand_in)
            yield f"Detour: {old} does not change, but is replaced by {new}: what it holds is free meanwhile."
        if stand_in is not None:
            yield f"Detour: {stand_in} ({detour.stand_in}) stands in for {detour.role} during the change."

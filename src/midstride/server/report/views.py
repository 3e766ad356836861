"""A configuration of the model in the form of the live view, so that the page's graph draws what nothing reports."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator, violations
from midstride.runtime.records.status_forms import (
    FunctionalityStatus,
    InstanceStatus,
    Middleware,
    PortStatus,
    SpareStatus,
)
from midstride.runtime.view.instance_status import endpoints, namespace_of
from midstride.runtime.view.status import topic_status
from midstride.server.view.view_forms import VERSION, SystemView
from midstride.verdicts.conditions import system_condition


def modelled_view(configuration: Configuration, system: str, backend: str, at: float) -> SystemView:
    """The view of ``configuration`` if every component did as modelled; nothing is measured."""
    evaluator, found = Evaluator(configuration), [str(violation) for violation in violations(configuration)]
    return SystemView(
        version=VERSION,
        manager="",
        n=0,
        at=at,
        system=system,
        backend=backend,
        phase="up",
        revision=0,
        running=None,
        lock=None,
        requirements=[],
        condition=system_condition(len(configuration.instances_by_role), len(configuration.instances_by_role), found),
        valid=not found,
        violations=found,
        instances=[_instance(configuration, each) for _, each in sorted(configuration.instances.items())],
        topics=[topic_status(configuration, evaluator, name) for name in sorted(configuration.context.connectors)],
        crashed=[],
        silences=[],
        unwritten=None,
        damaged=None,
        file=None,
        changed_since=False,
        middleware=Middleware(name=backend),
        spares=SpareStatus(kept=0, ready=0, unused_by=[]),
        change=None,
    )


def _instance(configuration: Configuration, instance: Instance) -> InstanceStatus:
    modes = {
        each.name: each.modes[configuration.modes[FunctionalityRef(instance.name, each.name)]].name
        for each in instance.component
    }
    return InstanceStatus(
        name=instance.name,
        role=instance.role,
        component=instance.component.name,
        namespace=namespace_of(instance.role),
        host=None,
        node=None,
        pid=None,
        reachable=True,
        answers=True,
        ending=False,
        waiting=None,
        as_modelled=True,
        differences=[],
        undeclared=[],
        deviation=None,
        simulated_time=False,
        run=instance.component.run,
        log_file=None,
        functionalities=[
            FunctionalityStatus(
                name=each.name,
                mode=modes[each.name],
                modes=[mode.name for mode in each.modes],
                modelled=modes[each.name],
                normal=modes[each.name] == each.modes[0].name,
                because=None,
                reflex=False,
                restoring=None,
                since=None,
            )
            for each in instance.component
        ],
        ports=list(_ports(configuration, instance, modes)),
        parameters=[],
        endpoints=endpoints(instance, None, ()),
    )


def _ports(configuration: Configuration, instance: Instance, modes: dict[str, str]) -> Iterator[PortStatus]:
    component = instance.component
    for name in component.ports():
        owner = component.find_owner(name)
        topics: list[str | None] = [*configuration.attached_to(PortRef(instance.name, name))]
        for topic in topics or [None]:
            yield PortStatus(
                name=name,
                direction="in" if owner is None else "out",
                functionalities=[each.name for each in (component.users(name) if owner is None else [owner])],
                topic=topic,
                type=component.type_of(name),
                gate=None,
                declared=component.stated_rate(name, modes),
                rate=None,
                met=None,
                age=None,
                jitter=None,
                longest=None,
            )

"""The status of the system: live instances and modes as reported, compared with the model."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from msgspec import structs

from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator, violations
from midstride.runtime.records.status_forms import (
    CrashedInstance,
    InstanceStatus,
    ProgramStatus,
    SpareStatus,
    Status,
    TopicStatus,
)
from midstride.runtime.view.condition import condition
from midstride.runtime.view.instance_status import EntryShape, instance_status, is_sound, port_statuses
from midstride.runtime.view.watched_system import WatchedSystem


def status(watched: WatchedSystem, programs: Iterable[ProgramStatus]) -> Status:
    """The whole status, as it is now."""
    configuration = watched.system.configuration
    evaluator, found = Evaluator(configuration), violations(configuration)
    silences = watched.monitor.faults(configuration)
    program_of = {program.name: program for program in programs}
    instances = [_instance(watched, name, program_of.get(name)) for name in sorted(configuration.instances)]
    values, broken = system_values(watched), [str(violation) for violation in found]
    return Status(
        **values,
        running=watched.commands.running,
        condition=condition(watched, instances, values["crashed"], silences, broken),
        valid=not found and not silences and all(map(is_sound, instances)),
        violations=broken,
        instances=instances,
        silences=silences,
        topics=[topic_status(configuration, evaluator, name) for name in sorted(configuration.context.connectors)],
    )


def system_values(watched: WatchedSystem) -> dict[str, Any]:
    """The fields of a status that are about the system as a whole, and do not depend on when it is looked at."""
    system, backend = watched.system, watched.backend
    refused = [watched.store.unwritten, watched.journal.unwritten, backend.unwritten()]
    return {
        "system": system.specification.name,
        "backend": backend.name,
        "revision": system.revision,
        "lock": watched.permission.current_lock,
        "crashed": crashed(watched),
        "unwritten": "; ".join(filter(None, refused)) or None,
        "damaged": watched.journal.damaged,
        "file": system.file,
        "changed_since": system.changed_since,
        "middleware": backend.middleware(),
        "spares": SpareStatus(
            kept=watched.spares,
            ready=backend.spares(),
            unused_by=[
                name
                for name, each in sorted(system.configuration.instances.items())
                if watched.spares and not (each.component.once or watched.launcher.takes_spare(each))
            ],
        ),
    }


def crashed(watched: WatchedSystem) -> list[CrashedInstance]:
    """The instances that have exited unexpectedly or could not be started, and what to do about each."""
    system, respawner = watched.system, watched.respawner
    return [
        CrashedInstance(
            name,
            exited.status,
            exited.log_tail,
            None if role is None else system.remedy(role),
            respawner.status(role),
            role,
            exited.because or f"{exited.words}{'' if exited.status is None else f' (status {exited.status})'}",
        )
        for name, exited in sorted({**system.life.missing, **system.life.exits}.items())
        if name not in system.configuration.instances
        for role in [system.role_of_missing(name)]
    ]


def topic_status(configuration: Configuration, evaluator: Evaluator, name: str) -> TopicStatus:
    """The status of the connector ``name``."""
    connector = configuration.context.connectors[name]
    return TopicStatus(
        name=name,
        topic=connector.topic,
        type=connector.guarantee.type,
        rate=connector.guarantee.rate,
        satisfied=evaluator.connector_satisfied(name),
        publishers=[str(port) for port in sorted(configuration.publishers_on(name))],
        subscribers=[str(port) for port in sorted(configuration.subscribers_on(name))],
        outside=sorted({each.name for each in configuration.context.publishers_out_of_scope(connector)}),
    )


def _instance(watched: WatchedSystem, name: str, program: ProgramStatus | None) -> InstanceStatus:
    configuration = watched.system.configuration
    shape = EntryShape.of(configuration, configuration.instances[name])
    ports = port_statuses(shape, watched.system.life.responsive(name), exact=True)
    found = instance_status(watched, shape, time.time(), None, ports, exact=True)
    if program is None:
        return structs.replace(found, changed_files=[], unknown_files=None, executable=None)
    return structs.replace(
        found, changed_files=program.changed, unknown_files=program.unknown, executable=program.executable
    )

"""The status of the system: live instances and modes as reported, compared with the model."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

from immutables import Map
from msgspec import structs

from midstride.errors import MidstrideError
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator, violations
from midstride.runtime.records.status_forms import (
    CrashedInstance,
    HostStatus,
    InstanceStatus,
    OtherEndpoints,
    ProgramStatus,
    SpareStatus,
    Status,
    TopicStatus,
)
from midstride.runtime.timeouts import within
from midstride.runtime.view.condition import condition
from midstride.runtime.view.instance_status import EntryShape, instance_status, is_sound, port_statuses
from midstride.runtime.view.watched_system import WatchedSystem

# How long ROS's graph may take to say which endpoints it shows (s): on ROS 1, the master is asked.
GRAPH_TIMEOUT: Final = 2.0


def status(
    watched: WatchedSystem, programs: Iterable[ProgramStatus], others: Mapping[str, OtherEndpoints] = Map()
) -> Status:
    """The whole status, as it is now. ``others``: endpoints that are no ports, by topic."""
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
        topics=[
            structs.replace(topic, others=others.get(topic.topic))
            for name in sorted(configuration.context.connectors)
            for topic in [topic_status(configuration, evaluator, name)]
        ],
    )


async def other_endpoints(watched: WatchedSystem) -> dict[str, OtherEndpoints]:
    """The endpoints that ROS's graph shows on topics where no port publishes, or none listens, by topic.

    Empty where the graph cannot be looked at in time.
    """
    configuration = watched.system.configuration
    names = [name for name, connector in configuration.context.connectors.items() if connector.kind == "topic"]
    unwritten = {name for name in names if not configuration.publishers_on(name)}
    unheard = {name for name in names if not configuration.subscribers_on(name)}
    topics = {name: configuration.topic(name) for name in unwritten | unheard}
    if not topics:
        return {}
    try:
        async with within(GRAPH_TIMEOUT):
            seen = await watched.backend.endpoints([*topics.values()])
    except (MidstrideError, asyncio.TimeoutError):
        return {}
    return {
        topic: OtherEndpoints(
            publishers=sorted({node for node, where in seen.publishers if where == topic and name in unwritten}),
            subscribers=sorted({node for node, where in seen.subscribers if where == topic and name in unheard}),
        )
        for name, topic in topics.items()
    }


def system_values(watched: WatchedSystem) -> dict[str, Any]:
    """The fields of a status that are about the system as a whole, and do not depend on when it is looked at."""
    system, backend = watched.system, watched.backend
    refused = [watched.store.unwritten, watched.journal.unwritten, backend.unwritten()]
    return {
        "system": system.specification.name,
        "backend": backend.name,
        "revision": system.revision,
        "lock": watched.permission.current_lock,
        "requirements": watched.permission.requirements(),
        "crashed": crashed(watched),
        "unwritten": "; ".join(filter(None, refused)) or None,
        "damaged": watched.journal.damaged,
        "file": system.file,
        "changed_since": system.changed_since,
        "middleware": backend.middleware(),
        "hosts": hosts(watched),
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


def hosts(watched: WatchedSystem) -> list[HostStatus]:
    """The hosts other than the manager's, by name, and the link to each."""
    instances = sorted(watched.system.configuration.instances.values(), key=lambda each: each.name)
    return [
        HostStatus(
            name=link.host,
            destination=link.destination,
            connected=link.problem is None,
            since=round(link.since, 3),
            because=link.problem,
            version=link.version,
            instances=[each.name for each in instances if each.host == link.host],
            fallbacks=[
                words
                for each in instances
                if each.host == link.host and link.problem is not None
                for words in [watched.leases.in_words(each.name)]
                if words is not None
            ],
            clock_ahead=None if link.clock is None else link.clock.ahead / 1e9,
            clock_uncertainty=None if link.clock is None else link.clock.uncertainty / 1e9,
        )
        for link in watched.backend.host_links()
    ]


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
            exited.details,
            None if role is None else system.specification.nodes[role].container,
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

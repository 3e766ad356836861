"""The status of the system: live components and modes as reported, compared with the model."""

from __future__ import annotations

from collections.abc import Iterable

from midstride.model.component import ComponentSpec, FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator, violations
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.records import status_forms
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.wire.state import ComponentState, FunctionalityState, LinkState


def status(
    watched: WatchedSystem,
    backend: Backend,
    programs: Iterable[status_forms.ProgramStatus],
    *,
    unwritten: str | None,
    damaged: str | None,
    spares: int,
) -> status_forms.Status:
    """The answer to ``midstride status``. ``spares``: how many processes the ``backend`` is to keep ready."""
    system, launcher = watched.system, watched.launcher
    configuration, evaluator = system.configuration, Evaluator(system.configuration)
    found, silences = violations(configuration), watched.monitor.faults(configuration)
    program_of = {program.name: program for program in programs}
    components = [
        _component(watched, instance, program_of.get(name))
        for name, instance in sorted(configuration.instances.items())
    ]
    return status_forms.Status(
        # A component that waits for the clock of a simulation does not do what its modes guarantee.
        valid=not found
        and not silences
        and all(each.as_modelled and each.waiting is None and not each.differences for each in components),
        violations=[str(violation) for violation in found],
        components=components,
        crashed=crashed(watched),
        silences=silences,
        topics=[
            status_forms.TopicStatus(
                name=name,
                satisfied=evaluator.connector_satisfied(name),
                publishers=[str(port) for port in sorted(configuration.publishers_on(name))],
                subscribers=[str(port) for port in sorted(configuration.subscribers_on(name))],
            )
            for name in sorted(configuration.context.connectors)
        ],
        system=system.specification.name,
        backend=backend.name,
        revision=system.revision,
        running=watched.commands.running,
        unwritten=unwritten,
        damaged=damaged,
        middleware=backend.middleware(),
        file=system.file,
        changed_since=system.changed_since,
        spares=status_forms.SpareStatus(
            kept=spares,
            ready=backend.spares(),
            unused_by=[name for name, each in sorted(configuration.instances.items()) if not launcher.takes_spare(each)]
            if spares
            else [],
        ),
    )


def crashed(watched: WatchedSystem) -> list[status_forms.CrashedInstance]:
    """The instances that have exited unexpectedly, and what to do about each."""
    system, respawner = watched.system, watched.respawner
    return [
        status_forms.CrashedInstance(
            name,
            exited.status,
            exited.log_tail,
            None if role is None else system.remedy(role),
            respawner.status(role),
            role,
        )
        for name, exited in sorted({**system.life.missing, **system.life.exits}.items())
        if name not in system.configuration.instances
        for role in [system.role_of_missing(name)]
    ]


def _component(
    watched: WatchedSystem, instance: Instance, program: status_forms.ProgramStatus | None
) -> status_forms.ComponentStatus:
    configuration, life = watched.system.configuration, watched.system.life
    state, handle = life.responsive(instance.name), life[instance.name].handle
    process = state or handle
    reported = {} if state is None else state.functionalities
    functionalities = [
        _functionality(configuration, ref, reported.get(ref.functionality), watched.restorer.status(ref))
        for ref in instance.functionality_refs()
    ]
    return status_forms.ComponentStatus(
        name=instance.name,
        role=instance.role,
        component=instance.component.name,
        pid=None if process is None else process.pid,
        node=None if state is None else state.node,
        answers=state is not None and state.answers,
        reachable=state is not None,
        ending=life.is_ending(instance.name),
        waiting=None if state is None else state.waiting,
        differences=[] if state is None else state.differences,
        undeclared=[] if state is None else state.undeclared,
        as_modelled=all(each.mode == each.modelled for each in functionalities),
        changed_files=[] if program is None else program.changed,
        unknown_files=None if program is None else program.unknown,
        functionalities=functionalities,
        parameters=[] if state is None else parameters(state),
        attachments=[
            _attachment(instance.component, state, port, connector, configuration.topic(connector))
            for port, connector in configuration.attached_ports(instance.name)
        ],
        simulated_time=state is not None and state.simulated_time,
        run=instance.component.run,
        log_file=None if handle is None else handle.log,
    )


def parameters(state: ComponentState) -> list[status_forms.ParameterStatus]:
    """The parameters of a component, by name."""
    return [
        status_forms.ParameterStatus(name, value, state.declared.get(name, value), name in state.declared)
        for name, value in sorted(state.parameters.items())
    ]


def _attachment(
    component: ComponentSpec, state: ComponentState | None, port: PortRef, connector: str, topic: str
) -> status_forms.AttachmentStatus:
    link = None if state is None else state.ports.get(port.port, {}).get(topic)
    if state is None or link is None:
        return status_forms.AttachmentStatus(str(port), connector, None)
    modes = {name: each.mode for name, each in state.functionalities.items()}
    return status_forms.AttachmentStatus(
        str(port), connector, link.gate, _measured(link, component.stated_rate(port.port, modes))
    )


def _measured(link: LinkState, declared: float | None) -> status_forms.MeasuredStatus | None:
    measured = link.measured
    if measured is None:
        return None
    return status_forms.MeasuredStatus(
        declared=declared,
        rate=measured.rate,
        met=None if declared is None else measured.meets(declared),
        window=measured.window,
        age=measured.age,
        jitter=measured.jitter,
        longest=measured.longest,
        fields=[
            status_forms.FieldStatus(
                field=name,
                constraint=each.constraint,
                checked=each.checked,
                violations=each.violations,
                run=each.run,
                last=each.last,
            )
            for name, each in link.fields.items()
        ],
    )


def _functionality(
    configuration: Configuration, ref: FunctionalityRef, state: FunctionalityState | None, restoring: str | None = None
) -> status_forms.FunctionalityStatus:
    modelled = configuration.mode(ref).name
    mode = modelled if state is None else state.mode
    return status_forms.FunctionalityStatus(
        name=str(ref),
        mode=mode,
        modelled=modelled,
        normal=mode == configuration.functionality(ref).modes[0].name,
        because=None if state is None else state.because,
        since=None if state is None else state.since,
        busy=None if state is None else state.busy,
        restoring=restoring,
    )

"""What is live and in which mode, as the components themselves tell it, beside what the model says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator, violations
from midstride.runtime.backend import Exited
from midstride.runtime.component_client import ComponentClient
from midstride.wire.state import ComponentState

State = dict[str, Any]


def status(configuration: Configuration, client: ComponentClient, gone: Mapping[str, Exited]) -> State:
    """The document of ``midstride status``."""
    states = {name: client.responsive(name) for name in sorted(configuration.instances)}
    found = violations(configuration)
    components = [
        _component(configuration, instance, states[name]) for name, instance in sorted(configuration.instances.items())
    ]
    differing = [row["name"] for row in components if not row["as_modelled"]]
    crashed = [
        {"name": name, "status": exited.status, "log": exited.log_tail}
        for name, exited in sorted(gone.items())
        if name not in configuration.instances
    ]
    return {
        "valid": not found and not differing and all(row["reachable"] for row in components),
        "violations": [str(violation) for violation in found],
        "components": components,
        "crashed": crashed,
        "topics": [
            {
                "name": name,
                "satisfied": Evaluator(configuration).connector_satisfied(name),
                "publishers": [str(port) for port in sorted(configuration.publishers_on(name))],
                "subscribers": [str(port) for port in sorted(configuration.subscribers_on(name))],
            }
            for name in sorted(configuration.context.connectors)
        ],
    }


def _component(configuration: Configuration, instance: Instance, state: ComponentState | None) -> State:
    own = {} if state is None else state.functionalities
    functionalities = []
    as_modelled = True
    for ref in instance.functionality_refs():
        functionality = configuration.functionality(ref)
        modelled = configuration.mode(ref).name
        view = own.get(ref.functionality)
        mode = modelled if view is None else view.mode
        as_modelled = as_modelled and mode == modelled
        functionalities.append(
            {
                "name": str(ref),
                "mode": mode,
                "modelled": modelled,
                "normal": mode == functionality.modes[0].name,
                "because": None if view is None else view.because,
                "since": None if view is None else view.since,
                "busy": None if view is None else view.busy,
            }
        )
    links = {} if state is None else state.ports

    def gate(port: PortRef, connector: str) -> str | None:
        link = links.get(port.port, {}).get(configuration.context.connectors[connector].topic)
        return None if link is None else link.gate

    return {
        "name": instance.name,
        "role": instance.role,
        "component": instance.component.name,
        "pid": None if state is None else state.pid,
        "reachable": state is not None,
        "waiting": None if state is None else state.waiting,
        "as_modelled": as_modelled,
        "functionalities": functionalities,
        "attachments": [
            {
                "port": str(port),
                "connector": connector,
                "gate": gate(port, connector),
            }
            for port, connector in configuration.attached_ports(instance.name)
        ],
    }


def why(configuration: Configuration, client: ComponentClient, functionality: str) -> State:
    """Why ``functionality`` (of a role or an instance) is in its mode. Raises PlanRefused for an unknown one."""
    asked = FunctionalityRef.parse(functionality)
    every = [ref for instance in configuration.instances.values() for ref in instance.functionality_refs()]
    matching = [ref for ref in every if ref == asked] or [
        ref
        for ref in every
        if ref.functionality == asked.functionality and configuration.instances[ref.instance].role == asked.instance
    ]
    if not matching:
        known = ", ".join(sorted(map(str, every))[:12]) or "none"
        raise PlanRefused(f"there is no functionality {functionality}; there are {known}")
    ref = sorted(matching)[0]
    state = client.responsive(ref.instance)
    view = None if state is None else state.functionalities.get(ref.functionality)
    mode = configuration.mode(ref).name if view is None else view.mode
    return {
        "functionality": str(ref),
        "mode": mode,
        "normal": configuration.functionality(ref).modes[0].name == mode,
        "because": None if view is None else view.because,
        "chain": _chain(configuration, ref),
        "inputs": {
            str(PortRef(ref.instance, name)): Evaluator(configuration).input_satisfied(PortRef(ref.instance, name))
            for name in configuration.functionality(ref).inputs
        },
    }


def _chain(configuration: Configuration, ref: FunctionalityRef) -> list[str]:
    """For each better mode than the current one: what it assumes that does not hold."""
    judge, functionality, told = Evaluator(configuration), configuration.functionality(ref), []
    for index in range(configuration.modes[ref]):
        mode = functionality.modes[index]
        missing = [a for a in mode.assumptions if not judge.assumption_satisfied(ref, functionality, a)]
        told += [f"not {mode.name}: it {judge.why_assumption_unsatisfied(ref, a)}" for a in missing]
        if not missing:
            told.append(f"not {mode.name}: all it assumes holds; nobody has raised it yet")
    return told

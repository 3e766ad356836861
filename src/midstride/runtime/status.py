"""What is live and in which mode, as the components themselves tell it, beside what the model says."""

from __future__ import annotations

import asyncio
from collections.abc import Container, Mapping
from typing import Any, Final

from midstride.errors import MidstrideError, PlanRefused
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator, violations
from midstride.runtime.backend import Exited
from midstride.runtime.clock import Clock
from midstride.runtime.component_client import ComponentClient

# How long a component's own word is waited for (s): whoever asks for the status is to have it within 0.1 s.
TIMEOUT: Final = 0.08

State = dict[str, Any]


async def observed(
    names: list[str], link: ComponentClient, clock: Clock, timeout: float = TIMEOUT
) -> dict[str, State | None]:
    """The state of each component by its own word; None for one that does not answer in time."""
    asking = {name: asyncio.ensure_future(_peek(name, link)) for name in names}
    if not asking:
        return {}
    patience = asyncio.ensure_future(clock.sleep(timeout))
    everyone = asyncio.gather(*asking.values())
    first: set[asyncio.Future[Any]] = {everyone, patience}
    try:
        await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
        return {name: task.result() if task.done() else None for name, task in asking.items()}
    finally:
        patience.cancel()
        for task in asking.values():
            task.cancel()
        await asyncio.gather(patience, everyone, return_exceptions=True)


async def _peek(name: str, link: ComponentClient) -> State | None:
    try:
        return await link.peek(name)
    except MidstrideError:
        return None


async def own_degradations(
    configuration: Configuration, link: ComponentClient, clock: Clock, gone: Container[str]
) -> dict[FunctionalityRef, int]:
    """The functionalities that stand in a worse mode than the model says, by their own word; ``gone`` are not asked.

    The caller takes them into the model: the components that say so are expected at the revision they say it at.
    """
    states = await observed(
        sorted(name for name in configuration.instances if name not in gone), link, clock, timeout=1.0
    )
    worse: dict[FunctionalityRef, int] = {}
    for name, state in states.items():
        for functionality, view in (state or {}).get("functionalities", {}).items():
            ref = FunctionalityRef(name, functionality)
            index = configuration.functionality(ref).mode_index(view["mode"])
            if index > configuration.modes[ref]:
                worse[ref] = index
                link.accept(name, state or {})
    return worse


async def status(
    configuration: Configuration, link: ComponentClient, clock: Clock, gone: Mapping[str, Exited]
) -> State:
    """The document of ``midstride status``."""
    states = await observed(sorted(configuration.instances), link, clock)
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


def _component(configuration: Configuration, instance: Instance, state: State | None) -> State:
    own = (state or {}).get("functionalities", {})
    functionalities = []
    as_modelled = True
    for ref in instance.functionality_refs():
        functionality = configuration.functionality(ref)
        modelled = configuration.mode(ref).name
        view = own.get(ref.functionality)
        mode = modelled if view is None else view["mode"]
        as_modelled = as_modelled and mode == modelled
        functionalities.append(
            {
                "name": str(ref),
                "mode": mode,
                "modelled": modelled,
                "normal": mode == functionality.modes[0].name,
                "because": None if view is None else view.get("because"),
                "since": None if view is None else view.get("since"),
                "busy": None if view is None else view.get("busy"),
            }
        )
    ports = (state or {}).get("ports", {})
    return {
        "name": instance.name,
        "role": instance.role,
        "component": instance.component.name,
        "pid": None if state is None else state.get("pid"),
        "reachable": state is not None,
        "waiting": None if state is None else state.get("waiting"),
        "as_modelled": as_modelled,
        "functionalities": functionalities,
        "attachments": [
            {
                "port": str(port),
                "connector": connector,
                "gate": ports.get(port.port, {}).get(configuration.context.connectors[connector].topic, {}).get("gate"),
            }
            for port, connector in configuration.attached_ports(instance.name)
        ],
    }


async def why(configuration: Configuration, link: ComponentClient, clock: Clock, functionality: str) -> State:
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
    state = (await observed([ref.instance], link, clock))[ref.instance]
    view = (state or {}).get("functionalities", {}).get(ref.functionality, {})
    mode = view.get("mode", configuration.mode(ref).name)
    return {
        "functionality": str(ref),
        "mode": mode,
        "normal": configuration.functionality(ref).modes[0].name == mode,
        "because": view.get("because"),
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

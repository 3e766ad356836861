"""The invariants once the faults are over: the processes, the model, the saved state and the specification agree."""

from __future__ import annotations

from collections.abc import Container, Iterable
from types import NoneType
from typing import Any

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.specification import initial
from midstride.plan.forms.step_forms import AttachStep, DetachStep, HandoverStep
from midstride.runtime.manager import Manager
from midstride.runtime.records.state_store import SavedState
from midstride.runtime.watch.observed_configuration import reported_modes
from midstride.simulation.killable_manager import ManagerKilled
from midstride.simulation.platform import Platform
from midstride.simulation.stand_in import StandIn


def differences(manager: Manager, platform: Platform, saved: SavedState | None) -> list[str]:
    """The differences between what runs, the manager's model, its saved state and the specification."""
    found = []
    configuration, expected = manager.configuration, initial(manager.specification)
    processes = {process.instance: process for process in platform.stand_ins()}
    running = sorted(name for name, each in configuration.instances.items() if not each.component.once)
    if sorted(processes) != running:
        found.append(f"{sorted(processes)} run, the model has {running}")
    done = [] if saved is None else sorted(each.instance.name for each in saved.instances if each.done)
    if done != sorted({*configuration.instances}.difference(running)):
        found.append(f"saved as done are {done}")
    roles = {role: len(names) for role, names in configuration.instances_by_role.items() if names}
    if roles != dict.fromkeys(manager.specification.nodes, 1):
        found.append(f"instances by role: {roles}")
    for name, process in processes.items():
        instance = configuration.instances.get(name)
        if instance is None or process.state is None:
            continue
        for ref, index in reported_modes(instance.component, process.state).items():
            if index != configuration.modes[ref]:
                found.append(f"{ref} is in mode {index}, the model has {configuration.modes[ref]}")
            best = expected.modes[FunctionalityRef(instance.role, ref.functionality)]
            if index != best:
                found.append(f"{ref} is in mode {index}, the best is {best}")
        shown = attachments(process)
        modelled = {(port.port, configuration.topic(name)) for port, name in configuration.attached_ports(name)}
        if shown != modelled:
            found.append(f"{name} is attached to {sorted(shown)}, the model has {sorted(modelled)}")
    recorded = [] if saved is None else sorted(each.instance.name for each in saved.instances if not each.done)
    if recorded != sorted(processes):
        found.append(f"saved are {recorded}")
    if saved is not None and saved.specification != manager.specification:
        found.append("another specification is saved")
    return found


def attachments(process: StandIn) -> set[tuple[str, str]]:
    """The ports that it shows to be attached, with their topics; an output behind a closed gate is not."""
    ports = {} if process.state is None else process.state.ports
    return {(port, topic) for port, topics in ports.items() for topic, link in topics.items() if link.gate != "closed"}


def not_done(step: AttachStep | DetachStep, manager: Manager, platform: Platform, fenced: Container[str]) -> str | None:
    """In which way a step that is done has not been: what its process shows, unless it has ended.

    Nothing is asked of one in ``fenced`` but its end: it hangs, or did.
    """
    instance, _, port = step.port.rpartition(".")
    process = platform.standing(instance)
    if process is None or process.state is None or instance in fenced:
        return None
    topic = manager.configuration.topic(step.topic)
    attached = (port, topic) in attachments(process)
    if not manager.configuration.is_topic(step.topic):  # which of the servers answers is another question
        attached = topic in process.state.ports.get(port, {})
    if attached == isinstance(step, AttachStep):
        return None
    return f"{step.port} is {'' if attached else 'not '}attached to {step.topic} after `{step.action}` is done"


def not_handed_over(step: HandoverStep, manager: Manager, platform: Platform) -> list[str]:
    """The new sides of a hand-over that is done which have no endpoint, although their processes run."""
    found = []
    for swap in step.swaps:
        if (ports := _ports(swap.new, platform)) is None:
            continue
        if manager.configuration.topic(swap.topic) not in ports:
            found.append(f"{swap.new} is not on {swap.topic} after the hand-over is done")
    return found


def _ports(port: str, platform: Platform) -> Container[str] | None:
    """The topics of a port of an instance that runs, and has reported."""
    instance, _, name = port.rpartition(".")
    process = platform.standing(instance)
    return None if process is None or process.state is None else process.state.ports.get(name, {})


def left_attached(step: HandoverStep, manager: Manager, platform: Platform) -> list[str]:
    """The new publishers of a hand-over that has failed which still have an endpoint on its topic.

    Without those that were given up after their cut, while they were watched: the roll-back hands them back.
    """
    found = []
    for swap in step.swaps:
        instance, _, port = swap.new.rpartition(".")
        if swap.topic in manager.configuration.attached_to(PortRef(instance, port)):
            continue
        topic = manager.configuration.topic(swap.topic)
        if topic in (_ports(swap.new, platform) or ()):
            found.append(f"{swap.new} is still on {topic} after the hand-over has failed")
    return found


def closed_outputs(platform: Platform) -> list[str]:
    """The outputs whose gate is closed, where no other instance of their role publishes instead."""
    roles = [process.role for process in platform.stand_ins()]
    return [
        f"{process.instance}.{port} on {topic}"
        for process in platform.stand_ins()
        if process.state is not None and roles.count(process.role) == 1
        for port, topics in process.state.ports.items()
        for topic, link in topics.items()
        if link.gate == "closed"
    ]


def uncaught(errors: Iterable[dict[str, Any]]) -> list[str]:
    """The errors that no task has caught. Tasks of a process that was killed end where they were."""
    found = [error for error in errors if not isinstance(error.get("exception"), (ManagerKilled, NoneType))]
    return [f"uncaught: {error['message']}: {error['exception']!r}" for error in found]

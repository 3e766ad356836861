"""The words for what a change does to the processes of containers that several nodes share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from midstride.model.component import PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.load_words import is_intra_process
from midstride.plan.change import Change, measured_key
from midstride.verdicts.assessment import seconds_in_words

# Containers of rclcpp: all nodes in an executor with several threads, and each in one of its own, which ends before it.
_SEVERAL_THREADS: Final = "component_container_mt"
_THREAD_EACH: Final = "component_container_isolated"


def in_words(change: Change) -> Iterator[str]:
    """Yield who leaves a process that goes on, who gets one for itself, who moves together, and what that costs."""
    yield from _moves(change)
    yield from _pauses(change)
    yield from _given_up(change)


def _moves(change: Change) -> Iterator[str]:
    moved: dict[str, list[str]] = {}
    old = {new: before for before, new in change.replaced.items()}
    for instance in change.coming:
        if instance.container is None:
            continue
        container = instance.container.name
        before = None if instance.name not in old else change.instance(old[instance.name])
        if before is None:
            if not instance.process:
                yield (
                    f"{instance.name} starts in a process for itself: the one before it had left {container}, or that "
                    f"had exited or hung while loading it; `midstride restart {container}` brings all together again"
                )
        elif instance.process and instance.process == before.process:
            yield (
                f"{instance.name} starts in {before.process}, beside {before.name}: with the code that is loaded "
                "there, and if it crashes, all of them end"
            )
        elif instance.process:
            moved.setdefault(instance.process, []).append(instance.role)
        else:
            yield (
                f"{instance.name} has a process for itself, beside {container}, so that it runs what its library has "
                f"now, and no other node ends with it; `midstride restart {container}` brings all together again"
            )
    for process, roles in sorted(moved.items()):
        yield f"{', '.join(sorted(roles))}: loaded into a new process, {process}"


def _pauses(change: Change) -> Iterator[str]:
    """Yield what runs in a process beside nodes that work there."""
    for instance in change.coming:
        if instance.container is not None and (others := _beside(change, instance)):
            yield (
                f"{instance.name} is loaded into {instance.process}: its constructor runs there, and may hold up "
                f"{', '.join(others)} for as long as it takes"
            )
    for name in change.leaving:
        instance = change.instance(name)
        if instance.container is not None and (others := _staying(change, instance)):
            yield (
                f"{name} is unloaded from {instance.process}: its destructor runs there, and may hold up "
                f"{', '.join(others)} for as long as it takes ({_known(change, instance)}); if it does not return, it "
                "ends only with all of them"
            )
            if instance.component.has_lifecycle and instance.container.program.run.split()[0] == _SEVERAL_THREADS:
                yield (
                    f"{name} is a lifecycle node: rclcpp's {_SEVERAL_THREADS} may crash or hang as it unloads one, "
                    f"also without Midstride; {_THREAD_EACH} was not seen to"
                )


def _known(change: Change, instance: Instance) -> str:
    """Say how long instances of this component took to end, as far as that has been measured."""
    component = instance.component.name
    if (measured := change.measured.get(measured_key("remove", instance))) is None:
        return f"not measured yet for {component}"
    return f"measured: {component} ended within {seconds_in_words(measured.longest)}"


def _staying(change: Change, instance: Instance) -> list[str]:
    """The other instances of its process that the change leaves there."""
    return [name for name in _beside(change, instance) if name not in change.leaving]


def _beside(change: Change, instance: Instance) -> list[str]:
    """The other instances that are in its process when the change begins."""
    if not instance.process:
        return []
    others = (each for each in change.start.instances.values() if each.process == instance.process)
    return sorted(each.name for each in others if each.name != instance.name)


class _Edge(NamedTuple):
    """A topic between two nodes of one container whose components ask for intra-process communication."""

    output: PortRef
    input: PortRef
    together: bool  # in one process
    gated: bool  # the output has a gate, which keeps it out of that communication

    @property
    def within(self) -> bool:
        return self.together and not self.gated


def _given_up(change: Change) -> Iterator[str]:
    """Yield the topics whose messages do not stay within a process any more, or that do not from the start."""
    before = {_by_role(change, edge): edge for edge in _edges(change.start, change.start.instances)}
    coming = [instance.name for instance in change.coming if instance.name in change.final.instances]
    for edge in _edges(change.final, coming):
        was = before.get(_by_role(change, edge))
        if edge.within or (was is not None and not was.within):
            continue
        why = "in different processes" if not edge.together else f"as {edge.output} has a gate, and may be handed over"
        yield f"{edge.output} to {edge.input}: through the middleware, not within the process, {why}"


def _by_role(change: Change, edge: _Edge) -> tuple[str, str, str, str]:
    output, input_ = edge.output, edge.input
    return change.role_of(output.instance), output.port, change.role_of(input_.instance), input_.port


def _edges(configuration: Configuration, names: Iterable[str]) -> Iterator[_Edge]:
    """Yield those at whose ends one of the instances ``names`` is, each once."""
    found: dict[tuple[PortRef, PortRef], None] = {}
    for name in sorted(names):
        instance = configuration.instances[name]
        if instance.container is None or not is_intra_process(instance.component.run):
            continue
        for port, connector in configuration.attached_ports(name):
            if not configuration.is_topic(connector):
                continue
            if configuration.is_output(port):
                found |= {(port, other): None for other in sorted(configuration.subscribers_on(connector))}
            else:
                found |= {(other, port): None for other in sorted(configuration.publishers_on(connector))}
    for output, input_ in found:
        one, other = (configuration.instances[each.instance] for each in (output, input_))
        same = one.container is not None and other.container is not None and one.container.name == other.container.name
        if same and all(is_intra_process(each.component.run) for each in (one, other)):
            together = one.name == other.name or (one.process == other.process != "")
            yield _Edge(output, input_, together, one.component.preloads)

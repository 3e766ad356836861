"""The difference between what runs and the target, as one value (docs/semantics.md section 6).

A node of a specification is a *role*, what runs is an *instance* of it. A role whose declaration differs is replaced:
its old instance leaves, a new one with a new name comes. A changeable parameter is set in place. A topic whose
contract differs is a new topic, which during the plan has a separate identity beside the old one (``/scan@2`` for
``/scan`` on the wire).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from immutables import Map

from midstride.model.action import Action, Create, Handover, Remove, Swap
from midstride.model.component import ComponentSpec, FunctionalityRef, ParameterValue, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import DEFAULT_SECONDS, Specification, handover_seconds, probation_seconds
from midstride.plan.estimate import Estimate

PortAttachment = tuple[PortRef, str]


def measured_key(kind: str, instance: Instance) -> str:
    """The key of how long a creation or removal has taken: of the component, on its host."""
    return f"{kind} {instance.component.name}{f' on {instance.host}' if instance.host else ''}"


@dataclass(frozen=True, slots=True, order=True)
class Detour:
    """The steps of one role beyond the structural differences (docs/semantics.md section 6).

    ``moved``: a node that stays is replaced by a new instance with the same declaration, so that it may be absent for a
    time. ``stand_in``: the component of an instance that exists during the plan only; None: there is none.
    """

    role: str
    moved: bool = False
    stand_in: str | None = None


@dataclass(frozen=True, slots=True)
class Change:
    """From ``start``, where ``specification`` runs, to a structure of ``target``.

    ``start`` is the running configuration in the context that holds throughout the plan: the target's caps,
    capacities and environment. ``baseline`` is ``best`` of it in its original context, ``final`` ``best`` of the
    target. ``pending`` are the functionalities of ``start`` that could be in a better mode, ``lowered`` those that are
    in a worse mode than in ``baseline``. ``measured`` holds how long steps took in earlier runs, by kind
    (``attach``) or by kind, component and host (:func:`measured_key`). ``detours`` are part of the other fields
    already; ``stand_ins`` are the instances among ``coming`` that are also ``leaving``, by name; ``direct`` is the same
    change without detours.
    """

    specification: Specification
    target: Specification
    origin: Configuration
    start: Configuration
    baseline: Configuration
    final: Configuration
    leaving: tuple[str, ...] = ()
    coming: tuple[Instance, ...] = ()
    replaced: Map[str, str] = field(default_factory=Map)
    detached: tuple[PortAttachment, ...] = ()
    attached: tuple[PortAttachment, ...] = ()
    parameters: tuple[tuple[str, Map[str, ParameterValue]], ...] = ()
    pending: tuple[FunctionalityRef, ...] = ()
    lowered: tuple[FunctionalityRef, ...] = ()
    identities: Map[str, str] = field(default_factory=Map)
    renamed: tuple[Instance, ...] = ()
    measured: Map[str, Estimate] = field(default_factory=Map)
    detours: tuple[Detour, ...] = ()
    stand_ins: Map[str, Instance] = field(default_factory=Map)
    direct: Change | None = None

    @classmethod
    def none(cls, specification: Specification, running: Configuration, measured: Mapping[str, Estimate]) -> Change:
        """The change that changes nothing of what runs."""
        return cls(specification, specification, running, running, running, running, measured=Map(measured))

    def instances(self) -> list[str]:
        """The instances with structural changes."""
        ports = [port.instance for port, _ in (*self.detached, *self.attached)]
        return list(dict.fromkeys([*self.leaving, *(instance.name for instance in self.coming), *ports]))

    def instance(self, name: str) -> Instance:
        """The instance of that name, which runs at the start or comes. Raises KeyError where none does."""
        return self.start.instances.get(name) or self.stand_ins.get(name) or self.final.instances[name]

    def ends_process_of(self, instance: Instance) -> bool:
        """Return whether all that share the process of ``instance`` at the start leave."""
        return instance.process != "" and all(
            each.name in self.leaving for each in self.start.instances.values() if each.process == instance.process
        )

    def role_of(self, instance: str) -> str:
        return self.instance(instance).role

    def component_of(self, instance: str) -> ComponentSpec:
        return self.instance(instance).component

    def is_output(self, port: PortRef) -> bool:
        return self.component_of(port.instance).has_output(port.port)

    def seconds(self, kind: str, instance: Instance | None = None) -> float:
        """The time that a step is expected to take (s)."""
        return self.estimate(kind, instance).seconds

    def estimate(self, kind: str, instance: Instance | None = None) -> Estimate:
        """The duration of a step: declared in the target, else measured earlier, else the stated default.

        An instance with a new process of its container also waits until that can load it, which is in what was measured
        of its component. To a hand-over, :meth:`estimate_of` adds the probation of its outputs; the time for which they
        are watched afterwards is in it. A removal takes at most what the component states until it is killed.
        """
        timing = self.target.timing
        component = None if instance is None else instance.component
        waits = self._container_seconds(instance) if kind == "create" and instance is not None else 0.0
        if kind == "create" and component is not None and component.startup_seconds is not None:
            return Estimate.exactly(component.startup_seconds).plus(waits)
        own = None if instance is None else self.measured.get(measured_key(kind, instance))
        measured = self.measured.get(kind) if own is None else own
        if kind not in timing and measured is not None:
            found = measured if own is not None else measured.plus(waits)
        else:
            found = Estimate.exactly(timing.get(kind, DEFAULT_SECONDS[kind])).plus(waits)
        if kind == "remove" and component is not None and component.stop is not None and component.gate is not None:
            return found.at_most(component.stop.longest + (component.stop.drain if component.loads_library else 0.0))
        return found.plus(handover_seconds(timing, "watch_after")) if kind in ("handover", "set") else found

    def _container_seconds(self, instance: Instance) -> float:
        """The time that the container of ``instance`` states to need before it loads a node (s); 0 if it runs."""
        if instance.container is None or instance.container.program.startup_seconds is None:
            return 0.0
        running = self.start.instances.values() if instance.process else ()
        if any(each.container is not None and each.process == instance.process for each in running):
            return 0.0
        return instance.container.program.startup_seconds

    def estimate_of(self, action: Action) -> Estimate:
        """The duration of ``action``."""
        created = isinstance(action, Create | Remove)
        found = self.estimate(action.kind, self.instance(*action.instances()) if created else None)
        return found.plus(self.probation(action)) if isinstance(action, Handover) else found

    def probation(self, action: Handover) -> float:
        """The time for which the outputs of a hand-over are on probation for their rates, all at the same time (s)."""
        return max(probation_seconds(self.target.timing, self._rate(swap.new)) for swap in action.swaps)

    def _rate(self, port: PortRef) -> float | None:
        """The rate that an output guarantees in its best mode (Hz)."""
        component = self.component_of(port.instance)
        owner = component.find_owner(port.port)
        return None if owner is None else component.stated_rate(port.port, {owner.name: owner.modes[0].name})

    def sibling(self, connector: str) -> str | None:
        """The old connector of a topic whose contract changes, given the new one; else None."""
        if not self.identities:
            return None
        topic = self.start.context.connectors[connector].topic
        return topic if self.identities.get(topic) == connector else None

    def exchanges(self) -> dict[str, tuple[Swap, ...]]:
        """The swaps of each replacement, by its name.

        An output is swapped for the port of the same name where there is one, else for any other on the same topic.
        """
        replaced = [pair for pair in self.detached if pair[0].instance in self.replaced]
        old_outputs, new_outputs = self._outputs(replaced), self._outputs(self.attached)
        found: dict[str, list[Swap]] = {}
        for old, olds in old_outputs.items():
            new = self.replaced[old]
            free = new_outputs.get(new, [])
            for same_port in (True, False):
                for port, connector in list(olds):
                    candidates = (
                        other for other, on in free if on == connector and (not same_port or other.port == port.port)
                    )
                    successor = next(candidates, None)
                    if successor is not None:
                        free.remove((successor, connector))
                        olds.remove((port, connector))
                        found.setdefault(new, []).append(Swap(connector, port, successor))
        return {new: tuple(swaps) for new, swaps in found.items()}

    def _outputs(self, attachments: Iterable[PortAttachment]) -> dict[str, list[PortAttachment]]:
        """The attachments of outputs, by instance."""
        found: dict[str, list[PortAttachment]] = {}
        for port, connector in attachments:
            if self.is_output(port):
                found.setdefault(port.instance, []).append((port, connector))
        return found

    def in_target_context(self, configuration: Configuration) -> Configuration:
        """``configuration``, reached by the whole plan, in the target's own context and with its own names."""
        for name, identity in self.identities.items():
            for port in [*configuration.publishers_on(identity), *configuration.subscribers_on(identity)]:
                configuration = configuration.without_attachment(port, identity).with_attachment(port, name)
        for instance in self.renamed:
            running = configuration.instances[instance.name]
            known = replace(running, component=instance.component, container=instance.container)
            configuration = replace(configuration, instances=configuration.instances.set(instance.name, known))
        return configuration.with_context(self.target.context)

"""Encodes one system: its topics, environment, instances and configurations (docs/semantics.md, section 2)."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from itertools import combinations
from typing import Final, TypeVar

from midstride.model.component import (
    Assumption,
    ComponentSpec,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    PortRef,
)
from midstride.model.configuration import Configuration, Instance, SystemContext, to_fraction
from midstride.model.contract import Predicate
from midstride.model.wording import KIND_WORDS
from midstride.verify.alloy_atoms import AlloyAtoms, ModeName, SystemName, TooLarge

# The sets of components that exceed a resource are enumerated.
_MAX_HOLDERS: Final = 16


_Key = TypeVar("_Key", bound=Hashable)


class NotEncoded(Exception):
    """An action refers to something for which the dump has no atom; the message names it."""


class _AtomsOf(dict[_Key, str]):
    """The atoms of one kind of thing, by what they stand for. Raises NotEncoded where there is none."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __missing__(self, key: _Key) -> str:
        raise NotEncoded(f"there is no {self._kind} {key}")


class WorldEncoder:
    """Adds one system to ``atoms``; ``prefix`` keeps its names apart from those of other systems."""

    def __init__(self, atoms: AlloyAtoms, context: SystemContext, prefix: str = "") -> None:
        self.atoms = atoms
        self.context = context
        self.prefix = prefix
        self.components = _AtomsOf[str]("component")
        self.declared: dict[str, ComponentSpec] = {}
        self.usage: dict[str, Mapping[str, float]] = {}  # what each instance holds, by the keys of the resources
        self.ports = _AtomsOf[PortRef]("port")
        self.functionalities = _AtomsOf[FunctionalityRef]("functionality")
        self.modes: dict[tuple[FunctionalityRef, int], str] = {}
        self.connectors = _AtomsOf[str]("topic")
        self._environment()

    def _environment(self) -> None:
        atoms = self.atoms
        for name, connector in sorted(self.context.connectors.items()):
            base, comment = f"{self.prefix}{connector.kind}_{name}", f"{name} : {connector.guarantee}"
            atom = atoms.atom("Connector", base, name, comment)
            self.connectors[name] = atom
            atoms.add("conn_guar", atom, atoms.predicate(connector.guarantee))
            if connector.max_publishers is not None:
                atoms.capped.append(atom)
                provider = KIND_WORDS[connector.kind].provider
                for number in range(1, connector.max_publishers + 1):
                    comment = f"{provider} {number} of at most {connector.max_publishers} on {name}"
                    atoms.add("slots", atom, atoms.atom("Slot", f"{atom}_slot{number}", comment))
        self.offers: list[str] = []
        self.publishers: list[str] = []
        for offer in self.context.environment:
            if offer.topic is None:
                self.offers.append(atoms.predicate(offer.guarantee))
            else:
                self._publishers(offer)

    def _publishers(self, offer: EnvironmentGuarantee) -> None:
        """A publisher out of scope, on each connector of its topic."""
        for name, connector in sorted(self.context.connectors.items()):
            if connector.topic == offer.topic:
                comment = f"environment {offer.name} on {name} : {offer.guarantee}"
                atom = self.atoms.atom("Publisher", f"{self.prefix}environment_{offer.name}", offer.name, comment)
                self.atoms.add("on", atom, self.connectors[name])
                self.atoms.add("pub_guar", atom, self.atoms.predicate(offer.guarantee))
                self.publishers.append(atom)

    # -- declarations -----------------------------------------------------------------------------------

    def instances(self, configuration: Configuration) -> None:
        """Add the declarations of the instances of a configuration."""
        for _, instance in sorted(configuration.instances.items()):
            self.instance(instance)

    def instance(self, instance: Instance) -> None:
        """Add the declaration of an instance. Raises ValueError if the name stands for another component."""
        name, component = instance.name, instance.component
        if (known := self.declared.get(name)) is not None:
            if known != component:
                raise ValueError(f"{name} already exists, with component {known.name} instead of {component.name}")
            if self.usage[name] != instance.resource_usage:
                raise ValueError(f"{name} already exists, on another host than {instance.host}")
            return
        atoms = self.atoms
        self.declared[name], self.usage[name] = component, instance.resource_usage
        atom = atoms.atom("Component", self.prefix + name, name, f"{name}, a {component.name}")
        self.components[name] = atom
        for port in component.ports():
            self._port(atom, PortRef(name, port), component)
        for functionality in component:
            self._functionality(atom, FunctionalityRef(name, functionality.name), functionality)

    def _port(self, owner: str, ref: PortRef, component: ComponentSpec) -> None:
        atoms = self.atoms
        is_output = ref.port in component.outputs
        comment = str(ref) if is_output else f"{ref} : {component.inputs[ref.port]}"
        atom = atoms.atom("Output" if is_output else "Input", f"{self.prefix}{ref}", ref, comment)
        self.ports[ref] = atom
        atoms.add("outputs" if is_output else "inputs", owner, atom)
        if not is_output:
            atoms.add("input_asm", atom, atoms.predicate(component.inputs[ref.port]))

    def _functionality(self, owner: str, ref: FunctionalityRef, functionality: FunctionalitySpec) -> None:
        atoms = self.atoms
        atom = atoms.atom("Functionality", f"{self.prefix}{ref}_f", ref)
        self.functionalities[ref] = atom
        atoms.add("funcs", owner, atom)
        for port in functionality.inputs:
            atoms.add("assoc_inputs", atom, self.ports[PortRef(ref.instance, port)])
        for port in functionality.outputs:
            atoms.add("assoc_outputs", atom, self.ports[PortRef(ref.instance, port)])
        better: list[str] = []
        for index, mode in enumerate(functionality.modes):
            named = atoms.atom("Mode", f"{self.prefix}{ref}_{mode.name}", ModeName(ref, mode.name))
            self.modes[ref, index] = named
            atoms.add("modes", atom, named)
            for each in better:
                atoms.add("worse", each, named)
            better.append(named)
            self._mode(named, ref, mode, functionality)

    def _mode(self, atom: str, ref: FunctionalityRef, mode: Mode, functionality: FunctionalitySpec) -> None:
        atoms = self.atoms
        for assumption in mode.assumptions:
            atoms.add("mode_asms", atom, self._assumption(ref, assumption))
        for port in functionality.outputs:
            guarantee = mode.guarantee(port)
            if isinstance(guarantee, Predicate):
                atoms.add("mode_guars", atom, self.ports[PortRef(ref.instance, port)], atoms.predicate(guarantee))

    def _assumption(self, ref: FunctionalityRef, assumption: Assumption) -> str:
        if not isinstance(assumption, InputAlternatives):
            return self.atoms.predicate(assumption)
        key = f"{ref.instance}.{assumption}"
        atom = self.atoms.atom("NamedInputs", f"{self.prefix}assume_{ref.instance}_{assumption}", assumption, key)
        for port in assumption.inputs:
            self.atoms.add("named", atom, self.ports[PortRef(ref.instance, port)])
        return atom

    def overloads(self) -> None:
        """Add the smallest sets of instances that together exceed a resource."""
        resources = sorted({key for usage in self.usage.values() for key in usage})
        for resource in resources:
            holds = {name: usage[resource] for name, usage in sorted(self.usage.items()) if resource in usage}
            if len(holds) > _MAX_HOLDERS:
                raise TooLarge(
                    f"{len(holds)} components hold {resource}, more than the {_MAX_HOLDERS} that can be enumerated"
                )
            for number, group in enumerate(_too_much(holds, self.context.capacity(resource)), start=1):
                comment = f"too much {resource} together: {', '.join(group)}"
                atom = self.atoms.atom("Overload", f"{self.prefix}too_much_{resource}_{number}", group, comment)
                for name in group:
                    self.atoms.add("holders", atom, self.components[name])

    # -- configurations -----------------------------------------------------------------------------------

    def system(self, configuration: Configuration, number: int, description: str) -> str:
        """Add a configuration of this system; its atom."""
        atoms = self.atoms
        atom = atoms.atom("System", f"{self.prefix}S{number}", SystemName(number, description))
        for name in sorted(configuration.instances):
            atoms.add("comps", atom, self.components[name])
        for connector in self.connectors.values():
            atoms.add("conns", atom, connector)
        for port, connector in sorted(configuration.attachments()):
            atoms.add("roles", atom, self.connectors[connector], self.ports[port])
        for ref, index in sorted(configuration.modes.items()):
            atoms.add("cur_mode", atom, self.functionalities[ref], self.modes[ref, index])
        for offer in self.offers:
            atoms.add("env_guars", atom, offer)
        for publisher in self.publishers:
            atoms.add("env_pubs", atom, publisher)
        return atom


def _too_much(holds: dict[str, float], capacity: float) -> Iterator[tuple[str, ...]]:
    """The smallest groups that together hold more than ``capacity``."""
    found: list[frozenset[str]] = []
    for count in range(1, len(holds) + 1):
        for group in combinations(holds, count):
            too_much = sum(to_fraction(holds[name]) for name in group) > to_fraction(capacity)
            if too_much and not any(smaller <= set(group) for smaller in found):
                found.append(frozenset(group))
                yield group

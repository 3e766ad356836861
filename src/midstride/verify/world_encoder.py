"""One world in a universe: what is declared of its instances, and configurations of them (semantics.md section 2)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Final

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
from midstride.verify.alloy_atoms import AlloyAtoms, ModeName, SystemName, TooLarge

# The sets of components that hold too much of a resource together are tried out one by one.
_MOST_HOLDERS: Final = 16


class WorldEncoder:
    """One world in a universe: its topics, environment and instances, and configurations of them."""

    def __init__(self, universe: AlloyAtoms, world: SystemContext, prefix: str = "") -> None:
        self.universe = universe
        self.world = world
        self.prefix = prefix
        self.components: dict[str, str] = {}
        self.declared: dict[str, ComponentSpec] = {}
        self.ports: dict[PortRef, str] = {}
        self.functionalities: dict[FunctionalityRef, str] = {}
        self.modes: dict[tuple[FunctionalityRef, int], str] = {}
        self.connectors: dict[str, str] = {}
        self._environment()

    def _environment(self) -> None:
        universe = self.universe
        for name, connector in sorted(self.world.connectors.items()):
            atom = universe.atom("Connector", f"{self.prefix}topic_{name}", name, f"{name} : {connector.guarantee}")
            self.connectors[name] = atom
            universe.add("conn_guar", atom, universe.predicate(connector.guarantee))
            if connector.max_publishers is not None:
                universe.capped.append(atom)
                for number in range(1, connector.max_publishers + 1):
                    told = f"publisher {number} of at most {connector.max_publishers} on {name}"
                    universe.add("slots", atom, universe.atom("Slot", f"{atom}_slot{number}", told))
        self.offers: list[str] = []
        self.publishers: list[str] = []
        for offer in self.world.environment:
            if offer.topic is None:
                self.offers.append(universe.predicate(offer.guarantee))
            else:
                self._publishers(offer)

    def _publishers(self, offer: EnvironmentGuarantee) -> None:
        """A publisher out of scope, on each connector that is its topic."""
        for name, connector in sorted(self.world.connectors.items()):
            if connector.topic == offer.topic:
                told = f"environment {offer.name} on {name} : {offer.guarantee}"
                atom = self.universe.atom("Publisher", f"{self.prefix}environment_{offer.name}", offer.name, told)
                self.universe.add("on", atom, self.connectors[name])
                self.universe.add("pub_guar", atom, self.universe.predicate(offer.guarantee))
                self.publishers.append(atom)

    # -- declarations -----------------------------------------------------------------------------------

    def knows(self, instance: Instance) -> bool:
        return self.declared.get(instance.name) == instance.component

    def instance(self, instance: Instance) -> None:
        """Dump what is declared of an instance. Each name stands for one declaration in a scene."""
        name, component = instance.name, instance.component
        if name in self.declared:
            if not self.knows(instance):
                known = self.declared[name]
                raise ValueError(
                    f"there is a {name} already, a {known.name}, and it would be a {component.name} as well"
                )
            return
        universe = self.universe
        self.declared[name] = component
        atom = universe.atom("Component", self.prefix + name, name, f"{name}, a {component.name}")
        self.components[name] = atom
        for port in component.ports():
            self._port(atom, PortRef(name, port), component)
        for functionality in component:
            self._functionality(atom, FunctionalityRef(name, functionality.name), functionality)

    def _port(self, owner: str, ref: PortRef, component: ComponentSpec) -> None:
        universe = self.universe
        is_output = ref.port in component.outputs
        told = str(ref) if is_output else f"{ref} : {component.inputs[ref.port]}"
        atom = universe.atom("Output" if is_output else "Input", f"{self.prefix}{ref}", ref, told)
        self.ports[ref] = atom
        universe.add("outputs" if is_output else "inputs", owner, atom)
        if not is_output:
            universe.add("input_asm", atom, universe.predicate(component.inputs[ref.port]))

    def _functionality(self, owner: str, ref: FunctionalityRef, functionality: FunctionalitySpec) -> None:
        universe = self.universe
        atom = universe.atom("Functionality", f"{self.prefix}{ref}_f", ref)
        self.functionalities[ref] = atom
        universe.add("funcs", owner, atom)
        for port in functionality.inputs:
            universe.add("assoc_inputs", atom, self.ports[PortRef(ref.instance, port)])
        for port in functionality.outputs:
            universe.add("assoc_outputs", atom, self.ports[PortRef(ref.instance, port)])
        better: list[str] = []
        for index, mode in enumerate(functionality.modes):
            named = universe.atom("Mode", f"{self.prefix}{ref}_{mode.name}", ModeName(ref, mode.name))
            self.modes[ref, index] = named
            universe.add("modes", atom, named)
            for each in better:
                universe.add("worse", each, named)
            better.append(named)
            self._mode(named, ref, mode, functionality)

    def _mode(self, atom: str, ref: FunctionalityRef, mode: Mode, functionality: FunctionalitySpec) -> None:
        universe = self.universe
        for assumption in mode.assumptions:
            universe.add("mode_asms", atom, self._assumption(ref, assumption))
        for port in functionality.outputs:
            guarantee = mode.guarantee(port)
            if isinstance(guarantee, Predicate):
                universe.add("mode_guars", atom, self.ports[PortRef(ref.instance, port)], universe.predicate(guarantee))

    def _assumption(self, ref: FunctionalityRef, assumption: Assumption) -> str:
        if not isinstance(assumption, InputAlternatives):
            return self.universe.predicate(assumption)
        key = f"{ref.instance}.{assumption}"
        atom = self.universe.atom("NamedInputs", f"{self.prefix}assume_{ref.instance}_{assumption}", assumption, key)
        for port in assumption.inputs:
            self.universe.add("named", atom, self.ports[PortRef(ref.instance, port)])
        return atom

    def overloads(self) -> None:
        """Dump the smallest sets of the instances declared so far that hold too much of a resource together."""
        resources = sorted({name for component in self.declared.values() for name in component.resource_usage})
        for resource in resources:
            holds = {
                name: component.resource_usage[resource]
                for name, component in sorted(self.declared.items())
                if resource in component.resource_usage
            }
            if len(holds) > _MOST_HOLDERS:
                raise TooLarge(f"{len(holds)} components hold {resource}, and at most {_MOST_HOLDERS} are tried out")
            for number, group in enumerate(_too_much(holds, self.world.capacity(resource)), start=1):
                told = f"too much {resource} together: {', '.join(group)}"
                atom = self.universe.atom("Overload", f"{self.prefix}too_much_{resource}_{number}", group, told)
                for name in group:
                    self.universe.add("holders", atom, self.components[name])

    # -- configurations -----------------------------------------------------------------------------------

    def system(self, configuration: Configuration, number: int, told: str) -> str:
        """Dump a configuration of this world; the atom."""
        universe = self.universe
        atom = universe.atom("System", f"{self.prefix}S{number}", SystemName(number, told))
        for name in sorted(configuration.instances):
            universe.add("comps", atom, self.components[name])
        for connector in self.connectors.values():
            universe.add("conns", atom, connector)
        for port, connector in sorted(configuration.attachments()):
            universe.add("roles", atom, self.connectors[connector], self.ports[port])
        for ref, index in sorted(configuration.modes.items()):
            universe.add("cur_mode", atom, self.functionalities[ref], self.modes[ref, index])
        for offer in self.offers:
            universe.add("env_guars", atom, offer)
        for publisher in self.publishers:
            universe.add("env_pubs", atom, publisher)
        return atom


def _too_much(holds: dict[str, float], capacity: float) -> Iterator[tuple[str, ...]]:
    """The smallest groups that hold more than ``capacity`` together."""
    found: list[frozenset[str]] = []
    for count in range(1, len(holds) + 1):
        for group in combinations(holds, count):
            too_much = sum(to_fraction(holds[name]) for name in group) > to_fraction(capacity)
            if too_much and not any(smaller <= set(group) for smaller in found):
                found.append(frozenset(group))
                yield group

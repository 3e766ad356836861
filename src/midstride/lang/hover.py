"""Hover texts in Markdown: contracts, modes, and the initial mode of functionalities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from midstride.lang.index import Symbol
from midstride.model.component import (
    ComponentSpec,
    ContainerProgram,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
)
from midstride.model.configuration import Configuration
from midstride.model.contract import NOTHING, connector_kind, format_number
from midstride.model.diagnosis import reasons_against
from midstride.model.rules import Evaluator
from midstride.model.specification import Specification, initial
from midstride.model.wording import KIND_WORDS, counted


def hover(symbol: Symbol, specification: Specification, *, runnable: bool) -> str | None:
    """Describe a symbol. ``runnable``: the specification has no errors, so the initial modes are known."""
    describe = getattr(_Hover(specification, initial(specification) if runnable else None), symbol.kind)
    return "\n\n".join([f"**{symbol.kind}** `{symbol.name}`", *describe(symbol)])


@dataclass(frozen=True, slots=True)
class _Hover:
    """The lines about a symbol, by a method for each kind of symbol."""

    specification: Specification
    configuration: Configuration | None

    def topic(self, symbol: Symbol) -> Iterator[str]:
        connector = self.specification.connectors.get(symbol.name)
        if connector is None:
            return
        limit = connector.max_publishers
        most = "" if limit is None else f" (at most {counted(limit, KIND_WORDS[connector.kind].provider)})"
        yield f"`{connector.guarantee}`{most}"
        if self.configuration is None:
            return
        publishers = self.configuration.publishers_on(symbol.name)
        subscribers = self.configuration.subscribers_on(symbol.name)
        words = ("published", "subscribed") if connector.kind == "topic" else ("served", "called")
        for what, ports in zip(words, (publishers, subscribers), strict=True):
            if ports:
                yield f"{what} by {', '.join(f'`{port}`' for port in sorted(ports))}"
        evaluator = Evaluator(self.configuration)
        satisfied = evaluator.connector_satisfied(symbol.name)
        yield "satisfied" if satisfied else evaluator.why_connector_unsatisfied(symbol.name)

    def component(self, symbol: Symbol) -> Iterator[str]:
        component = self.specification.components.get(symbol.name)
        if component is None:
            return
        if component.run is not None:
            yield f"`{component.run}`" + ("" if component.package is None else f" of package {component.package}")
        if (container := component.container) is not None:
            yield f"loaded by `{container.run}` of package {container.package}"
        if component.once:
            yield "ends when it has done its work"
        yield from _of_process(component)
        for name in component.input_order:
            assumption = component.inputs[name]
            yield f"{KIND_WORDS[assumption.kind].input} `{name} : {assumption}`{_tolerance(component, name)}"
        for name in component.outputs:
            owner = component.find_owner(name)
            word = KIND_WORDS[connector_kind(component.type_of(name) or "")].output
            yield f"{word} `{name} : {owner.modes[0].guarantee(name) if owner and owner.modes else NOTHING}`"
        for functionality in component:
            yield f"functionality `{functionality.name}`: {', '.join(mode.name for mode in functionality.modes)}"

    def node(self, symbol: Symbol) -> Iterator[str]:
        node = self.specification.nodes.get(symbol.name)
        if node is None or node.component not in self.specification.components:
            return
        yield f"component `{node.component}`"
        if node.container is not None:
            yield f"in the container `{node.container}`"
        if node.respawn is not None:
            yield f"respawn: {node.respawn}"
        for functionality in self.specification.components[node.component]:
            yield from self._initial_mode(FunctionalityRef(symbol.name, functionality.name))

    def _initial_mode(self, ref: FunctionalityRef) -> Iterator[str]:
        if self.configuration is None or ref not in self.configuration.modes:
            return
        yield f"`{ref}` will be in mode **{self.configuration.mode(ref).name}**"
        if self.configuration.modes[ref]:
            yield from (f"- {reason}" for reason in reasons_against(self.configuration, ref)[:3])

    def port(self, symbol: Symbol) -> Iterator[str]:
        component = self.specification.components.get(symbol.owner)
        if component is not None and symbol.name in component.inputs:
            yield f"assumes `{component.inputs[symbol.name]}`{_tolerance(component, symbol.name)}"
        elif component is not None and (owner := component.find_owner(symbol.name)) is not None:
            for mode in owner.modes:
                yield f"{mode.name}: `{mode.guarantee(symbol.name)}`"

    def functionality(self, symbol: Symbol) -> Iterator[str]:
        found = self._declared(symbol.owner, symbol.name)
        if found is None:
            return
        yield f"modes: {', '.join(mode.name for mode in found.modes)}; weight {format_number(found.weight)}"
        for role in self.specification.roles():
            if self.specification.nodes[role].component == symbol.owner:
                yield from self._initial_mode(FunctionalityRef(role, symbol.name))

    def mode(self, symbol: Symbol) -> Iterator[str]:
        component, _, name = symbol.owner.partition(".")
        found = self._declared(component, name)
        for mode in found.modes if found is not None else ():
            if mode.name == symbol.name:
                names = [str(a) if isinstance(a, InputAlternatives) else f"`{a}`" for a in mode.assumptions]
                yield f"assumes {', '.join(names) or 'nothing'}"
                for output, given in sorted(mode.guarantees.items()):
                    yield f"guarantees `{output} : {given}`"
                for parameter, value in sorted(mode.parameters.items()):
                    yield f"sets `{parameter} = {value!r}`"

    def container(self, symbol: Symbol) -> Iterator[str]:
        program = self.specification.containers.get(symbol.name)
        if program is not None:
            yield f"`{program.run}` of package {program.package}"
            yield from _of_process(program)
            yield f"loads {', '.join(f'`{role}`' for role in self.specification.members_of(symbol.name)) or 'no node'}"

    def resource(self, symbol: Symbol) -> Iterator[str]:
        for key, declared in sorted(self.specification.resources.items()):
            if declared.name == symbol.name:
                where = f"on host {declared.host}: " if declared.host else ""
                yield f"{where}capacity {format_number(declared.capacity)}"
                held = 0.0 if self.configuration is None else float(self.configuration.held.get(key, 0))
                yield f"{where}in use initially: {format_number(held)}"

    def host(self, symbol: Symbol) -> Iterator[str]:
        declared = self.specification.hosts.get(symbol.name)
        if declared is not None:
            yield f"reached as `{declared.ssh}`"
            yield from (f"sources `{file}`" for file in filter(None, [declared.setup]))
            yield f"programs run in {'the home directory' if declared.folder is None else f'`{declared.folder}`'}"
            roles = [role for role, node in sorted(self.specification.nodes.items()) if node.host == symbol.name]
            yield f"runs {', '.join(f'`{role}`' for role in roles) or 'no node'}"

    def guarantee(self, symbol: Symbol) -> Iterator[str]:
        for offer in self.specification.environment:
            if offer.name == symbol.name:
                yield f"`{offer.guarantee}`" + ("" if offer.topic is None else f" on `{offer.topic}`")

    def parameter(self, symbol: Symbol) -> Iterator[str]:
        component = self.specification.components.get(symbol.owner)
        declared = None if component is None else component.parameters.get(symbol.name)
        if declared is not None:
            yield f"`{declared.value!r}`" + (", changeable in place" if declared.changeable else "")

    def _declared(self, component: str, functionality: str) -> FunctionalitySpec | None:
        found = self.specification.components.get(component)
        return None if found is None else found.functionalities.get(functionality)


def _tolerance(component: ComponentSpec, name: str) -> str:
    missed = component.tolerates.get(name)
    tolerance = "" if missed is None else f", tolerates {missed} missed"
    return f"{tolerance}, a condition" if name in component.conditions else tolerance


def _of_process(stated: ComponentSpec | ContainerProgram) -> Iterator[str]:
    if stated.prefix is not None:
        yield f"after `{stated.prefix}`"
    for name, value in stated.environment.items():
        yield f"without the variable `{name}`" if value is None else f"with `{name}={value}`"

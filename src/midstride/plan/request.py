"""What is asked for: roles to replace, add and remove, or a whole specification to change to."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.component import ComponentSpec
from midstride.model.diagnostics import Problem
from midstride.model.specification import Node, Specification
from midstride.model.specification_checks import check, check_component, check_node, errors

# How many names are listed where none is near the one that is not there.
SHOWN: Final = 10


@dataclass(frozen=True, slots=True)
class Request:
    """A change asked for. ``components`` are further declarations that the specification does not have yet."""

    replace: tuple[tuple[str, str], ...] = ()
    add: tuple[Node, ...] = ()
    remove: tuple[str, ...] = ()
    to: Specification | None = None
    components: tuple[ComponentSpec, ...] = ()
    strategy: str = "minimal"

    def target(self, specification: Specification) -> Specification:
        """The specification to change to. Raises PlanRefused, naming what is not there and what is."""
        if self.to is not None:
            if self.replace or self.add or self.remove:
                raise PlanRefused("ask either for a whole specification or for single changes, not for both")
            _well_formed(check(self.to))
            return self.to
        if not (self.replace or self.add or self.remove):
            raise PlanRefused("nothing is asked for: name nodes to replace, add or remove, or a specification")
        named = [*self.remove, *(role for role, _ in self.replace)]
        for index, role in enumerate(named):
            if role in named[:index]:
                raise PlanRefused(f"node {role} is named twice: say once what is to become of it")
        target = specification
        for component in self.components:
            _well_formed(check_component(component), f"component {component.name}: ")
            known = target.components.get(component.name)
            if known is not None and known != component:
                raise PlanRefused(
                    f"component {component.name} is declared already, and otherwise; give it another name"
                )
            target = replace(target, components=target.components.set(component.name, component))
        for role in self.remove:
            _known(role, target.nodes, "node")
            target = target.without_node(role)
        for role, name in self.replace:
            _known(role, target.nodes, "node")
            _known(name, target.components, "component")
            target = _replaced(target, role, name)
        for node in self.add:
            if node.role in target.nodes:
                raise PlanRefused(f"there is a node {node.role} already; replace it, or choose another name")
            target = _added(target, node)
        for role in (*(role for role, _ in self.replace), *(node.role for node in self.add)):
            # Whether the contracts fit is said by the change itself, of the instances concerned.
            _well_formed(problem for problem in check_node(target, role) if problem.code != "E020")
        return target

    def describe(self) -> str:
        """What is to change, in the words of the commands that would do it."""
        words = [f"remove {role}" for role in self.remove]
        words += [f"replace {role} by {component}" for role, component in self.replace]
        words += [f"add {node.role} ({node.component})" for node in self.add]
        if self.to is not None:
            words.append(f"apply {self.to.name}")
        return ", ".join(words) or "nothing"


def _well_formed(problems: Iterable[Problem], of: str = "") -> None:
    if found := errors(problems):
        raise PlanRefused("; ".join(f"{of}{problem}" for problem in found))


def _known(name: str, names: Iterable[str], kind: str, of: str = "") -> None:
    if name in names:
        return
    every = sorted(names)
    near = difflib.get_close_matches(name, every, n=1)
    more = f" and {len(every) - SHOWN} more" if len(every) > SHOWN else ""
    hint = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(every[:SHOWN]) or 'none'}{more}"
    raise PlanRefused(f"there is no {kind} {name}{of}{hint}")


def _replaced(target: Specification, role: str, name: str) -> Specification:
    node, component = target.nodes[role], target.components[name]
    ports = set(component.ports())
    missing = sorted(port for port in node.attachments if port not in ports)
    if missing:
        told = ", ".join(f"{port} (on {', '.join(node.attachments[port])})" for port in missing)
        raise PlanRefused(f"{name} cannot play {role}: it has no port {told}; use `apply` with a changed specification")
    parameters = Map({key: value for key, value in node.parameters.items() if key in component.parameters})
    return target.with_node(replace(node, component=name, parameters=parameters))


def _added(target: Specification, node: Node) -> Specification:
    _known(node.component, target.components, "component")
    component = target.components[node.component]
    for port, names in node.attachments.items():
        _known(port, component.ports(), "port", f" of {node.component}")
        for name in names:
            _known(name, target.connectors, "topic")
    for name in node.parameters:
        _known(name, component.parameters, "parameter", f" of {node.component}")
    return target.with_node(node)

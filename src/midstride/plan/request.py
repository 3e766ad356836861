"""What is asked for: roles to replace, add and remove, or a whole specification to change to."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from immutables import Map

from midstride.errors import PlanRefused, SpecificationError
from midstride.model.component import ComponentSpec
from midstride.model.diagnostics import Problem
from midstride.model.document import (
    component_from_document,
    component_to_document,
    specification_from_document,
    specification_to_document,
)
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

    def to_document(self) -> dict[str, Any]:
        return {
            "replace": [list(pair) for pair in self.replace],
            "add": [
                {
                    "role": node.role,
                    "component": node.component,
                    "attachments": {port: list(names) for port, names in node.attachments.items()},
                    "parameters": dict(node.parameters),
                }
                for node in self.add
            ],
            "remove": list(self.remove),
            "to": None if self.to is None else specification_to_document(self.to),
            "components": [component_to_document(component) for component in self.components],
            "strategy": self.strategy,
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Request:
        """Raises SpecificationError where the document is no request."""
        unknown = set(document) - {"replace", "add", "remove", "to", "components", "strategy"}
        if unknown:
            raise SpecificationError(f"/: unknown key {sorted(unknown)[0]!r}")
        try:
            to = document.get("to")
            return cls(
                replace=tuple((str(role), str(name)) for role, name in document.get("replace") or ()),
                add=tuple(_node(entry) for entry in document.get("add") or ()),
                remove=tuple(str(role) for role in document.get("remove") or ()),
                to=None if to is None else specification_from_document(to),
                components=tuple(component_from_document(entry) for entry in document.get("components") or ()),
                strategy=str(document.get("strategy") or "minimal"),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise SpecificationError(f"not a request for a change ({type(error).__name__}: {error})") from None


def _node(entry: Mapping[str, Any]) -> Node:
    attachments = {
        str(port): tuple([names] if isinstance(names, str) else names)
        for port, names in (entry.get("attachments") or {}).items()
    }
    return Node(str(entry["role"]), str(entry["component"]), Map(attachments), Map(entry.get("parameters") or {}))


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

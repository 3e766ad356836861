"""A request for a change: roles to replace, add and remove, or a whole specification to change to."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from immutables import Map

from midstride.errors import PlanRefused, SpecificationError
from midstride.model.component import ComponentSpec
from midstride.model.diagnostics import Problem, suggestion, unknown_name
from midstride.model.document import (
    component_from_document,
    component_to_document,
    specification_from_document,
    specification_to_document,
)
from midstride.model.specification import Node, Specification
from midstride.model.specification_checks import check, check_component, check_node, errors


@dataclass(frozen=True, slots=True)
class Request:
    """A request for a change. ``components`` are declarations that the specification does not have yet."""

    replace: tuple[tuple[str, str], ...] = ()
    add: tuple[Node, ...] = ()
    remove: tuple[str, ...] = ()
    to: Specification | None = None
    components: tuple[ComponentSpec, ...] = ()
    strategy: str = "minimal"

    def target(self, specification: Specification) -> Specification:
        """The specification to change to. Raises PlanRefused for an unknown name or a malformed declaration."""
        if self.to is not None:
            if self.replace or self.add or self.remove:
                raise PlanRefused("give either a whole specification or single changes, not both")
            _well_formed(check(self.to))
            return self.to
        if not (self.replace or self.add or self.remove):
            raise PlanRefused("the request is empty: name nodes to replace, add or remove, or give a specification")
        named = [*self.remove, *(role for role, _ in self.replace)]
        for index, role in enumerate(named):
            if role in named[:index]:
                raise PlanRefused(f"node {role} is named twice; name each node once")
        target = specification
        for component in self.components:
            _well_formed(check_component(component), f"component {component.name}: ")
            known = target.components.get(component.name)
            if known is not None and known != component:
                raise PlanRefused(f"component {component.name} is already declared differently; give it another name")
            target = replace(target, components=target.components.set(component.name, component))
        for role in self.remove:
            require("node", role, target.nodes)
            target = target.without_node(role)
        for role, name in self.replace:
            require("node", role, target.nodes)
            require("component", name, target.components)
            target = _replaced(target, role, name)
        for node in self.add:
            if node.role in target.nodes:
                raise PlanRefused(f"node {node.role} already exists; replace it, or choose another name")
            target = target.with_node(node)
        for role in (*(role for role, _ in self.replace), *(node.role for node in self.add)):
            # Whether the contracts fit is checked by the change itself, for the instances concerned.
            _well_formed(problem for problem in check_node(target, role) if problem.code != "E020")
        return target

    def describe(self) -> str:
        """The change in the words of the commands that ask for it."""
        words = [f"remove {role}" for role in self.remove]
        words += [f"replace {role} with {component}" for role, component in self.replace]
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


def require(kind: str, name: str, known: Collection[str]) -> None:
    """Raises PlanRefused, with a suggestion, where ``name`` is not known."""
    if name not in known:
        hint = suggestion(name, known)
        raise PlanRefused(unknown_name(kind, name) + (f"; {hint}" if hint else ""))


def _replaced(target: Specification, role: str, name: str) -> Specification:
    node, component = target.nodes[role], target.components[name]
    missing = sorted(set(node.attachments) - set(component.ports()))
    if missing:
        ports_on = ", ".join(f"{port} (on {', '.join(node.attachments[port])})" for port in missing)
        raise PlanRefused(
            f"{name} cannot replace {role}: it has no port {ports_on}; use `apply` with a changed specification"
        )
    parameters = Map({key: value for key, value in node.parameters.items() if key in component.parameters})
    return target.with_node(replace(node, component=name, parameters=parameters))

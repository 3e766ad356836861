"""Maps the subjects of the model's problems to places in the text.

A subject is a path in the JSON form (``components``, ``Talker``, ``outputs``, ``0``); its place is the most specific
part of the declaration that the path identifies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from midstride.lang import syntax
from midstride.lang.declarations import Declarations
from midstride.lang.source import Span
from midstride.model.diagnostics import Problem

Subject = Sequence[str]


class SourceMap:
    """Finds where the subject of a problem is declared."""

    def __init__(
        self,
        declarations: Declarations,
        merged: Mapping[str, syntax.ComponentDeclaration],
        parameters: Mapping[tuple[str, str], Span],
    ) -> None:
        self.declarations = declarations
        self.merged = merged
        self.parameters = parameters

    def span_of(self, problem: Problem) -> Span | None:
        """The place of a problem's subject; None if the text has none."""
        subject, found = problem.subject, self.declarations
        kind, name, rest = (*subject, "", "")[0], (*subject, "", "")[1], subject[2:]
        if kind == "components" and name in self.merged:
            return self._component(self.merged[name], rest)
        if kind == "nodes" and name in found.nodes:
            return self._node(name, rest)
        if kind == "topics" and name in found.topics:
            topic = found.topics[name]
            if rest[:1] == ("max_publishers",) and topic.max_publishers is not None:
                return topic.max_publishers.span
            return topic.name.span if not rest or topic.contract is None else _contract(topic.contract, rest)
        if kind == "environment" and name in found.offers:
            offer = found.offers[name].declaration
            if rest[:1] == ("topic",) and offer.topic is not None:
                return offer.topic.span
            return offer.name.span if not rest or offer.contract is None else _contract(offer.contract, rest[1:])
        if kind == "resources" and name in found.resources:
            resource = found.resources[name]
            return resource.name.span if resource.capacity is None or not rest else resource.capacity.span
        if kind == "constraints" and name.isdecimal() and int(name) < len(found.constraints):
            return self._constraint(int(name), rest, problem)
        if kind == "timing_seconds" and name in found.timing:
            return found.timing[name].kind.span
        return None if found.system is None else found.system.span

    def _component(self, declaration: syntax.ComponentDeclaration, rest: Subject) -> Span:
        kind, name, inner = (*rest, "", "")[0], (*rest, "", "")[1], rest[2:]
        if kind == "run" and declaration.runs:
            return declaration.runs[0].command.span
        if kind == "takes_seconds" and declaration.runs and declaration.runs[0].startup is not None:
            return declaration.runs[0].startup.span
        if kind == "holds":
            held = next((h for statement in declaration.holds for h in statement if h.resource.text == name), None)
            if held is not None:
                return held.resource.span
        if kind == "parameters":
            entry = next((entry for entry in declaration.parameters if entry.name.text == name), None)
            if entry is not None:
                return entry.name.span
        if kind == "inputs":
            port = next((port for port in declaration.inputs if port.name.text == name), None)
            if port is not None:
                return port.name.span if not inner or port.contract is None else _contract(port.contract, inner)
        if kind == "outputs" and name.isdecimal() and int(name) < len(declaration.outputs):
            return declaration.outputs[int(name)].span
        if kind == "functionalities":
            functionality = next((f for f in declaration.functionalities if f.name.text == name), None)
            if functionality is not None:
                return _functionality(functionality, inner)
        return declaration.name.span

    def _node(self, role: str, rest: Subject) -> Span:
        declaration = self.declarations.nodes[role].declaration
        kind, name, inner = (*rest, "", "")[0], (*rest, "", "")[1], rest[2:]
        if kind == "component" and declaration.component is not None:
            return declaration.component.span
        if kind == "parameters":
            return self.parameters.get((role, name), declaration.name.span)
        if kind == "attachments":
            attachments = [attachment for attachment in declaration.attachments if attachment.port.text == name]
            topics = [topic for attachment in attachments for topic in attachment.topics]
            if inner and inner[0].isdecimal() and int(inner[0]) < len(topics):
                return topics[int(inner[0])].span
            if attachments:
                return attachments[0].port.span
        return declaration.name.span

    def _constraint(self, index: int, rest: Subject, problem: Problem) -> Span:
        statement = self.declarations.constraints[index].statement
        key = (*rest, "")[0]
        if isinstance(statement, syntax.OrderStatement):
            return {"order": statement.first.span, "before": statement.then.span}.get(key, statement.span)
        if key in {"keep", "limit"}:
            of_node = problem.declared[:1] == ("nodes",)
            return statement.functionality.role.span if of_node else statement.functionality.functionality.span
        if isinstance(statement, syntax.KeepStatement) and key == "at":
            return statement.mode.span
        if isinstance(statement, syntax.LimitStatement) and key == "below_baseline_seconds":
            return statement.seconds.span
        return statement.span


def _functionality(declaration: syntax.FunctionalityDeclaration, rest: Subject) -> Span:
    kind, name, inner = (*rest, "", "")[0], (*rest, "", "")[1], rest[2:]
    if kind == "weight" and declaration.weight is not None:
        return declaration.weight.span
    if kind == "uses":
        return _nth(declaration.uses, name, declaration.name.span)
    if kind == "produces":
        return _nth(declaration.produces, name, declaration.name.span)
    if kind == "modes":
        mode = next((mode for mode in declaration.modes if mode.name.text == name), None)
        if mode is not None:
            return _mode(mode, inner)
    return declaration.name.span


def _mode(mode: syntax.ModeDeclaration, rest: Subject) -> Span:
    kind, name, inner = (*rest, "", "")[0], (*rest, "", "")[1], rest[2:]
    if kind == "assumes" and name.isdecimal() and int(name) < len(mode.assumptions):
        assumption = mode.assumptions[int(name)]
        if isinstance(assumption, syntax.NamedAssumption):
            return _nth(assumption.inputs, (*inner, "", "")[1], assumption.span)
        return _contract(assumption, inner)
    if kind == "guarantees":
        guarantee = next((guarantee for guarantee in mode.guarantees if guarantee.output.text == name), None)
        if guarantee is not None:
            return (
                guarantee.output.span
                if not inner or guarantee.contract is None
                else _contract(guarantee.contract, inner)
            )
    return mode.name.span


def _nth(names: Sequence[syntax.Name], index: str, otherwise: Span) -> Span:
    return names[int(index)].span if index.isdecimal() and int(index) < len(names) else otherwise


def _contract(contract: syntax.ContractExpression, rest: Subject) -> Span:
    kind, name = (*rest, "", "")[:2]
    if kind == "rate" and contract.rate is not None:
        return contract.rate.span
    if kind == "qos" and contract.qos:
        policy = next((p for p in contract.qos if name.startswith(p.name.text)), contract.qos[0])
        return policy.value.span
    if kind == "where":
        constraint = next((c for c in contract.where if c.path.text == name), None)
        if constraint is not None:
            return constraint.span
    return contract.span

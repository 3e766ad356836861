"""Validity, the safety property: every functionality has what its current mode assumes.

A topic is satisfied while a publisher guarantees enough on it, an input while a topic it is attached to is, a
functionality while every assumption of its current mode is. A configuration is *valid* if that holds of every
functionality, and no publisher cap or resource capacity is exceeded (docs/semantics.md section 3; the paper's
section 4.1). An :class:`Evaluator` looks at one connector, input or functionality and its neighbours, never at the
whole system; only :func:`violations` walks everything.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Connector,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    PortRef,
)
from midstride.model.configuration import Configuration, to_fraction
from midstride.model.contract import Contract, explain, format_number, satisfies
from midstride.model.wording import KIND_WORDS, indefinite

_SHOWN = 8  # how many names a message lists


@dataclass(frozen=True, slots=True)
class Violation:
    """One reason why a configuration is not valid, as data and (``str``) in words.

    ``names`` are the functionalities, ports, topics or resources concerned.
    """

    kind: Literal["assumption", "attachment", "cap", "capacity"]
    subject: str
    because: str
    names: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.subject}: {self.because}"


class Evaluator:
    """Evaluates one configuration; ``overlay`` holds modes to assume instead of the current ones."""

    __slots__ = ("configuration", "modes", "overlay")

    def __init__(self, configuration: Configuration, overlay: Mapping[FunctionalityRef, int] | None = None) -> None:
        self.configuration = configuration
        self.modes = configuration.modes
        self.overlay: Mapping[FunctionalityRef, int] = {} if overlay is None else overlay

    def mode_index(self, ref: FunctionalityRef) -> int:
        index = self.overlay.get(ref)
        return self.modes[ref] if index is None else index

    def guarantee(self, output: PortRef) -> Contract:
        """The guarantee of a live output in the mode of its owner."""
        owner = self.configuration.component(output.instance).owner(output.port)
        return owner.modes[self.mode_index(FunctionalityRef(output.instance, owner.name))].guarantee(output.port)

    def connector_satisfied(self, name: str) -> bool:
        connector = self.configuration.context.connectors.get(name)
        if connector is None:
            return False
        needed, environment = connector.guarantee, self.configuration.context.publishers_out_of_scope(connector)
        return any(satisfies(offer.guarantee, needed) for offer in environment) or self._published(name, needed)

    def _published(self, name: str, needed: Contract) -> bool:
        """Return whether an attached output satisfies the connector."""
        return any(satisfies(self.guarantee(output), needed) for output in self.configuration.publishers_on(name))

    def input_satisfied(self, port: PortRef) -> bool:
        assumption = self.configuration.component(port.instance).inputs[port.port]
        connectors = self.configuration.context.connectors
        return any(
            satisfies(connectors[name].guarantee, assumption) and self.connector_satisfied(name)
            for name in self.configuration.connectors_of.get(port, ())
            if name in connectors
        )

    def assumption_satisfied(
        self, ref: FunctionalityRef, functionality: FunctionalitySpec, assumption: Assumption
    ) -> bool:
        if isinstance(assumption, InputAlternatives):
            return any(self.input_satisfied(PortRef(ref.instance, name)) for name in assumption.inputs)
        inputs = self.configuration.component(ref.instance).inputs
        for name in functionality.inputs:
            if satisfies(inputs[name], assumption) and self.input_satisfied(PortRef(ref.instance, name)):
                return True
        return any(satisfies(offer.guarantee, assumption) for offer in self.configuration.context.offers())

    def mode_satisfied(self, ref: FunctionalityRef, index: int) -> bool:
        """Return whether every assumption of ``ref``'s mode ``index`` is satisfied."""
        functionality = self.configuration.functionality(ref)
        return all(self.assumption_satisfied(ref, functionality, a) for a in functionality.modes[index].assumptions)

    def satisfied(self, ref: FunctionalityRef) -> bool:
        """Return whether every assumption of the mode that ``ref`` is in is satisfied."""
        return self.mode_satisfied(ref, self.mode_index(ref))

    def best_satisfied_mode(self, ref: FunctionalityRef, start: int) -> int:
        """The best mode from ``start`` on that is satisfied; the last one always is (rule M1)."""
        last = self.configuration.functionality(ref).last_mode
        return next((index for index in range(start, last) if self.mode_satisfied(ref, index)), last)

    # -- the same, with reasons ----------------------------------------------------------------------

    def why_connector_unsatisfied(self, name: str) -> str:
        connector = self.configuration.context.connectors.get(name)
        if connector is None:
            return f"{name} is not declared in this system"
        shortfalls = []
        for output in sorted(self.configuration.publishers_on(name)):
            owner = self.configuration.component(output.instance).owner(output.port)
            mode = owner.modes[self.mode_index(FunctionalityRef(output.instance, owner.name))]
            clauses = explain(mode.guarantee(output.port), connector.guarantee)
            shortfalls.append(f"{output} in mode {mode.name}: {', '.join(clauses)}")
        for offer in self.configuration.context.publishers_out_of_scope(connector):
            shortfalls.append(f"environment {offer.name}: {', '.join(explain(offer.guarantee, connector.guarantee))}")
        provider = KIND_WORDS[connector.kind].provider
        return (
            f"no {provider} satisfies {name} ({'; '.join(shortfalls)})" if shortfalls else f"{name} has no {provider}"
        )

    def why_input_unsatisfied(self, port: PortRef) -> str:
        attached = self.configuration.attached_to(port)
        assumption = self.configuration.component(port.instance).inputs[port.port]
        words = KIND_WORDS[assumption.kind]
        if not attached:
            return f"{words.input} {port} is not attached to any {words.connector}"
        reasons = []
        for name in attached:
            connector = self.configuration.context.connectors.get(name)
            if connector is not None and not satisfies(connector.guarantee, assumption):
                clauses = ", ".join(explain(connector.guarantee, assumption))
                reasons.append(f"{name} does not satisfy what {words.input} {port} assumes ({clauses})")
            else:
                reasons.append(self.why_connector_unsatisfied(name))
        return "; ".join(reasons)

    def why_assumption_unsatisfied(self, ref: FunctionalityRef, assumption: Assumption) -> str:
        """The reasons, from the assumption down to the contract that falls short."""
        if isinstance(assumption, InputAlternatives):
            reasons = [self.why_input_unsatisfied(PortRef(ref.instance, name)) for name in assumption.inputs]
            return f"assumes {assumption}: " + "; ".join(reasons)
        functionality = self.configuration.functionality(ref)
        inputs = self.configuration.component(ref.instance).inputs
        reasons = []
        for name in functionality.inputs:
            if satisfies(inputs[name], assumption):
                reasons.append(self.why_input_unsatisfied(PortRef(ref.instance, name)))
            else:
                clauses = ", ".join(explain(inputs[name], assumption))
                word = KIND_WORDS[inputs[name].kind].input
                reasons.append(f"{word} {ref.instance}.{name} does not satisfy it ({clauses})")
        if not reasons:
            reasons.append(
                f"{ref} uses no {KIND_WORDS[assumption.kind].input}, and the environment does not guarantee it"
            )
        return f"assumes {assumption}: " + "; ".join(reasons)

    def violations_of(self, refs: Iterable[FunctionalityRef]) -> Iterator[Violation]:
        """The unsatisfied assumptions of ``refs``."""
        for ref in sorted(set(refs)):
            functionality = self.configuration.functionality(ref)
            mode = functionality.modes[self.mode_index(ref)]
            for assumption in mode.assumptions:
                if not self.assumption_satisfied(ref, functionality, assumption):
                    because = self.why_assumption_unsatisfied(ref, assumption)
                    names = (str(ref), *self._concerned(ref, functionality, assumption))
                    yield Violation("assumption", f"{ref} in mode {mode.name}", because, names)

    def _concerned(self, ref: FunctionalityRef, functionality: FunctionalitySpec, assumption: Assumption) -> list[str]:
        """The ports and topics that an assumption depends on: its inputs, their topics, and the publishers there."""
        inputs = assumption.inputs if isinstance(assumption, InputAlternatives) else functionality.inputs
        ports = [PortRef(ref.instance, name) for name in inputs]
        topics = [name for port in ports for name in self.configuration.attached_to(port)]
        publishers = [port for name in topics for port in sorted(self.configuration.publishers_on(name))[:_SHOWN]]
        return list(dict.fromkeys([*map(str, ports), *topics, *map(str, publishers)]))


def publishers_count(configuration: Configuration, connector: str) -> int:
    """The number of publishers that count against the connector's cap: attached outputs, and the environment's."""
    declared = configuration.context.connectors[connector]
    return len(configuration.publishers_on(connector)) + len(configuration.context.publishers_out_of_scope(declared))


def cap_violation(configuration: Configuration, connector: str) -> Violation | None:
    declared = configuration.context.connectors.get(connector)
    if declared is None or declared.max_publishers is None:
        return None
    count = publishers_count(configuration, connector)
    if count <= declared.max_publishers:
        return None
    names = [f"environment {offer.name}" for offer in configuration.context.publishers_out_of_scope(declared)]
    names += [str(port) for port in sorted(configuration.publishers_on(connector))]
    because = (
        f"{count} {KIND_WORDS[declared.kind].provider}s ({_listed(names)}), at most {declared.max_publishers} allowed"
    )
    return Violation("cap", connector, because, (connector, *names[:_SHOWN]))


def capacity_violation(configuration: Configuration, resource: str) -> Violation | None:
    held, capacity = configuration.held.get(resource), configuration.context.capacity(resource)
    if held is None or held <= to_fraction(capacity):
        return None
    holders = sorted(configuration.holders[resource])
    because = f"{format_number(float(held))} held by {_listed(holders)}, but the capacity is {format_number(capacity)}"
    return Violation("capacity", f"resource {resource}", because, (resource, *holders[:_SHOWN]))


def _listed(names: list[str]) -> str:
    rest = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {rest} more" if rest > 0 else "")


def violations(configuration: Configuration) -> list[Violation]:
    """Every reason why ``configuration`` is not valid (docs/semantics.md section 3). Walks the system."""
    found: list[Violation] = []
    for port, connector in sorted(configuration.attachments()):
        if not configuration.has_port(port):
            because = f"{port} is not a port of a live component"
        elif connector not in configuration.context.connectors:
            kind = KIND_WORDS[configuration.component(port.instance).kind_of(port.port)].connector
            because = f"{connector} is not {indefinite(kind)} of this system"
        else:
            continue
        found.append(Violation("attachment", f"{port} on {connector}", because, (str(port), connector)))
    found += Evaluator(configuration).violations_of(configuration.modes)
    limits = [cap_violation(configuration, name) for name in sorted(configuration.context.connectors)]
    limits += [capacity_violation(configuration, name) for name in sorted(configuration.held)]
    return [*found, *(violation for violation in limits if violation is not None)]


def normal_guarantee(component: ComponentSpec, output: str) -> Contract:
    """The guarantee of ``output`` in the normal mode of its owner."""
    return component.owner(output).modes[0].guarantee(output)


def attachment_shortfall(component: ComponentSpec, port: PortRef, connector: Connector) -> tuple[str, list[str]]:
    """The side that falls short if ``port`` is attached to ``connector``, in words, and the clauses (none: it fits).

    The normal mode of an output must satisfy the connector, the connector what an input assumes.
    """
    if port.port in component.inputs:
        clauses = explain(connector.guarantee, component.inputs[port.port])
        return f"{connector.name} does not satisfy what {port} assumes", clauses
    clauses = explain(normal_guarantee(component, port.port), connector.guarantee)
    return f"{port} in mode {component.owner(port.port).modes[0].name} does not satisfy {connector.name}", clauses

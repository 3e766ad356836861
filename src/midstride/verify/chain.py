"""The chain from an assumption down to its unmet cause: the data of a violation's diagram."""

from __future__ import annotations

from midstride.model.component import Assumption, FunctionalityRef, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import explain, satisfies
from midstride.model.rules import Evaluator
from midstride.model.wording import KIND_WORDS
from midstride.verify.verdict import CauseLink


def chain(configuration: Configuration, ref: FunctionalityRef, assumption: Assumption) -> CauseLink:
    """From a live functionality through one of its assumptions, its inputs and their topics to the publishers."""
    evaluator = Evaluator(configuration)
    functionality = configuration.functionality(ref)
    holds = evaluator.assumption_satisfied(ref, functionality, assumption)
    ports = assumption.inputs if isinstance(assumption, InputAlternatives) else functionality.inputs
    under = [_input(evaluator, PortRef(ref.instance, port), assumption) for port in ports]
    if not isinstance(assumption, InputAlternatives):
        under += [
            CauseLink("environment", offer.name, str(offer.guarantee), satisfies(offer.guarantee, assumption))
            for offer in configuration.context.offers()
        ]
    named = CauseLink("assumption", f"assumes {assumption}", "", holds, tuple(under))
    return CauseLink("functionality", str(ref), f"in mode {configuration.mode(ref).name}", holds, (named,))


def _input(evaluator: Evaluator, port: PortRef, assumption: Assumption) -> CauseLink:
    configuration = evaluator.configuration
    needed = configuration.component(port.instance).inputs[port.port]
    detail = str(needed)
    counts = isinstance(assumption, InputAlternatives) or satisfies(needed, assumption)
    if not counts:
        detail += ": does not satisfy the assumption"
    topics = tuple(_topic(evaluator, name, port) for name in configuration.attached_to(port))
    if not topics:
        detail += ": not attached"
    return CauseLink("input", str(port), detail, counts and evaluator.input_satisfied(port), topics)


def _topic(evaluator: Evaluator, name: str, port: PortRef) -> CauseLink:
    configuration = evaluator.configuration
    connector = configuration.context.connectors.get(name)
    if connector is None:
        return CauseLink("topic", name, "not a topic of this system", False)
    clauses = explain(connector.guarantee, configuration.component(port.instance).inputs[port.port])
    publishers = []
    for output in sorted(configuration.publishers_on(name)):
        owner = configuration.component(output.instance).owner(output.port)
        mode = owner.modes[evaluator.mode_index(FunctionalityRef(output.instance, owner.name))]
        guarantee = evaluator.guarantee(output)
        satisfied = satisfies(guarantee, connector.guarantee)
        publishers.append(CauseLink("output", str(output), f"in mode {mode.name}: {guarantee}", satisfied))
    for offer in configuration.context.publishers_out_of_scope(connector):
        satisfied = satisfies(offer.guarantee, connector.guarantee)
        publishers.append(CauseLink("environment", offer.name, str(offer.guarantee), satisfied))
    detail = f"{connector.guarantee}" + (f": {', '.join(clauses)}" if clauses else "")
    if not publishers:
        detail += f": no {KIND_WORDS[connector.kind].provider}"
    return CauseLink("topic", name, detail, not clauses and evaluator.connector_satisfied(name), tuple(publishers))

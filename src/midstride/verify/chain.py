"""The chain from an assumption down to what falls short, link by link: the data of a violation's picture."""

from __future__ import annotations

from midstride.model.component import Assumption, FunctionalityRef, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import explain, satisfies
from midstride.model.rules import Evaluator
from midstride.verify.verdict import CauseLink


def chain(configuration: Configuration, ref: FunctionalityRef, assumption: Assumption) -> CauseLink:
    """From a live functionality, by one of its assumptions, its inputs and their topics, to whoever publishes there."""
    judge = Evaluator(configuration)
    functionality = configuration.functionality(ref)
    holds = judge.assumption_satisfied(ref, functionality, assumption)
    ports = assumption.inputs if isinstance(assumption, InputAlternatives) else functionality.inputs
    under = [_input(judge, PortRef(ref.instance, port), assumption) for port in ports]
    if not isinstance(assumption, InputAlternatives):
        under += [
            CauseLink("environment", offer.name, str(offer.guarantee), satisfies(offer.guarantee, assumption))
            for offer in configuration.context.offers()
        ]
    named = CauseLink("assumption", f"assumes {assumption}", "", holds, tuple(under))
    return CauseLink("functionality", str(ref), f"in mode {configuration.mode(ref).name}", holds, (named,))


def _input(judge: Evaluator, port: PortRef, assumption: Assumption) -> CauseLink:
    configuration = judge.configuration
    needed = configuration.component(port.instance).inputs[port.port]
    told = str(needed)
    counts = isinstance(assumption, InputAlternatives) or satisfies(needed, assumption)
    if not counts:
        told += ": not what is assumed"
    topics = tuple(_topic(judge, name, port) for name in configuration.attached_to(port))
    if not topics:
        told += ": not attached"
    return CauseLink("input", str(port), told, counts and judge.input_satisfied(port), topics)


def _topic(judge: Evaluator, name: str, port: PortRef) -> CauseLink:
    configuration = judge.configuration
    connector = configuration.context.connectors.get(name)
    if connector is None:
        return CauseLink("topic", name, "not a topic of this system", False)
    clauses = explain(connector.guarantee, configuration.component(port.instance).inputs[port.port])
    publishers = []
    for output in sorted(configuration.publishers_on(name)):
        owner = configuration.component(output.instance).owner(output.port)
        mode = owner.modes[judge.mode_index(FunctionalityRef(output.instance, owner.name))]
        guarantee = judge.guarantee(output)
        good = satisfies(guarantee, connector.guarantee)
        publishers.append(CauseLink("output", str(output), f"in mode {mode.name}: {guarantee}", good))
    for offer in configuration.context.publishers_out_of_scope(connector):
        good = satisfies(offer.guarantee, connector.guarantee)
        publishers.append(CauseLink("environment", offer.name, str(offer.guarantee), good))
    told = f"{connector.guarantee}" + (f": {', '.join(clauses)}" if clauses else "")
    if not publishers:
        told += ": nobody publishes"
    return CauseLink("topic", name, told, not clauses and judge.connector_satisfied(name), tuple(publishers))

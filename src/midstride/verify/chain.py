"""The chain from an assumption down to what falls short, link by link: the data of a violation's picture."""

from __future__ import annotations

from midstride.model.component import Assumption, FunctionalityRef, NamedInputs, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import explain, satisfies
from midstride.model.rules import Judge
from midstride.verify.verdict import Link


def chain(s: Configuration, ref: FunctionalityRef, assumption: Assumption) -> Link:
    """From a live functionality, by one of its assumptions, its inputs and their topics, to whoever publishes there."""
    judge = Judge(s)
    functionality = s.functionality(ref)
    holds = judge.assumption_satisfied(ref, functionality, assumption)
    ports = assumption.inputs if isinstance(assumption, NamedInputs) else functionality.inputs
    under = [_input(judge, PortRef(ref.component, port), assumption) for port in ports]
    if not isinstance(assumption, NamedInputs):
        under += [
            Link("environment", offer.name, str(offer.guarantee), satisfies(offer.guarantee, assumption))
            for offer in s.world.offers()
        ]
    named = Link("assumption", f"assumes {assumption}", "", holds, tuple(under))
    return Link("functionality", str(ref), f"in mode {s.mode(ref).name}", holds, (named,))


def _input(judge: Judge, port: PortRef, assumption: Assumption) -> Link:
    s = judge.s
    needed = s.component(port.component).inputs[port.port]
    told = str(needed)
    counts = isinstance(assumption, NamedInputs) or satisfies(needed, assumption)
    if not counts:
        told += ": not what is assumed"
    topics = tuple(_topic(judge, name, port) for name in s.attached_to(port))
    if not topics:
        told += ": not attached"
    return Link("input", str(port), told, counts and judge.input_satisfied(port), topics)


def _topic(judge: Judge, name: str, port: PortRef) -> Link:
    s = judge.s
    connector = s.world.connectors.get(name)
    if connector is None:
        return Link("topic", name, "not a topic of this system", False)
    clauses = explain(connector.guarantee, s.component(port.component).inputs[port.port])
    publishers = []
    for output in sorted(s.publishers_on(name)):
        owner = s.component(output.component).owner(output.port)
        mode = owner.modes[judge.mode_index(FunctionalityRef(output.component, owner.name))]
        guarantee = judge.guarantee(output)
        good = satisfies(guarantee, connector.guarantee)
        publishers.append(Link("output", str(output), f"in mode {mode.name}: {guarantee}", good))
    for offer in s.world.publishers_out_of_scope(connector):
        good = satisfies(offer.guarantee, connector.guarantee)
        publishers.append(Link("environment", offer.name, str(offer.guarantee), good))
    told = f"{connector.guarantee}" + (f": {', '.join(clauses)}" if clauses else "")
    if not publishers:
        told += ": nobody publishes"
    return Link("topic", name, told, not clauses and judge.connector_satisfied(name), tuple(publishers))

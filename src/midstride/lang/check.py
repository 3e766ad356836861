"""From the files of a system to its specification, or to all that is wrong with it.

What a text can do wrong is found here; what must hold of a specification however it is written is judged by
:mod:`midstride.model.specification_checks` on all that could be built, and reported at its place in the text. What
would only follow from a part that could not be read is left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from immutables import Map

from midstride.lang.components import UNRESOLVED, Components
from midstride.lang.contracts import Contracts
from midstride.lang.declarations import Declarations, collect, topic_name
from midstride.lang.diagnostics import Diagnostic, Note, Reporter, in_order
from midstride.lang.files import Loader, Read, join
from midstride.lang.hints import Hints
from midstride.lang.impact_notes import ImpactNotes
from midstride.lang.lexer import is_topic_name
from midstride.lang.message_types import MessageTypes
from midstride.lang.nodes import Nodes
from midstride.lang.source import Source, Span
from midstride.lang.source_map import SourceMap
from midstride.lang.syntax import KeepStatement, LimitStatement
from midstride.model.component import ComponentSpec, Connector, EnvironmentGuarantee, FunctionalityRef, Resource
from midstride.model.diagnostics import Problem
from midstride.model.specification import Constraint, Keep, Limit, Node, Order, Specification
from midstride.model.specification_checks import check as check_specification

# Consequences, which mean something only where there is no error to mend first.
_CONSEQUENCES = frozenset({"W031", "W032", "W033", "W034"})
# Judgements of a functionality that need all its contracts, and those that need all its modes.
_ON_CONTRACTS = frozenset({"E011", "E012", "W032"})
_ON_MODES = frozenset({"E010", "E011", "E012", "E015", "W032"})
# The statements that declare what the JSON form has in these sections.
_WORD = {"functionalities": "functionality", "parameters": "parameters"}
# Judged where the text is resolved, with a better place.
_OURS = frozenset({"E016"})


@dataclass(frozen=True, slots=True)
class Resolved:
    """All there is to know of a system's files, for tools that need more than the specification."""

    declarations: Declarations
    components: Components
    contracts: Contracts
    specification: Specification


def check_files(
    source: Source, read: Read, messages: MessageTypes | None
) -> tuple[Specification | None, tuple[Diagnostic, ...], tuple[Source, ...], Resolved]:
    """The specification that ``source`` and its includes say, or None where they are in error; the diagnostics; the
    sources."""
    reporter = Reporter()
    loader = Loader(read, reporter)
    loader.load(source)
    judging = reporter
    if loader.placed[0].file.system is None and "system" not in loader.lost:
        end = len(source.text) - len(source.text.lstrip())
        help = "begin the file with `system NAME`; a fragment is checked by checking the file that includes it"
        reporter.report("E106", Span(source, end, end), "this file names no system", help=help)
        judging = Reporter()  # what a fragment names may be declared by the files that include it: that is not told
    declarations = collect(loader.placed, judging)
    building = _Building(declarations, frozenset(loader.lost), messages, read, judging)
    specification = building.specification()
    building.judge(specification, loader.incomplete)
    reporter.finish(source.name)
    resolved = Resolved(declarations, building.components, building.contracts, specification)
    sources = (*loader.sources, *building.nodes.sources)
    return (None if reporter.has_errors else specification), in_order(reporter.found), sources, resolved


class _Building:
    def __init__(
        self,
        declarations: Declarations,
        lost: frozenset[str],
        messages: MessageTypes | None,
        read: Read,
        reporter: Reporter,
    ) -> None:
        self.declarations = declarations
        self.lost = lost
        self.reporter = reporter
        self.contracts = Contracts(declarations.contracts, lost, messages, reporter)
        self.components = Components(declarations.components, self.contracts, lost, reporter)
        self.contracts.resolve_all()
        self.built: dict[str, ComponentSpec] = self.components.build()
        self.nodes = Nodes(declarations, self.built, self.components.merged, read, reporter)
        self.doubtful_topics: set[str] = set()

    def specification(self) -> Specification:
        """The specification as far as it can be told."""
        found = self.declarations
        nodes = self.nodes.build()
        return Specification(
            name="" if found.system is None else found.system.text,
            connectors=Map(self._connectors()),
            components=Map(self.built),
            nodes=Map(nodes),
            environment=tuple(self._offers()),
            resources=Map(
                {
                    name: Resource(name, 1.0 if resource.capacity is None else resource.capacity.value)
                    for name, resource in found.resources.items()
                }
            ),
            constraints=tuple(self._constraints(nodes)),
            timing=Map({kind: duration.seconds.value for kind, duration in found.timing.items()}),
        )

    def _connectors(self) -> dict[str, Connector]:
        connectors: dict[str, Connector] = {}
        for name, topic in self.declarations.topics.items():
            guarantee = self.contracts.predicate(topic.contract, "a topic's contract")
            if guarantee is None:
                self.doubtful_topics.add(name)
            cap = None if topic.cap is None else int(topic.cap.value)
            connectors[name] = Connector(name, guarantee or UNRESOLVED, cap)
        return connectors

    def _offers(self) -> list[EnvironmentGuarantee]:
        offers: list[EnvironmentGuarantee] = []
        for name, (namespace, offer) in self.declarations.offers.items():
            guarantee = self.contracts.predicate(offer.contract, "a guarantee of the environment")
            topic = None if offer.topic is None else topic_name(namespace, offer.topic.text)
            offers.append(EnvironmentGuarantee(name, guarantee or UNRESOLVED, topic))
        return offers

    def _constraints(self, nodes: dict[str, Node]) -> list[Constraint]:
        found: list[Constraint] = []
        for namespace, statement in self.declarations.constraints:
            if isinstance(statement, (KeepStatement, LimitStatement)):
                role = join(namespace, statement.functionality.role.text)
                ref = FunctionalityRef(role, statement.functionality.functionality.text)
                if isinstance(statement, KeepStatement):
                    found.append(Keep(ref, statement.mode.text))
                else:
                    found.append(Limit(ref, statement.seconds.value))
            else:
                found.append(Order(join(namespace, statement.first.text), join(namespace, statement.then.text)))
        return found

    # -- judging ---------------------------------------------------------------------------------------------

    def judge(self, specification: Specification, incomplete: bool) -> None:
        """Report what is wrong with the specification, save what follows from what has been reported."""
        places = SourceMap(self.declarations, self.components.merged, self.nodes.places)
        faulty = self.reporter.has_errors
        problems = check_specification(specification)
        unfit_alone = not faulty and {p.code for p in problems if p.severity == "error"} == {"E020"}
        consequences = ImpactNotes(specification) if unfit_alone else None
        advice = Hints(specification)
        for problem in problems:
            if problem.code in _OURS or (faulty and problem.code in _CONSEQUENCES) or not problem.subject:
                continue
            if problem.subject == ("system",) and not specification.name:
                continue
            place = places.of(problem)
            if self._follows(problem, specification, incomplete, place):
                continue
            notes: Iterable[Note] = ()
            follows: str | None = None
            if problem.code == "E020":
                notes = self._contracts_of(problem, specification)
                follows = None if consequences is None else consequences.of(problem)
            help = advice.on(problem, "" if place is None else place.text)
            self.reporter.report(problem.code, place, problem.message, help=help, notes=notes, follows=follows)

    def _contracts_of(self, problem: Problem, specification: Specification) -> list[Note]:
        """Where the two contracts of an attachment are stated."""
        _, role, _, port, index = problem.subject
        node = specification.nodes[role]
        declaration = self.components.merged[node.component]
        topic = self.declarations.topics[node.attachments[port][int(index)]]
        notes = [Note("the contract of the topic", topic.contract.span)] if topic.contract is not None else []
        stated = next((i.contract for i in declaration.inputs if i.name.text == port), None)
        owner = next((f for f in declaration.functionalities if any(o.text == port for o in f.produces)), None)
        if owner is not None:
            stated = next((g.contract for g in owner.modes[0].guarantees if g.output.text == port), None)
        if stated is not None:
            notes.append(Note("what the port states", stated.span))
        return notes

    def _follows(self, problem: Problem, specification: Specification, incomplete: bool, place: Span | None) -> bool:
        """Whether a problem may only follow from a part that could not be read or resolved."""
        kind, name, *rest = (*problem.subject, "", "")
        if problem.code == "E008":
            text = "" if place is None else place.text
            return incomplete or text in self.lost or text.rpartition("/")[2] in self.lost or self._undeclared(problem)
        if problem.code == "E006" and place is not None and not is_topic_name(place.text):
            return True  # its characters have been told
        if kind == "components":
            doubts = self.components.doubts[name]
            if rest and rest[0] == "functionalities":
                of_contracts = problem.code in _ON_CONTRACTS and rest[1] in doubts.functionalities
                return of_contracts or (rest[1] in doubts.broken and problem.code in _ON_MODES)
            return problem.code == "E013" and (doubts.may_declare("functionality") or bool(doubts.broken))
        if kind == "nodes":
            return self._node_follows(problem, specification, name, tuple(rest))
        if kind == "topics" and name in self.doubtful_topics:
            return True
        return problem.code == "W031" and incomplete

    def _undeclared(self, problem: Problem) -> bool:
        """Whether the name may be declared by a statement that is missing from a component, or by what it is like."""
        kind, name, section = (*problem.declared, "", "", "")[:3]
        if kind != "components" or name not in self.components.doubts:
            return False
        words = {"inputs": ("input", "output"), "outputs": ("input", "output")}.get(section, (_WORD.get(section, ""),))
        return bool(name) and self.components.doubts[name].may_declare(*words)

    def _node_follows(self, problem: Problem, specification: Specification, role: str, rest: tuple[str, ...]) -> bool:
        entry = self.declarations.nodes[role]
        node = specification.nodes[role]
        doubts = self.components.doubts.get(node.component)
        if doubts is None:
            return False
        if problem.code == "W030":
            return entry.declaration.broken or bool(doubts.lost) or doubts.base
        if problem.code == "E020" and len(rest) > 2:
            port, index = rest[1], rest[2]
            topics = node.attachments.get(port, ())
            topic = topics[int(index)] if index.isdecimal() and int(index) < len(topics) else ""
            owner = specification.components[node.component].find_owner(port)
            broken = owner is not None and owner.name in doubts.normal
            return port in doubts.ports or topic in self.doubtful_topics or broken
        return False

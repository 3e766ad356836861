"""Builds the model's components from their declarations: inheritance by ``like``, contracts, assumptions.

Only errors specific to the text form are reported here; :mod:`midstride.model.specification_checks` checks the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Final, TypeAlias, TypeVar

from immutables import Map

from midstride.lang import syntax
from midstride.lang.contract_builder import ContractResolver, cycle_text
from midstride.lang.declarations import MAX_PARTS, ancestry, host_of, limited
from midstride.lang.diagnostic_text import Note, Reporter
from midstride.lang.token_stream import RESERVED
from midstride.model.component import (
    DEFAULT_CONTAINER,
    DEFAULT_STOP,
    GATES,
    Assumption,
    ComponentSpec,
    ContainerProgram,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    NodeEndpoint,
    ParameterSpec,
    StopTimes,
)
from midstride.model.contract import ConnectorKind, Predicate
from midstride.model.near_miss import did_you_mean
from midstride.model.wording import KIND_WORDS

T = TypeVar("T")
Inputs: TypeAlias = Mapping[str, Predicate]  # of a component, by name

# The placeholder for a contract that could not be resolved; no error is derived from it.
UNRESOLVED: Final = Predicate("")
# Each component inherits everything from the one before, so a chain takes quadratic space.
MAX_LIKE: Final = 32
# The kinds of endpoints: the language's name, and the model's.
ENDPOINT_KINDS: Final = {"topic": "topic", "service": "service", "ROS action": "action"}


@dataclass(slots=True)
class UnresolvedParts:
    """The parts of a component that could not be parsed or resolved, from which no further error is derived.

    ``skipped``: the first words of the statements missing from it. ``base``: whether the component that it is like is
    unknown. ``incomplete``: the functionalities with a part missing; ``normal``: those whose normal mode may have a
    part missing. ``functionalities`` and ``ports``: those with an unresolved contract.
    """

    skipped: frozenset[str] = frozenset()
    base: bool = False
    incomplete: set[str] = field(default_factory=set)
    normal: set[str] = field(default_factory=set)
    functionalities: set[str] = field(default_factory=set)
    ports: set[str] = field(default_factory=set)

    def __bool__(self) -> bool:
        return any((self.skipped, self.base, self.incomplete, self.functionalities, self.ports))

    def may_declare(self, *words: str) -> bool:
        """Return whether one of the missing statements may start with one of ``words``."""
        return self.base or any(word not in RESERVED or word in words for word in self.skipped)


@dataclass(slots=True)
class ComponentBuilder:
    """Builds the components of a system. ``unresolved`` lists, per component, the parts that could not be resolved."""

    declared: Mapping[str, syntax.ComponentDeclaration]
    contracts: ContractResolver
    skipped: frozenset[str]
    reporter: Reporter
    merged: dict[str, syntax.ComponentDeclaration] = field(default_factory=dict)
    unresolved: dict[str, UnresolvedParts] = field(default_factory=dict)
    _depths: dict[str, int] = field(default_factory=dict)

    def build(self) -> dict[str, ComponentSpec]:
        """Every declared component, with :data:`UNRESOLVED` for contracts that could not be resolved."""
        for name in self.declared:
            self._merge(name)
        built = {name: self._component(self.merged[name]) for name in self.declared}
        for name, declared in self.declared.items():
            for entry in declared.parameters if built[name].gate is None else ():
                if entry.for_all:
                    report_for_all(entry.name, name, self.reporter)
        return built

    # -- like --------------------------------------------------------------------------------------------

    def _merge(self, name: str) -> None:
        """Set ``merged`` and ``unresolved`` for ``name`` and the components it is like, without recursion."""
        chain = list(takewhile(lambda own: own.name.text not in self.merged, ancestry(self.declared, name)))
        like, names = chain[-1].like if chain else None, [own.name.text for own in chain]
        if like is not None and like.text in names:
            message = f"components form a cycle: {cycle_text([*names[names.index(like.text) :], like.text], 'is like')}"
            self.reporter.report("E140", like.span, message, help="declare one of them without `like`")
        elif like is not None and like.text not in {*self.merged, *self.skipped}:
            help = did_you_mean(like.text, self.declared)
            self.reporter.report("E008", like.span, f"there is no component `{like.text}`", help=help)
        for name, own in zip(reversed(names), reversed(chain), strict=True):
            unresolved = self.unresolved[name] = UnresolvedParts(skipped=own.skipped)
            unresolved.base = max(len(own.inputs), len(own.outputs), len(own.functionalities)) > MAX_PARTS
            merged = self._without_duplicates(own)
            if own.like is not None:
                base_name = own.like.text
                self._depths[name] = depth = self._depths.get(base_name, 0) + 1
                if depth == MAX_LIKE + 1:
                    message = f"`like` is chained more than {MAX_LIKE} times"
                    self.reporter.report("E140", own.like.span, message, help="declare one of them without `like`")
                if base_name in self.merged and depth <= MAX_LIKE:
                    merged = _inherited(self.merged[base_name], merged)
                    unresolved.skipped |= self.unresolved[base_name].skipped
                    unresolved.base |= self.unresolved[base_name].base
                else:
                    unresolved.base = True
            self.merged[name] = merged

    def containers(self, declarations: Mapping[str, syntax.ContainerDeclaration]) -> dict[str, ContainerProgram]:
        """The containers that several nodes share, by name."""
        found = {}
        for name, declared in declarations.items():
            variables = _variables(self._unique(declared.environment, _name, "variable"))
            found[name] = replace(_shared_container(declared.run, Map(variables)), host=host_of(declared.host))
        return found

    def _without_duplicates(self, own: syntax.ComponentDeclaration) -> syntax.ComponentDeclaration:
        for run in own.runs[1:]:
            note = Note("first one here", own.runs[0].span)
            message = f"`{own.name.text}` has more than one `run` command"
            self.reporter.report("E128", run.span, message, help="keep one of them", notes=[note])
        for declared in own.inputs:
            name, span = declared.name
            if (contract := self.contracts.declared.get(name)) is not None:
                note = Note("contract declared here", contract.name.span)
                both = f"`{name}` is both an input of {own.name.text} and a contract"
                message = f"{both}, so `assume {name}` is ambiguous"
                self.reporter.report("E141", span, message, help="rename one of them", notes=[note])
        functionalities = self._unique(own.functionalities, _name, "functionality")
        held = (held for statement in own.holds for held in statement)
        return own._replace(
            inputs=self._unique(own.inputs, _name, "input"),
            outputs=self._unique(own.outputs, lambda name: name, "output"),
            functionalities=tuple(self._unique_modes(functionality) for functionality in functionalities),
            parameters=self._unique(own.parameters, _name, "parameter"),
            environment=self._unique(own.environment, _name, "variable"),
            holds=(self._unique(held, lambda held: held.resource, "held resource"),) if own.holds else (),
        )

    def _unique_modes(self, functionality: syntax.FunctionalityDeclaration) -> syntax.FunctionalityDeclaration:
        modes = self._unique(functionality.modes, _name, "mode")
        for mode in modes:
            self._unique(mode.guarantees, lambda guarantee: guarantee.output, "guarantee for")
            self._unique(mode.parameters, _name, "parameter")
        return functionality._replace(
            uses=tuple(limited(functionality.uses, "name", lambda name: name.span, self.reporter)),
            produces=tuple(limited(functionality.produces, "name", lambda name: name.span, self.reporter)),
            modes=modes,
            incomplete=functionality.incomplete or len(modes) < len(functionality.modes),
        )

    def _unique(self, entries: Iterable[T], name_of: Callable[[T], syntax.Name], what: str) -> tuple[T, ...]:
        first: dict[str, T] = {}
        for entry in limited(tuple(entries), what, lambda entry: name_of(entry).span, self.reporter):
            name = name_of(entry)
            if name.text in first:
                note = Note("first declared here", name_of(first[name.text]).span)
                message = f"duplicate {what} `{name.text}`"
                self.reporter.report("E007", name.span, message, help="give each its own name", notes=[note])
            else:
                first[name.text] = entry
        return tuple(first.values())

    # -- building ------------------------------------------------------------------------------------------

    def _component(self, declaration: syntax.ComponentDeclaration) -> ComponentSpec:
        unresolved = self.unresolved[declaration.name.text]
        inputs: dict[str, Predicate] = {}
        for declared in declaration.inputs:
            predicate = self.contracts.predicate(declared.contract, "the assumption of an input")
            name = declared.name.text
            word = KIND_WORDS[declared.kind].input
            self.contracts.of_kind(predicate, declared.kind, declared.contract.span, f"{word} {name}")
            if predicate is None:
                unresolved.ports.add(name)
                using = (f for f in declaration.functionalities if any(used.text == name for used in f.uses))
                unresolved.functionalities.update(functionality.name.text for functionality in using)
            inputs[name] = predicate or UNRESOLVED
        parts = (self._functionality(part, declaration.name.text, inputs) for part in declaration.functionalities)
        run = declaration.runs[0] if declaration.runs else None
        return ComponentSpec.of(
            declaration.name.text,
            inputs=inputs,
            outputs=tuple(output.text for output in declaration.outputs),
            functionalities=tuple(parts),
            resource_usage={
                held.resource.text: 1.0 if held.amount is None else held.amount.value
                for statement in declaration.holds
                for held in statement
            },
            parameters={
                entry.name.text: ParameterSpec(entry.value.value, entry.changeable) for entry in declaration.parameters
            },
            allows=tuple(dict.fromkeys(NodeEndpoint(ENDPOINT_KINDS[a.kind], a.name.text) for a in declaration.allows)),
            run=None if run is None else run.command.text,
            package=None if run is None or run.package is None else run.package.text,
            prefix=None if run is None or run.prefix is None else run.prefix.text,
            environment=_variables(declaration.environment),
            startup_seconds=None if run is None or run.startup is None else run.startup.value,
            tolerates={each.name.text: int(each.tolerates.value) for each in declaration.inputs if each.tolerates},
            conditions=[each.name.text for each in declaration.inputs if each.condition],
            gate=next(
                (gate for gate in GATES if run and run.gate and run.gate.text == gate),
                "none" if run is not None and run.once is not None else None,
            ),
            once=run is not None and run.once is not None,
            unnamed=run is not None and run.unnamed,
            renames=None if run is None or run.renames is None else run.renames.text,
            topics={own.name.text: own.topic.text for own in declaration.topics},
            activate_seconds=None if run is None or run.activate is None else run.activate.value,
            stop=None if run is None or run.stop is None else _stop_times(run.stop),
            lazy=[output.text for output in declaration.lazy],
            container=None if run is None or run.container is None else container_program(run.container),
        )

    def _functionality(
        self, declared: syntax.FunctionalityDeclaration, component: str, inputs: Inputs
    ) -> FunctionalitySpec:
        name, unresolved = declared.name.text, self.unresolved[component]
        if declared.incomplete:
            unresolved.incomplete.add(name)
            if not any(mode.incomplete for mode in declared.modes[1:]):
                unresolved.normal.add(name)
        return FunctionalitySpec(
            name,
            tuple(self._mode(mode, name, component, inputs) for mode in declared.modes),
            inputs=tuple(used.text for used in declared.uses),
            outputs=tuple(produced.text for produced in declared.produces),
            weight=1.0 if declared.weight is None else declared.weight.value,
        )

    def _mode(self, mode: syntax.ModeDeclaration, functionality: str, component: str, inputs: Inputs) -> Mode:
        unresolved = self.unresolved[component]
        guarantees: dict[str, Predicate] = {}
        for guarantee in mode.guarantees:
            contract = self.contracts.contract(guarantee.contract)
            if contract is None:
                unresolved.functionalities.add(functionality)
                unresolved.ports.add(guarantee.output.text)
                contract = UNRESOLVED
            elif (kind := self._served_as(component, guarantee.output.text)) is not None:
                word = f"{KIND_WORDS[kind].output} {guarantee.output.text}"
                self.contracts.of_kind(contract, kind, guarantee.contract.span, word)
            if isinstance(contract, Predicate):
                guarantees.setdefault(guarantee.output.text, contract)
        assumptions: list[Assumption] = []
        for assumed in mode.assumptions:
            assumption = self._assumption(assumed, component, inputs)
            if assumption is None:
                unresolved.functionalities.add(functionality)
            assumptions.append(assumption or UNRESOLVED)
        parameters = Map({entry.name.text: entry.value.value for entry in mode.parameters})
        return Mode(mode.name.text, tuple(assumptions), Map(guarantees), parameters)

    def _served_as(self, component: str, output: str) -> ConnectorKind | None:
        """The kind that an output is declared as; None where it is not declared."""
        declared = self.merged[component]
        if all(name.text != output for name in declared.outputs):
            return None
        return next((served.kind for served in declared.served if served.name.text == output), "topic")

    def _assumption(self, assumed: syntax.AssumptionExpression, component: str, inputs: Inputs) -> Assumption | None:
        if isinstance(assumed, syntax.NamedAssumption):
            return InputAlternatives(tuple(name.text for name in assumed.inputs))
        if assumed.base is None or "/" in assumed.base.text:
            return self.contracts.predicate(assumed, "an assumption")
        name, span = assumed.base
        if name in inputs and assumed.is_bare_name:
            return InputAlternatives((name,))  # a contract of that name has been reported
        if name in self.contracts.declared:
            return self.contracts.predicate(assumed, "an assumption")
        if name in inputs:
            message = f"`{name}` is an input; what it needs is stated in its declaration"
            help = f"write `assume {name}`, and move the rest to the declaration of the input"
            self.reporter.report("E142", assumed.span, message, help=help)
        elif name not in self.skipped and not self.unresolved[component].may_declare("input"):
            message = f"`{name}` is neither an input of {component} nor a contract"
            hint = did_you_mean(name, [*inputs, *self.contracts.declared])
            self.reporter.report("E008", span, message, help=hint)
        return None


def report_for_all(parameter: syntax.Name, component: str, reporter: Reporter) -> None:
    """Report E148: the program of a component has one node, and a parameter is stated for all of them."""
    message = f"{component} uses Midstride's API, so its process has one node"
    reporter.report("E148", parameter.span, message, help=f"write `parameters {{ {parameter.text} = … }}`")


def _name(declared: syntax.Named) -> syntax.Name:
    return declared.name


def _inherited(base: syntax.ComponentDeclaration, own: syntax.ComponentDeclaration) -> syntax.ComponentDeclaration:
    """``own``, completed from ``base`` part by part; a functionality is one part."""

    def merged(name_of: Callable[[T], syntax.Name], theirs: tuple[T, ...], ours: tuple[T, ...]) -> tuple[T, ...]:
        return tuple({name_of(entry).text: entry for entry in (*theirs, *ours)}.values())

    if own.files:  # instead of those of the base, whose values come before them
        theirs, ours = tuple(entry._replace(after=0) for entry in base.parameters), own.parameters
    else:
        before = len(base.files)
        theirs, ours = base.parameters, tuple(entry._replace(after=before) for entry in own.parameters)
    return own._replace(
        runs=own.runs or base.runs,
        holds=own.holds or base.holds,
        parameters=merged(_name, theirs, ours),
        environment=merged(_name, base.environment, own.environment),
        files=own.files or base.files,
        inputs=merged(_name, base.inputs, own.inputs),
        outputs=merged(lambda name: name, base.outputs, own.outputs),
        allows=(*base.allows, *own.allows),
        functionalities=merged(_name, base.functionalities, own.functionalities),
        topics=merged(_name, base.topics, own.topics),
        lazy=merged(lambda name: name, _not_stated_again(base.lazy, own.outputs), own.lazy),
        served=merged(_name, _served_again(base.served, own.outputs), own.served),
    )


def _not_stated_again(lazy: tuple[syntax.Name, ...], outputs: tuple[syntax.Name, ...]) -> tuple[syntax.Name, ...]:
    """An output is one part: one that is stated again is lazy only where that says so."""
    stated = {output.text for output in outputs}
    return tuple(output for output in lazy if output.text not in stated)


def _served_again(
    served: tuple[syntax.ServerDeclaration, ...], outputs: tuple[syntax.Name, ...]
) -> tuple[syntax.ServerDeclaration, ...]:
    """The servers without those stated again as outputs, which are servers only where that says so."""
    stated = {output.text for output in outputs}
    return tuple(each for each in served if each.name.text not in stated)


def container_program(clause: syntax.ContainerClause) -> ContainerProgram:
    """The program of a container, which is the default where none is stated."""
    if clause.program is None:
        return DEFAULT_CONTAINER
    package = DEFAULT_CONTAINER.package if clause.package is None else clause.package.text
    return ContainerProgram(clause.program.text, package)


def _shared_container(run: syntax.Run | None, environment: Map[str, str | None]) -> ContainerProgram:
    """A container that several nodes share, with the details of its process."""
    if run is None:
        return replace(DEFAULT_CONTAINER, environment=environment)
    return replace(
        container_program(syntax.ContainerClause(run.command, run.package)),
        prefix=None if run.prefix is None else run.prefix.text,
        environment=environment,
        startup_seconds=None if run.startup is None else run.startup.value,
        stop=None if run.stop is None else _stop_times(run.stop),
    )


def _variables(stated: Iterable[syntax.EnvironmentVariable]) -> dict[str, str | None]:
    return {each.name.text: each.value and each.value.text for each in stated}


def _stop_times(stop: syntax.StopClause) -> StopTimes:
    sigterm, sigkill, drain, patience = stop.sigterm, stop.sigkill, stop.drain, stop.patience
    return StopTimes(
        DEFAULT_STOP.sigterm if sigterm is None else sigterm.value,
        DEFAULT_STOP.sigkill if sigkill is None else sigkill.value,
        DEFAULT_STOP.drain if drain is None else drain.value,
        DEFAULT_STOP.patience if patience is None else patience.value,
    )

"""From component declarations to the model's components: inheritance by ``like``, contracts, what assumptions mean.

Only what a text can do wrong is judged here; what must hold of a component however it is written is
:mod:`midstride.model.specification_checks`'s to say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar

from immutables import Map

from midstride.lang.contracts import Contracts
from midstride.lang.declarations import MAX_PARTS, bounded
from midstride.lang.diagnostics import Note, Reporter
from midstride.lang.syntax import (
    Allowed,
    Assumed,
    ComponentDeclaration,
    ContractExpression,
    FunctionalityDeclaration,
    ModeDeclaration,
    Name,
    NamedAssumption,
)
from midstride.lang.token_stream import RESERVED
from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Endpoint,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterSpec,
)
from midstride.model.contract import NOTHING, Predicate
from midstride.model.near_miss import did_you_mean

T = TypeVar("T")

# Stands for a contract that could not be resolved; whatever is concluded from it is left untold.
UNRESOLVED: Final = Predicate("")
# Each takes over all that the one before has: a long chain would be as large as its square.
MAX_LIKE: Final = 32
# What the model calls the kinds of endpoints that the language names.
ENDPOINT_KINDS: Final = {"topic": "topic", "service": "service", "ROS action": "action"}


@dataclass(slots=True)
class Doubts:
    """What of a component could not be read or resolved, so that nothing may be concluded about it.

    ``lost``: the first words of the statements missing from it. ``normal``: the functionalities whose normal mode is
    in doubt. ``base``: what it is like is not known. ``broken``: the functionalities something is missing from.
    ``functionalities`` and ``ports``: those with a contract that is not known.
    """

    lost: frozenset[str] = frozenset()
    base: bool = False
    broken: set[str] = field(default_factory=set)
    normal: set[str] = field(default_factory=set)
    functionalities: set[str] = field(default_factory=set)
    ports: set[str] = field(default_factory=set)

    def may_declare(self, *words: str) -> bool:
        """Whether a statement beginning with one of ``words`` may be among what is missing."""
        return self.base or any(word not in RESERVED or word in words for word in self.lost)


class Components:
    """Builds the components of a system. ``doubts`` tells which of them, or which parts, are in doubt."""

    def __init__(
        self,
        declared: Mapping[str, ComponentDeclaration],
        contracts: Contracts,
        lost: frozenset[str],
        reporter: Reporter,
    ) -> None:
        self.declared = declared
        self.contracts = contracts
        self.lost = lost
        self.reporter = reporter
        self.merged: dict[str, ComponentDeclaration] = {}
        self.doubts: dict[str, Doubts] = {}
        self._depths: dict[str, int] = {}

    def build(self) -> dict[str, ComponentSpec]:
        """Every component declared, as far as it can be told."""
        for name in self.declared:
            self._merge(name)
        return {name: self._component(self.merged[name]) for name in self.declared}

    # -- like --------------------------------------------------------------------------------------------

    def _merge(self, name: str) -> None:
        """Settle ``merged`` and ``doubts`` for ``name`` and for all it is like. A long chain takes no stack."""
        chain: dict[str, None] = {}
        while name not in self.merged:
            own = self.declared[name]
            chain[name] = None
            if own.like is None:
                break
            base = own.like.text
            if base in chain:
                names = list(chain)
                circle = [*names[names.index(base) :], base]
                circle = circle if len(circle) <= 8 else [*circle[:4], "…", *circle[-3:]]
                told = " is like ".join(f"`{other}`" for other in circle)
                message = f"components are like each other: {told}"
                self.reporter.report("E140", own.like.span, message, help="declare one of them by itself")
                break
            if base not in self.declared:
                if base not in self.lost:
                    help = did_you_mean(base, self.declared)
                    self.reporter.report("E008", own.like.span, f"there is no component `{base}`", help=help)
                break
            name = base
        for name in reversed(chain):
            own = self.declared[name]
            doubts = self.doubts[name] = Doubts(lost=own.lost)
            doubts.base = max(len(own.inputs), len(own.outputs), len(own.functionalities)) > MAX_PARTS
            merged = self._without_duplicates(own)
            if own.like is not None:
                base_name = own.like.text
                self._depths[name] = depth = self._depths.get(base_name, 0) + 1
                if depth == MAX_LIKE + 1:
                    message = f"this is like a component that is like another one, more than {MAX_LIKE} times over"
                    self.reporter.report("E140", own.like.span, message, help="declare one of them by itself")
                if base_name in self.merged and depth <= MAX_LIKE:
                    merged = _over(self.merged[base_name], merged)
                    doubts.lost |= self.doubts[base_name].lost
                    doubts.base |= self.doubts[base_name].base
                else:
                    doubts.base = True
            self.merged[name] = merged

    def _without_duplicates(self, own: ComponentDeclaration) -> ComponentDeclaration:
        for run in own.runs[1:]:
            note = Note("the first one is here", own.runs[0].span)
            message = f"`{own.name.text}` is started by one command alone"
            self.reporter.report("E128", run.span, message, help="keep one of the two", notes=[note])
        for declared in own.inputs:
            contract = self.contracts.declared.get(declared.name.text)
            if contract is not None:
                name = declared.name
                note = Note("the contract is here", contract.name.span)
                either = f"`assume {name.text}` could mean either"
                message = f"`{name.text}` is an input of {own.name.text} and a contract: {either}"
                self.reporter.report("E141", name.span, message, help="rename one of the two", notes=[note])
        inputs = self._once(own.inputs, lambda declared: declared.name, "input")
        outputs = self._once(own.outputs, lambda name: name, "output")
        functionalities = self._once(own.functionalities, lambda declared: declared.name, "functionality")
        parameters = self._once(own.parameters, lambda entry: entry.name, "parameter")
        held = self._once(
            (held for statement in own.holds for held in statement), lambda held: held.resource, "resource held"
        )
        return own._replace(
            inputs=inputs,
            outputs=outputs,
            functionalities=tuple(self._modes_once(functionality) for functionality in functionalities),
            parameters=parameters,
            holds=(held,) if own.holds else (),
        )

    def _modes_once(self, functionality: FunctionalityDeclaration) -> FunctionalityDeclaration:
        modes = self._once(functionality.modes, lambda mode: mode.name, "mode")
        for mode in modes:
            self._once(mode.guarantees, lambda guarantee: guarantee.output, "guarantee for")
        used, produced = (
            tuple(bounded(names, "name", lambda name: name.span, self.reporter))
            for names in (functionality.uses, functionality.produces)
        )
        functionality = functionality._replace(uses=used, produces=produced)
        fewer = len(modes) < len(functionality.modes)
        return functionality._replace(modes=modes, broken=functionality.broken or fewer)

    def _once(self, entries: Iterable[T], name_of: Callable[[T], Name], what: str) -> tuple[T, ...]:
        first: dict[str, T] = {}
        for entry in bounded(tuple(entries), what, lambda entry: name_of(entry).span, self.reporter):
            name = name_of(entry)
            if name.text in first:
                note = Note("the first one is here", name_of(first[name.text]).span)
                message = f"there is one {what} `{name.text}` here already"
                self.reporter.report("E007", name.span, message, help="give each its own name", notes=[note])
            else:
                first[name.text] = entry
        return tuple(first.values())

    # -- building ------------------------------------------------------------------------------------------

    def _component(self, declaration: ComponentDeclaration) -> ComponentSpec:
        doubts = self.doubts[declaration.name.text]
        inputs: dict[str, Predicate] = {}
        for declared in declaration.inputs:
            predicate = self.contracts.predicate(declared.contract, "what an input assumes")
            if predicate is None:
                doubts.ports.add(declared.name.text)
                doubts.functionalities |= {
                    f.name.text
                    for f in declaration.functionalities
                    if any(u.text == declared.name.text for u in f.uses)
                }
            inputs[declared.name.text] = predicate or UNRESOLVED
        functionalities = tuple(
            self._functionality(f, declaration, inputs, doubts) for f in declaration.functionalities
        )
        run = declaration.runs[0] if declaration.runs else None
        return ComponentSpec.of(
            declaration.name.text,
            inputs=inputs,
            outputs=tuple(output.text for output in declaration.outputs),
            functionalities=functionalities,
            holds={
                held.resource.text: 1.0 if held.amount is None else held.amount.value
                for statement in declaration.holds
                for held in statement
            },
            parameters={
                entry.name.text: ParameterSpec(entry.value.value, entry.changeable) for entry in declaration.parameters
            },
            allows=tuple(dict.fromkeys(_endpoint(allowed) for allowed in declaration.allows)),
            run=None if run is None else run.command.text,
            takes=None if run is None or run.takes is None else run.takes.value,
        )

    def _functionality(
        self,
        declared: FunctionalityDeclaration,
        owner: ComponentDeclaration,
        inputs: Mapping[str, Predicate],
        doubts: Doubts,
    ) -> FunctionalitySpec:
        name = declared.name.text
        if declared.broken:
            doubts.broken.add(name)
            if not any(mode.broken for mode in declared.modes[1:]):
                doubts.normal.add(name)
        modes = tuple(self._mode(mode, name, owner, inputs, doubts) for mode in declared.modes)
        return FunctionalitySpec(
            name,
            modes,
            inputs=tuple(used.text for used in declared.uses),
            outputs=tuple(produced.text for produced in declared.produces),
            weight=1.0 if declared.weight is None else declared.weight.value,
        )

    def _mode(
        self,
        mode: ModeDeclaration,
        functionality: str,
        owner: ComponentDeclaration,
        inputs: Mapping[str, Predicate],
        doubts: Doubts,
    ) -> Mode:
        guarantees: dict[str, Predicate] = {}
        for guarantee in mode.guarantees:
            contract = self.contracts.contract(guarantee.contract)
            if contract is None:
                doubts.functionalities.add(functionality)
                doubts.ports.add(guarantee.output.text)
                guarantees.setdefault(guarantee.output.text, UNRESOLVED)
            elif contract is not NOTHING:
                assert isinstance(contract, Predicate)
                guarantees.setdefault(guarantee.output.text, contract)
        assumptions: list[Assumption] = []
        for assumed in mode.assumptions:
            assumption = self._assumption(assumed, owner, inputs)
            if assumption is None:
                doubts.functionalities.add(functionality)
            assumptions.append(assumption or UNRESOLVED)
        return Mode(mode.name.text, tuple(assumptions), Map(guarantees))

    def _assumption(
        self, assumed: Assumed, owner: ComponentDeclaration, inputs: Mapping[str, Predicate]
    ) -> Assumption | None:
        if isinstance(assumed, NamedAssumption):
            return InputAlternatives(tuple(name.text for name in assumed.inputs))
        if (
            assumed.base is not None
            and "/" not in assumed.base.text
            and assumed.base.text not in self.contracts.declared
        ):
            return self._named_input(assumed, assumed.base, owner, inputs)
        if assumed.is_bare_name and assumed.base is not None and assumed.base.text in inputs:
            return InputAlternatives((assumed.base.text,))  # a contract of that name is an error, which has been told
        return self.contracts.predicate(assumed, "an assumption")

    def _named_input(
        self, assumed: ContractExpression, base: Name, owner: ComponentDeclaration, inputs: Mapping[str, Predicate]
    ) -> Assumption | None:
        if base.text in inputs:
            if assumed.is_bare_name:
                return InputAlternatives((base.text,))
            message = f"`{base.text}` is an input, whose own assumption says what is needed of it"
            self.reporter.report(
                "E142",
                assumed.span,
                message,
                help=f"write `assume {base.text}`, and the rest where the input is declared",
            )
        elif base.text not in self.lost and not self.doubts[owner.name.text].may_declare("input"):
            help = did_you_mean(base.text, [*inputs, *self.contracts.declared])
            message = f"`{base.text}` is neither an input of {owner.name.text} nor a contract"
            self.reporter.report("E008", base.span, message, help=help)
        return None


def _endpoint(allowed: Allowed) -> Endpoint:
    return Endpoint(ENDPOINT_KINDS[allowed.kind], allowed.name.text)


def _over(base: ComponentDeclaration, own: ComponentDeclaration) -> ComponentDeclaration:
    """``own`` with what it does not declare itself taken from ``base``: part by part, a functionality being one."""

    def merged(name_of: Callable[[T], Name], theirs: tuple[T, ...], ours: tuple[T, ...]) -> tuple[T, ...]:
        entries = {name_of(entry).text: entry for entry in theirs}
        entries.update({name_of(entry).text: entry for entry in ours})
        return tuple(entries.values())

    return own._replace(
        runs=own.runs or base.runs,
        holds=own.holds or base.holds,
        parameters=merged(lambda entry: entry.name, base.parameters, own.parameters),
        files=own.files or base.files,
        inputs=merged(lambda declared: declared.name, base.inputs, own.inputs),
        outputs=merged(lambda name: name, base.outputs, own.outputs),
        allows=(*base.allows, *own.allows),
        functionalities=merged(lambda declared: declared.name, base.functionalities, own.functionalities),
    )

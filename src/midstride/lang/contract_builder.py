"""Resolution of contract expressions to the model's predicates.

A contract that cannot be resolved is None; its error has been reported, and no further error is derived from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, get_args

from midstride.lang.diagnostic_text import Reporter
from midstride.lang.message_types import MessageDefinition, MessageTypes, MissingField, field_kind
from midstride.lang.parse_contract import SECONDS
from midstride.lang.source import Span
from midstride.lang.syntax import BoundClause, ContractDeclaration, ContractExpression, FieldConstraint, Name, QoSPolicy
from midstride.model.contract import (
    BOUND_WORDS,
    NOTHING,
    ConnectorKind,
    Contract,
    Durability,
    HistoryPolicy,
    Interval,
    Liveliness,
    OneOf,
    Predicate,
    QoS,
    Reliability,
    ValueSet,
    canonical_type,
    connector_kind,
)
from midstride.model.near_miss import did_you_mean
from midstride.model.wording import KIND_WORDS, indefinite

# The values of the QoS policies that are enumerations.
POLICY_WORDS: Final[Mapping[str, tuple[str, ...]]] = {
    "reliability": get_args(Reliability),
    "durability": get_args(Durability),
    "liveliness": get_args(Liveliness),
    "history": get_args(HistoryPolicy),
}
_DURATIONS: Final = ("deadline", "lease", "lifespan")
POLICIES: Final = (*POLICY_WORDS, *_DURATIONS, "depth")
# The long names that ROS 2 uses for the lease.
_ALIASES: Final = {"liveliness_lease_duration": "lease", "lease_duration": "lease"}


@dataclass(slots=True)
class ContractResolver:
    """Resolves contract expressions, and holds the named contracts of a system."""

    declared: Mapping[str, ContractDeclaration]
    skipped: frozenset[str]
    messages: MessageTypes | None
    reporter: Reporter
    _resolved: dict[str, Contract | None] = field(default_factory=dict)
    _types: dict[str, MessageDefinition | bool] = field(default_factory=dict)
    _cache: dict[tuple[str, float | None], Predicate] = field(default_factory=dict)

    def resolve_all(self) -> None:
        """Resolve every named contract, used or not, so that its errors are reported."""
        for name in self.declared:
            self._named(name, self.declared[name].name.span)

    def named(self, name: str) -> Contract | None:
        """A named contract; None if it could not be resolved."""
        return self._resolved.get(name)

    def predicate(self, expression: ContractExpression | None, what: str) -> Predicate | None:
        """The predicate that an expression states, or None. Reports ``nothing``, which ``what`` cannot be."""
        contract = self.contract(expression)
        if contract is NOTHING and expression is not None:
            message = f"{what} cannot be `nothing`"
            self.reporter.report("E135", expression.span, message, help="only an output can guarantee `nothing`")
            return None
        return contract if isinstance(contract, Predicate) else None

    def contract(self, expression: ContractExpression | None) -> Contract | None:
        """The contract that an expression states, or None if it cannot be resolved."""
        if expression is None:
            return None
        base = expression.base
        plain = not expression.qos and not expression.where and expression.bound is None
        if base is None:
            if expression.rate or not plain:
                message = "`nothing` has no rate, QoS, fields or bound"
                self.reporter.report("E135", expression.span, message, help="write `nothing` alone")
            return NOTHING
        if "/" in base.text:
            if not self._can_be_used(base):
                self._fields(expression, None, {})
                return None
            rate = expression.rate.value if expression.rate else None
            predicate = self._cache.setdefault((base.text, rate), Predicate(base.text, rate))
        else:
            named = self._named(base.text, base.span)
            if named is NOTHING and not (plain and expression.rate is None):
                self.reporter.report("E135", expression.span, "`nothing` has no rate, QoS, fields or bound")
            if not isinstance(named, Predicate):
                self._fields(expression, None, {})
                return named
            predicate = named if expression.rate is None else replace(named, rate=expression.rate.value)
        if plain:
            return predicate
        if expression.bound is not None:
            predicate = self._bounded(predicate, expression.bound)
        qos = self._qos(expression.qos, predicate.qos)
        fields = self._fields(expression, predicate.type, dict(predicate.fields))
        if fields is None:
            return None
        return replace(predicate, qos=qos, fields=tuple(fields.items()))

    def _bounded(self, predicate: Predicate, bound: BoundClause) -> Predicate:
        """The predicate with its bound; reports one in the words of another kind."""
        word = BOUND_WORDS[predicate.kind]
        if predicate.kind != "topic" and bound.word.text != word:
            what = KIND_WORDS[predicate.kind].connector
            message = f"{predicate.type} is the type of {indefinite(what)}, which `{word}`"
            self.reporter.report(
                "E147", bound.word.span, message, help=f"write `{word} within {bound.seconds.span.text}`"
            )
        return replace(predicate, within=bound.seconds.value)

    def of_kind(self, contract: Contract | None, kind: ConnectorKind, span: Span, declared: str) -> None:
        """Report a contract of another kind than what is ``declared``, such as `topic /map`."""
        if not isinstance(contract, Predicate) or not contract.type or contract.kind == kind:
            return
        words, own = KIND_WORDS[contract.kind], KIND_WORDS[kind]
        instead = {own.connector.removeprefix("ROS "): words.connector.removeprefix("ROS "), own.output: words.output}
        instead[own.input] = words.input
        word, _, rest = declared.rpartition(" ")
        message = f"{contract.type} is the type of {indefinite(words.connector)}, and `{declared}` is none"
        self.reporter.report("E147", span, message, help=f"write `{instead[word]} {rest}`")

    # -- names and types -------------------------------------------------------------------------------

    def _named(self, name: str, span: Span) -> Contract | None:
        """The contract called ``name``. The contracts it refines are resolved first, without recursion."""
        chain: dict[str, None] = {}
        first = name
        while name not in self._resolved:
            declaration = self.declared.get(name)
            if declaration is None:
                self._report_undeclared(name, span)
                break
            if name in chain:
                names = list(chain)
                message = f"contracts form a cycle: {cycle_text([*names[names.index(name) :], name], 'refines')}"
                help = "base one of them on a message type"
                self.reporter.report("E136", declaration.name.span, message, help=help)
                self._resolved.update(dict.fromkeys(chain))
                break
            chain[name] = None
            base = None if declaration.contract is None else declaration.contract.base
            if base is None or "/" in base.text:
                break
            name, span = base.text, base.span
        for refined in reversed(chain):
            if refined not in self._resolved:
                contract = self.declared[refined].contract
                base = None if contract is None else contract.base
                known = base is None or "/" in base.text or base.text in self._resolved
                self._resolved[refined] = self.contract(contract) if known else None
        return self._resolved.get(first)

    def _report_undeclared(self, name: str, span: Span) -> None:
        if name in self.skipped or self.reporter.is_full:  # looking for near misses takes time
            return
        help = did_you_mean(name, self.declared)
        if help is None:
            help = f"declare it (`contract {name} = …`), or name a message type (`std_msgs/msg/String`)"
        self.reporter.report("E008", span, f"there is no contract `{name}`", help=help)

    def _can_be_used(self, name: Name) -> bool:
        """Return whether a type can be used: it is known, or its package is unknown. Reports one that cannot."""
        full_name = canonical_type(name.text)
        if self._type(full_name) is not False:
            return True
        package, folder, rest = full_name.split("/")
        assert self.messages is not None
        types = tuple(self.messages.types(package, folder))
        help = did_you_mean(rest, types) or f"its types: {', '.join(types[:8])}{', …' if len(types) > 8 else ''}"
        what = {"msg": "message"}.get(folder) or KIND_WORDS[connector_kind(full_name)].connector
        message = f"package `{package}` has no {what} type `{rest}`"
        self.reporter.report("E130", name.span, message, help=help if types else None)
        return False

    def _type(self, name: str) -> MessageDefinition | bool:
        """The message type; True if its package is unknown; False if the package has no such type."""
        if self.messages is None:
            return True
        if name not in self._types:
            found = self.messages.message(name)
            self._types[name] = found or not any(True for _ in self.messages.types(*name.split("/")[:2]))
        return self._types[name]

    # -- QoS ---------------------------------------------------------------------------------------------

    def _qos(self, policies: tuple[QoSPolicy, ...], base: QoS) -> QoS:
        if not policies:
            return base
        stated: dict[str, Any] = {}
        for policy in policies:
            name = _ALIASES.get(policy.name.text, policy.name.text)
            if name not in POLICIES:
                help = did_you_mean(name, POLICIES) or f"known policies: {', '.join(POLICIES)}"
                message = f"there is no QoS policy `{policy.name.text}`"
                self.reporter.report("E131", policy.name.span, message, help=help)
            elif name in stated:
                self.reporter.report("E128", policy.name.span, f"duplicate policy `{name}`", help="keep one of them")
            elif (value := self._policy(name, policy)) is not None:
                stated[name] = value
        return replace(base, **stated)

    def _policy(self, name: str, policy: QoSPolicy) -> object:
        value, span, unit = policy.value.value, policy.value.span, policy.unit
        if name in POLICY_WORDS:
            if value in POLICY_WORDS[name]:
                return value
            help = did_you_mean(str(value), POLICY_WORDS[name]) or f"one of {', '.join(POLICY_WORDS[name])}"
            self.reporter.report("E131", span, f"`{span.text}` is not a valid {name}", help=help)
        elif name == "depth":
            if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**31:
                return value
            help = "the depth is a whole number, 0 or more"
            self.reporter.report("E131", span, f"`{span.text}` is not a valid depth", help=help)
        elif isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0:
            self.reporter.report("E131", span, f"`{span.text}` is not a duration", help=f"write `{name} = 0.1 s`")
        elif unit is None or unit.text not in SECONDS:
            place = span if unit is None else unit.span
            message = f"`{name}` needs a unit" if unit is None else f"`{unit.text}` is not a unit of time"
            self.reporter.report("E127", place, message, help=f"write `{name} = {span.text} s`")
        else:
            return value * SECONDS[unit.text]
        return None

    # -- fields ------------------------------------------------------------------------------------------

    def _fields(
        self, expression: ContractExpression, type_: str | None, fields: dict[str, ValueSet]
    ) -> dict[str, ValueSet] | None:
        """``fields`` narrowed by the constraints of the expression, or None if one of them is invalid."""
        sound = True
        for constraint in expression.where:
            path, values = constraint.path.text, _values(constraint)
            before = fields.get(path)
            together = values if before is None else before.intersection(values)
            if together.is_empty:
                stated = f"`{constraint.span.text}`"
                if before is not None and not values.is_empty:
                    stated = f"both {stated} and {path} {before}"
                message = f"no value of {path} satisfies {stated}"
                self.reporter.report("E016", constraint.span, message, help="widen one of the constraints")
                sound = False
            else:
                fields[path] = together
                sound &= type_ is None or self._field(type_, constraint, values)
        return fields if sound else None

    def _field(self, type_: str, constraint: FieldConstraint, values: ValueSet) -> bool:
        known = self._type(type_)
        if not isinstance(known, MessageDefinition) or self.messages is None:
            return True
        path = constraint.path
        kind = field_kind(self.messages, known, path.text)
        if isinstance(kind, MissingField):
            help = did_you_mean(kind.name, kind.known)
            if help is None and kind.known:
                help = f"its fields: {', '.join(kind.known[:8])}" + (", …" if len(kind.known) > 8 else "")
            self.reporter.report("E137", path.span, f"{kind.owner} has no field `{kind.name}`", help=help)
            return False
        if kind == "unknown":
            return True
        stated = {"number"} if isinstance(values, Interval) else {kind for kind, _ in values.members}
        if kind not in {"number", "text", "boolean"}:
            shown = "a list" if kind == "list" else f"a {kind}"
            self.reporter.report("E138", path.span, f"{path.text} of {type_} is {shown}, which cannot be compared")
            return False
        if stated - {kind}:
            compared = " and ".join(sorted(_KIND_NAMES[name] for name in stated))
            compared = f"`{constraint.span.text}` compares it with {compared}"
            message = f"{path.text} of {type_} is {_KIND_NAMES[kind]}, but {compared}"
            self.reporter.report("E138", constraint.span, message, help=_constant_hint(known, constraint))
            return False
        return True


def cycle_text(names: list[str], verb: str) -> str:
    """``A refines B refines A``; a long cycle is abbreviated."""
    shown = names if len(names) <= 8 else [*names[:4], "…", *names[-3:]]
    return f" {verb} ".join(f"`{name}`" for name in shown)


_KIND_NAMES: Final = {"number": "a number", "text": "a string", "boolean": "a boolean"}


def _constant_hint(message: MessageDefinition, constraint: FieldConstraint) -> str | None:
    """The constraint rewritten with the value of the constant that it names."""
    for value in constraint.values:
        if isinstance(value.value, str) and value.value in message.constants:
            at = value.span.start - constraint.span.start
            text = constraint.span.text
            constant = message.constants[value.value]
            return f"write the value of the constant: `{text[:at]}{constant}{text[at + len(value.span.text) :]}`"
    return None


def _values(constraint: FieldConstraint) -> ValueSet:
    values = [value.value for value in constraint.values]
    operator = constraint.operator
    if operator in {"=", "!=", "in {}"}:
        return OneOf.of(values)
    number = values[0]
    assert isinstance(number, (int, float))  # the parser guarantees it
    if operator == "in []":
        upper = values[1]
        assert isinstance(upper, (int, float))
        return Interval(number, upper)
    if operator in {">", ">="}:
        return Interval(low=number, low_open=operator == ">")
    return Interval(high=number, high_open=operator == "<")

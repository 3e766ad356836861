"""Parsing of contracts (types, rates, QoS profiles, field constraints) and of plain values."""

from __future__ import annotations

import math
import re
from typing import Final

from midstride.lang import syntax
from midstride.lang.blocks import BlockParser
from midstride.lang.token_stream import Panic
from midstride.model.component import ParameterValue
from midstride.model.contract import BOUND_WORDS, Scalar
from midstride.model.near_miss import nearest

HERTZ: Final = {"Hz": 1.0, "kHz": 1000.0}
SECONDS: Final = {"s": 1.0, "ms": 0.001, "us": 0.000001, "min": 60.0}

_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*/((msg|srv|action)/)?[A-Za-z][A-Za-z0-9_]*")
_COMPARISONS: Final = frozenset({"=", "<", "<=", ">", ">=", "==", "!="})
# As the value of a parameter; elsewhere, `-inf` is a number that is too large.
_NOT_FINITE: Final = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_INTEGER: Final = re.compile(r"[+-]?[0-9]+")


class ContractParser(BlockParser):
    """The part of the parser for contracts and values."""

    def contract(self, what: str) -> syntax.ContractExpression:
        """``TYPE or NAME [@ r Hz] [qos(…)] [where …] [responds within s]``, or ``nothing``."""
        start = self.i
        base = self._base(what)
        rate: syntax.Number | None = None
        qos: tuple[syntax.QoSPolicy, ...] = ()
        where: tuple[syntax.FieldConstraint, ...] = ()
        bound: syntax.BoundClause | None = None
        stated: set[str] = set()
        while True:
            kind = self.kinds[self.i]
            word = "rate" if kind == "@" else self.texts[self.i] if kind == "name" else ""
            if word == "where" or word == "rate" or (word == "qos" and self.kinds[self.i + 1] == "("):
                if word in stated:
                    message = f"this contract already has a {'rate' if word == 'rate' else f'`{word}`'}"
                    self.reporter.report("E128", self.span(), message, help="keep one of them")
                stated.add(word)
                self.i += 1
                if word == "rate":
                    rate = self.rate()
                elif word == "qos":
                    qos = self._qos()
                else:
                    where = self.sequence(self._constraint, self._constraint_at)
            elif word in BOUND_WORDS.values() and self.texts[self.i + 1] == "within":
                if bound is not None:
                    message = "this contract already has a bound"
                    self.reporter.report("E128", self.span(), message, help="keep one of them")
                bound = self._bound()
            elif kind == "number" and "rate" not in stated and self.texts[self.i + 1] in HERTZ:
                help = f"write `@ {self.texts[self.i]} {self.texts[self.i + 1]}`"
                self.reporter.report("E120", self.span(), "expected `@` before the rate", help=help)
                stated.add("rate")
                rate = self.rate()
            else:
                return syntax.ContractExpression(self.since(start), base, rate, qos, where, bound)

    def _bound(self) -> syntax.BoundClause:
        start = self.i
        word = self.take()
        self.i += 1
        seconds = self.seconds(f"a time after `{word.text} within`")
        if seconds.value <= 0:
            message = "a bound must be greater than 0 s"
            self.reporter.report("E126", seconds.span, message, help="leave it out if none is required")
            seconds = syntax.Number(1.0, seconds.span)
        return syntax.BoundClause(word, seconds, self.since(start))

    def _base(self, what: str) -> syntax.Name | None:
        if self.kinds[self.i] == "path":
            name = self.take()
            if not _TYPE.fullmatch(name.text):
                help = "types are written `pkg/msg/Type` or `pkg/Type`, `pkg/srv/Type` or `pkg/action/Type`"
                self.reporter.report("E133", name.span, f"`{name.text}` is not a message type", help=help)
                raise Panic
            return name
        if self.kinds[self.i] == "name" and not self.is_keyword(self.i):
            start = self.i
            self.i += 1
            parts = [self.texts[start]]
            while self.kinds[self.i] in {".", ":"} and self.kinds[self.i + 1] in {"name", ":"}:
                if self.kinds[self.i + 1] == ":" and self.kinds[self.i + 2] != "name":
                    break
                self.i += 1 if self.kinds[self.i + 1] == "name" else 2
                parts.append(self.texts[self.i])
                self.i += 1
            if len(parts) == 1:
                return None if parts[0] == "nothing" else syntax.Name(parts[0], self.span(start))
            help = f"write `{'/'.join(parts)}`" if len(parts) <= 3 else "message types are written `pkg/msg/Type`"
            message = f"`{self.since(start).text}` is not a message type"
            self.reporter.report("E133", self.since(start), message, help=help)
            raise Panic
        raise self.fail(f"a message type or contract name {what}")

    def rate(self) -> syntax.Number:
        number = self.quantity("a rate", HERTZ)
        if number.value <= 0:
            help = "omit the rate if none is required"
            self.reporter.report("E126", number.span, "a rate must be greater than 0 Hz", help=help)
            return syntax.Number(1.0, number.span)
        return number

    def seconds(self, what: str) -> syntax.Number:
        return self.quantity(what, SECONDS)

    def _qos(self) -> tuple[syntax.QoSPolicy, ...]:
        self.expect("(", "after `qos`")
        policies: list[syntax.QoSPolicy] = []
        for _ in self.items(")"):
            name = self.name("a QoS policy" if not policies else "`,` or `)` in the QoS profile", ("=",))
            self.expect("=", f"after `{name.text}`", ("name", "number"))
            value = self.scalar(f"a value for `{name.text}`")
            is_next = self.kinds[self.i] != "name" or self.kinds[self.i + 1] in {"=", "name", "number", "string"}
            unit = None if is_next and not (self.at_word("s") or self.at_word("ms")) else self.take()
            policies.append(syntax.QoSPolicy(name, value, unit))
        return tuple(policies)

    def _constraint_at(self, at: int) -> bool:
        """Return whether a field constraint begins at the token ``at``: dotted names, then a comparison."""
        if self.kinds[at] != "name":
            return False
        while self.kinds[at + 1] == "." and self.kinds[at + 2] == "name":
            at += 2
        if self.kinds[at + 1] in _COMPARISONS:
            return True
        return self.texts[at + 1] == "in" and self.kinds[at + 2] in {"{", "["}

    def _constraint(self) -> syntax.FieldConstraint:
        start = self.i
        path = self.dotted("a field")
        if self.texts[self.i] == "in":
            self.i += 1
            if self.accept("{"):
                return syntax.FieldConstraint(path, "in {}", self._set(), self.since(start))
            if self.accept("["):
                return syntax.FieldConstraint(path, "in []", self._interval(), self.since(start))
            raise self.fail("`{` or `[` after `in`", "write `in {rgb8, bgr8}` or `in [0, 10]`")
        if self.kinds[self.i] not in _COMPARISONS:
            raise self.fail(f"a comparison after `{path.text}`", "one of `=`, `<`, `<=`, `>`, `>=` and `in`")
        operator, sign = self.take()
        if operator == "==":
            self.reporter.report("E132", sign, "`==` is not a comparison operator here", help="write `=`")
            operator = "="
        elif operator == "!=":
            self.reporter.report("E132", sign, "`!=` is not supported", help="list the allowed values: `in {…}`")
        value = self.scalar(f"a value for `{path.text}`")
        if operator not in {"=", "!="} and (isinstance(value.value, (str, bool))):
            message = f"`{operator}` compares numbers, but `{value.span.text}` is not a number"
            self.reporter.report("E132", value.span, message, help="write `=` or `in {…}`")
            operator = "="
        return syntax.FieldConstraint(path, operator, (value,), self.since(start))

    def _set(self) -> tuple[syntax.ScalarValue, ...]:
        values: list[syntax.ScalarValue] = []
        for _ in self.items("}"):
            if values and (self.kinds[self.i] not in {"name", "string", "number"} or self.is_keyword(self.i)):
                panic = self.fail("`}` to close the set of values")
                if self.kinds[self.i] == "name":
                    break  # the next statement starts here: the brace is missing
                raise panic
            values.append(self.scalar("a value"))
        return tuple(values)

    def _interval(self) -> tuple[syntax.ScalarValue, ...]:
        low = self.number("the lower end")
        self.accept(",")
        self.layout.items.add(self.i)
        high = self.number("the upper end")
        self.expect("]", "to close the interval", ("name", "}", "{"))
        return (syntax.ScalarValue(low.value, low.span), syntax.ScalarValue(high.value, high.span))

    # -- values -------------------------------------------------------------------------------------------

    def dotted(self, what: str) -> syntax.Name:
        """``header.frame_id``."""
        start = self.i
        if self.kinds[self.i] != "name":
            raise self.fail(what)
        self.i += 1
        while self.kinds[self.i] == "." and self.kinds[self.i + 1] == "name":
            self.i += 2
        return syntax.Name("".join(self.texts[start : self.i]), self.since(start))

    def scalar(self, what: str) -> syntax.ScalarValue:
        """A number, a string, ``true`` or ``false``, or a bare word, which is a string."""
        kind, text = self.kinds[self.i], self.texts[self.i]
        if kind == "number":
            whole = _INTEGER.fullmatch(text) is not None
            number = self.number(what)
            value: Scalar = number.value
            if whole:  # a float does not have every integer from 2**53 on
                value = int(number.value) if abs(number.value) < 2**53 else int(text)
            return syntax.ScalarValue(value, number.span)
        if kind == "string":
            return syntax.ScalarValue(*self.text(what))
        if kind not in {"name", "path"} or self.is_keyword(self.i):
            raise self.fail(what)
        return syntax.ScalarValue(text == "true" if text in {"true", "false"} else text, self.take().span)

    def _number_or_scalar(self, what: str) -> syntax.ScalarValue:
        """A scalar, or a number that is not finite."""
        if self.kinds[self.i] in {"name", "number"} and self.texts[self.i] in _NOT_FINITE:
            text, span = self.take()
            return syntax.ScalarValue(_NOT_FINITE[text], span)
        return self.scalar(what)

    def parameter_value(self) -> syntax.Value:
        """A scalar, or a list of scalars of one type."""
        start = self.i
        if not self.accept("["):
            return syntax.Value(*self._number_or_scalar("a value"))
        listed = [self._number_or_scalar("a value, or `]` to close the list") for _ in self.items("]")]
        values = [value.value for value in listed]
        kinds = {type(value) for value in values}
        if kinds == {int, float}:
            values = [float(value) for value in values]
        elif len(kinds) > 1:
            message = "a list cannot mix types: use only numbers, only strings or only booleans"
            odd = next(value for value in listed if type(value.value) is not type(listed[0].value))
            self.reporter.report("E134", odd.span, message)
        result: ParameterValue = values  # type: ignore[assignment]  # of one type: checked above
        return syntax.Value(result, self.since(start))

    def parameters(self, first: int, entries: list[syntax.ParameterEntry], files: list[syntax.Name]) -> frozenset[str]:
        """``parameters { name = value … }``, or ``parameters for all { … }``, or ``parameters "file.yaml"``."""
        if self.kinds[self.i] == "string":
            files.append(self.text("a ROS parameter file name"))
            return frozenset()
        for_all = self.accept_word("for")
        if for_all:
            self.expect_word("all", "after `parameters for`")

        def entry() -> bool:
            if self.kinds[self.i] != "name":
                return False
            if self.is_keyword(self.i) and self.kinds[self.i + 1] not in {"=", "."}:
                return False
            changeable = self.kinds[self.i + 1] == "name" and self.accept_word("changeable")
            if self.kinds[self.i + 1] == "name" and nearest(self.texts[self.i], ["changeable"]):
                self.fail("a parameter name", "did you mean `changeable`?")
                self.i += 1
                changeable = True
            name = self.dotted("a parameter name")
            self.expect("=", f"after `{name.text}`", ("name", "number", "string", "["))
            value = self.parameter_value()
            entries.append(syntax.ParameterEntry(name, value, changeable, len(files), for_all))
            if self.texts[self.i] in {*HERTZ, *SECONDS} and self.kinds[self.i + 1] not in {"=", ":", "."}:
                help = f"write `{name.text} = {value.span.text}`; the node defines the unit"
                self.reporter.report("E120", self.span(), "a parameter value cannot have a unit", help=help)
                self.i += 1
            return True

        if self.kinds[self.i] != "{":
            if for_all:
                raise self.fail("`{` after `parameters for all`")
            raise self.fail("`{` or a parameter file name in double quotes after `parameters`")
        return self.block("the parameters", first, {}, entry, ", ")

"""Parsing of contracts (types, rates, QoS profiles, field constraints) and of plain values."""

from __future__ import annotations

import re
from typing import Final

from midstride.lang.blocks import BlockParser
from midstride.lang.lexer import string_value
from midstride.lang.syntax import (
    ContractExpression,
    FieldConstraint,
    Name,
    Number,
    ParameterEntry,
    QoSPolicy,
    ScalarValue,
    Value,
)
from midstride.lang.token_stream import RESERVED, Panic
from midstride.model.component import ParameterValue
from midstride.model.contract import Scalar
from midstride.model.near_miss import nearest

HERTZ: Final = {"Hz": 1.0, "kHz": 1000.0}
SECONDS: Final = {"s": 1.0, "ms": 0.001, "us": 0.000001, "min": 60.0}

_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*/(msg/)?[A-Za-z][A-Za-z0-9_]*")
_COMPARISONS: Final = frozenset({"=", "<", "<=", ">", ">=", "==", "!="})
_INTEGER: Final = re.compile(r"[+-]?[0-9]+")
_INT64: Final = 2**63


class ContractParser(BlockParser):
    """The part of the parser for contracts and values."""

    def contract(self, what: str) -> ContractExpression:
        """``TYPE or NAME [@ r Hz] [qos(…)] [where …]``, or ``nothing``."""
        start = self.i
        base = self._base(what)
        rate: Number | None = None
        qos: tuple[QoSPolicy, ...] = ()
        where: tuple[FieldConstraint, ...] = ()
        stated: set[str] = set()
        while True:
            kind = self.kinds[self.i]
            word = "rate" if kind == "@" else self.texts[self.i] if kind == "name" else ""
            if word == "where" or word == "rate" or (word == "qos" and self.kinds[self.i + 1] == "("):
                if word in stated:
                    shown = "rate" if word == "rate" else f"`{word}`"
                    self.reporter.report(
                        "E128", self.span(), f"this contract already has a {shown}", help="keep one of them"
                    )
                stated.add(word)
                self.i += 1
                if word == "rate":
                    rate = self.rate()
                elif word == "qos":
                    qos = self._qos()
                else:
                    where = self._where()
            elif kind == "number" and "rate" not in stated and self.texts[self.i + 1] in HERTZ:
                message = "expected `@` before the rate"
                self.reporter.report(
                    "E120", self.span(), message, help=f"write `@ {self.texts[self.i]} {self.texts[self.i + 1]}`"
                )
                stated.add("rate")
                rate = self.rate()
            else:
                return ContractExpression(self.since(start), base, rate, qos, where)

    def _base(self, what: str) -> Name | None:
        if self.kinds[self.i] == "path":
            text, span = self.texts[self.i], self.span()
            if not _TYPE.fullmatch(text):
                help = "message types are written `pkg/msg/Type` or `pkg/Type`"
                self.reporter.report("E133", span, f"`{text}` is not a message type", help=help)
                self.i += 1
                raise Panic
            self.i += 1
            return Name(text, span)
        if self.kinds[self.i] == "name" and self.texts[self.i] not in RESERVED:
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
                return None if parts[0] == "nothing" else Name(parts[0], self.span(start))
            help = f"write `{'/'.join(parts)}`" if len(parts) <= 3 else "message types are written `pkg/msg/Type`"
            message = f"`{self.since(start).text}` is not a message type"
            self.reporter.report("E133", self.since(start), message, help=help)
            raise Panic
        raise self.fail(f"a message type or contract name {what}")

    def rate(self) -> Number:
        number = self.quantity("a rate", HERTZ)
        if number.value <= 0:
            self.reporter.report(
                "E126", number.span, "a rate must be greater than 0 Hz", help="omit the rate if none is required"
            )
            return Number(1.0, number.span)
        return number

    def seconds(self, what: str) -> Number:
        return self.quantity(what, SECONDS)

    def _qos(self) -> tuple[QoSPolicy, ...]:
        self.expect("(", "after `qos`")
        policies: list[QoSPolicy] = []
        while not self.accept(")"):
            if policies:
                self.accept(",")
                if self.accept(")"):
                    break
                self.layout.items.add(self.i)
            name = self.name("a QoS policy" if not policies else "`,` or `)` in the QoS profile", ("=",))
            self.expect("=", f"after `{name.text}`", ("name", "number"))
            value = self.scalar(f"a value for `{name.text}`")
            unit = None
            if (
                (self.kinds[self.i] == "name" and self.kinds[self.i + 1] not in {"=", "name", "number", "string"})
                or self.at_word("s")
                or self.at_word("ms")
            ):
                unit = Name(self.texts[self.i], self.span())
                self.i += 1
            policies.append(QoSPolicy(name, value, unit))
        return tuple(policies)

    def _where(self) -> tuple[FieldConstraint, ...]:
        found: list[FieldConstraint] = []
        while True:
            if found:
                at = self.i + (self.kinds[self.i] == ",")
                if not self._constraint_at(at):
                    return tuple(found)
                self.i = at
                self.layout.items.add(at)
            found.append(self._constraint())

    def _constraint_at(self, at: int) -> bool:
        """Whether a field constraint begins at the token ``at``: dotted names, then a comparison."""
        if self.kinds[at] != "name":
            return False
        while self.kinds[at + 1] == "." and self.kinds[at + 2] == "name":
            at += 2
        if self.kinds[at + 1] in _COMPARISONS:
            return True
        return self.texts[at + 1] == "in" and self.kinds[at + 2] in {"{", "["}

    def _constraint(self) -> FieldConstraint:
        start = self.i
        path = self.dotted("a field")
        operator, sign = self.texts[self.i], self.span()
        if operator == "in":
            self.i += 1
            if self.kinds[self.i] not in {"{", "["}:
                raise self.fail("`{` or `[` after `in`", "write `in {rgb8, bgr8}` or `in [0, 10]`")
            values = self._set() if self.kinds[self.i] == "{" else self._interval()
            operator = "in []" if len(values) == 2 and self.kinds[self.i - 1] == "]" else "in {}"
            return FieldConstraint(path, operator, values, self.since(start))
        if self.kinds[self.i] not in _COMPARISONS:
            raise self.fail(f"a comparison after `{path.text}`", "one of `=`, `<`, `<=`, `>`, `>=` and `in`")
        self.i += 1
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
        return FieldConstraint(path, operator, (value,), self.since(start))

    def _set(self) -> tuple[ScalarValue, ...]:
        self.i += 1
        values: list[ScalarValue] = []
        while not self.accept("}"):
            if values:
                self.accept(",")
                if self.accept("}"):
                    break
                if self.kinds[self.i] not in {"name", "string", "number"} or self.texts[self.i] in RESERVED:
                    panic = self.fail("`}` to close the set of values")
                    if self.kinds[self.i] == "name":
                        break  # the next statement starts here: the brace is missing
                    raise panic
                self.layout.items.add(self.i)
            values.append(self.scalar("a value"))
        return tuple(values)

    def _interval(self) -> tuple[ScalarValue, ...]:
        self.i += 1
        low = self.number("the lower end")
        self.accept(",")
        self.layout.items.add(self.i)
        high = self.number("the upper end")
        self.expect("]", "to close the interval", ("name", "}", "{"))
        return (ScalarValue(low.value, low.span), ScalarValue(high.value, high.span))

    # -- values -------------------------------------------------------------------------------------------

    def dotted(self, what: str) -> Name:
        """``header.frame_id``."""
        start = self.i
        if self.kinds[self.i] != "name":
            raise self.fail(what)
        self.i += 1
        while self.kinds[self.i] == "." and self.kinds[self.i + 1] == "name":
            self.i += 2
        if self.i == start + 1:
            return Name(self.texts[start], self.span(start))
        return Name("".join(self.texts[start : self.i]), self.since(start))

    def scalar(self, what: str) -> ScalarValue:
        """A number, a string, ``true`` or ``false``, or a bare word, which is a string."""
        kind, text = self.kinds[self.i], self.texts[self.i]
        if kind == "number":
            whole = _INTEGER.fullmatch(text) is not None
            number = self.number(what)
            value: Scalar = int(number.value) if whole and abs(number.value) < 2**53 else number.value
            if whole and abs(number.value) >= 2**53 and len(text) <= 20:
                value = int(text)
                if not -_INT64 <= value < _INT64:
                    self.reporter.report("E126", number.span, "integers have at most 64 bits")
            return ScalarValue(value, number.span)
        if kind == "string":
            self.i += 1
            return ScalarValue(string_value(text), self.span(self.i - 1))
        if kind in {"name", "path"} and (text not in RESERVED or kind == "path"):
            self.i += 1
            return ScalarValue(text == "true" if text in {"true", "false"} else text, self.span(self.i - 1))
        raise self.fail(what)

    def parameter_value(self) -> Value:
        """A scalar, or a list of scalars of one type."""
        if self.kinds[self.i] != "[":
            scalar = self.scalar("a value")
            return Value(scalar.value, scalar.span)
        start = self.i
        self.i += 1
        listed: list[ScalarValue] = []
        while not self.accept("]"):
            if listed:
                self.accept(",")
                if self.accept("]"):
                    break
                self.layout.items.add(self.i)
            listed.append(self.scalar("a value, or `]` to close the list"))
        values: list[Scalar] = [value.value for value in listed]
        kinds = {type(value) for value in values}
        if kinds == {int, float}:
            values = [float(value) for value in values]
        elif len(kinds) > 1:
            message = "a list cannot mix types: use only numbers, only strings or only booleans"
            odd = next(value for value in listed if type(value.value) is not type(listed[0].value))
            self.reporter.report("E134", odd.span, message)
        result: ParameterValue = values  # type: ignore[assignment]  # of one type: checked above
        return Value(result, self.since(start))

    def parameters(self, entries: list[ParameterEntry], files: list[Name]) -> frozenset[str]:
        """``parameters { name = value … }`` or ``parameters "file.yaml"``."""
        first = self.i
        self.i += 1
        if self.kinds[self.i] == "string":
            files.append(self.text("a ROS parameter file name"))
            return frozenset()

        def entry() -> bool:
            if self.kinds[self.i] != "name":
                return False
            if self.texts[self.i] in RESERVED and self.kinds[self.i + 1] not in {"=", "."}:
                return False
            changeable = self.kinds[self.i + 1] == "name" and self.accept_word("changeable")
            if self.kinds[self.i + 1] == "name" and nearest(self.texts[self.i], ["changeable"]):
                self.fail("a parameter name", "did you mean `changeable`?")
                self.i += 1
                changeable = True
            name = self.dotted("a parameter name")
            self.expect("=", f"after `{name.text}`", ("name", "number", "string", "["))
            value = self.parameter_value()
            entries.append(ParameterEntry(name, value, changeable))
            if self.texts[self.i] in {*HERTZ, *SECONDS} and self.kinds[self.i + 1] not in {"=", ":", "."}:
                help = f"write `{name.text} = {value.span.text}`; the node defines the unit"
                self.reporter.report("E120", self.span(), "a parameter value cannot have a unit", help=help)
                self.i += 1
            return True

        if self.kinds[self.i] != "{":
            raise self.fail("`{` or a parameter file name in double quotes after `parameters`")
        return self.block("the parameters", first, {}, entry, ", ")

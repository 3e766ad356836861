"""The expressions of ``$(eval …)``, a subset of Python that computes with text, numbers, lists and sets.

A launch file may be a stranger's, so it is not Python that evaluates it: names other than the functions here,
attributes other than a few methods of text, and results beyond the limits are refused.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, Final

from midstride.launch_files.findings import UnknownValue

MAX_TEXT: Final = 20_000
MAX_SIZE: Final = 100_000
MAX_EXPONENT: Final = 64
MAX_BITS: Final = 256

_BINARY: Final[dict[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_UNARY: Final[dict[type[ast.unaryop], Callable[[Any], Any]]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_COMPARE: Final[dict[type[ast.cmpop], Callable[[Any, Any], Any]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
    ast.Is: operator.eq,
    ast.IsNot: operator.ne,
}
_MATH: Final = {
    name: getattr(math, name)
    for name in "acos asin atan atan2 ceil cos degrees exp fabs floor fmod hypot log log10 log2 radians sin sqrt tan "
    "trunc pi e tau".split()
}
_NAMES: Final[dict[str, Any]] = {
    **{each.__name__: each for each in (abs, bool, float, int, len, list, max, min, round, sorted, str, sum, any, all)},
    **_MATH,
    "math": _MATH,
    "set": frozenset,
}
_METHODS: Final = frozenset(
    "capitalize count endswith find index isdigit join lower lstrip replace rstrip split startswith strip title "
    "upper".split()
)
_OF_SETS: Final = frozenset("difference intersection issubset issuperset union".split())


def evaluate(text: str, names: Mapping[str, Any] | None = None) -> str:
    """The value of an expression as text. ``names``: what it may use beside the functions. Raises UnknownValue."""
    if len(text) > MAX_TEXT:
        raise UnknownValue("the expression is too long")
    try:
        return _shown(_bounded(_value(ast.parse(text.strip(), mode="eval").body, {**_NAMES, **(names or {})})))
    except UnknownValue:
        raise
    except (SyntaxError, ValueError, TypeError, ArithmeticError, LookupError, RecursionError, MemoryError) as error:
        raise UnknownValue(f"the expression `{shortened(text)}` has no value ({type(error).__name__})") from None


def _value(node: ast.expr, names: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=str() | bool() | int() | float() | None as value):
            return value
        case ast.List(elts=elements):
            return [_value(element, names) for element in elements]
        case ast.Tuple(elts=elements):
            return tuple(_value(element, names) for element in elements)
        case ast.Set(elts=elements):
            return frozenset(_value(element, names) for element in elements)
        case ast.Name(id=name) if name in names:
            if isinstance(names[name], UnknownValue):
                raise names[name]
            return names[name]
        case ast.BoolOp(op=op, values=values):
            stop = isinstance(op, ast.Or)
            result: Any = None
            for each in values:
                result = _value(each, names)
                if bool(result) is stop:
                    break
            return result
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            return _UNARY[type(op)](_value(operand, names))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _bounded(_computed(op, _value(left, names), _value(right, names)))
        case ast.Compare(left=first, ops=ops, comparators=others) if all(type(op) in _COMPARE for op in ops):
            values = [_value(each, names) for each in (first, *others)]
            return all(_COMPARE[type(op)](values[i], values[i + 1]) for i, op in enumerate(ops))
        case ast.IfExp(test=test, body=body, orelse=otherwise):
            return _value(body if _value(test, names) else otherwise, names)
        case ast.Subscript(value=of, slice=ast.Slice(lower=lower, upper=upper, step=step)):
            return _value(of, names)[
                slice(*(None if each is None else _value(each, names) for each in (lower, upper, step)))
            ]
        case ast.Subscript(value=of, slice=index):
            return _value(of, names)[_value(index, names)]
        case ast.Attribute(value=ast.Name(id="math"), attr=name) if name in _MATH:
            return _MATH[name]
        case ast.Call(func=ast.Attribute(value=of, attr=method), args=arguments, keywords=[]) if method in _METHODS:
            text, values = _value(of, names), [_value(each, names) for each in arguments]
            if isinstance(text, str):
                return _bounded(_called(text, method, values))
        case ast.Call(func=ast.Attribute(value=of, attr=method), args=arguments, keywords=[]) if method in _OF_SETS:
            members = _value(of, names)
            if isinstance(members, frozenset):
                return getattr(members, method)(*(_value(each, names) for each in arguments))
        case ast.Call(func=function, args=arguments, keywords=[]):
            called = _value(function, names)
            if callable(called):
                return _bounded(called(*(_value(each, names) for each in arguments)))
    raise UnknownValue(f"`{shortened(ast.unparse(node))}` is not among the expressions that are evaluated here")


def _shown(value: Any) -> str:
    """The text that Python writes for ``value``, but with the elements of a set in order, not in any."""
    if isinstance(value, frozenset):
        return f"{{{', '.join(sorted(map(repr, value)))}}}" if value else "set()"
    return str(value)


def _called(text: str, method: str, values: list[Any]) -> Any:
    if method == "replace" and text.count(values[0]) * len(values[1]) > MAX_SIZE:
        raise UnknownValue("a value of the expression is too large")
    if method == "join" and len(text) * len(values[0]) > MAX_SIZE:
        raise UnknownValue("a value of the expression is too large")
    return getattr(text, method)(*values)


def _computed(op: ast.operator, left: Any, right: Any) -> Any:
    numbers = isinstance(left, (int, float)) and isinstance(right, (int, float))
    if not numbers and not (
        (isinstance(op, ast.Add) and type(left) is type(right))
        or (isinstance(op, ast.Mult) and _size(left) * _size(right) <= MAX_SIZE)
    ):
        raise UnknownValue("the expression computes what is not evaluated here")  # such as text formatting by `%`
    if isinstance(op, ast.Pow) and not abs(right) <= MAX_EXPONENT:
        raise UnknownValue("an exponent of the expression is too large")
    return _BINARY[type(op)](left, right)


def _size(value: Any) -> int:
    """The number of characters and members in a value; for a number, the number of repetitions that it causes."""
    if isinstance(value, (list, tuple, frozenset)):
        return len(value) + sum(_size(each) for each in value if not isinstance(each, (int, float)))
    return len(value) if isinstance(value, str) else abs(value) if isinstance(value, int) else 1


def _bounded(value: Any) -> Any:
    large = isinstance(value, (str, list, tuple, frozenset)) and _size(value) > MAX_SIZE
    if large or (isinstance(value, int) and value.bit_length() > MAX_BITS):
        raise UnknownValue("a value of the expression is too large")
    if callable(value) or isinstance(value, dict):
        raise UnknownValue("the expression has a function as its value")
    return value


def shortened(text: str) -> str:
    """``text`` for a message."""
    return text if len(text) <= 80 else text[:79] + "…"

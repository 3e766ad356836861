"""Formulas as SMT-LIB text, over sorts of any size or over a few named elements.

A formula is written once, as a Python function of a :class:`Logic`. Without sizes, its quantifiers range over
uninterpreted sorts: unsatisfiable means unsatisfiable in systems of any size. With sizes, each sort has that many
elements and quantifiers are expanded: a model is also one of the unbounded form, and can be shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count, product
from typing import TypeAlias

Term: TypeAlias = str
TRUE, FALSE = "true", "false"


def app(name: str, *arguments: Term) -> Term:
    return f"({name} {' '.join(arguments)})" if arguments else name


def not_(term: Term) -> Term:
    if term in (TRUE, FALSE):
        return FALSE if term == TRUE else TRUE
    return app("not", term)


def _joined(name: str, terms: Iterable[Term], neutral: Term, absorbing: Term) -> Term:
    kept = [term for term in dict.fromkeys(terms) if term != neutral]
    if absorbing in kept:
        return absorbing
    if len(kept) < 2:
        return kept[0] if kept else neutral
    return app(name, *kept)


def and_(*terms: Term) -> Term:
    return _joined("and", terms, TRUE, FALSE)


def or_(*terms: Term) -> Term:
    return _joined("or", terms, FALSE, TRUE)


def implies(premise: Term, conclusion: Term) -> Term:
    return or_(not_(premise), conclusion) if FALSE in (premise, conclusion) else app("=>", premise, conclusion)


def equal(left: Term, right: Term) -> Term:
    return TRUE if left == right else app("=", left, right)


def if_(condition: Term, then: Term, otherwise: Term) -> Term:
    return app("ite", condition, then, otherwise)


class Logic:
    """The declarations of a script, and its quantifiers. ``sizes``: the number of elements of each sort, or any."""

    def __init__(self, sorts: Sequence[str], sizes: Mapping[str, int] | None = None) -> None:
        self.sorts, self.sizes = tuple(sorts), sizes
        self.declared: dict[str, tuple[tuple[str, ...], str]] = {}
        self.facts: list[Term] = []
        self._fresh = count(1)

    @property
    def bounded(self) -> bool:
        return self.sizes is not None

    def elements(self, sort: str) -> list[Term]:
        """The elements of a bounded sort."""
        assert self.sizes is not None
        return [f"{sort.lower()}_{number}" for number in range(1, self.sizes[sort] + 1)]

    def function(self, name: str, arguments: Sequence[str], result: str) -> Callable[..., Term]:
        """Declare a function (or, without arguments, a constant); the result applies it."""
        self.declared[name] = (tuple(arguments), result)
        return lambda *terms: app(name, *terms)

    def constant(self, name: str, sort: str) -> Term:
        return self.function(name, (), sort)()

    def all(self, sorts: Sequence[str], body: Callable[..., Term]) -> Term:
        return self._quantified("forall", and_, sorts, body)

    def some(self, sorts: Sequence[str], body: Callable[..., Term]) -> Term:
        return self._quantified("exists", or_, sorts, body)

    def _quantified(
        self, name: str, expanded: Callable[..., Term], sorts: Sequence[str], body: Callable[..., Term]
    ) -> Term:
        if self.bounded:
            return expanded(*(body(*chosen) for chosen in product(*map(self.elements, sorts))))
        variables = [f"{sort[0].lower()}{next(self._fresh)}" for sort in sorts]
        inside = body(*variables)
        if inside in (TRUE, FALSE):
            return inside  # a sort is never empty
        bound = " ".join(f"({variable} {sort})" for variable, sort in zip(variables, sorts, strict=True))
        return f"({name} ({bound}) {inside})"

    def number(self, sort: str, holds: Callable[[Term], Term]) -> Term:
        """The number of elements of a bounded sort for which ``holds`` is true."""
        return app("+", "0", *(if_(holds(element), "1", "0") for element in self.elements(sort)))

    def script(self, assertions: Mapping[str, Term]) -> str:
        """Declarations, facts and named assertions as SMT-LIB text, without ``check-sat``."""
        lines = ["(set-logic ALL)"]
        for sort in self.sorts:
            if self.bounded:
                lines.append(f"(declare-datatypes (({sort} 0)) (({' '.join(f'({e})' for e in self.elements(sort))})))")
            else:
                lines.append(f"(declare-sort {sort} 0)")
        for name, (arguments, result) in self.declared.items():
            lines.append(f"(declare-fun {name} ({' '.join(arguments)}) {result})")
        lines += [f"(assert {fact})" for fact in self.facts]
        for name, term in assertions.items():
            lines += [f"; {name}", f"(assert {term})"]
        return "\n".join(lines) + "\n"

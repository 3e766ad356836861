"""The rules that every well-formed system obeys (docs/semantics.md, sections 1 and 2), by name."""

from __future__ import annotations

from midstride.verify.prove.terms import and_, app, equal, implies, not_, or_
from midstride.verify.prove.theory import (
    ASSUMPTION,
    COMPONENT,
    FUNCTIONALITY,
    MODE,
    OFFER,
    PORT,
    PREDICATE,
    RESOURCE,
    TOPIC,
    Part,
    Theory,
)


def rules(t: Theory) -> list[Part]:
    """The rules, as named formulas."""
    logic = t.logic
    sat, nothing, better, whose = t.satisfies, t.nothing, t.better, t.whose
    satisfaction = and_(
        logic.all((PREDICATE,), lambda q: not_(sat(nothing, q))),
        logic.all((PREDICATE,), lambda q: or_(equal(q, nothing), sat(q, q))),
        logic.all((PREDICATE,) * 3, lambda p, q, r: implies(and_(sat(p, q), sat(q, r)), sat(p, r))),
    )
    declared = and_(
        logic.all((PORT,), lambda p: implies(t.is_output(p), equal(t.host(t.owner(p)), t.component(p)))),
        logic.all(
            (FUNCTIONALITY, PORT),
            lambda f, p: implies(t.uses(f, p), and_(not_(t.is_output(p)), equal(t.component(p), t.host(f)))),
        ),
        logic.all((OFFER, TOPIC), lambda e, k: implies(t.is_free(e), not_(t.offered_on(e, k)))),
        logic.all((COMPONENT, RESOURCE), lambda c, r: app(">=", t.holds(c, r), "0.0")),
    )
    named = logic.all(
        (MODE, ASSUMPTION, PORT),
        lambda m, a, p: implies(and_(t.assumes(m, a), t.is_named(a), t.names(a, p)), t.uses(whose(m), p)),
    )
    chains = and_(
        logic.all((MODE,), lambda m: not_(better(m, m))),
        logic.all((MODE,) * 3, lambda m, n, o: implies(and_(better(m, n), better(n, o)), better(m, o))),
        logic.all((MODE, MODE), lambda m, n: implies(better(m, n), equal(whose(m), whose(n)))),
        logic.all(
            (MODE, MODE), lambda m, n: implies(equal(whose(m), whose(n)), or_(equal(m, n), better(m, n), better(n, m)))
        ),
        logic.all((FUNCTIONALITY,), lambda f: and_(equal(whose(t.normal(f)), f), equal(whose(t.last(f)), f))),
        logic.all((MODE,), lambda m: not_(better(m, t.normal(whose(m))))),
        logic.all((MODE,), lambda m: not_(better(t.last(whose(m)), m))),
    )
    m1 = logic.all((FUNCTIONALITY, ASSUMPTION), lambda f, a: not_(t.assumes(t.last(f), a)))
    m2 = logic.all(
        (MODE, MODE, PORT, PREDICATE),
        lambda m, n, p, q: implies(
            and_(t.is_output(p), equal(t.owner(p), whose(m)), better(m, n), sat(t.guarantee(n, p), q)),
            sat(t.guarantee(m, p), q),
        ),
    )
    return [
        Part("satisfaction is a preorder, and `nothing` satisfies nothing", satisfaction),
        Part("ports, functionalities and offers are well-formed", declared),
        Part("an assumption names associated inputs", named),
        Part("modes form chains", chains),
        Part("M1", m1),
        Part("M2", m2),
    ]

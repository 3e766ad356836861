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
    Parts,
    Theory,
)


def rules(t: Theory) -> Parts:
    """The rules, as named formulas."""
    sat, nothing, better, whose = t.satisfies, t.nothing, t.better, t.whose
    satisfaction = and_(
        t.all((PREDICATE,), lambda q: not_(sat(nothing, q))),
        t.all((PREDICATE,), lambda q: or_(equal(q, nothing), sat(q, q))),
        t.all((PREDICATE,) * 3, lambda p, q, r: implies(and_(sat(p, q), sat(q, r)), sat(p, r))),
    )
    declared = and_(
        t.all((PORT,), lambda p: implies(t.is_output(p), equal(t.host(t.owner(p)), t.component(p)))),
        t.all(
            (FUNCTIONALITY, PORT),
            lambda f, p: implies(t.uses(f, p), and_(not_(t.is_output(p)), equal(t.component(p), t.host(f)))),
        ),
        t.all((OFFER, TOPIC), lambda e, k: implies(t.is_free(e), not_(t.offered_on(e, k)))),
        t.all((COMPONENT, RESOURCE), lambda c, r: app(">=", t.holds(c, r), "0.0")),
    )
    named = t.all(
        (MODE, ASSUMPTION, PORT),
        lambda m, a, p: implies(and_(t.assumes(m, a), t.is_named(a), t.names(a, p)), t.uses(whose(m), p)),
    )
    chains = and_(
        t.all((MODE,), lambda m: not_(better(m, m))),
        t.all((MODE,) * 3, lambda m, n, o: implies(and_(better(m, n), better(n, o)), better(m, o))),
        t.all((MODE, MODE), lambda m, n: implies(better(m, n), equal(whose(m), whose(n)))),
        t.all(
            (MODE, MODE), lambda m, n: implies(equal(whose(m), whose(n)), or_(equal(m, n), better(m, n), better(n, m)))
        ),
        t.all((FUNCTIONALITY,), lambda f: and_(equal(whose(t.normal(f)), f), equal(whose(t.last(f)), f))),
        t.all((MODE,), lambda m: not_(better(m, t.normal(whose(m))))),
        t.all((MODE,), lambda m: not_(better(t.last(whose(m)), m))),
    )
    m1 = t.all((FUNCTIONALITY, ASSUMPTION), lambda f, a: not_(t.assumes(t.last(f), a)))
    m2 = t.all(
        (MODE, MODE, PORT, PREDICATE),
        lambda m, n, p, q: implies(
            and_(t.is_output(p), equal(t.owner(p), whose(m)), better(m, n), sat(t.guarantee(n, p), q)),
            sat(t.guarantee(m, p), q),
        ),
    )
    return {
        "satisfaction is a preorder, and `nothing` satisfies nothing": satisfaction,
        "ports, functionalities and offers are well-formed": declared,
        "an assumption names associated inputs": named,
        "modes form chains": chains,
        "M1": m1,
        "M2": m2,
    }

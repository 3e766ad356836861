"""F2 and F3 (docs/semantics.md, section 5), for structures of any size.

That ``best`` is the greatest valid assignment is proved as an invariant of its algorithm: it starts above every valid
assignment, each lowering stays above, it can continue while any functionality is unsatisfied, and its result is valid.
It terminates because each lowering is strict and chains are finite, which first-order logic cannot express.
"""

from __future__ import annotations

from collections.abc import Callable

from midstride.verify.prove.goals import Case, Goal, active
from midstride.verify.prove.terms import Term, and_, equal, if_, implies, not_
from midstride.verify.prove.theory import FUNCTIONALITY, MODE, PORT, SATISFIED, TOPIC, State, Theory


def _assignment(t: Theory, s: State, tag: str) -> State:
    """Another assignment of modes to the same structure."""
    return s.in_modes(t.assignment(f"mode_{tag}"))


def _better_of(t: Theory, s: State, a: State, b: State) -> State:
    """``s`` with each functionality in the better one of its modes in ``a`` and ``b``."""
    return s.in_modes(lambda f: if_(t.at_least(a.mode(f), b.mode(f)), a.mode(f), b.mode(f)))


def _no_less(t: Theory, less: State, attached: Callable[..., Term]) -> Term:
    return t.all((PORT, TOPIC), lambda p, k: implies(less.attached(p, k), attached(p, k)))


def _above(t: Theory, upper: State, lower: State) -> Term:
    return t.all((FUNCTIONALITY,), lambda f: implies(t.live_in(lower, f), t.at_least(upper.mode(f), lower.mode(f))))


def _closed(t: Theory) -> Case:
    a = t.start("one")
    b = _assignment(t, a, "other")
    join = _better_of(t, a, a, b)
    premises = {"the first is satisfied": t.all_satisfied(a), "the second is satisfied": t.all_satisfied(b)}
    return Case(t.structure_valid(a), premises, t.valid(join), (a, b, join), active(t, join))


def _start(t: Theory) -> Case:
    a = t.start("valid")
    normal = a.in_modes(t.normal)
    return Case(t.valid(a), {}, {"all normal modes are no worse": _above(t, normal, a)}, (a, normal), active(t, a))


def _lowering(t: Theory) -> tuple[State, State, Term, Term]:
    a = t.start("valid")
    b = _assignment(t, a, "reached")
    f = t.constant("the_functionality", FUNCTIONALITY)
    m = t.constant("the_mode", MODE)
    return a, b, f, m


def _lowered(t: Theory) -> Case:
    a, b, f, m = _lowering(t)
    t.facts += [equal(t.whose(m), f), t.at_least(b.mode(f), m), a.live(t.host(f))]
    first = t.all(
        (MODE,),
        lambda n: implies(
            and_(equal(t.whose(n), f), t.at_least(b.mode(f), n), t.better(n, m)), not_(t.mode_satisfied(b, f, n))
        ),
    )
    premises = {
        "a valid assignment is no better than the current one": _above(t, b, a),
        "that assignment is valid": t.all_satisfied(a),
        "no mode in between is satisfied": first,
    }
    after = b.in_modes(lambda g: if_(equal(g, f), m, b.mode(g)))
    occurs = and_(active(t, a), not_(equal(m, b.mode(f))))
    return Case({}, premises, {"it is no better than the result": _above(t, after, a)}, (a, b, after), occurs)


def _goes_on(t: Theory) -> Case:
    _, b, f, _ = _lowering(t)
    strictly = t.some((MODE,), lambda n: and_(t.better(b.mode(f), n), t.mode_satisfied(b, f, n)))
    premises = {"it is unsatisfied": not_(t.satisfied(b, f))}
    return Case({}, premises, {"a strictly worse mode of it is satisfied": strictly}, (b,))


def _end(t: Theory) -> Case:
    a, b, _, _ = _lowering(t)
    premises = {
        SATISFIED: t.all_satisfied(b),
        "the structure is valid": and_(*t.structure_valid(a).values()),
        "every valid assignment is no better": _above(t, b, a),
    }
    conclusion = {**t.valid(b), "it is no worse than any valid assignment": _above(t, b, a)}
    return Case({}, premises, conclusion, (a, b), active(t, b))


def _unique(t: Theory) -> Case:
    a = t.start("one")
    b = _assignment(t, a, "other")
    premises = {
        "the first is no worse than the second": _above(t, a, b),
        "the second is no worse than the first": _above(t, b, a),
    }
    same = t.all((FUNCTIONALITY,), lambda f: implies(t.live_in(a, f), equal(a.mode(f), b.mode(f))))
    return Case({}, premises, {"they are the same": same}, (a, b), active(t, a))


def _more(t: Theory) -> Case:
    s = t.start()
    attached = t.function("attached_after", (PORT, TOPIC), "Bool")
    after = t.state("after", s.live, attached, s.mode)
    f = t.constant("the_functionality", FUNCTIONALITY)
    premises = {"no attachment is removed": _no_less(t, s, attached), "it was satisfied": t.satisfied(s, f)}
    t.facts.append(s.live(t.host(f)))
    return Case({}, premises, {"it is satisfied": t.satisfied(after, f)}, (s, after), active(t, s))


def _grows(t: Theory) -> Case:
    """`best` of the larger structure is no worse than this join, so it is no worse than `best` of the smaller one."""
    a = t.start("less")
    attached = t.function("attached_more", (PORT, TOPIC), "Bool")
    more = t.state("more", a.live, attached, a.mode)
    b = _assignment(t, more, "more")
    join = _better_of(t, more, a, b)
    premises = {
        "no attachment is removed": _no_less(t, a, attached),
        "the first is satisfied with less": t.all_satisfied(a),
        "the second is satisfied with more": t.all_satisfied(b),
    }
    conclusion = {"every functionality is satisfied with more": t.all_satisfied(join)}
    return Case({}, premises, conclusion, (a, b, join), active(t, join))


_CHAINS = "modes form chains"

FACT_GOALS: tuple[Goal, ...] = (
    Goal("better of two", "F2", "valid assignments are closed under the pointwise better of two", _closed, ("M2",)),
    Goal("best: start", "F2", "all normal modes are above every valid assignment", _start, (_CHAINS,)),
    Goal("best: step", "F2", "one lowering stays above every valid assignment", _lowered, ("M2",)),
    Goal("best: goes on", "F2", "an unsatisfied functionality has a worse mode that is satisfied", _goes_on, ("M1",)),
    Goal("best: end", "F2", "its result is valid, and the greatest", _end),
    Goal("best: unique", "F2", "there is only one greatest assignment", _unique, (_CHAINS,)),
    Goal("more attached", "F3", "more attachments never make a functionality unsatisfied", _more),
    Goal("best grows", "F3", "valid with less, joined with valid with more, is valid with more", _grows, ("M2",)),
)

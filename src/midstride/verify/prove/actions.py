"""The actions (docs/semantics.md, section 4): the conjuncts of each precondition by name, and the effect.

A group (of functionalities, of swaps) is a relation of any size, so only the group forms are needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from midstride.verify.prove.terms import Term, and_, app, equal, if_, implies, not_, or_
from midstride.verify.prove.theory import FUNCTIONALITY, PORT, TOPIC, Parts, State, Theory

# Names of conjuncts, as messages show them.
NOT_LIVE, LIVE, ISOLATED, CAPACITY = "not live", "live", "isolated", "capacities hold"
NOT_ATTACHED, CONTRACT, CAP, ATTACHED = "not attached there", "the contracts fit", "the cap holds", "attached"
STAYS = "every functionality stays satisfied"
STRICTLY = "a strictly {} mode is named"
OUTSIDE, INSIDE = "functionalities outside F stay satisfied", "functionalities in F are satisfied in their new modes"
OUTPUTS, OLD, NEW, ONCE = (
    "old and new are outputs of live components",
    "every old output is attached",
    "no new output is attached",
    "no port occurs twice",
)
MEETS, CAPS = "every new output currently meets its topic", "caps hold afterwards"


@dataclass(frozen=True, slots=True)
class ActionFormula:
    """An action: its precondition, and the configuration that it leads to."""

    precondition: Parts
    after: State


def create(t: Theory, s: State, c: Term, tag: str = "after") -> ActionFormula:
    after = t.state(
        tag,
        lambda d: or_(s.live(d), equal(d, c)),
        lambda p, k: and_(s.attached(p, k), not_(equal(t.component(p), c))),
        lambda f: if_(equal(t.host(f), c), t.last(f), s.mode(f)),
    )
    return ActionFormula({NOT_LIVE: not_(s.live(c)), CAPACITY: t.capacities_hold(after)}, after)


def remove(t: Theory, s: State, c: Term, tag: str = "after") -> ActionFormula:
    isolated = t.all((PORT, TOPIC), lambda p, k: implies(equal(t.component(p), c), not_(s.attached(p, k))))
    after = t.state(tag, lambda d: and_(s.live(d), not_(equal(d, c))), s.attached, s.mode)
    return ActionFormula({LIVE: s.live(c), ISOLATED: isolated}, after)


def attach(t: Theory, s: State, p: Term, k: Term, tag: str = "after") -> ActionFormula:
    after = t.state(tag, s.live, lambda q, on: or_(s.attached(q, on), and_(equal(q, p), equal(on, k))), s.mode)
    precondition = {
        LIVE: s.live(t.component(p)),
        NOT_ATTACHED: not_(s.attached(p, k)),
        CONTRACT: t.fits(p, k),
        CAP: implies(t.is_output(p), t.cap_holds(after, k)),
    }
    return ActionFormula(precondition, after)


def detach(t: Theory, s: State, p: Term, k: Term, tag: str = "after") -> ActionFormula:
    after = t.state(tag, s.live, lambda q, on: and_(s.attached(q, on), not_(and_(equal(q, p), equal(on, k)))), s.mode)
    return ActionFormula({ATTACHED: s.attached(p, k), STAYS: t.all_satisfied(after)}, after)


ActionGroup = Callable[[Term], Term]


def change_modes(t: Theory, s: State, group: ActionGroup, to: Callable[[Term], Term], kind: str) -> ActionFormula:
    """``degrade`` or ``upgrade``: F is live, and each new mode is strictly worse or strictly better."""
    after = s.in_modes(lambda f: if_(group(f), to(f), s.mode(f)))
    better = kind == "upgrade"

    def strictly(f: Term) -> Term:
        return t.better(to(f), s.mode(f)) if better else t.better(s.mode(f), to(f))

    parts = {
        LIVE: t.all((FUNCTIONALITY,), lambda f: implies(group(f), t.live_in(s, f))),
        STRICTLY.format("better" if better else "worse"): t.all(
            (FUNCTIONALITY,), lambda f: implies(group(f), strictly(f))
        ),
    }
    if not better:
        parts[OUTSIDE] = t.all_satisfied(after, lambda f: not_(group(f)))
    return ActionFormula(parts | {INSIDE: t.all_satisfied(after, group)}, after)


Swaps = Callable[[Term, Term, Term], Term]  # topic, old, new


def handover(t: Theory, s: State, swaps: Swaps, tag: str = "after") -> ActionFormula:
    """All swaps at once. One-to-one replacement keeps the number of publishers: the third law of finite sets."""

    def is_new(p: Term, k: Term) -> Term:
        return t.some((PORT,), lambda old: swaps(k, old, p))

    def is_old(p: Term, k: Term) -> Term:
        return t.some((PORT,), lambda new: swaps(k, p, new))

    def each(formula: Callable[[Term, Term, Term], Term]) -> Term:
        return t.all((TOPIC, PORT, PORT), lambda k, old, new: implies(swaps(k, old, new), formula(k, old, new)))

    def outputs(k: Term, old: Term, new: Term) -> Term:
        return and_(*(and_(t.is_output(p), s.live(t.component(p))) for p in (old, new)))

    def once(k: Term) -> Term:
        return and_(
            t.all((PORT,) * 3, lambda o, n, m: implies(and_(swaps(k, o, n), swaps(k, o, m)), equal(n, m))),
            t.all((PORT,) * 3, lambda o, q, n: implies(and_(swaps(k, o, n), swaps(k, q, n)), equal(o, q))),
            t.all((PORT,) * 3, lambda o, p, n: not_(and_(swaps(k, o, p), swaps(k, p, n)))),
        )

    after = t.state(tag, s.live, lambda p, k: and_(or_(s.attached(p, k), is_new(p, k)), not_(is_old(p, k))), s.mode)

    def exchanged(k: Term, old: Term, new: Term) -> Term:
        return and_(t.is_output(old), t.is_output(new), s.attached(old, k), not_(s.attached(new, k)))

    def one_to_one(k: Term) -> Term:
        return and_(t.all((PORT, PORT), lambda o, n: implies(swaps(k, o, n), exchanged(k, o, n))), once(k))

    if not t.bounded:
        same = t.all((TOPIC,), lambda k: implies(one_to_one(k), equal(after.publishers(k), s.publishers(k))))
        t.facts.append(same)
    precondition = {
        OUTPUTS: each(outputs),
        OLD: each(lambda k, old, new: s.attached(old, k)),
        NEW: each(lambda k, old, new: not_(s.attached(new, k))),
        ONCE: t.all((TOPIC,), once),
        MEETS: each(lambda k, old, new: t.meets(s, new, k)),
        CAPS: t.all((TOPIC,), lambda k: t.cap_holds(after, k)),
    }
    return ActionFormula(precondition, after)


def in_group(f: Term) -> Term:
    return app("in_group", f)


def swap(k: Term, old: Term, new: Term) -> Term:
    return app("swapped", k, old, new)

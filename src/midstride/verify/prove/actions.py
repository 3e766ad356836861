"""The actions (docs/semantics.md, section 4): the conjuncts of each precondition by name, and the effect.

A group (of functionalities, of swaps) is a relation of any size, so only the group forms are needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from midstride.verify.prove.terms import Term, and_, app, equal, if_, implies, not_, or_
from midstride.verify.prove.theory import COMPONENT, FUNCTIONALITY, MODE, PORT, TOPIC, Part, State, Theory

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

    precondition: list[Part]
    after: State


def create(t: Theory, s: State, c: Term, tag: str = "after") -> ActionFormula:
    after = t.state(
        tag,
        lambda d: or_(s.live(d), equal(d, c)),
        lambda p, k: and_(s.attached(p, k), not_(equal(t.component(p), c))),
        lambda f: if_(equal(t.host(f), c), t.last(f), s.mode(f)),
    )
    return ActionFormula([Part(NOT_LIVE, not_(s.live(c))), Part(CAPACITY, t.capacities_hold(after))], after)


def remove(t: Theory, s: State, c: Term, tag: str = "after") -> ActionFormula:
    isolated = t.logic.all((PORT, TOPIC), lambda p, k: implies(equal(t.component(p), c), not_(s.attached(p, k))))
    after = t.state(tag, lambda d: and_(s.live(d), not_(equal(d, c))), s.attached, s.mode)
    return ActionFormula([Part(LIVE, s.live(c)), Part(ISOLATED, isolated)], after)


def attach(t: Theory, s: State, p: Term, k: Term, tag: str = "after") -> ActionFormula:
    after = t.state(tag, s.live, lambda q, on: or_(s.attached(q, on), and_(equal(q, p), equal(on, k))), s.mode)
    precondition = [
        Part(LIVE, s.live(t.component(p))),
        Part(NOT_ATTACHED, not_(s.attached(p, k))),
        Part(CONTRACT, t.fits(p, k)),
        Part(CAP, implies(t.is_output(p), t.cap_holds(after, k))),
    ]
    return ActionFormula(precondition, after)


def detach(t: Theory, s: State, p: Term, k: Term, tag: str = "after") -> ActionFormula:
    after = t.state(tag, s.live, lambda q, on: and_(s.attached(q, on), not_(and_(equal(q, p), equal(on, k)))), s.mode)
    return ActionFormula([Part(ATTACHED, s.attached(p, k)), Part(STAYS, t.all_satisfied(after))], after)


Group = Callable[[Term], Term]


def _changed(t: Theory, s: State, group: Group, to: Callable[[Term], Term], better: bool) -> tuple[list[Part], State]:
    """The shared precondition of mode changes: F is live, and each new mode is strictly better or worse."""
    after = s.in_modes(lambda f: if_(group(f), to(f), s.mode(f)))
    live = t.logic.all((FUNCTIONALITY,), lambda f: implies(group(f), s.live(t.host(f))))

    def strictly(f: Term) -> Term:
        return t.better(to(f), s.mode(f)) if better else t.better(s.mode(f), to(f))

    named = t.logic.all((FUNCTIONALITY,), lambda f: implies(group(f), strictly(f)))
    return [Part(LIVE, live), Part(STRICTLY.format("better" if better else "worse"), named)], after


def _satisfied(t: Theory, after: State, members: Group) -> Term:
    return t.logic.all(
        (FUNCTIONALITY,), lambda f: implies(and_(t.live_in(after, f), members(f)), t.satisfied(after, f))
    )


def degrade(t: Theory, s: State, group: Group, to: Callable[[Term], Term]) -> ActionFormula:
    parts, after = _changed(t, s, group, to, better=False)
    parts += [Part(OUTSIDE, _satisfied(t, after, lambda f: not_(group(f)))), Part(INSIDE, _satisfied(t, after, group))]
    return ActionFormula(parts, after)


def upgrade(t: Theory, s: State, group: Group, to: Callable[[Term], Term]) -> ActionFormula:
    parts, after = _changed(t, s, group, to, better=True)
    return ActionFormula([*parts, Part(INSIDE, _satisfied(t, after, group))], after)


Swaps = Callable[[Term, Term, Term], Term]  # topic, old, new


def handover(t: Theory, s: State, swaps: Swaps, tag: str = "after") -> ActionFormula:
    """All swaps at once. One-to-one replacement keeps the number of publishers: the third law of finite sets."""
    logic = t.logic

    def is_new(p: Term, k: Term) -> Term:
        return logic.some((PORT,), lambda old: swaps(k, old, p))

    def is_old(p: Term, k: Term) -> Term:
        return logic.some((PORT,), lambda new: swaps(k, p, new))

    def each(formula: Callable[[Term, Term, Term], Term]) -> Term:
        return logic.all((TOPIC, PORT, PORT), lambda k, old, new: implies(swaps(k, old, new), formula(k, old, new)))

    def outputs(k: Term, old: Term, new: Term) -> Term:
        return and_(*(and_(t.is_output(p), s.live(t.component(p))) for p in (old, new)))

    def once(k: Term) -> Term:
        return and_(
            logic.all((PORT,) * 3, lambda o, n, m: implies(and_(swaps(k, o, n), swaps(k, o, m)), equal(n, m))),
            logic.all((PORT,) * 3, lambda o, q, n: implies(and_(swaps(k, o, n), swaps(k, q, n)), equal(o, q))),
            logic.all((PORT,) * 3, lambda o, p, n: not_(and_(swaps(k, o, p), swaps(k, p, n)))),
        )

    after = t.state(tag, s.live, lambda p, k: and_(or_(s.attached(p, k), is_new(p, k)), not_(is_old(p, k))), s.mode)
    if not logic.bounded:
        logic.facts.append(
            logic.all(
                (TOPIC,),
                lambda k: implies(
                    and_(
                        logic.all(
                            (PORT, PORT),
                            lambda o, n: implies(
                                swaps(k, o, n),
                                and_(t.is_output(o), t.is_output(n), s.attached(o, k), not_(s.attached(n, k))),
                            ),
                        ),
                        once(k),
                    ),
                    equal(after.publishers(k), s.publishers(k)),
                ),
            )
        )
    meets = each(lambda k, old, new: t.satisfies(t.current(s, new), t.topic_guarantee(k)))
    precondition = [
        Part(OUTPUTS, each(outputs)),
        Part(OLD, each(lambda k, old, new: s.attached(old, k))),
        Part(NEW, each(lambda k, old, new: not_(s.attached(new, k)))),
        Part(ONCE, logic.all((TOPIC,), once)),
        Part(MEETS, meets),
        Part(CAPS, logic.all((TOPIC,), lambda k: t.cap_holds(after, k))),
    ]
    return ActionFormula(precondition, after)


def in_group(f: Term) -> Term:
    return app("in_group", f)


def swap(k: Term, old: Term, new: Term) -> Term:
    return app("swapped", k, old, new)


def a_group(t: Theory) -> tuple[Group, Callable[[Term], Term]]:
    """Any set of functionalities, and for each any mode of its chain."""
    group = t.logic.function("in_group", (FUNCTIONALITY,), "Bool")
    to = t.logic.function("mode_named", (FUNCTIONALITY,), MODE)
    t.logic.facts.append(t.logic.all((FUNCTIONALITY,), lambda f: equal(t.whose(to(f)), f)))
    return group, to


def some_swaps(t: Theory) -> Swaps:
    return t.logic.function("swapped", (TOPIC, PORT, PORT), "Bool")


def a_component(t: Theory) -> Term:
    return t.logic.constant("the_component", COMPONENT)


def a_port(t: Theory, output: bool) -> tuple[Term, Term]:
    """Any input or output, and any topic."""
    port, topic = t.logic.constant("the_port", PORT), t.logic.constant("the_topic", TOPIC)
    t.logic.facts.append(t.is_output(port) if output else not_(t.is_output(port)))
    return port, topic

"""The goals of the proofs about actions: that each is safe (F1), and what the conjuncts that F1 does not need are for.

`F1` goals: the action takes a valid configuration to a valid one. `fit` goals: attached ports fit their topics, as
``attach`` requires; undoing a ``detach`` relies on that. `F6` goals: the undo is allowed, and restores the
configuration. `check` goals: the functionalities that ``midstride.model.action`` checks are enough. The facts F2 and F3
are in :mod:`.facts`.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass
from functools import partial

from midstride.verify.prove import actions as act
from midstride.verify.prove.terms import FALSE, TRUE, Term, and_, equal, if_, implies, not_, or_
from midstride.verify.prove.theory import (
    ASSUMPTION,
    COMPONENT,
    FUNCTIONALITY,
    PORT,
    SATISFIED,
    TOPIC,
    Parts,
    State,
    Theory,
)

FITS = "attached ports fit their topics"
# The conjuncts that are about other functionalities than those named.
_ABOUT_MODES = (act.STAYS, act.OUTSIDE, act.INSIDE)


@dataclass(frozen=True, slots=True)
class Case:
    """A goal as formulas: ``given`` and ``asked`` imply ``conclusion``.

    ``occurs`` rules out the trivial case; ``action`` is the action's kind, for the text of a counterexample (see
    :mod:`.counterexample`).
    """

    given: Parts
    asked: Parts
    conclusion: Parts
    states: tuple[State, ...]
    occurs: Term = TRUE
    action: str = ""


@dataclass(frozen=True, slots=True)
class Goal:
    """One theorem. Dropping any conjunct of ``asked`` or rule of ``rules`` must break it, except those in ``spare``.

    ``together``: conjuncts that the rest implies one at a time, but not together.
    """

    name: str
    kind: str
    statement: str
    build: Callable[[Theory], Case]
    rules: tuple[str, ...] = ()
    spare: Set[str] = frozenset()
    together: tuple[tuple[str, ...], ...] = ()


def active(t: Theory, s: State) -> Term:
    """Some live functionality has an assumption, so validity is not trivial."""
    return t.some((FUNCTIONALITY, ASSUMPTION), lambda f, a: and_(t.live_in(s, f), t.assumes(s.mode(f), a)))


def _step(t: Theory, s: State, action: str) -> tuple[act.ActionFormula, Term]:
    """The action of that name in ``s``, with arbitrary arguments; and that it is not empty."""
    if action in ("create", "remove"):
        component = t.constant("the_component", COMPONENT)
        return (act.create if action == "create" else act.remove)(t, s, component), TRUE
    if action in ("degrade", "upgrade"):
        group, to = t.function("in_group", (FUNCTIONALITY,), "Bool"), t.assignment("mode_named")
        return act.change_modes(t, s, group, to, action), t.some((FUNCTIONALITY,), group)
    if action == "handover":
        swaps = t.function("swapped", (TOPIC, PORT, PORT), "Bool")
        return act.handover(t, s, swaps), t.some((TOPIC, PORT, PORT), swaps)
    kind, _, direction = action.partition(" ")
    port, topic = t.constant("the_port", PORT), t.constant("the_topic", TOPIC)
    t.facts.append(t.is_output(port) if direction == "output" else not_(t.is_output(port)))
    return (act.attach if kind == "attach" else act.detach)(t, s, port, topic), TRUE


def _preserved(action: str, t: Theory) -> Case:
    s = t.start()
    step, some = _step(t, s, action)
    occurs = and_(some, active(t, s))
    return Case(t.valid(s), step.precondition, t.valid(step.after), (s, step.after), occurs, action)


def _fitting(action: str, t: Theory) -> Case:
    s = t.start()
    step, some = _step(t, s, action)
    fit, still_fit = {FITS: t.all_fit(s)}, {FITS: t.all_fit(step.after)}
    return Case(fit, step.precondition, still_fit, (s, step.after), some, action)


def _named(prefix: str, parts: Parts) -> Parts:
    return {f"{prefix}{name}": formula for name, formula in parts.items()}


def _undone(action: str, t: Theory) -> Case:
    s = t.start()
    given = t.valid(s) | {FITS: t.all_fit(s)}
    step, some = _step(t, s, action)
    after, asked = step.after, dict(step.precondition)
    c, p, k = "the_component", "the_port", "the_topic"
    if action == "create":
        back = act.remove(t, after, c, "undone")
    elif action.startswith("attach"):
        back = act.detach(t, after, p, k, "undone")
    elif action.startswith("detach"):
        back = act.attach(t, after, p, k, "undone")
    elif action == "handover":
        old_meets = t.all(
            (TOPIC, PORT, PORT),
            lambda k, old, new: implies(act.swap(k, old, new), t.meets(s, old, k)),
        )
        asked["every old output still meets its topic"] = old_meets
        back = act.handover(t, after, lambda k, old, new: act.swap(k, new, old), "undone")
    else:
        back = act.change_modes(t, after, act.in_group, s.mode, "upgrade" if action == "degrade" else "degrade")
    conclusion = _named("the undo requires: ", back.precondition)
    conclusion |= _named("after the undo, ", t.same(back.after, s))
    return Case(given, asked, conclusion, (s, after, back.after), and_(some, active(t, s)), action)


def _remove_undone(t: Theory) -> Case:
    """`create c` again, then upgrades one by one: ``raised`` are those of ``c`` that were raised already."""
    s = t.start()
    c = t.constant("the_component", COMPONENT)
    step = act.remove(t, s, c)
    again = act.create(t, step.after, c, "created")
    raised = t.function("raised", (FUNCTIONALITY,), "Bool")
    f = t.constant("the_functionality", FUNCTIONALITY)
    midway = again.after.in_modes(lambda g: if_(and_(raised(g), equal(t.host(g), c)), s.mode(g), again.after.mode(g)))
    t.facts += [equal(t.host(f), c), not_(raised(f)), not_(equal(s.mode(f), t.last(f)))]
    up = act.change_modes(t, midway, lambda g: equal(g, f), s.mode, "upgrade")
    conclusion = _named("the undo requires: ", again.precondition)
    conclusion |= _named("the upgrade of the undo requires: ", up.precondition)
    all_raised = again.after.in_modes(lambda g: if_(equal(t.host(g), c), s.mode(g), again.after.mode(g)))
    conclusion |= _named("after the undo, ", t.same(all_raised, s))
    return Case(t.valid(s), step.precondition, conclusion, (s, step.after, up.after), active(t, s), "remove")


def _apart_undone(t: Theory) -> Case:
    """Undoing a hand-over whose old output no longer meets its topic: everything stays satisfied in between.

    In between, an attachment of ``before`` may be missing if its output does not meet the topic; others may exist.
    """
    s = t.start()
    attached = t.function("attached_between", (PORT, TOPIC), "Bool")
    between = t.state("between", s.live, attached, s.mode)
    kept = t.all(
        (PORT, TOPIC),
        lambda p, k: implies(and_(s.attached(p, k), or_(not_(t.is_output(p)), t.meets(s, p, k))), attached(p, k)),
    )
    asked = {"only outputs that do not meet their topic are missing": kept}
    given = {SATISFIED: t.all_satisfied(s)}
    some = t.some((PORT, TOPIC), lambda p, k: and_(s.attached(p, k), not_(attached(p, k))))
    conclusion = {SATISFIED: t.all_satisfied(between)}
    return Case(given, asked, conclusion, (s, between), and_(some, active(t, s)), "")


def _consumes(t: Theory, s: State, f: Term, k: Term) -> Term:
    return t.some((PORT,), lambda p: and_(t.uses(f, p), s.attached(p, k)))


def _checked(action: str, t: Theory) -> Case:
    """Only the neighbours that ``check`` examines can become unsatisfied."""
    s = t.start()
    step, some = _step(t, s, action)
    after = step.after
    required = {name: step.precondition[name] for name in step.precondition if name in _ABOUT_MODES}
    asked = {name: step.precondition[name] for name in step.precondition if name not in required}

    def lost(k: Term) -> Term:
        fed = t.some((PORT,), lambda p: and_(t.is_output(p), act.in_group(t.owner(p)), s.attached(p, k)))
        return and_(fed, t.topic_satisfied(s, k), not_(t.topic_satisfied(after, k)))

    def affected(f: Term) -> Term:
        if action == "detach output":
            return _consumes(t, after, f, "the_topic")
        if action == "detach input":
            return t.uses(f, "the_port")
        return or_(act.in_group(f), t.some((TOPIC,), lambda k: and_(lost(k), _consumes(t, s, f, k))))

    topic_kept = t.topic_satisfied(after, "the_topic") if action == "detach output" else FALSE
    examined = or_(topic_kept, t.all_satisfied(after, affected))
    asked["every functionality that `check` examines is satisfied"] = examined
    return Case(t.valid(s), asked, required, (s, after), and_(some, active(t, s)), action)


_NAMES = "an assumption names associated inputs"
_DOWN = act.STRICTLY.format("worse")
_VALID = "a valid configuration stays valid"
_BACK = "the undo is allowed and restores the configuration"
_LOCAL = "the functionalities that `check` examines are enough"

ACTION_GOALS: tuple[Goal, ...] = (
    Goal("create", "F1", _VALID, partial(_preserved, "create"), ("M1",)),
    Goal("remove", "F1", _VALID, partial(_preserved, "remove"), spare={act.LIVE}),
    Goal("attach output", "F1", _VALID, partial(_preserved, "attach output"), spare={act.NOT_ATTACHED, act.CONTRACT}),
    Goal("attach input", "F1", _VALID, partial(_preserved, "attach input"),
         spare={act.NOT_ATTACHED, act.CONTRACT, act.CAP}),
    Goal("detach output", "F1", _VALID, partial(_preserved, "detach output"), spare={act.ATTACHED}),
    Goal("detach input", "F1", _VALID, partial(_preserved, "detach input"), spare={act.ATTACHED}),
    Goal("degrade F", "F1", _VALID, partial(_preserved, "degrade"), spare={act.LIVE, _DOWN}),
    Goal("upgrade F", "F1", _VALID, partial(_preserved, "upgrade"), ("M2",), {act.LIVE}),
    Goal("handover", "F1", _VALID, partial(_preserved, "handover"), spare={act.OLD, act.NEW, act.ONCE, act.CAPS},
         together=((act.OLD, act.CAPS), (act.ONCE, act.CAPS))),
    Goal("attach output", "fit", FITS, partial(_fitting, "attach output"), spare={act.LIVE, act.NOT_ATTACHED, act.CAP}),
    Goal("attach input", "fit", FITS, partial(_fitting, "attach input"), spare={act.LIVE, act.NOT_ATTACHED, act.CAP}),
    Goal("handover", "fit", FITS, partial(_fitting, "handover"), ("M2",), {act.OLD, act.NEW, act.ONCE, act.CAPS}),
    Goal("create", "F6", _BACK, partial(_undone, "create"), spare={act.CAPACITY}),
    Goal("remove", "F6", "create and upgrades restore the configuration", _remove_undone),
    Goal("attach output", "F6", _BACK, partial(_undone, "attach output"), spare={act.LIVE, act.CONTRACT, act.CAP}),
    Goal("attach input", "F6", _BACK, partial(_undone, "attach input"), spare={act.LIVE, act.CONTRACT, act.CAP}),
    Goal("detach output", "F6", _BACK, partial(_undone, "detach output"), spare={act.STAYS}),
    Goal("detach input", "F6", _BACK, partial(_undone, "detach input"), spare={act.STAYS}),
    Goal("degrade F", "F6", _BACK, partial(_undone, "degrade"), spare={act.OUTSIDE, act.INSIDE}),
    Goal("upgrade F", "F6", _BACK, partial(_undone, "upgrade"), spare={act.INSIDE}),
    Goal("handover", "F6", _BACK, partial(_undone, "handover"), spare={act.MEETS, act.CAPS}),
    Goal("handover apart", "F6", "every functionality stays satisfied during the undo", _apart_undone),
    Goal("detach output", "check", _LOCAL, partial(_checked, "detach output"), (_NAMES,), {act.ATTACHED}),
    Goal("detach input", "check", _LOCAL, partial(_checked, "detach input"), (_NAMES,), {act.ATTACHED}),
    Goal("degrade F", "check", _LOCAL, partial(_checked, "degrade"), (_NAMES,), {act.LIVE, _DOWN}),
)  # fmt: skip

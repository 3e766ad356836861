"""What is proved of actions: that each is safe (F1), and what the conjuncts that F1 does not need are for.

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
from midstride.verify.prove.theory import ASSUMPTION, FUNCTIONALITY, PORT, TOPIC, Part, State, Theory

FITS = "attached ports fit their topics"


@dataclass(frozen=True, slots=True)
class Case:
    """A goal as formulas: ``given`` and ``asked`` imply ``conclusion``.

    ``occurs`` rules out the trivial case; ``action`` is the action's kind, for the text of a counterexample (see
    :mod:`.counterexample`).
    """

    given: list[Part]
    asked: list[Part]
    conclusion: list[Part]
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
    claim: str
    build: Callable[[Theory], Case]
    rules: tuple[str, ...] = ()
    spare: Set[str] = frozenset()
    together: tuple[tuple[str, ...], ...] = ()


def active(t: Theory, s: State) -> Term:
    """Some live functionality has an assumption, so validity is not trivial."""
    return t.logic.some((FUNCTIONALITY, ASSUMPTION), lambda f, a: and_(t.live_in(s, f), t.assumes(s.mode(f), a)))


def _some_member(t: Theory, group: act.Group) -> Term:
    return t.logic.some((FUNCTIONALITY,), group)


def _step(t: Theory, s: State, action: str) -> tuple[act.ActionFormula, Term]:
    """The action of that name in ``s``, with arbitrary arguments; and that it is not empty."""
    if action in ("create", "remove"):
        step = (act.create if action == "create" else act.remove)(t, s, act.a_component(t))
        return step, TRUE
    if action in ("degrade", "upgrade"):
        group, to = act.a_group(t)
        return (act.degrade if action == "degrade" else act.upgrade)(t, s, group, to), _some_member(t, group)
    if action == "handover":
        swaps = act.some_swaps(t)
        return act.handover(t, s, swaps), t.logic.some((TOPIC, PORT, PORT), swaps)
    word, _, which = action.partition(" ")
    port, topic = act.a_port(t, output=which == "output")
    return (act.attach if word == "attach" else act.detach)(t, s, port, topic), TRUE


def _preserved(action: str, t: Theory) -> Case:
    s = t.start()
    step, some = _step(t, s, action)
    occurs = and_(some, active(t, s))
    return Case(t.valid(s), step.precondition, t.valid(step.after), (s, step.after), occurs, action)


def _fitting(action: str, t: Theory) -> Case:
    s = t.start()
    step, some = _step(t, s, action)
    given = [Part(FITS, t.all_fit(s))]
    return Case(given, step.precondition, [Part(FITS, t.all_fit(step.after))], (s, step.after), some, action)


def _undone(action: str, t: Theory) -> Case:
    s = t.start()
    given = [*t.valid(s), Part(FITS, t.all_fit(s))]
    step, some = _step(t, s, action)
    after, asked = step.after, list(step.precondition)
    c, p, k = "the_component", "the_port", "the_topic"
    if action == "create":
        back = act.remove(t, after, c, "undone")
    elif action.startswith("attach"):
        back = act.detach(t, after, p, k, "undone")
    elif action.startswith("detach"):
        back = act.attach(t, after, p, k, "undone")
    elif action == "handover":
        old_meets = t.logic.all(
            (TOPIC, PORT, PORT),
            lambda k, old, new: implies(act.swap(k, old, new), t.satisfies(t.current(s, old), t.topic_guarantee(k))),
        )
        asked.append(Part("every old output still meets its topic", old_meets))
        back = act.handover(t, after, lambda k, old, new: act.swap(k, new, old), "undone")
    else:
        other = act.upgrade if action == "degrade" else act.degrade
        back = other(t, after, act.in_group, s.mode)
    conclusion = [Part(f"the undo requires: {part.name}", part.formula) for part in back.precondition]
    conclusion += [Part(f"after the undo, {part.name}", part.formula) for part in t.same(back.after, s)]
    return Case(given, asked, conclusion, (s, after, back.after), and_(some, active(t, s)), action)


def _remove_undone(t: Theory) -> Case:
    """`create c` again, then upgrades one by one: ``raised`` are those of ``c`` that were raised already."""
    s = t.start()
    c = act.a_component(t)
    step = act.remove(t, s, c)
    again = act.create(t, step.after, c, "created")
    raised = t.logic.function("raised", (FUNCTIONALITY,), "Bool")
    f = t.logic.constant("the_functionality", FUNCTIONALITY)
    midway = again.after.in_modes(lambda g: if_(and_(raised(g), equal(t.host(g), c)), s.mode(g), again.after.mode(g)))
    t.logic.facts += [equal(t.host(f), c), not_(raised(f)), not_(equal(s.mode(f), t.last(f)))]
    up = act.upgrade(t, midway, lambda g: equal(g, f), s.mode)
    conclusion = [Part(f"the undo requires: {part.name}", part.formula) for part in again.precondition]
    conclusion += [Part(f"the upgrade of the undo requires: {part.name}", part.formula) for part in up.precondition]
    all_raised = again.after.in_modes(lambda g: if_(equal(t.host(g), c), s.mode(g), again.after.mode(g)))
    conclusion += [Part(f"after the undo, {part.name}", part.formula) for part in t.same(all_raised, s)]
    return Case(t.valid(s), step.precondition, conclusion, (s, step.after, up.after), active(t, s), "remove")


def _apart_undone(t: Theory) -> Case:
    """Undoing a hand-over whose old output no longer meets its topic: everything stays satisfied in between.

    In between, an attachment of ``before`` may be missing if its output does not meet the topic; others may exist.
    """
    s = t.start()
    attached = t.logic.function("attached_between", (PORT, TOPIC), "Bool")
    between = t.state("between", s.live, attached, s.mode)
    kept = t.logic.all(
        (PORT, TOPIC),
        lambda p, k: implies(
            and_(s.attached(p, k), or_(not_(t.is_output(p)), t.satisfies(t.current(s, p), t.topic_guarantee(k)))),
            attached(p, k),
        ),
    )
    asked = [Part("only outputs that do not meet their topic are missing", kept)]
    given = [t.valid(s)[0]]
    some = t.logic.some((PORT, TOPIC), lambda p, k: and_(s.attached(p, k), not_(attached(p, k))))
    conclusion = [Part("every functionality is satisfied", t.all_satisfied(between))]
    return Case(given, asked, conclusion, (s, between), and_(some, active(t, s)), "")


def _consumes(t: Theory, s: State, f: Term, k: Term) -> Term:
    return t.logic.some((PORT,), lambda p: and_(t.uses(f, p), s.attached(p, k)))


def _checked(action: str, t: Theory) -> Case:
    """Only the neighbours that ``check`` examines can become unsatisfied."""
    s = t.start()
    step, some = _step(t, s, action)
    after = step.after
    asked = [part for part in step.precondition if part.name not in (act.STAYS, act.OUTSIDE, act.INSIDE)]
    required = [part for part in step.precondition if part not in asked]
    affected: Callable[[Term], Term]
    if action == "detach output":
        k = "the_topic"
        affected = lambda f: _consumes(t, after, f, k)  # noqa: E731
        topic_kept = t.topic_satisfied(after, k)
    elif action == "detach input":
        affected = lambda f: t.uses(f, "the_port")  # noqa: E731
        topic_kept = FALSE
    else:
        topic_kept = FALSE

        def lost(k: Term) -> Term:
            fed = t.logic.some((PORT,), lambda p: and_(t.is_output(p), act.in_group(t.owner(p)), s.attached(p, k)))
            return and_(fed, t.topic_satisfied(s, k), not_(t.topic_satisfied(after, k)))

        def affected(f: Term) -> Term:
            return or_(act.in_group(f), t.logic.some((TOPIC,), lambda k: and_(lost(k), _consumes(t, s, f, k))))

    examined = t.logic.all(
        (FUNCTIONALITY,), lambda f: implies(and_(t.live_in(after, f), affected(f)), t.satisfied(after, f))
    )
    asked.append(Part("every functionality that `check` examines is satisfied", or_(topic_kept, examined)))
    return Case(t.valid(s), asked, required, (s, after), and_(some, active(t, s)), action)


_NAMED = "an assumption names associated inputs"
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
    Goal("detach output", "check", _LOCAL, partial(_checked, "detach output"), (_NAMED,), {act.ATTACHED}),
    Goal("detach input", "check", _LOCAL, partial(_checked, "detach input"), (_NAMED,), {act.ATTACHED}),
    Goal("degrade F", "check", _LOCAL, partial(_checked, "degrade"), (_NAMED,), {act.LIVE, _DOWN}),
)  # fmt: skip

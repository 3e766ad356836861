"""Runs the proofs: verdicts as data.

A goal is proved part by part: the premises and the negation of one part of its conclusion, over sorts of any size, must
be unsatisfiable. A weakened goal (without one conjunct or rule) must have a counterexample, which is searched in small
systems, where it is readable. If the goal is declared not to need the conjunct, the weakened goal is proved instead.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import msgspec

from midstride.codec.form import Form, encode
from midstride.errors import SolverMissing, VerificationError
from midstride.verify.prove import solvers
from midstride.verify.prove.counterexample import Counterexample
from midstride.verify.prove.facts import FACT_GOALS
from midstride.verify.prove.goals import ACTION_GOALS, Case, Goal
from midstride.verify.prove.service_goals import SERVICE_GOALS
from midstride.verify.prove.terms import Term, and_, app, not_
from midstride.verify.prove.theory import SORTS, Parts, Theory
from midstride.verify.verdict import Answer

GOALS: Final[tuple[Goal, ...]] = (*ACTION_GOALS, *FACT_GOALS, *SERVICE_GOALS)
# Counterexamples are searched in systems of these sizes, smallest first.
SIZES: Final[tuple[Mapping[str, int], ...]] = tuple(
    dict(zip(SORTS, numbers, strict=True))
    for numbers in (
        (1, 1, 2, 2, 1, 2, 1, 1, 1),
        (1, 2, 4, 3, 1, 2, 1, 1, 1),
        (2, 2, 4, 3, 1, 2, 1, 1, 1),
        (2, 2, 4, 4, 2, 3, 2, 1, 1),
    )
)
SECONDS: Final = 20.0


class Weakened(Form, frozen=True, omit_defaults=False):
    """The goal without ``dropped``. VIOLATED: it is needed, as ``counterexample`` shows. HOLDS: the rest implies it."""

    dropped: tuple[str, ...]
    needed: bool
    answer: Answer = msgspec.field(name="verdict")
    counterexample: str | None = None

    @property
    def as_expected(self) -> bool:
        return self.answer is (Answer.VIOLATED if self.needed else Answer.HOLDS)


@dataclass(frozen=True, slots=True)
class Proof:
    """The verdict on one goal, by one or both solvers, and the evidence that it is not vacuous."""

    goal: Goal
    answer: Answer
    seconds: Mapping[str, float]
    because: str | None = None
    possible: Answer = Answer.UNKNOWN
    weakened: tuple[Weakened, ...] = ()

    @property
    def ok(self) -> bool:
        """Proved, not vacuous, and each conjunct is needed exactly where it is declared to be."""
        shown = self.possible is Answer.HOLDS and all(weakened.as_expected for weakened in self.weakened)
        return self.answer is Answer.HOLDS and shown

    def to_document(self) -> dict[str, Any]:
        return {
            "fact": self.goal.kind,
            "goal": self.goal.name,
            "claim": self.goal.statement,
            "verdict": self.answer.value,
            "because": self.because,
            "ok": self.ok,
            "seconds": {name: round(seconds, 3) for name, seconds in self.seconds.items()},
            "possible": self.possible.value,
            "weakened": [encode(weakened) for weakened in self.weakened],
        }


def prove(names: Sequence[solvers.SolverName] = solvers.NAMES, seconds: float = SECONDS) -> Iterator[Proof]:
    """The proof of each goal, as it is found. A missing solver makes every goal UNKNOWN, with that reason.

    ``seconds`` is the time limit of one query. Weakened goals are checked by the first solver that is installed.
    """
    for goal in GOALS:
        yield prove_goal(goal, names, seconds)


def prove_goal(goal: Goal, names: Sequence[solvers.SolverName] = solvers.NAMES, seconds: float = SECONDS) -> Proof:
    """The proof of one goal, as :func:`prove` gives it. HOLDS only if every solver finds so."""
    took: dict[str, float] = {}
    answers: list[Answer] = []
    because: list[str] = []
    installed: list[solvers.SolverName] = []
    for name in names:
        started = time.perf_counter()
        try:
            answer, reason = _proved(goal, name, seconds)
            installed.append(name)
        except SolverMissing as error:
            answer, reason = Answer.UNKNOWN, str(error)
        took[name] = time.perf_counter() - started
        answers.append(answer)
        because += [] if reason is None else [reason]
    if not installed:
        return Proof(goal, Answer.UNKNOWN, took, "; ".join(because))
    first = installed[0]
    total = answers[0] if len(set(answers)) == 1 else Answer.UNKNOWN  # also where the solvers differ
    if total is not Answer.HOLDS:
        model = _model(goal, first, (), seconds, violated=True)
        if model is not None and Answer.HOLDS in answers:
            total, because = Answer.UNKNOWN, [*because, "the solvers disagree"]
        elif model is not None:
            total, because = Answer.VIOLATED, [model]
    # Whether the premises can all be true in a non-trivial case.
    occurs = all(_model(goal, name, (), seconds, violated=False) is not None for name in installed)
    possible = Answer.HOLDS if occurs else Answer.UNKNOWN
    weakened = tuple(_weakened(goal, dropped, needed, first, seconds) for dropped, needed in weakenings(goal))
    return Proof(goal, total, took, "; ".join(because) or None, possible, weakened)


def weakenings(goal: Goal) -> Iterator[tuple[tuple[str, ...], bool]]:
    """The parts to leave out, and whether the goal must fail without them."""
    for name in goal.build(Theory()).asked:
        yield (name,), name not in goal.spare
    for rule in goal.rules:
        yield (rule,), True
    for names in goal.together:
        yield names, True


def premises(t: Theory, case: Case, dropped: tuple[str, ...]) -> Parts:
    """The premises of a goal, without the dropped ones."""
    parts = t.rules() | case.given | case.asked
    missing = set(dropped) - parts.keys()
    assert not missing, f"no conjunct is called {missing}"
    return {name: formula for name, formula in parts.items() if name not in dropped}


def script(goal: Goal, part: str, dropped: tuple[str, ...] = ()) -> str:
    """The unbounded negation of one part of the goal's conclusion, as SMT-LIB text."""
    t = Theory()
    case = goal.build(t)
    return t.script(premises(t, case, dropped) | {f"NOT: {part}": not_(case.conclusion[part])})


def _proved(
    goal: Goal, name: solvers.SolverName, seconds: float, dropped: tuple[str, ...] = ()
) -> tuple[Answer, str | None]:
    for part in goal.build(Theory()).conclusion:
        answer: solvers.SolverAnswer = "unknown"
        for strategy in solvers.STRATEGIES[name]:
            session = solvers.open_session(name, seconds, strategy)
            solvers.send(session, script(goal, part, dropped))
            answer = solvers.check_sat(session)
            if answer != "unknown":
                break
        if answer == "sat":
            return Answer.VIOLATED, f"{name}: does not follow: {part}"
        if answer == "unknown":
            return Answer.UNKNOWN, f"{name} does not decide within {seconds:g} s: {part}"
    return Answer.HOLDS, None


def _weakened(goal: Goal, dropped: tuple[str, ...], needed: bool, name: solvers.SolverName, seconds: float) -> Weakened:
    if not needed:
        answer, _ = _proved(goal, name, seconds, dropped)
        if answer is Answer.HOLDS:
            return Weakened(dropped, needed, answer)
    text = _model(goal, name, dropped, seconds, violated=True)
    return Weakened(dropped, needed, Answer.UNKNOWN if text is None else Answer.VIOLATED, text)


def _model(
    goal: Goal, name: solvers.SolverName, dropped: tuple[str, ...], seconds: float, *, violated: bool
) -> str | None:
    """The text of a small model of the premises (``violated``: in which the conclusion is false), or None."""
    for sizes in SIZES:
        t = Theory(sizes)
        case = goal.build(t)
        query = not_(and_(*case.conclusion.values())) if violated else case.occurs
        session = solvers.open_session(name, seconds)
        solvers.send(session, t.script(premises(t, case, dropped) | {"query": query}))
        if solvers.check_sat(session) != "sat":
            continue
        if violated:
            _shrink(t, session)
        return str(Counterexample(t, case, session)) if violated else ""
    return None


def _shrink(t: Theory, session: solvers.Session) -> None:
    """Remove from the model every tuple that it does not need, one by one."""
    for atom in _atoms(t):
        if solvers.value(session, atom) == "false":
            solvers.send(session, f"(assert (not {atom}))\n")
            kept = solvers.check_sat(session)
        else:
            solvers.send(session, f"(push 1)\n(assert (not {atom}))\n")
            kept = solvers.check_sat(session)
            if kept != "sat":
                solvers.send(session, f"(pop 1)\n(assert {atom})\n")
                kept = solvers.check_sat(session)
        if kept != "sat":
            raise VerificationError("a solver contradicts its own model")


def _atoms(t: Theory) -> list[Term]:
    """Every relation applied to every combination of elements."""
    return [
        app(name, *chosen)
        for name, (arguments, result) in t.declared.items()
        if result == "Bool"
        for chosen in product(*map(t.elements, arguments))
    ]

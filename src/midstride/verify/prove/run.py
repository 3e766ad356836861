"""Runs the proofs: verdicts as data.

A goal is asked part by part: premises and the negation of one part of its conclusion, over sorts of any size;
unsatisfiable is a proof. For a weakened goal (one conjunct or rule left out) a counterexample is looked for in a small
system, where it can be told; only a conjunct that the goal is said not to need is proved away without bounds.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

from midstride.errors import SolverMissing, VerificationError
from midstride.verify.prove import solvers
from midstride.verify.prove.facts import FACT_GOALS
from midstride.verify.prove.goals import ACTION_GOALS, Case, Goal
from midstride.verify.prove.rules import rules
from midstride.verify.prove.terms import Term, and_, app, not_
from midstride.verify.prove.theory import SORTS, Part, Theory
from midstride.verify.prove.wording import Wording
from midstride.verify.verdict import Answer

GOALS: Final[tuple[Goal, ...]] = (*ACTION_GOALS, *FACT_GOALS)
# Counterexamples are looked for in these, the smallest first. A model in them is one of systems of any size.
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


@dataclass(frozen=True, slots=True)
class Weakened:
    """The goal without ``dropped``. VIOLATED: it is needed, as ``counterexample`` shows. HOLDS: the rest implies it."""

    dropped: tuple[str, ...]
    needed: bool
    answer: Answer
    counterexample: str | None = None

    @property
    def as_expected(self) -> bool:
        return self.answer is (Answer.VIOLATED if self.needed else Answer.HOLDS)

    def to_document(self) -> dict[str, Any]:
        return {
            "dropped": list(self.dropped),
            "needed": self.needed,
            "verdict": self.answer.value,
            "counterexample": self.counterexample,
        }


@dataclass(frozen=True, slots=True)
class Proof:
    """The verdict on one goal, by one or both solvers, and what shows that it is not vacuous."""

    goal: Goal
    answer: Answer
    seconds: Mapping[str, float]
    because: str | None = None
    possible: Answer = Answer.UNKNOWN
    weakened: tuple[Weakened, ...] = ()

    @property
    def ok(self) -> bool:
        """Proved, of something that can happen, and each conjunct is needed just where it is said to be."""
        shown = self.possible is Answer.HOLDS and all(weakened.as_expected for weakened in self.weakened)
        return self.answer is Answer.HOLDS and shown

    def to_document(self) -> dict[str, Any]:
        return {
            "fact": self.goal.kind,
            "goal": self.goal.name,
            "claim": self.goal.claim,
            "verdict": self.answer.value,
            "because": self.because,
            "ok": self.ok,
            "seconds": {name: round(seconds, 3) for name, seconds in self.seconds.items()},
            "possible": self.possible.value,
            "weakened": [weakened.to_document() for weakened in self.weakened],
        }


def prove(
    names: Sequence[solvers.Name] = solvers.NAMES, goals: Iterable[Goal] = GOALS, seconds: float = SECONDS
) -> Iterator[Proof]:
    """Each goal's proof, as it is found. A solver that is absent makes every goal UNKNOWN, and says so.

    ``seconds`` is the time limit of one question. The weakened goals are asked of the first solver that is there.
    """
    for goal in goals:
        yield prove_goal(goal, names, seconds)


def prove_goal(goal: Goal, names: Sequence[solvers.Name] = solvers.NAMES, seconds: float = SECONDS) -> Proof:
    took: dict[str, float] = {}
    answers: list[Answer] = []
    because: list[str] = []
    there: list[solvers.Name] = []
    for name in names:
        started = time.perf_counter()
        try:
            answer, reason = _proved(goal, name, seconds)
            there.append(name)
        except SolverMissing as absent:
            answer, reason = Answer.UNKNOWN, str(absent)
        took[name] = time.perf_counter() - started
        answers.append(answer)
        because += [] if reason is None else [reason]
    if not there:
        return Proof(goal, Answer.UNKNOWN, took, "; ".join(because))
    first = there[0]
    total = _together(answers)
    if total is not Answer.HOLDS:
        model = _model(goal, first, (), seconds, violated=True)
        if model is not None and Answer.HOLDS in answers:
            total, because = Answer.UNKNOWN, [*because, "the solvers disagree"]
        elif model is not None:
            total, because = Answer.VIOLATED, [model]
    possible = Answer.HOLDS if all(_possible(goal, name, seconds) for name in there) else Answer.UNKNOWN
    weakened = tuple(_weakened(goal, dropped, needed, first, seconds) for dropped, needed in weakenings(goal))
    return Proof(goal, total, took, "; ".join(because) or None, possible, weakened)


def _together(answers: Iterable[Answer]) -> Answer:
    """HOLDS only where every solver says so; two that contradict each other leave it open."""
    said = set(answers)
    return said.pop() if len(said) == 1 else Answer.UNKNOWN


def weakenings(goal: Goal) -> Iterator[tuple[tuple[str, ...], bool]]:
    """What is left out, and whether the goal then fails."""
    for part in goal.build(Theory()).asked:
        yield (part.name,), part.name not in goal.spare
    for rule in goal.rules:
        yield (rule,), True
    for names in goal.together:
        yield names, True


def premises(t: Theory, case: Case, dropped: tuple[str, ...]) -> list[tuple[str, Term]]:
    """What a goal rests on, but for what is left out."""
    parts = [*rules(t), *case.given, *case.asked]
    missing = set(dropped) - {part.name for part in parts}
    assert not missing, f"no conjunct is called {missing}"
    return [(part.name, part.formula) for part in parts if part.name not in dropped]


def script(goal: Goal, part: int, dropped: tuple[str, ...] = ()) -> str:
    """The negated goal for one part of its conclusion, without bounds, as SMT-LIB text."""
    t = Theory()
    case = goal.build(t)
    concluded: Part = case.conclusion[part]
    return t.logic.script([*premises(t, case, dropped), (f"NOT: {concluded.name}", not_(concluded.formula))])


def _proved(goal: Goal, name: solvers.Name, seconds: float, dropped: tuple[str, ...] = ()) -> tuple[Answer, str | None]:
    for number, part in enumerate(goal.build(Theory()).conclusion):
        answer: solvers.Answer = "unknown"
        for strategy in solvers.STRATEGIES[name]:
            session = solvers.open_session(name, seconds, strategy)
            solvers.tell(session, script(goal, number, dropped))
            answer = solvers.ask(session)
            if answer != "unknown":
                break
        if answer == "sat":
            return Answer.VIOLATED, f"{name}: does not follow: {part.name}"
        if answer == "unknown":
            return Answer.UNKNOWN, f"{name} does not decide it ({seconds:g} s at most): {part.name}"
    return Answer.HOLDS, None


def _weakened(goal: Goal, dropped: tuple[str, ...], needed: bool, name: solvers.Name, seconds: float) -> Weakened:
    if not needed:
        answer, _ = _proved(goal, name, seconds, dropped)
        if answer is Answer.HOLDS:
            return Weakened(dropped, needed, answer)
    told = _model(goal, name, dropped, seconds, violated=True)
    return Weakened(dropped, needed, Answer.UNKNOWN if told is None else Answer.VIOLATED, told)


def _possible(goal: Goal, name: solvers.Name, seconds: float) -> bool:
    """Whether rules and precondition can all be true, of something that happens."""
    return _model(goal, name, (), seconds, violated=False) is not None


def _model(goal: Goal, name: solvers.Name, dropped: tuple[str, ...], seconds: float, *, violated: bool) -> str | None:
    """A small model of the premises, in words (of those alone, or with the conclusion violated), or None."""
    for sizes in SIZES:
        t = Theory(sizes)
        case = goal.build(t)
        wanted = not_(and_(*(part.formula for part in case.conclusion))) if violated else case.occurs
        session = solvers.open_session(name, seconds)
        solvers.tell(session, t.logic.script([*premises(t, case, dropped), ("wanted", wanted)]))
        if solvers.ask(session) != "sat":
            continue
        if violated:
            _shrink(t, session)
        return str(Wording(t, case, session)) if violated else ""
    return None


def _shrink(t: Theory, session: solvers.Session) -> None:
    """Leaves out of the model found whatever it can do without, one relation after another."""
    for atom in _atoms(t):
        if solvers.value(session, atom) == "false":
            solvers.tell(session, f"(assert (not {atom}))\n")
            kept = solvers.ask(session)
        else:
            solvers.tell(session, f"(push 1)\n(assert (not {atom}))\n")
            kept = solvers.ask(session)
            if kept != "sat":
                solvers.tell(session, f"(pop 1)\n(assert {atom})\n")
                kept = solvers.ask(session)
        if kept != "sat":
            raise VerificationError("a solver takes back a model that it gave")


def _atoms(t: Theory) -> list[Term]:
    """Every relation, of every elements."""
    return [
        app(name, *chosen)
        for name, (arguments, result) in t.logic.declared.items()
        if result == "Bool"
        for chosen in product(*map(t.logic.elements, arguments))
    ]

"""The solvers: each takes SMT-LIB text and answers in it. Neither is needed for anything but the proofs."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, Literal, Protocol

from midstride.errors import SolverMissing, VerificationError

Name = Literal["z3", "cvc5"]
Answer = Literal["sat", "unsat", "unknown"]
NAMES: Final[tuple[Name, ...]] = ("z3", "cvc5")
_DECIDED: Final[tuple[Literal["sat", "unsat"], ...]] = ("sat", "unsat")
_PACKAGE: Final[dict[Name, str]] = {"z3": "z3-solver", "cvc5": "cvc5"}


class Session(Protocol):
    """One conversation. Commands add to what was said before."""

    def say(self, text: str) -> str: ...


class _Z3:
    def __init__(self, seconds: float, _: str) -> None:
        self._z3: Any = _imported("z3")
        self._context = self._z3.Context()
        self.say(f"(set-option :timeout {int(seconds * 1000)})")

    def say(self, text: str) -> str:
        return str(self._z3.Z3_eval_smtlib2_string(self._context.ref(), text))


class _Cvc5:
    def __init__(self, seconds: float, strategy: str) -> None:
        cvc5: Any = _imported("cvc5")
        self._solver = cvc5.Solver(cvc5.TermManager())
        for option, value in (
            ("incremental", "true"),
            ("produce-models", "true"),
            ("tlimit-per", str(int(seconds * 1000))),
            (strategy, "true"),
        ):
            self._solver.setOption(option, value)
        self._parser = cvc5.InputParser(self._solver)
        self._parser.setIncrementalStringInput(cvc5.InputLanguage.SMT_LIB_2_6, "proof")

    def say(self, text: str) -> str:
        self._parser.appendIncrementalStringInput(text)
        told = []
        while not (command := self._parser.nextCommand()).isNull():
            told.append(str(command.invoke(self._solver, self._parser.getSymbolManager())))
        return "".join(told)


# How to instantiate quantifiers: what one way leaves open another may decide.
STRATEGIES: Final[dict[Name, tuple[str, ...]]] = {"z3": ("",), "cvc5": ("enum-inst-interleave", "enum-inst")}
_SESSIONS: Final[dict[Name, Callable[[float, str], Session]]] = {"z3": _Z3, "cvc5": _Cvc5}

_PACKAGES: Final[dict[Name, str]] = {"z3": "z3-solver", "cvc5": "cvc5"}


def _imported(name: Name) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise SolverMissing(
            f"the solver {name} is not installed, so it proves nothing: pip install {_PACKAGES[name]}"
        ) from None


def open_session(name: Name, seconds: float, strategy: str | None = None) -> Session:
    """A conversation in which no answer takes longer than that. Raises SolverMissing."""
    return _SESSIONS[name](seconds, strategy or STRATEGIES[name][0])


def version_of(name: Name) -> str | None:
    """The version installed, or None."""
    try:
        return version(_PACKAGE[name])
    except PackageNotFoundError:
        return None


def tell(session: Session, text: str) -> None:
    """Say what asks nothing. An answer is a complaint then, and an error: what was not understood would be missing."""
    if told := session.say(text).strip():
        raise VerificationError(f"a solver does not understand what it is told: {told[:500]}")


def ask(session: Session) -> Answer:
    """Whether what was said can be true. What is neither yes nor no is ``unknown``, a complaint an error."""
    told = session.say("(check-sat)\n").strip()
    for answer in _DECIDED:
        if told == answer:
            return answer
    if told.startswith("unknown") or "timeout" in told or "canceled" in told:  # cvc5 says why: `unknown (TIMEOUT)`
        return "unknown"
    raise VerificationError(f"a solver answers what is not an answer: {told[:500]}")


def value(session: Session, term: str) -> str:
    """The value of a term in the model just found."""
    told = session.say(f"(get-value ({term}))\n").strip()
    if not told.endswith("))"):
        raise VerificationError(f"a solver does not tell a value: {told[:500]}")
    inside = told[:-2].rstrip()
    if not inside.endswith(")"):
        return inside.split()[-1]
    depth = 0
    for place in range(len(inside) - 1, -1, -1):
        depth += (inside[place] == ")") - (inside[place] == "(")
        if depth == 0:
            return inside[place:]
    raise VerificationError(f"a solver does not tell a value: {told[:500]}")

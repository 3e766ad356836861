"""The SMT solvers, through SMT-LIB text. Only the proofs need them."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, Literal, Protocol

from midstride.errors import SolverMissing, VerificationError

SolverName = Literal["z3", "cvc5"]
SolverAnswer = Literal["sat", "unsat", "unknown"]
NAMES: Final[tuple[SolverName, ...]] = ("z3", "cvc5")
_DECIDED: Final[tuple[Literal["sat", "unsat"], ...]] = ("sat", "unsat")
_PACKAGE: Final[dict[SolverName, str]] = {"z3": "z3-solver", "cvc5": "cvc5"}


class Session(Protocol):
    """One session. Each command adds to the ones before."""

    def execute(self, text: str) -> str: ...


class _Z3:
    def __init__(self, seconds: float, _: str) -> None:
        self._z3: Any = _imported("z3")
        self._context = self._z3.Context()
        self.execute(f"(set-option :timeout {int(seconds * 1000)})")

    def execute(self, text: str) -> str:
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

    def execute(self, text: str) -> str:
        self._parser.appendIncrementalStringInput(text)
        answers = []
        while not (command := self._parser.nextCommand()).isNull():
            answers.append(str(command.invoke(self._solver, self._parser.getSymbolManager())))
        return "".join(answers)


# Ways to instantiate quantifiers, tried in order: one may decide what another leaves open.
STRATEGIES: Final[dict[SolverName, tuple[str, ...]]] = {"z3": ("",), "cvc5": ("enum-inst-interleave", "enum-inst")}
_SESSIONS: Final[dict[SolverName, Callable[[float, str], Session]]] = {"z3": _Z3, "cvc5": _Cvc5}


def _imported(name: SolverName) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise SolverMissing(f"the solver {name} is not installed: pip install {_PACKAGE[name]}") from None


def open_session(name: SolverName, seconds: float, strategy: str | None = None) -> Session:
    """A session in which no answer takes longer than ``seconds``. Raises SolverMissing."""
    return _SESSIONS[name](seconds, strategy or STRATEGIES[name][0])


def version_of(name: SolverName) -> str | None:
    """The version installed, or None."""
    try:
        return version(_PACKAGE[name])
    except PackageNotFoundError:
        return None


def send(session: Session, text: str) -> None:
    """Send declarations and assertions. Raises VerificationError for any answer: an assertion would be missing."""
    if answer := session.execute(text).strip():
        raise VerificationError(f"a solver rejects its input: {answer[:500]}")


def check_sat(session: Session) -> SolverAnswer:
    """Ask whether the assertions can all be true. Raises VerificationError where the solver reports an error."""
    text = session.execute("(check-sat)\n").strip()
    for answer in _DECIDED:
        if text == answer:
            return answer
    if text.startswith("unknown") or "timeout" in text or "canceled" in text:  # cvc5 adds a reason: `unknown (TIMEOUT)`
        return "unknown"
    raise VerificationError(f"unexpected answer from a solver: {text[:500]}")


def value(session: Session, term: str) -> str:
    """The value of a term in the model just found. Raises VerificationError if the answer has none."""
    text = session.execute(f"(get-value ({term}))\n").strip()
    if not text.endswith("))"):
        raise VerificationError(f"unexpected value from a solver: {text[:500]}")
    inside = text[:-2].rstrip()
    if not inside.endswith(")"):
        return inside.split()[-1]
    depth = 0
    for place in range(len(inside) - 1, -1, -1):
        depth += (inside[place] == ")") - (inside[place] == "(")
        if depth == 0:
            return inside[place:]
    raise VerificationError(f"unexpected value from a solver: {text[:500]}")

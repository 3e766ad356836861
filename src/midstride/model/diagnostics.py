"""Problems of a specification, and the catalogue of their kinds.

Codes are stable: ``E…`` are errors, ``W…`` warnings. E001 to E099 and W001 to W099 concern the meaning of a
specification and are defined here; a concrete syntax uses codes from 100 on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

from midstride.model.near_miss import did_you_mean, nearest

Severity: TypeAlias = Literal["error", "warning"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of problem: its title, and general advice."""

    code: str
    title: str
    advice: str

    @property
    def severity(self) -> Severity:
        return "error" if self.code.startswith("E") else "warning"


CATALOGUE: Final[dict[str, Kind]] = {
    kind.code: kind
    for kind in (
        # -- form -----------------------------------------------------------
        Kind("E001", "wrong type of value", "write a value of the type that the message names"),
        Kind("E002", "unknown key", "remove the key, or spell it as the message suggests"),
        Kind("E003", "missing key", "add the key"),
        Kind("E004", "number out of range", "write a finite number within the range that the message names"),
        Kind("E005", "unknown value", "use one of the values that the message lists"),
        Kind(
            "E006",
            "invalid name",
            "names consist of letters, digits and underscores and do not start with a digit; topics start with /",
        ),
        Kind("E007", "duplicate name", "give each its own name"),
        Kind("E008", "unknown name", "declare it, or use a declared name"),
        Kind("E009", "invalid command", "write the command as in a shell, with its quotes closed"),
        # -- components ------------------------------------------------------------------------------
        Kind(
            "E010",
            "M1: the last mode assumes something",
            "remove the assumptions of the last mode, or add a last mode without any",
        ),
        Kind(
            "E011",
            "M2: a worse mode guarantees more than a better one",
            "let the better mode guarantee at least as much",
        ),
        Kind("E012", "M3: the modes disagree on the endpoint of an output", "state one type and one QoS in all modes"),
        Kind("E013", "output produced by no functionality", "let one functionality produce it"),
        Kind("E014", "output produced by several functionalities", "let only one functionality produce it"),
        Kind("E015", "fewer than two modes", "give the functionality at least two modes, best first"),
        Kind("E016", "empty field constraint", "relax the constraints until some value satisfies them all"),
        # -- systems ---------------------------------------------------------------------------------
        Kind(
            "E020",
            "mismatched contracts",
            "weaken the requirement or strengthen the guarantee",
        ),
        Kind("E021", "port attached twice to one topic", "attach it once"),
        Kind("E022", "too many publishers", "detach a publisher or raise the limit"),
        Kind("E023", "capacity exceeded", "remove a node that uses the resource, or raise the capacity"),
        Kind("E024", "contradictory constraints", "remove one of them"),
        Kind("E025", "parameter of the wrong type", "use a value of the type that the component declares"),
        # -- warnings --------------------------------------------------------------------------------
        Kind("W030", "port not attached", "attach it, or remove it from the component"),
        Kind("W031", "unsatisfied topic", "attach an output that guarantees enough"),
        Kind("W032", "assumption that cannot be satisfied", "add an input that satisfies it, or weaken the assumption"),
        Kind("W033", "functionality not in its normal mode initially", "fix the root cause, listed last"),
        Kind(
            "W034",
            "constraint that does not hold initially",
            "fix what keeps the functionality degraded, or remove the constraint",
        ),
    )
}


# The total number of names compared to find near misses: with a thousand names, for the first hundred problems.
_COMPARISONS: Final = 150_000


@dataclass(frozen=True, slots=True)
class Problem:
    """One error or warning. ``subject`` is the path to it in the JSON form, from the specification down."""

    code: str
    subject: tuple[str, ...]
    message: str
    help: str = ""
    declared: tuple[str, ...] = field(default=(), compare=False, repr=False)  # E008: where it would be declared
    # E008: the unknown name and what is known, until :func:`suggested` has looked for near misses.
    candidates: tuple[str, Collection[str]] | None = field(default=None, compare=False, repr=False)

    @property
    def severity(self) -> Severity:
        return CATALOGUE[self.code].severity

    @property
    def path(self) -> str:
        """The subject as a JSON pointer (RFC 6901): ``/components/Talker/outputs/0``."""
        return "".join("/" + element.replace("~", "~0").replace("/", "~1") for element in self.subject) or "/"

    def __str__(self) -> str:
        return f"{self.path}: {self.message}" + (f" ({self.help})" if self.help else "") + f" [{self.code}]"


def suggested(found: list[Problem]) -> list[Problem]:
    """``found`` with near misses for unknown names; in a large system only for the first ones, to limit the time."""
    left = _COMPARISONS
    for index, problem in enumerate(found):
        if problem.candidates is None:
            continue
        help = ""
        left -= len(problem.candidates[1]) + 1
        if left > 0:
            help = suggestion(*problem.candidates) or "none is declared"
        found[index] = replace(problem, help=help, candidates=None)
    return found


def suggestion(wrong: str, known: Iterable[str]) -> str:
    """``did you mean `x`?`` if there is a near miss, else the known names; empty if there are none."""
    names = sorted(set(known))
    if (hint := did_you_mean(wrong, names)) is not None or not names:
        return hint or ""
    return f"known: {', '.join(names[:8])}" + (", …" if len(names) > 8 else "")


def independent(form: Iterable[Problem], names: Iterable[Problem]) -> list[Problem]:
    """The problems of form and of names, without unknown names whose declaration could not be read."""
    found = list(form)
    unread = {fault.subject for fault in found if fault.code == "E001"}
    strayed = {fault.subject for fault in found if fault.code == "E002"}
    lacking = {fault.subject for fault in found if fault.code == "E003"}

    def doubtful(declared: tuple[str, ...]) -> bool:
        if any(declared[:length] in unread for length in range(len(declared) + 1)):
            return True  # the whole section, or what it lies in
        if declared[:-1] in lacking or any(subject[:-1] == declared for subject in unread):
            return True  # the section itself, or one of its entries
        return any(
            subject[:-1] == declared[:-1] and nearest(subject[-1], declared[-1:]) is not None
            for subject in strayed  # the section itself, misspelt
        )

    found.extend(problem for problem in names if not (problem.declared and doubtful(problem.declared)))
    return found

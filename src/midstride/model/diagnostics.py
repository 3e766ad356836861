"""What can be wrong with a specification: the catalogue, and a problem found, as data.

Codes are stable: ``E…`` are errors, ``W…`` warnings. Codes below 100 concern what a specification says, in
whatever notation, and are defined here; a notation defines its own from 100 on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

from midstride.model.near_miss import did_you_mean, nearest

Severity: TypeAlias = Literal["error", "warning"]


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """An entry of the catalogue: a kind of problem, and what to do about it."""

    code: str
    title: str
    advice: str

    @property
    def severity(self) -> Severity:
        return "error" if self.code.startswith("E") else "warning"


CATALOGUE: Final[dict[str, ProblemKind]] = {
    kind.code: kind
    for kind in (
        # -- the form of what is written -----------------------------------------------------------
        ProblemKind("E001", "wrong type of value", "write a value of the type that the message names"),
        ProblemKind("E002", "unknown key", "remove the key, or write it as the message suggests"),
        ProblemKind("E003", "missing key", "add the key"),
        ProblemKind("E004", "number out of range", "write a finite number within the range that the message names"),
        ProblemKind("E005", "unknown word", "write one of the words that the message lists"),
        ProblemKind(
            "E006",
            "not a name",
            "names consist of letters, digits and underscores and do not start with a digit; topics start with /",
        ),
        ProblemKind("E007", "duplicate name", "give each its own name"),
        ProblemKind("E008", "unknown name", "declare it, or use a declared name"),
        ProblemKind("E009", "not a shell command", "write the command as in a shell, with its quotes closed"),
        # -- components ------------------------------------------------------------------------------
        ProblemKind(
            "E010",
            "M1: the last mode assumes something",
            "let the last mode assume nothing, or add a last mode that assumes nothing",
        ),
        ProblemKind(
            "E011",
            "M2: a worse mode guarantees what a better one does not",
            "let the better mode guarantee at least as much",
        ),
        ProblemKind(
            "E012", "M3: the modes disagree on the endpoint of an output", "state one type and one QoS in all modes"
        ),
        ProblemKind("E013", "output owned by no functionality", "let a functionality produce it"),
        ProblemKind("E014", "output owned by several functionalities", "let only one functionality produce it"),
        ProblemKind("E015", "nothing to degrade to", "give the functionality at least two modes, best first"),
        ProblemKind("E016", "empty field constraint", "widen the constraints until some value meets them all"),
        # -- systems ---------------------------------------------------------------------------------
        ProblemKind(
            "E020",
            "attachment whose contracts do not fit",
            "weaken what is needed or strengthen what is guaranteed",
        ),
        ProblemKind("E021", "port attached twice to one topic", "attach it once"),
        ProblemKind("E022", "too many publishers", "detach a publisher or raise the cap"),
        ProblemKind("E023", "capacity exceeded", "remove a node that holds the resource, or raise the capacity"),
        ProblemKind("E024", "constraints that contradict each other", "remove one of them"),
        ProblemKind("E025", "parameter of the wrong type", "write a value of the type that the component declares"),
        # -- warnings --------------------------------------------------------------------------------
        ProblemKind("W030", "port that is attached to no topic", "attach it, or remove it"),
        ProblemKind("W031", "topic that no publisher satisfies", "attach an output that guarantees enough"),
        ProblemKind("W032", "assumption that nothing can satisfy", "add an input that satisfies it, or weaken it"),
        ProblemKind("W033", "functionality that starts below its normal mode", "fix the root cause, listed last"),
        ProblemKind(
            "W034",
            "constraint that does not hold at the start",
            "fix what keeps the functionality in a lower mode, or remove the constraint",
        ),
    )
}


# How many comparisons the search for near misses may take in all: 150 unknown among 1,000 known names, say.
_COMPARISONS: Final = 150_000


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem. ``subject`` is the path to it, by the keys of the JSON form, from the specification down."""

    code: str
    subject: tuple[str, ...]
    message: str
    help: str = ""
    declared: tuple[str, ...] = field(default=(), compare=False, repr=False)  # E008: where the name would be declared
    # E008: the unknown name and the known ones, until :func:`with_suggestions` has searched for near misses.
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


def with_suggestions(found: list[Problem]) -> list[Problem]:
    """``found`` with near misses for unknown names; in a large system only for the first ones, since it takes time."""
    budget = _COMPARISONS
    for index, problem in enumerate(found):
        if problem.candidates is None:
            continue
        help = ""
        budget -= len(problem.candidates[1]) + 1
        if budget > 0:
            help = suggestion(*problem.candidates) or "no such name is declared"
        found[index] = replace(problem, help=help, candidates=None)
    return found


def unknown_name(kind: str, name: str, of: str = "") -> str:
    """``there is no topic `/scam` `` or, where it would belong to something, ``Filter has no input `im` ``."""
    return f"{of} has no {kind} `{name}`" if of else f"there is no {kind} `{name}`"


def suggestion(wrong: str, known: Iterable[str]) -> str:
    """``did you mean `x`?`` for a near miss, else a list of what is known, or nothing if there is none."""
    names = sorted(set(known))
    if (hint := did_you_mean(wrong, names)) is not None or not names:
        return hint or ""
    return f"known: {', '.join(names[:8])}" + (", …" if len(names) > 8 else "")


def independent(form: Iterable[Problem], names: Iterable[Problem]) -> list[Problem]:
    """Both lists, without unknown names that merely follow from a declaration that could not be read."""
    found = list(form)
    unread = {problem.subject for problem in found if problem.code == "E001"}
    unknown = {problem.subject for problem in found if problem.code == "E002"}
    missing = {problem.subject for problem in found if problem.code == "E003"}

    def doubtful(declared: tuple[str, ...]) -> bool:
        if any(declared[:length] in unread for length in range(len(declared) + 1)):
            return True  # the section itself, or one around it, could not be read
        if declared[:-1] in missing or any(subject[:-1] == declared for subject in unread):
            return True  # the section is missing, or one of its entries could not be read
        return any(
            subject[:-1] == declared[:-1] and nearest(subject[-1], declared[-1:]) is not None
            for subject in unknown  # the section itself, misspelt
        )

    found.extend(problem for problem in names if not (problem.declared and doubtful(problem.declared)))
    return found

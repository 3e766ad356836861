"""What can be wrong with a specification: the catalogue as data, and one thing found, as a value.

Codes are stable: ``E…`` are errors, ``W…`` warnings. E001 to E099 and W001 to W099 are about what a
specification says, however it is written down, and live here; a concrete syntax takes its own above.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

from midstride.model.near_miss import did_you_mean, nearest

Severity: TypeAlias = Literal["error", "warning"]


@dataclass(frozen=True, slots=True)
class Kind:
    """An entry of the catalogue: what is wrong in general, and what to do about it."""

    code: str
    title: str
    advice: str

    @property
    def severity(self) -> Severity:
        return "error" if self.code.startswith("E") else "warning"


CATALOGUE: Final[dict[str, Kind]] = {
    kind.code: kind
    for kind in (
        # -- the form of what is written -----------------------------------------------------------
        Kind("E001", "wrong type of value", "write a value of the type that the message names"),
        Kind("E002", "unknown key", "take the key out, or write it as the message suggests"),
        Kind("E003", "missing key", "add the key"),
        Kind("E004", "number out of range", "write a finite number within the range that the message names"),
        Kind("E005", "unknown word", "write one of the words that the message lists"),
        Kind(
            "E006",
            "not a name",
            "names have letters, digits and underscores, and start with no digit; topics start with /",
        ),
        Kind("E007", "duplicate name", "give each its own name"),
        Kind("E008", "unknown name", "declare it, or write the name of one that is declared"),
        Kind("E009", "not a command", "write the command as in a shell, with its quotes closed"),
        # -- components ------------------------------------------------------------------------------
        Kind(
            "E010",
            "M1: the last mode assumes something",
            "let the last mode assume nothing, or add a last mode that does",
        ),
        Kind(
            "E011",
            "M2: a worse mode guarantees what a better one does not",
            "let the better mode guarantee at least as much",
        ),
        Kind("E012", "M3: the modes disagree on the endpoint of an output", "state one type and one QoS in all modes"),
        Kind("E013", "output owned by no functionality", "let one functionality produce it"),
        Kind("E014", "output owned by several functionalities", "let one functionality alone produce it"),
        Kind("E015", "nothing to degrade to", "give the functionality at least two modes, best first"),
        Kind("E016", "empty field constraint", "widen the constraints on the field until some value meets them all"),
        # -- systems ---------------------------------------------------------------------------------
        Kind(
            "E020",
            "attachment whose contracts do not satisfy",
            "weaken what is needed or strengthen what is guaranteed",
        ),
        Kind("E021", "port attached twice to one topic", "attach it once"),
        Kind("E022", "too many publishers", "detach a publisher or raise the cap"),
        Kind("E023", "capacity exceeded", "take a holder out, or raise the capacity"),
        Kind("E024", "constraints that contradict each other", "take one of them out"),
        Kind("E025", "parameter of another type", "write a value of the type of the component's own"),
        # -- warnings --------------------------------------------------------------------------------
        Kind("W030", "port never attached", "attach it, or take it out"),
        Kind("W031", "topic nobody satisfies", "attach an output that guarantees enough"),
        Kind("W032", "assumption nothing can satisfy", "attach an input that counts, or weaken the assumption"),
        Kind("W033", "functionality not at its normal mode at first", "mend what the chain of reasons ends in"),
        Kind(
            "W034",
            "constraint that does not hold at first",
            "mend what keeps the functionality down, or take the constraint out",
        ),
    )
}


# How many names are compared with in all, looking for near misses: a hundred times with a thousand names, say.
_COMPARISONS: Final = 150_000


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong. ``subject`` leads to it, by the names of the JSON form, from the specification down."""

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
    """``found`` with near misses for unknown names; in a large system for the first ones alone, since it takes time."""
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
    """``did you mean `x`?`` for a near miss, else what is known, else nothing."""
    names = sorted(set(known))
    if (hint := did_you_mean(wrong, names)) is not None or not names:
        return hint or ""
    return f"known: {', '.join(names[:8])}" + (", …" if len(names) > 8 else "")


def independent(form: Iterable[Problem], names: Iterable[Problem]) -> list[Problem]:
    """Both, without the unknown names that only follow from a declaration that could not be read."""
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

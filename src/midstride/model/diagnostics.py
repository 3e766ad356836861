"""A problem found in a specification, as data.

Codes are stable: ``E…`` are errors, ``W…`` warnings. Codes below 100 concern what a specification says, in whatever
notation; a notation defines its own from 100 on. :mod:`midstride.lang.catalogue` explains each.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

from midstride.model.near_miss import did_you_mean, nearest
from midstride.model.printable import on_one_line

Severity: TypeAlias = Literal["error", "warning"]
SubjectPath: TypeAlias = tuple[str, ...]  # by the keys of the JSON form, from the specification down


# How many comparisons the search for near misses may take in all: 150 unknown among 1,000 known names, say.
_COMPARISONS: Final = 150_000


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem, and the path to its ``subject``."""

    code: str
    subject: SubjectPath
    message: str
    help: str = ""
    declared: tuple[str, ...] = field(default=(), compare=False, repr=False)  # E008: where the name would be declared
    # E008: the unknown name and the known ones, until :func:`with_suggestions` has searched for near misses.
    candidates: tuple[str, Collection[str]] | None = field(default=None, compare=False, repr=False)

    @property
    def severity(self) -> Severity:
        return "error" if self.code.startswith("E") else "warning"

    @property
    def path(self) -> str:
        """The subject as a JSON pointer (RFC 6901): ``/components/Talker/outputs/0``."""
        return "".join("/" + element.replace("~", "~0").replace("/", "~1") for element in self.subject) or "/"

    def __str__(self) -> str:
        help = f" ({self.help})" if self.help else ""
        return on_one_line(f"{self.path}: {self.message}{help} [{self.code}]")


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

"""Verdicts are data: HOLDS, VIOLATED or UNKNOWN, with what was judged, by what, how far, and what does not hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal

from midstride.codec.form import Form


class Answer(Enum):
    """UNKNOWN is neither a yes nor a no: nothing could be judged, and ``Verdict.because`` says why."""

    HOLDS = "holds"
    VIOLATED = "violated"
    UNKNOWN = "unknown"

    def __str__(self) -> str:
        return self.value.upper()


Kind = Literal[
    "precondition", "effect", "assumption", "cap", "capacity", "attachment", "rule", "end", "name", "document"
]


class CauseLink(Form, frozen=True):
    """One link of the chain from an assumption to what falls short, for the picture."""

    thing: Literal["functionality", "assumption", "input", "topic", "output", "environment"]
    name: str
    told: str
    satisfied: bool
    under: tuple[CauseLink, ...] = ()


class Finding(Form, frozen=True, omit_defaults=False):
    """One thing that does not hold, in the file's own names.

    ``step`` counts from 1; None is the configuration at the start (or the only one), the declarations, or the end.
    """

    kind: Kind
    step: int | None
    where: str
    subject: str
    because: str
    assumption: str | None = None
    chain: CauseLink | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.subject}: {self.because}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question. ``steps`` are a judged plan's, in words; ``failed`` is the first that fails."""

    answer: Answer
    subject: str
    scope: str
    by: str
    findings: tuple[Finding, ...] = ()
    because: str | None = None
    seconds: float = 0.0
    steps: tuple[str, ...] = field(default=())

    @property
    def holds(self) -> bool:
        return self.answer is Answer.HOLDS

    @property
    def headline(self) -> str:
        """What was judged, and the answer."""
        return f"{self.answer}: {self.subject}"

    @property
    def words(self) -> str:
        """The answer with its reasons, on one line."""
        reasons = [str(finding) for finding in self.findings] or [self.because or self.scope]
        return f"{self.headline}: {'; '.join(reasons)}"

    @property
    def failed(self) -> int | None:
        return min((finding.step for finding in self.findings if finding.step is not None), default=None)

    def __str__(self) -> str:
        told = f"{self.headline} ({self.scope}; {self.by})"
        return told if self.because is None else f"{told}: {self.because}"


class VerdictForm(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """A verdict in JSON."""

    verdict: Literal["holds", "violated", "unknown"]
    subject: str
    scope: str
    by: str
    because: str | None
    findings: list[Finding]
    steps: list[str]
    failed: int | None
    seconds: float

    @classmethod
    def of(cls, verdict: Verdict) -> VerdictForm:
        return cls(
            verdict=verdict.answer.value,
            subject=verdict.subject,
            scope=verdict.scope,
            by=verdict.by,
            because=verdict.because,
            findings=list(verdict.findings),
            steps=list(verdict.steps),
            failed=verdict.failed,
            seconds=verdict.seconds,
        )

"""Verdicts as data: HOLDS, VIOLATED or UNKNOWN, with the subject, the verifier, the scope, and the findings."""

from __future__ import annotations

from enum import Enum
from typing import Literal

import msgspec

from midstride.codec.form import Form


class Answer(Enum):
    """UNKNOWN is neither yes nor no: ``Verdict.because`` says why there is no answer."""

    HOLDS = "holds"
    VIOLATED = "violated"
    UNKNOWN = "unknown"

    def __str__(self) -> str:
        return self.value.upper()


ViolationKind = Literal[
    "precondition", "effect", "assumption", "cap", "capacity", "attachment", "rule", "end", "name", "document"
]


class CauseLink(Form, frozen=True):
    """One link of the chain from an assumption to its unmet cause, for diagrams."""

    kind: Literal["functionality", "assumption", "input", "topic", "output", "environment"]
    name: str
    detail: str
    satisfied: bool
    causes: tuple[CauseLink, ...] = ()


class Finding(Form, frozen=True, omit_defaults=False):
    """One violation, in the names of the file.

    ``step`` counts from 1; None is the configuration at the start (or the only one), the declarations, or the end.
    """

    kind: ViolationKind
    step: int | None
    where: str
    subject: str
    because: str
    assumption: str | None = None
    chain: CauseLink | None = None

    def __str__(self) -> str:
        return f"{self.where}: {self.subject}: {self.because}"


class Verdict(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """The answer to one question. ``steps`` are a plan's; ``failed`` is the first that fails."""

    answer: Answer = msgspec.field(name="verdict")
    subject: str
    scope: str
    by: str
    because: str | None = None
    findings: tuple[Finding, ...] = ()
    steps: tuple[str, ...] = ()
    failed: int | None = None
    seconds: float = 0.0

    def __post_init__(self) -> None:
        failed = min((finding.step for finding in self.findings if finding.step is not None), default=None)
        msgspec.structs.force_setattr(self, "failed", failed)

    @property
    def holds(self) -> bool:
        return self.answer is Answer.HOLDS

    @property
    def headline(self) -> str:
        """The answer, and its subject."""
        return f"{self.answer}: {self.subject}"

    @property
    def words(self) -> str:
        """The answer with its reasons, on one line."""
        reasons = [str(finding) for finding in self.findings] or [self.because or self.scope]
        return f"{self.headline}: {'; '.join(reasons)}"

    def __str__(self) -> str:
        text = f"{self.headline} ({self.scope}; {self.by})"
        return text if self.because is None else f"{text}: {self.because}"

"""Verdicts as data: HOLDS, VIOLATED or UNKNOWN, with the subject, the verifier, the scope, and the findings."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal


class Answer(Enum):
    """UNKNOWN is neither yes nor no: ``Verdict.because`` says why there is no answer."""

    HOLDS = "holds"
    VIOLATED = "violated"
    UNKNOWN = "unknown"

    def __str__(self) -> str:
        return self.value.upper()


Kind = Literal[
    "precondition", "effect", "assumption", "cap", "capacity", "attachment", "rule", "end", "name", "document"
]


@dataclass(frozen=True, slots=True)
class CauseLink:
    """One link of the chain from an assumption to its unmet cause, for diagrams."""

    thing: Literal["functionality", "assumption", "input", "topic", "output", "environment"]
    name: str
    detail: str
    satisfied: bool
    under: tuple[CauseLink, ...] = ()

    def to_document(self) -> dict[str, Any]:
        document: dict[str, Any] = {
            "thing": self.thing, "name": self.name, "told": self.detail, "satisfied": self.satisfied
        }  # fmt: skip
        if self.under:
            document["under"] = [link.to_document() for link in self.under]
        return document


@dataclass(frozen=True, slots=True)
class Finding:
    """One violation, in the names of the file.

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

    def to_document(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "step": self.step,
            "where": self.where,
            "subject": self.subject,
            "assumption": self.assumption,
            "because": self.because,
            "chain": None if self.chain is None else self.chain.to_document(),
        }


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question. ``steps`` are a plan's; ``failed`` is the first that fails."""

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
        """The answer, and its subject."""
        return f"{self.answer}: {self.subject}"

    @property
    def words(self) -> str:
        """The answer with its reasons, on one line."""
        reasons = [str(finding) for finding in self.findings] or [self.because or self.scope]
        return f"{self.headline}: {'; '.join(reasons)}"

    @property
    def failed(self) -> int | None:
        return min((finding.step for finding in self.findings if finding.step is not None), default=None)

    def to_document(self) -> dict[str, Any]:
        return {
            "verdict": self.answer.value,
            "subject": self.subject,
            "scope": self.scope,
            "by": self.by,
            "because": self.because,
            "findings": [finding.to_document() for finding in self.findings],
            "steps": list(self.steps),
            "failed": self.failed,
            "seconds": self.seconds,
        }

    def __str__(self) -> str:
        text = f"{self.headline} ({self.scope}; {self.by})"
        return text if self.because is None else f"{text}: {self.because}"

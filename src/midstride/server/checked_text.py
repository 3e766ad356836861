"""Checks the text of a specification that a client sends, and answers the request that applies it.

Whoever sends a text must not choose what is read from the manager's disk: it can include no file and name no file of
parameters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

from msgspec import Meta, convert

from midstride.codec.form import Report
from midstride.codec.specification_form import SpecificationForm
from midstride.lang.load import load_text
from midstride.lang.message_types import installed
from midstride.lang.source_files import Unreadable
from midstride.plan.forms.request_form import ChangeRequest
from midstride.server.requests import SubmittedText

_HELP: Final = "save the files on the robot, and apply them there with `midstride apply FILE`"

Line: TypeAlias = Annotated[int, Meta(description="from 1")]


class NotePlace(Report, frozen=True, kw_only=True):
    """A further place that a diagnostic is about."""

    message: str
    file: str
    line: Line
    column: Line


class DiagnosticReport(Report, frozen=True, kw_only=True):
    """A problem in a text, as `midstride check --json` prints it; `end_column` is exclusive."""

    code: str
    severity: Literal["error", "warning"]
    file: str
    line: Line
    column: Line
    end_line: Line
    end_column: Line
    message: str
    help: str | None
    follows: Annotated[str | None, Meta(description="what follows from it")]
    notes: list[NotePlace]


class CheckedText(Report, frozen=True, kw_only=True):
    """The check of a text that is to be applied: if it can be, `request` is what `/plan` and `/change` take."""

    ok: bool
    diagnostics: list[DiagnosticReport]
    request: Annotated[ChangeRequest | None, Meta(description="null where there are errors")]


def checked(submitted: SubmittedText) -> CheckedText:
    """Check a text. It can take seconds; nothing makes it raise."""
    name = Path(submitted.name).name or "text.stride"
    loaded = load_text(submitted.text, name, read=_refuse, messages=installed())
    specification = loaded.specification
    return CheckedText(
        ok=specification is not None,
        diagnostics=[convert(each.to_json(), DiagnosticReport) for each in loaded.diagnostics],
        request=None if specification is None else ChangeRequest(to=SpecificationForm.of(specification)),
    )


def _refuse(path: Path) -> str:
    raise Unreadable("E100", "no file is read for a text that is sent to the manager", _HELP)

"""Exceptions as HTTP responses: a status, and one form with the message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import UNSET, UnsetType
from starlette.responses import Response

from midstride import errors
from midstride.codec.form import Form
from midstride.codec.writing import to_json

# The first that matches; anything else is an internal error.
_STATUS: Final[tuple[tuple[type[Exception], int], ...]] = (
    (errors.SpecificationError, 422),
    (errors.PlanRefused, 409),
    (errors.ActionRefused, 409),
    (errors.CommandRefused, 409),
    (errors.NoManager, 404),
    (errors.ManagerError, 409),
    (errors.VerificationError, 409),
    (errors.CallTimeout, 504),
    (errors.BackendError, 502),
    (errors.MidstrideError, 500),
)


def status_of(error: Exception) -> int:
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


class FailureDetails(Form, frozen=True, forbid_unknown_fields=False):
    """The exception's name, as in midstride.errors, its message, and each fault of a specification."""

    kind: str
    message: str
    problems: list[str] | UnsetType = UNSET


class Failure(Form, frozen=True, forbid_unknown_fields=False):
    """An operation that failed."""

    error: FailureDetails

    @classmethod
    def of(cls, error: Exception) -> Failure:
        problems = [str(each) for each in error.problems] if isinstance(error, errors.SpecificationError) else UNSET
        return cls(FailureDetails(type(error).__name__, str(error) or type(error).__name__, problems))

    @classmethod
    def named(cls, kind: str, message: str) -> Failure:
        return cls(FailureDetails(kind, message))


def answer(form: object, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """The HTTP response that has the form as its JSON."""
    return Response(to_json(form), status, headers, media_type="application/json")

"""Exceptions as answers: a status that HTTP clients understand, and one document with the words."""

from __future__ import annotations

from typing import Any, Final

from midstride import errors

# The first that fits; what fits none is the server's own fault.
_STATUS: Final[tuple[tuple[type[Exception], int], ...]] = (
    (errors.SpecificationError, 422),
    (errors.PlanRefused, 409),
    (errors.ActionRefused, 409),
    (errors.NoManager, 404),
    (errors.ManagerError, 409),
    (errors.CallTimeout, 504),
    (errors.BackendError, 502),
    (errors.MidstrideError, 500),
)


def status_of(error: Exception) -> int:
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


def told(error: Exception) -> dict[str, Any]:
    """``{"error": {"kind", "message"}}``; a specification's faults one by one beside it."""
    document: dict[str, Any] = {"kind": type(error).__name__, "message": str(error) or type(error).__name__}
    if isinstance(error, errors.SpecificationError):
        document["problems"] = [str(problem) for problem in error.problems]
    return {"error": document}


def in_one_line(faults: list[dict[str, Any]]) -> str:
    """Pydantic's list of faults: where and what, each in a few words."""
    told = []
    for fault in faults:
        where = "/" + "/".join(str(part) for part in fault["loc"] if part != "body")
        told.append(f"{where}: {fault['msg']}")
    return "; ".join(told)

"""The OpenAPI document: FastAPI knows the operations, the schemas come from the classes that are sent and read."""

from __future__ import annotations

from typing import Any, Final, TypeAlias, get_args

import msgspec
from fastapi import FastAPI

from midstride.codec.schema import Schema, schemas
from midstride.codec.specification_form import SpecificationForm
from midstride.plan.forms.request_form import ChangeRequest
from midstride.runtime.records import reports, status_forms
from midstride.runtime.records.change_history import History, SpecificationVersion
from midstride.runtime.records.change_report import ChangeReport
from midstride.runtime.records.rehearsal_forms import Rehearsal
from midstride.server.checked_text import CheckedText
from midstride.server.error_answers import Failure
from midstride.server.requests import (
    LARGEST_BODY,
    DeathRequest,
    LockRequest,
    ParameterSetting,
    SubmittedChange,
    SubmittedRehearsal,
    SubmittedText,
    UnlockRequest,
)
from midstride.server.view import view_forms

Responses: TypeAlias = dict[int | str, dict[str, Any]]

FORMS: Final = (
    ChangeRequest,
    DeathRequest,
    Failure,
    LockRequest,
    UnlockRequest,
    status_forms.ChangeLock,
    ParameterSetting,
    SpecificationForm,
    SubmittedChange,
    ChangeReport,
    SubmittedRehearsal,
    SubmittedText,
    CheckedText,
    History,
    Rehearsal,
    SpecificationVersion,
    reports.DeadHost,
    reports.DownReport,
    reports.Event,
    reports.LiveConfiguration,
    reports.Outcome,
    status_forms.ParametersReport,
    reports.PlannedChange,
    status_forms.ProgramStatus,
    status_forms.Service,
    reports.UpReport,
    status_forms.Why,
    view_forms.Patch,
    view_forms.Timeline,
    view_forms.SystemView,
)
_TEMPLATE: Final = "#/components/schemas/{name}"


def answers(form: Any, *, body: bool = False) -> Responses:
    """The responses of an operation: ``form``, or a list of it, and what each failure means.

    ``body``: its requests have one.
    """
    too_large: Responses = {413: _described(Failure, f"the body has more than {LARGEST_BODY} bytes")} if body else {}
    return {200: _described(form, "the answer"), **failures(), **too_large}


def failures() -> Responses:
    return {
        401: _described(Failure, "over TCP: the token is missing or wrong"),
        403: _described(Failure, "over TCP, from a browser: another host name, or a change from another origin"),
        409: _described(Failure, "refused; nothing was changed, and the message says why"),
        422: _described(Failure, "not JSON, or an invalid request or specification; every fault is listed"),
        500: _described(Failure, "the system could not be brought up, or an internal error"),
        502: _described(Failure, "the platform failed"),
        504: _described(Failure, "a component did not answer in time"),
    }


def request_body(form: type[msgspec.Struct]) -> dict[str, Any]:
    """The body of an operation's request, as FastAPI's ``openapi_extra``."""
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": _schema(form)}}}}


def document_forms(app: FastAPI) -> None:
    """Have the application's OpenAPI document contain the schemas of all forms."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        document = plain()
        document["components"] = {
            "schemas": schemas(FORMS, _TEMPLATE),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer", "description": "over TCP alone"}},
        }
        document["security"] = [{"token": []}, {}]
        return document

    app.openapi = openapi  # type: ignore[method-assign]  # the way that FastAPI documents


def _described(form: Any, description: str) -> dict[str, Any]:
    return {"description": description, "content": {"application/json": {"schema": _schema(form)}}}


def _schema(form: Any) -> Schema:
    if members := get_args(form):  # list[…]
        return {"type": "array", "items": _schema(members[0])}
    return {"$ref": _TEMPLATE.format(name=form.__name__)}

"""The HTTP API (docs/http.md): ``/api/v1``, its OpenAPI document, and the event stream.

Every operation is the manager's; nothing is decided here. A change that has started is completed, or rolled back by the
manager, even if the client disconnects.
"""

from __future__ import annotations

import asyncio
import os
from typing import Annotated, Any, Final

from fastapi import APIRouter, FastAPI, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, PlainTextResponse
from msgspec import UNSET
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from midstride import __version__
from midstride.codec.specification_form import SpecificationForm
from midstride.errors import MidstrideError, SpecificationError, internal_error
from midstride.plan.alternatives import alternatives
from midstride.plan.forms.request_form import ChangeRequest
from midstride.runtime.records.change_history import History, SpecificationVersion
from midstride.runtime.records.change_report import ChangeReport
from midstride.runtime.records.rehearsal_forms import Rehearsal
from midstride.runtime.records.reports import (
    DeadHost,
    DownReport,
    Event,
    LiveConfiguration,
    Outcome,
    PlannedChange,
    UpReport,
)
from midstride.runtime.records.status_forms import ChangeLock, ParametersReport, ProgramStatus, Service, Why
from midstride.server.checked_text import CheckedText, checked
from midstride.server.error_answers import Failure, answer, status_of
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.metrics.metrics_source import metrics_answer
from midstride.server.openapi import answers, document_forms, failures, request_body
from midstride.server.rehearsing import Rehearser
from midstride.server.report.documents import change_file
from midstride.server.requests import (
    DeathRequest,
    LockRequest,
    ParameterSetting,
    SubmittedChange,
    SubmittedRehearsal,
    SubmittedText,
    UnlockRequest,
    read_change,
    read_death,
    read_lock,
    read_rehearsal,
    read_request,
    read_setting,
    read_text,
    read_unlock,
)
from midstride.server.static import dashboard
from midstride.server.view.live import LiveView
from midstride.server.view.routes import viewing
from midstride.wire.frames import PROTOCOL

# Row numbers are 32-bit.
_LARGEST: Final = 2**31 - 1
_Number = Annotated[int | None, Query(ge=1, le=_LARGEST, description="as in /history")]
_Id = Annotated[str | None, Query(max_length=100, description="as of a change")]


def create_app(live: LiveView) -> FastAPI:
    """The application of the manager that ``live`` shows. It keeps no state."""
    lifecycle = live.lifecycle
    app = FastAPI(
        title="Midstride",
        version=__version__,
        summary="The manager of a running system: its state, plans, changes and events",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,  # the page would load its scripts from elsewhere
        redoc_url=None,
    )
    app.include_router(_reading(lifecycle, lifecycle.manager.watched.backend.name), prefix="/api/v1", tags=["reading"])
    app.include_router(viewing(live), prefix="/api/v1", tags=["viewing"])
    app.include_router(_changing(lifecycle), prefix="/api/v1", tags=["changing"])
    app.include_router(_monitoring(lifecycle), tags=["monitoring"])
    app.include_router(dashboard())
    app.add_exception_handler(MidstrideError, _refused)
    app.add_exception_handler(SpecificationError, _faulty)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(ClientDisconnect, _disconnected)
    app.add_exception_handler(Exception, _internal_error)
    document_forms(app)
    return app


async def _refused(_: Request, error: Exception) -> Response:
    return answer(Failure.of(error), status_of(error))


async def _faulty(_: Request, error: Exception) -> Response:
    return await asyncio.to_thread(lambda: answer(Failure.of(error), status_of(error)))  # of thousands of faults


async def _invalid(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    places = ["/".join(str(part) for part in fault["loc"] if part != "body") for fault in error.errors()]
    faults = [f"/{place}: {fault['msg']}" for place, fault in zip(places, error.errors(), strict=True)]
    return answer(Failure.named("SpecificationError", "; ".join(faults)), 422)


async def _http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    kind, message, headers = "TooLarge", error.detail, error.headers
    if error.status_code == 405:  # the first route of the path knows nothing of the others
        operations = request.app.openapi()["paths"].get(request.url.path, {})
        methods = {method.upper() for method in operations} or {"GET", "HEAD"}  # the dashboard's are not documented
        headers = {"Allow": ", ".join(sorted(methods))}
    if error.status_code != 413:
        kind = "NoOperation"
        message = f"{request.method} {request.url.path}: {message}; /api/v1/openapi.json lists every operation"
    return answer(Failure.named(kind, message), error.status_code, headers)


async def _disconnected(_: Request, __: Exception) -> Response:
    return Response(status_code=400)  # nothing reads it


async def _internal_error(_: Request, error: Exception) -> Response:
    return answer(Failure.named("InternalError", internal_error(error)), 500)


def _reading(lifecycle: Lifecycle, backend: str) -> APIRouter:
    router, manager = APIRouter(), lifecycle.manager

    @router.get("", responses=answers(Service))
    async def service() -> Response:
        """The manager that answers, and whether its system is up."""
        name = manager.specification.name
        return answer(Service(name, backend, __version__, os.getpid(), lifecycle.phase, PROTOCOL))

    @router.get("/up", responses=answers(UpReport))
    async def up() -> Response:
        """The result of bringing the system up; waits until it is known."""
        return answer(await lifecycle.outcome_of_up())

    @router.get("/programs", responses=answers(list[ProgramStatus]))
    async def programs() -> Response:
        """The files of the programs that run, and which of them have changed on disk since they started."""
        return answer(await manager.programs())

    @router.get("/configuration", responses=answers(LiveConfiguration))
    async def configuration() -> Response:
        """The configuration as its components report it, with its topics and environment."""
        return answer(await manager.live())

    @router.get("/specification", responses=answers(SpecificationForm))
    async def specification() -> Response:
        """The specification that the system runs, in its JSON form."""
        return answer(SpecificationForm.of(manager.specification))

    @router.get("/specification/earlier", responses=answers(SpecificationVersion))
    async def earlier_specification(version: _Number = None) -> Response:
        """A version of the specification; by default the one before the latest change of it."""
        return answer(await manager.earlier_specification(version))

    @router.get("/history", responses=answers(History))
    async def history(
        latest: Annotated[int, Query(ge=1, le=_LARGEST, description="how many changes, and incidents")] = 20,
    ) -> Response:
        """The latest changes with their figures, also those of earlier managers, and incidents such as crashes."""
        return answer(await manager.history(latest))

    @router.get("/change", responses=answers(ChangeReport))
    async def past_change(number: _Number = None) -> Response:
        """A change of the history, by default the latest: its plan, both specifications, what happened, the figures."""
        return answer(await manager.change_report(number))

    @router.get(
        "/report",
        response_class=HTMLResponse,
        responses={200: {"content": {"text/html": {}}, "description": "one self-contained file"}, **failures()},
    )
    async def report(number: _Number = None) -> Response:
        """A change of the history, by default the latest, as an HTML file that needs nothing else."""
        found = await manager.change_report(number)
        text = await asyncio.to_thread(change_file, found, manager.specification.name, backend)
        headers = {"Content-Disposition": 'attachment; filename="change.html"', "X-Content-Type-Options": "nosniff"}
        return HTMLResponse(text, headers=headers)

    @router.get("/parameters", responses=answers(list[ParametersReport]))
    async def parameters(
        node: Annotated[str | None, Query(description="a node or an instance; by default all of them")] = None,
    ) -> Response:
        """The parameters of running nodes, as the nodes say them now."""
        lifecycle.require_up()
        return answer(await manager.parameters(node))

    @router.get("/why", responses=answers(Why))
    async def why(functionality: Annotated[str, Query(description="as `listener.listen`")]) -> Response:
        """The reason why a functionality is in the mode it is in."""
        return answer(await manager.why(functionality))

    @router.get("/log", responses=answers(list[Event]))
    async def log(
        since: Annotated[int, Query(ge=0, description="the last event's number")] = 0,
    ) -> Response:
        """The events so far."""
        return answer(manager.log(since))

    return router


def _monitoring(lifecycle: Lifecycle) -> APIRouter:
    router = APIRouter()

    @router.get(
        "/metrics",
        response_class=PlainTextResponse,
        responses={
            200: {"content": {"text/plain": {}}, "description": "the text format of Prometheus"},
            **failures(),
        },
    )
    async def metrics() -> Response:
        """The health of the system for Prometheus, at the path that it expects. What is not known is absent."""
        return await metrics_answer(lifecycle)

    return router


def _changing(lifecycle: Lifecycle) -> APIRouter:
    router, manager, rehearser = APIRouter(), lifecycle.manager, Rehearser()

    @router.post("/plan", responses=answers(PlannedChange, body=True), openapi_extra=request_body(ChangeRequest))
    async def plan(http: Request) -> Response:
        """The plan for a change; nothing is changed. Pass its `revision` as `expected` to `/change`."""
        request = await read_request(http)
        lifecycle.require_up()
        revision = manager.revision
        found = await manager.plan(request)
        permission = manager.watched.permission
        allowed: dict[str, Any] = {
            "forbidden": permission.refusal() or UNSET,
            "requires": permission.requirements() or UNSET,
        }

        def response() -> Response:
            others = alternatives(found) if request.explain else UNSET
            planned = PlannedChange.of(found, revision=revision, alternatives=others, **allowed)
            return answer(planned)

        return await asyncio.to_thread(response)

    @router.post("/check", responses=answers(CheckedText, body=True), openapi_extra=request_body(SubmittedText))
    async def check(http: Request) -> Response:
        """Check the text of a specification; no file is read for it. Its `request` can be planned and carried out."""
        submitted = await read_text(http)
        return await asyncio.to_thread(lambda: answer(checked(submitted)))

    @router.post("/rehearsal", responses=answers(Rehearsal, body=True), openapi_extra=request_body(SubmittedRehearsal))
    async def rehearsal(http: Request) -> Response:
        """Rehearse a change in the simulator, with stand-ins for programs, while faults strike. Nothing is changed."""
        asked = await read_rehearsal(http)
        lifecycle.require_up()
        return answer(await rehearser.rehearse(manager.specification, asked))

    @router.post("/change", responses=answers(Outcome, body=True), openapi_extra=request_body(SubmittedChange))
    async def change(http: Request) -> Response:
        """Carry out a change, once the commands before it are done; responds when it has been measured."""
        change, request = await read_change(http)
        lifecycle.require_up()
        work = manager.change(
            request,
            expected=change.expected,
            verify=change.verify,
            brief=change.brief,
            wait=change.wait,
            id=change.id,
            by=change.by,
            file=change.file,
            override=change.override,
        )
        return answer(await lifecycle.carry_out(work))

    @router.post(
        "/parameters", responses=answers(ParametersReport, body=True), openapi_extra=request_body(ParameterSetting)
    )
    async def parameters(http: Request) -> Response:
        """Set parameters of a running node, once the commands before are done; a replacement keeps the values."""
        setting, values = await read_setting(http)
        lifecycle.require_up()
        work = manager.set_parameters(setting.node, values, setting.override, setting.by, setting.id)
        return answer(await lifecycle.carry_out(work))

    @router.post("/lock", responses=answers(ChangeLock, body=True), openapi_extra=request_body(LockRequest))
    async def lock(http: Request) -> Response:
        """Lock the system at once: no command changes it, but /down. A change in progress goes on."""
        asked = await read_lock(http)
        lifecycle.require_up()
        return answer(manager.lock(asked.reason, asked.by, asked.until, holds_recovery=asked.holds_recovery))

    @router.post("/unlock", responses=answers(ChangeLock, body=True), openapi_extra=request_body(UnlockRequest))
    async def unlock(http: Request) -> Response:
        """End the lock; the answer is the one that has ended."""
        asked = await read_unlock(http)
        lifecycle.require_up()
        return answer(manager.unlock(asked.by))

    @router.post("/dead", responses=answers(DeadHost, body=True), openapi_extra=request_body(DeathRequest))
    async def declare_dead(http: Request) -> Response:
        """Take what runs on a host that cannot be reached for exited, so that it may be started elsewhere."""
        asked = await read_death(http)
        lifecycle.require_up()
        return answer(await lifecycle.carry_out(manager.declare_dead(asked.host, asked.by)))

    @router.post("/down", responses=answers(DownReport))
    async def down(id: _Id = None) -> Response:
        """Stop every component, and then the manager."""
        return answer(await lifecycle.carry_out(lifecycle.take_down(id), breakable=False))

    return router

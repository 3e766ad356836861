"""The HTTP API (interfaces.md): ``/api/v1``, its OpenAPI document, and the event stream.

Every operation is the manager's; nothing is decided here. A change that was begun is carried out
to its end (or taken back by the manager) even if the client goes away.
"""

from __future__ import annotations

import os
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI, Header, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, StreamingResponse
from starlette.exceptions import HTTPException

from midstride import __version__
from midstride.errors import MidstrideError
from midstride.model.document import specification_to_document
from midstride.server import documents, errors, stream
from midstride.server.lifecycle import Lifecycle

_REFUSED: dict[int | str, dict[str, Any]] = {
    409: {"model": documents.Failure, "description": "refused, nothing was changed; the message says why"},
    422: {"model": documents.Failure, "description": "not a request, or not a specification; every fault is named"},
    502: {"model": documents.Failure, "description": "the platform below failed"},
}


def _answers(model: type[documents.Outgoing]) -> dict[int | str, dict[str, Any]]:
    return {200: {"model": model}, **_REFUSED}


def create_app(lifecycle: Lifecycle, *, backend: str) -> FastAPI:
    """The application of one manager. It keeps no state of its own."""
    app = FastAPI(
        title="Midstride",
        version=__version__,
        summary="The manager of a running system: its state, its plans, its changes, and what happens",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,  # the page would load its scripts from elsewhere
        redoc_url=None,
    )
    app.include_router(_reading(lifecycle, backend), prefix="/api/v1", tags=["reading"])
    app.include_router(_changing(lifecycle), prefix="/api/v1", tags=["changing"])
    app.add_exception_handler(MidstrideError, _told)
    app.add_exception_handler(RequestValidationError, _not_a_request)
    app.add_exception_handler(HTTPException, _no_operation)
    app.add_exception_handler(Exception, _our_fault)
    return app


async def _told(_: Request, error: Exception) -> Response:
    return JSONResponse(errors.told(error), errors.status_of(error))


async def _not_a_request(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    message = errors.in_one_line(list(error.errors()))
    return JSONResponse({"error": {"kind": "SpecificationError", "message": message}}, 422)


async def _no_operation(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    asked = f"{request.method} {request.url.path}"
    message = f"{asked}: {error.detail}; /api/v1/openapi.json lists every operation"
    return JSONResponse({"error": {"kind": "NoOperation", "message": message}}, error.status_code, error.headers)


async def _our_fault(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": {"kind": "InternalError", "message": f"internal error: {error!r}"}}, 500)


def _reading(lifecycle: Lifecycle, backend: str) -> APIRouter:
    router, manager = APIRouter(), lifecycle.manager

    @router.get("", responses={200: {"model": documents.Service}})
    async def service() -> Response:
        """Who answers, and whether its system is up."""
        told = {"system": manager.specification.name, "backend": backend, "version": __version__}
        return JSONResponse({**told, "pid": os.getpid(), "phase": lifecycle.phase})

    @router.get("/up", responses=_answers(documents.Outcome))
    async def up() -> Response:
        """What came of bringing the system up; waits until that is known."""
        return JSONResponse(await lifecycle.outcome_of_up())

    @router.get("/status", responses=_answers(documents.Status))
    async def status() -> Response:
        """What is live and in which modes, as each component itself says it."""
        return JSONResponse(await manager.status())

    @router.get("/configuration", responses=_answers(documents.Live))
    async def configuration() -> Response:
        """What is live, attached and in which mode, as each component itself says it, with the world it lives in."""
        return JSONResponse(await manager.live())

    @router.get("/specification", responses=_REFUSED)
    async def specification() -> Response:
        """The specification that the system runs, in its JSON form."""
        return JSONResponse(specification_to_document(manager.specification))

    @router.get("/why", responses=_answers(documents.Why))
    async def why(functionality: Annotated[str, Query(description="as `listener.listen`")]) -> Response:
        """Why a functionality is in the mode it is in."""
        return JSONResponse(await manager.why(functionality))

    @router.get("/log", responses={200: {"model": list[documents.Event]}})
    async def log(since: Annotated[int, Query(ge=0, description="the last event's number one has")] = 0) -> Response:
        """What has happened so far."""
        return JSONResponse(manager.log(since))

    @router.get(
        "/events",
        response_class=StreamingResponse,
        responses={200: {"content": {"text/event-stream": {}}, "description": "server-sent events, as in /log"}},
    )
    async def events(
        since: Annotated[int, Query(ge=0)] = 0,
        last_event_id: Annotated[int | None, Header(description="goes before `since`")] = None,
    ) -> Response:
        """What has happened after event `since`, and what happens from now on."""
        begin = since if last_event_id is None else last_event_id
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(stream.events(lifecycle, begin), media_type="text/event-stream", headers=headers)

    return router


def _changing(lifecycle: Lifecycle) -> APIRouter:
    router, manager = APIRouter(), lifecycle.manager

    @router.post("/plan", responses=_answers(documents.Plan))
    async def plan(request: documents.ChangeRequest) -> Response:
        """The plan for a change; nothing is changed. `revision` goes into `expected` of `/change`."""
        lifecycle.require_up()
        revision = manager.revision
        found = await manager.plan(request.request())
        return JSONResponse({**found.to_document(), "revision": revision})

    @router.post("/change", responses=_answers(documents.Outcome))
    async def change(change: documents.Change) -> Response:
        """Carry a change out, once the commands before it are done; answers when it is measured."""
        lifecycle.require_up()
        request = change.request.request()
        work = manager.change(request, expected=change.expected, verify=change.verify, id=change.id)
        return JSONResponse(await lifecycle.carry_out(work))

    @router.post("/down", responses=_REFUSED)
    async def down() -> Response:
        """End every component, and then the manager."""
        await lifecycle.carry_out(lifecycle.take_down(), breakable=False)
        return JSONResponse({"outcome": "done"})

    return router

"""The operations on the live view: the whole, its stream, and what was before."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from fastapi import APIRouter, Header, Query, Response
from fastapi.responses import StreamingResponse

from midstride.errors import ManagerError
from midstride.server.error_answers import answer
from midstride.server.openapi import answers, failures
from midstride.server.view.live import LiveView
from midstride.server.view.view_forms import SystemView, Timeline
from midstride.server.view.view_stream import position, stream

# The largest time that makes sense: the year 10000.
_LATEST: Final = 253_402_300_800.0
_TIME: Final = Query(ge=0, le=_LATEST, allow_inf_nan=False, description="UNIX time (s)")
_Time = Annotated[float | None, _TIME]
_NOT_STORED: Final = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


def viewing(live: LiveView) -> APIRouter:
    router = APIRouter()

    @router.get("/view", responses=answers(SystemView))
    async def view() -> Response:
        """The running system in one document, as its components last reported themselves."""
        return answer(live.view(await live.lifecycle.manager.status()))

    @router.get(
        "/view/stream",
        response_class=StreamingResponse,
        responses={
            200: {
                "content": {"text/event-stream": {}},
                "description": "server-sent events: `view` (SystemView), `patch` (Patch) and `event` (Event)",
            },
            **failures(),
        },
    )
    async def view_stream(
        since: Annotated[
            str, Query(max_length=100, description="the id of the last one received, or the number of an event")
        ] = "",
        only: Annotated[Literal["event"] | None, Query(description="no `view` and no `patch`")] = None,
        last_event_id: Annotated[str | None, Header(max_length=100, description="takes precedence")] = None,
    ) -> Response:
        """The view, then what changes in it as it changes, and the manager's events."""
        if only is None:
            live.start()
        begin = position(since if last_event_id is None else last_event_id)
        events = stream(live, begin, log_only=only is not None)
        return StreamingResponse(events, media_type="text/event-stream", headers=_NOT_STORED)

    @router.get("/view/timeline", responses=answers(Timeline))
    async def timeline(since: _Time = None, until: _Time = None) -> Response:
        """Modes, changes and events between two times; by default all that this manager remembers."""
        live.start()
        live.refresh(measurements=False)
        return answer(live.timeline(0.0 if since is None else since, live.now() if until is None else until))

    @router.get("/view/at", responses=answers(SystemView))
    async def view_at(at: Annotated[float, _TIME]) -> Response:
        """The view as it was at a time, without what was measured meanwhile. 409 for a time that is not remembered."""
        live.start()
        live.refresh(measurements=False)
        document = live.document_at(at)
        if document is None:
            raise ManagerError(f"what was before {live.oldest:.3f} (UNIX time) is not remembered")
        return Response(document, media_type="application/json", headers=_NOT_STORED)

    return router

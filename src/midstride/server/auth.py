"""The bearer token of the TCP door. The Unix socket needs none: the file system guards it."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from midstride.server.errors import Failure, answer


class BearerAuth:
    """An application behind a bearer token; without it nothing is answered but the refusal."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._expected = f"Bearer {token}".encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and not self._is_allowed(Headers(scope=scope)):
            failure = Failure.named("Unauthorized", "send the header `Authorization: Bearer <token>`")
            refusal = answer(failure, 401, {"WWW-Authenticate": "Bearer"})
            await refusal(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _is_allowed(self, headers: Headers) -> bool:
        return secrets.compare_digest(headers.get("authorization", "").encode(), self._expected)


def new_token(path: Path) -> str:
    """A fresh token, written to a file that only its user can read."""
    token = secrets.token_urlsafe(32)
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    with os.fdopen(handle, "w") as file:
        file.write(token)
    return token

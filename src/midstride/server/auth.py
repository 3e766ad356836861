"""The access to the API over TCP: by the token. The Unix socket needs none: the file system protects it.

Programs send it as a bearer token with each request. A browser is given it once, in the URL that opens the dashboard,
and has it as a cookie from then on. What browsers may be made to send by other pages is refused: requests to a host
name that leads here (DNS rebinding), and changes that come from another origin.
"""

from __future__ import annotations

import ipaddress
import secrets
from typing import Final
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from midstride.server.error_answers import Failure, answer
from midstride.server.static import HEADERS

# Such a client may not keep its connection.
_UNAUTHORIZED: Final = {"WWW-Authenticate": "Bearer", "Connection": "close"}
_CLOSE: Final = {"Connection": "close"}
_SAFE: Final = frozenset({"GET", "HEAD"})
# A redirect would be part of the navigation that opened the page. If that came from elsewhere, say from a file,
# browsers would not send the new cookie with it; with a navigation that this page begins, they do.
_OPENED: Final = '<!doctype html><meta http-equiv="refresh" content="0;url=/dashboard/"><title>Midstride</title>'


def new_token() -> str:
    return secrets.token_urlsafe(32)


class TokenAuth:
    """Passes on to ``app`` the requests of clients that have ``token``.

    ``host`` is the name or address that is listened on, ``port`` distinguishes the cookies of several servers.
    """

    def __init__(self, app: ASGIApp, token: str, *, host: str, port: int) -> None:
        self._app = app
        self._token = token.encode()
        self._host = host
        self._cookie = f"midstride_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        refused = self._refusal(scope) if scope["type"] == "http" else None
        await (refused or self._app)(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        """The answer to a request that is not passed on; None for one that is."""
        headers = Headers(scope=scope)
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        if scheme == "Bearer" and self._is_token(bearer):
            return None  # no browser sends this unless it is told to
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        opens = scope["path"] == "/" and scope["method"] == "GET" and bool(given) and self._is_token(given[0])
        if not opens and not self._is_token(self._cookie_in(headers)):
            words = "send the header `Authorization: Bearer <token>`, or open the URL that `midstride dashboard` prints"
            return answer(Failure.named("Unauthorized", words), 401, _UNAUTHORIZED)
        if not self._is_here(headers.get("host", "")):
            words = "this host name is not the one that is listened on; use the address, as http://127.0.0.1:PORT"
            return answer(Failure.named("Forbidden", words), 403, _CLOSE)
        if opens:
            return self._opened()
        if scope["method"] not in _SAFE and headers.get("origin") != f"http://{headers['host']}":
            return answer(Failure.named("Forbidden", "a change may not come from another origin"), 403, _CLOSE)
        return None

    def _is_token(self, given: str) -> bool:
        return secrets.compare_digest(given.encode("utf-8", "replace"), self._token)

    def _is_here(self, host: str) -> bool:
        """Return whether a ``Host`` header is an address, or a name that is certainly this machine's."""
        name = host.removesuffix("]") if host.endswith("]") else host.rpartition(":")[0] or host
        name = name.strip("[]").lower()
        if name in {"localhost", self._host.lower()}:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True  # only names can be rebound

    def _cookie_in(self, headers: Headers) -> str:
        """Whatever others there are: a browser also sends those of every other server on this host, in any form."""
        pairs = (each.partition("=") for each in headers.get("cookie", "").split(";"))
        return next((value.strip() for name, _, value in pairs if name.strip() == self._cookie), "")

    def _opened(self) -> Response:
        response = HTMLResponse(_OPENED, headers={**HEADERS, "Cache-Control": "no-store"})
        response.set_cookie(self._cookie, self._token.decode(), httponly=True, samesite="strict")
        return response

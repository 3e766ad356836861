"""The files of the dashboard: static, with a policy under which nothing but these files is executed or fetched.

The page loads its modules as one script, which is made of them here: one request instead of fifty, each of which the
browser would know of only after it has read those that import it.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

from fastapi import APIRouter, HTTPException, Request, Response
from starlette.responses import RedirectResponse

from midstride.server.report.modules import inlined

# In this package, so that an installed one has them, too.
FOLDER: Final = Path(__file__).parent / "dashboard"
# The script of all modules, and the module that it begins with. It is no file.
SCRIPT: Final = "page.js"
_ENTRY: Final = "main.js"
# Independent of what the machine has registered.
_TYPES: Final[Mapping[str, str]] = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".md": "text/plain; charset=utf-8",
    ".svg": "image/svg+xml",
}
# Names and reasons that foreign nodes give are shown on the page: no script may come from a text.
POLICY: Final = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src 'self' data:; "
    "font-src 'self'; connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    # Kept, but never shown without asking whether it is still the file of the version that runs.
    "Cache-Control": "no-cache",
}


def dashboard(folder: Path = FOLDER) -> APIRouter:
    """The files of ``folder`` under ``/dashboard/``, which ``/`` leads to."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    @router.get("/dashboard")
    async def start() -> Response:
        return RedirectResponse("/dashboard/", 307, HEADERS)

    @router.api_route("/dashboard/{name:path}", methods=["GET", "HEAD"])
    async def file(name: str, request: Request) -> Response:
        path = _find(folder, _ENTRY if name == SCRIPT else name or "index.html")
        content = await asyncio.to_thread(partial(_script, folder) if name == SCRIPT else path.read_bytes)
        tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        headers = {**HEADERS, "ETag": tag}
        known = request.headers.get("If-None-Match", "")
        if tag in (each.strip().removeprefix("W/") for each in known.split(",")):
            return Response(status_code=304, headers=headers)
        return Response(content, headers=headers, media_type=_TYPES.get(path.suffix, "application/octet-stream"))

    return router


def _find(folder: Path, name: str) -> Path:
    """The file of that name. Raises HTTPException (404) for any other, and for one outside of ``folder``."""
    try:
        path = (folder / name).resolve()
        if path.is_relative_to(folder.resolve()) and path.is_file():
            return path
    except (OSError, ValueError):  # too long, or with a null byte
        pass
    raise HTTPException(404, "the dashboard has no such file")


def _script(folder: Path) -> bytes:
    """The modules of ``folder`` as they are now, as one script."""
    return _inlined(folder, max(path.stat().st_mtime_ns for path in folder.rglob("*.js")))


@lru_cache(maxsize=4)
def _inlined(folder: Path, _changed: int) -> bytes:
    return inlined(folder, _ENTRY).encode()

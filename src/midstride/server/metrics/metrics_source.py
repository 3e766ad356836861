"""The metrics of a manager: as the answer to ``GET /metrics``, and in a file that is kept up to date."""

from __future__ import annotations

import asyncio
import contextlib
import copy
import logging
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fastapi import Response

from midstride import __version__
from midstride.errors import ManagerError, internal_error
from midstride.runtime.timeouts import within
from midstride.runtime.view.status import status
from midstride.server.manager_lifecycle import Lifecycle
from midstride.whole_file import write_whole

if TYPE_CHECKING:
    from midstride.server.metrics.exposition import Snapshot

log = logging.getLogger(__name__)

# How often the file is written (s): several times between two visits of a collector.
EVERY: Final = 5.0
# node_exporter reads files of this ending alone, and as another user.
SUFFIX: Final = ".prom"
_READABLE: Final = 0o644


async def metrics_answer(lifecycle: Lifecycle) -> Response:
    """The metrics as they are now."""
    from midstride.server.metrics.exposition import CONTENT_TYPE, exposition  # not loaded before somebody asks

    text = await asyncio.to_thread(exposition, snapshot(lifecycle))
    return Response(text, headers={"Content-Type": CONTENT_TYPE, "Cache-Control": "no-store"})


def snapshot(lifecycle: Lifecycle) -> Snapshot:
    """Take a snapshot of the system for its metrics."""
    from midstride.server.metrics.exposition import Snapshot

    watched = lifecycle.manager.watched
    return Snapshot(
        time.time(),
        __version__,
        lifecycle.phase,
        frozenset(watched.system.specification.roles()),
        status(watched, ()),
        copy.deepcopy(watched.system.counts),  # which grow while another thread writes them
    )


class MetricsFile:
    """A file with the metrics for node_exporter's textfile collector, as long as the manager runs.

    Each version takes the place of the one before at once. The file is removed when the manager ends in order. A
    manager that is killed leaves it behind: then only the time in it shows that it is out of date.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._refused: str | None = None

    @classmethod
    def require(cls, path: Path) -> MetricsFile:
        """The file at ``path``. Raises ManagerError if a collector would not read it, or it cannot be written."""
        if path.suffix != SUFFIX:
            raise ManagerError(f"--metrics-file {path}: node_exporter only reads files that end in `{SUFFIX}`")
        made = cls(path)
        try:
            write_whole(path, b"", mode=_READABLE)
        except OSError as error:
            raise ManagerError(f"--metrics-file: cannot write to {path.parent}: {error.strerror or error}") from None
        return made

    @contextlib.asynccontextmanager
    async def kept(self, lifecycle: Lifecycle) -> AsyncIterator[None]:
        """Keep the file up to date while the context is open, and remove it then."""
        over = asyncio.Event()
        writing = asyncio.ensure_future(self._keep(lifecycle, over))
        try:
            yield
        finally:
            over.set()  # not cancelled: a thread that writes would write on, after the removal
            await writing
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)

    async def _keep(self, lifecycle: Lifecycle, over: asyncio.Event) -> None:
        from midstride.server.metrics.exposition import exposition

        while not over.is_set():
            try:
                text = await asyncio.to_thread(exposition, snapshot(lifecycle))
                await asyncio.to_thread(write_whole, self._path, text, mode=_READABLE)
                self._refused = None
            except OSError as error:  # the time in the old version then says that it is old
                self._note(lifecycle, error.strerror or str(error))
            except Exception as error:  # a fault of ours must not end the manager
                log.exception("writing the metrics failed")
                self._note(lifecycle, internal_error(error))
            with contextlib.suppress(asyncio.TimeoutError):
                async with within(EVERY):
                    await over.wait()

    def _note(self, lifecycle: Lifecycle, because: str) -> None:
        if because != self._refused:
            self._refused = because
            lifecycle.manager.watched.events.add("note", f"the metrics cannot be written to {self._path}: {because}")

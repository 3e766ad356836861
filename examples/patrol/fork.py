"""What several runs have in common is run once: each goes on in a process that is forked at that moment."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import threading
import traceback
from collections.abc import Awaitable
from typing import Any


class Fork:
    """Forks when it is made, and both processes continue: the child by ``end``, its parent by ``result``.

    On an event loop that has no sockets: those would be shared.
    """

    def __init__(self) -> None:
        if threading.active_count() > 1:
            raise RuntimeError(f"a fork would lack threads: {', '.join(each.name for each in threading.enumerate())}")
        sys.stdout.flush()
        sys.stderr.flush()
        self._read, self._write = os.pipe()
        loop = asyncio.get_running_loop()
        self._child = os.fork()
        self.is_child = not self._child
        if self.is_child:
            asyncio._set_running_loop(loop)  # asyncio does not take it for running in another process
        os.close(self._read if self.is_child else self._write)

    async def end(self, work: Awaitable[Any]) -> None:
        """In the child: it ends, and its parent gets what ``work`` returns (JSON)."""
        status = 1
        try:
            with open(self._write, "w", encoding="utf-8") as pipe:
                json.dump(await work, pipe)
            status = 0
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(status)

    def result(self) -> Any:
        """In the parent: wait until the child has ended. Raises RuntimeError where it failed."""
        with open(self._read, encoding="utf-8") as pipe:
            text = pipe.read()
        _, status = os.waitpid(self._child, 0)
        if status:
            raise RuntimeError(f"a forked run failed (status {os.waitstatus_to_exitcode(status)})")
        return json.loads(text)

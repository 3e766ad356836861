"""The reason why a step of a change has failed, in words."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Final

from midstride.errors import MidstrideError, StartFailed, Superseded, internal_error
from midstride.model import wording
from midstride.model.action import Action, Create
from midstride.runtime.change.action_driver import ActionDriver
from midstride.runtime.process.child_process import tail as tail_of
from midstride.runtime.process.log_runs import text_of_latest_run

log = logging.getLogger(__name__)

# How often it is looked whether a process has exited whose connection has closed, and how long that is apart (s).
EXIT_LOOKS: Final = 10
EXIT_INTERVAL: Final = 0.05


async def failure_reason(driver: ActionDriver, action: Action, error: BaseException) -> str:
    """The reason why a step has failed, with what a new instance has written last, where it has exited or raised.

    Nothing else would show it: the roll-back removes the instance.
    """
    words, life = error_words(error), driver.system.life
    if not isinstance(error, MidstrideError) or isinstance(error, (StartFailed, Superseded)):
        return words
    for new in (each.instance for each in driver.change.actions if isinstance(each, Create)):
        if new.name not in action.instances() or new.component.run is None:
            continue
        for _ in range(EXIT_LOOKS):  # the end of its connection is known first
            if not life.is_gone(new.name) or life.has_exited(new.name):
                break
            await driver.backend.clock.sleep(EXIT_INTERVAL)
        exit, handle = life[new.name].exit, life[new.name].handle
        if life.has_exited(new.name) and exit is not None:
            tail = exit.log_tail.strip()
            return wording.with_log(f"{new.name} {wording.exited(exit.status)}", tail) if tail else words
        if new.component.gate is not None and handle is not None and handle.log is not None:
            tail = text_of_latest_run(tail_of(Path(handle.log)))
            if (exception := wording.exception_in(tail)) is not None:
                return f"{words}; it has raised {exception}\n{tail.strip()}"
    return words


def error_words(error: BaseException) -> str:
    """The message of an exception; an unexpected one is logged with its traceback."""
    if isinstance(error, MidstrideError):
        return str(error)
    if isinstance(error, asyncio.CancelledError):
        return "the manager is shutting down"
    log.error("a step failed with an unexpected error", exc_info=error)
    return internal_error(error)

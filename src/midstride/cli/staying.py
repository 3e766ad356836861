"""A command that stays for as long as its system runs, and stops the system when it is ended itself."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import click

from midstride.cli.client import Client
from midstride.cli.shutdown import shut_down

POLL = 0.2
# A manager that does not answer for so long has ended (s).
SILENCE = 5.0


@dataclass(slots=True)
class EndRequest:
    """Says that a signal has asked this process to end.

    An exception raised by a signal handler is lost if the interpreter is in one of its own callbacks, for example
    during an import. Long-running loops therefore check this flag, too: nobody can press Ctrl-C again in a terminal
    that is closed.
    """

    came: bool = False


@contextmanager
def ended_by_signals() -> Iterator[EndRequest]:
    """SIGTERM and SIGHUP interrupt the block as Ctrl-C does. A launch ends its processes with SIGINT, then SIGTERM."""
    request = EndRequest()

    def interrupt(*_: object) -> None:
        request.came = True
        _interrupt()

    with _handled_by(interrupt, signal.SIGTERM, signal.SIGHUP):
        yield request


@contextmanager
def not_interrupted() -> Iterator[None]:
    """Ignore signals in the block, which ends a system: a terminal and a launch may both send one."""
    with _handled_by(signal.SIG_IGN, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        yield


@contextmanager
def _handled_by(handler: Callable[..., object] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def _interrupt() -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a job that a script has started in the background
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def stay(client: Client, system: str, begin: Callable[[], object], request: EndRequest) -> int:
    """Wait until this process is asked to end, its parent ends, or the manager does; stop the system, if it runs.

    ``begin`` is called first; the system is stopped as well where that is interrupted.
    """
    parent = os.getppid()
    try:
        begin()
        answered = time.monotonic()
        while os.getppid() == parent and not request.came:
            time.sleep(POLL)
            if client.answers():
                answered = time.monotonic()
            elif time.monotonic() - answered > SILENCE:
                click.echo(f"{system}: its manager has ended", err=True)
                return 1
    except KeyboardInterrupt:
        pass
    with not_interrupted():
        _, report = shut_down(system)
    for words in (f"{system} is down", *(each.words for each in report.killed)):
        click.echo(f"{words}.")
    return 0

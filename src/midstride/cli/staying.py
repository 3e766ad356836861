"""A command that stays for as long as its system runs, and stops the system when it is ended itself."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from midstride.cli.client import Client
from midstride.cli.shutdown import shut_down

POLL = 0.2
# A manager that does not answer for so long has ended (s).
SILENCE = 5.0


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP interrupt the block as Ctrl-C does. A launch ends its processes with SIGINT, then SIGTERM."""
    with _handled_by(_interrupt, signal.SIGTERM, signal.SIGHUP):
        yield


@contextmanager
def _handled_by(handler: Callable[..., object] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def _interrupt(*_: object) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a job that a script has started in the background
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def stay(client: Client, system: str, begin: Callable[[], object]) -> int:
    """Wait until this process is interrupted, its parent ends, or the manager does; stop the system, if it runs.

    ``begin`` is called first; the system is stopped as well where that is interrupted.
    """
    parent = os.getppid()
    try:
        begin()
        answered = time.monotonic()
        while os.getppid() == parent:
            time.sleep(POLL)
            if client.answers():
                answered = time.monotonic()
            elif time.monotonic() - answered > SILENCE:
                click.echo(f"{system}: its manager has ended", err=True)
                return 1
    except KeyboardInterrupt:
        pass
    # A terminal and a launch may both send one.
    with _handled_by(signal.SIG_IGN, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        _, report = shut_down(system)
    for words in (f"{system} is down", *(each.words for each in report.killed)):
        click.echo(f"{words}.")
    return 0

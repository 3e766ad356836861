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
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
    with _signals_ignored():  # a terminal and a launch may both send one
        _, report = shut_down(system)
    for words in (f"{system} is down", *(each.words for each in report.killed)):
        click.echo(f"{words}.")
    return 0


@contextmanager
def _signals_ignored() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

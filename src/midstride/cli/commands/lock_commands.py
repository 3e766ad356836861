"""``lock`` and ``unlock``: no change of the running system until a person allows it again."""

from __future__ import annotations

import re
import socket
import time
from datetime import datetime, timedelta
from typing import Any

import click

from midstride.cli.durations import duration
from midstride.cli.follow import Sending, explained_when_interrupted
from midstride.cli.output import json_option, show
from midstride.cli.running_systems import find, system_option
from midstride.cli.user_name import user_name


class Duration(click.ParamType):  # type: ignore[type-arg]  # generic in the newest Click only
    """A time with its unit: ``90s``, ``5m``, ``2h``, ``1d``."""

    name = "duration"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The time in seconds."""
        seconds = duration(str(value))
        if not seconds:
            self.fail(f"{value!r} is no time such as 90s, 5m, 2h or 1d", param, ctx)
        return seconds


class LocalTime(click.ParamType):  # type: ignore[type-arg]  # as above
    """A time to come on this computer's clock: ``18:30`` is the next one, ``2026-03-01T08:00`` that day."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The UNIX time in seconds."""
        text, now = str(value), datetime.now()
        if re.fullmatch(r"\d{1,2}:\d{2}", text):
            hours, minutes = map(int, text.split(":"))
            if hours > 23 or minutes > 59:
                self.fail(f"{text!r} is no time of day", param, ctx)
            at = now.replace(hour=hours, minute=minutes, second=0, microsecond=0)
            return (at if at > now else at + timedelta(days=1)).timestamp()
        try:
            at = datetime.fromisoformat(text)
        except ValueError:
            self.fail(f"{text!r} is no time such as 18:30 or 2026-03-01T08:00", param, ctx)
        if at.timestamp() <= now.timestamp():
            self.fail(f"{text!r} is in the past", param, ctx)
        return at.timestamp()


def _by_option(function: Any) -> Any:
    summary = "Who asks for it, by default you and this computer."
    return click.option("--by", metavar="NAME", help=summary)(function)


def _asked_by(by: str | None) -> str:
    return by or f"{user_name()}@{socket.gethostname()}"[:200]


@click.command("lock")
@click.option("--reason", required=True, metavar="TEXT", help="Why: everyone whose change is refused reads it.")
@_by_option
@click.option("--for", "lasting", type=Duration(), metavar="TIME", help="End the lock after 90s, 5m, 2h, 1d.")
@click.option("--until", type=LocalTime(), metavar="TIME", help="End the lock at 18:30, or 2026-03-01T08:00.")
@click.option(
    "--also-recovery",
    is_flag=True,
    help="Also hold back what the manager does without a command: restarting crashed nodes, restoring what degraded.",
)
@system_option
@json_option
def lock_command(
    reason: str, by: str | None, lasting: float | None, until: float | None, also_recovery: bool, system: str | None
) -> int:
    """Refuse every change of the running system until it is unlocked: a person is at work on it, or it moves.

    A change in progress goes on. `midstride down` is always allowed. The lock outlives the manager.
    """
    if lasting is not None and until is not None:
        raise click.UsageError("--for and --until exclude each other")
    if not reason.strip():
        raise click.UsageError("--reason is empty: say why the system must not be changed")
    client, _ = find(system)
    end = until if lasting is None else time.time() + lasting
    sending = Sending()
    with explained_when_interrupted(lambda: _interrupted(sending)):
        lock = client.lock(reason.strip(), _asked_by(by), end, holds_recovery=also_recovery, begin=sending.begin)
        from midstride.cli.render_status import lock_line

        lines = [f"{lock_line(lock)}."]
        if (running := client.status().running) is not None:
            lines.append(f"`{running.command}` is being carried out, and goes on.")
    show(lock, lines)
    return 0


def _interrupted(sending: Sending) -> str:
    """Keep the manager from being asked, and say what becomes of the lock."""
    if sending.withdraw():
        return "Nothing was changed: the manager had not been asked yet."
    return "Whether the system is locked now is not known here: `midstride status` shows it."


@click.command("unlock")
@_by_option
@system_option
@json_option
def unlock_command(by: str | None, system: str | None) -> int:
    """End the lock of the running system, whoever has locked it."""
    client, _ = find(system)
    sending = Sending()
    with explained_when_interrupted(lambda: _interrupted(sending)):
        lock = client.unlock(_asked_by(by), sending.begin)
    show(lock, [f"Unlocked. {lock.by} had locked it: {lock.reason}"])
    return 0

"""The live view: status and latest events, until Ctrl-C. The system does not depend on it."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

import click
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from midstride.cli import render, render_status
from midstride.cli.client import Client
from midstride.cli.follow import last_event_number
from midstride.cli.output import console
from midstride.errors import MidstrideError

if TYPE_CHECKING:
    from midstride.runtime.records.reports import Event

# How often the status is refreshed (s), and how many events are shown below it.
REFRESH = 0.5
EVENTS_SHOWN = 12
# The start of the next step shows that the one before is done.
HIDDEN = frozenset({"step_done"})


def watch(client: Client, system: str, since: int | None = None) -> int:
    """Show the system until it is down, its manager exits, or Ctrl-C. The exit status.

    Of the events, those after number ``since``, by default those that come.
    """
    out = console()
    shown: deque[Event] = deque(maxlen=EVENTS_SHOWN)
    try:
        since = last_event_number(client) if since is None else since
        if out.is_terminal:
            _live(client, out, shown, since)
        else:
            for event in client.events(since):
                shown.append(event)
                out.print(render.event(event))
    except KeyboardInterrupt:
        click.echo(
            f"\n{system} keeps running: `midstride status` shows it, `midstride watch` opens this view again, "
            "`midstride down` stops it."
        )
        return 0
    if shown and shown[-1].kind == "down":
        click.echo(f"{system} is down.")
        return 0
    click.echo(f"The manager of {system} has exited; its components keep running.", err=True)
    return 1


def _live(client: Client, out: Console, shown: deque[Event], since: int) -> None:
    changed, over = threading.Event(), threading.Event()

    def read_events() -> None:
        try:
            for event in client.events(since):
                if event.kind not in HIDDEN:
                    shown.append(event)
                changed.set()
        except MidstrideError:  # the manager has exited
            pass
        over.set()
        changed.set()

    threading.Thread(target=read_events, daemon=True).start()
    with Live(console=out, auto_refresh=False, transient=False) as live:
        while not over.is_set():
            try:
                status = render_status.status(client.status())
            except MidstrideError:
                break
            hint = Text("Ctrl-C leaves the view; the system keeps running.", style="dim")
            live.update(Group(status, Text(""), *map(render.event, list(shown)), hint), refresh=True)
            changed.wait(REFRESH)
            changed.clear()
    over.wait(REFRESH)

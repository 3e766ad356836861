"""The live view: what is live and what happens, until Ctrl-C. The system does not depend on it."""

from __future__ import annotations

import threading
from collections import deque

import click
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from midstride.cli import render
from midstride.cli.client import Client, Event
from midstride.cli.output import console
from midstride.errors import MidstrideError

# How often the state is asked for again (s), and how many events stand below it.
REFRESH = 0.5
EVENTS_SHOWN = 12
# The next step begins when the one before it is done.
UNINTERESTING = frozenset({"step_done"})


def watch(client: Client, system: str) -> int:
    """Show the system until it is down, its manager ends, or Ctrl-C. The exit status."""
    out = console()
    seen: deque[Event] = deque(maxlen=EVENTS_SHOWN)
    try:
        if out.is_terminal:
            _live(client, out, seen)
        else:
            for event in client.events():
                seen.append(event)
                out.print(render.event(event))
    except KeyboardInterrupt:
        click.echo(
            f"\n{system} goes on running. `midstride status` shows it, `midstride watch` this view, "
            "`midstride down` ends it."
        )
        return 0
    if seen and seen[-1]["kind"] == "down":
        click.echo(f"{system} is down.")
        return 0
    click.echo(f"The manager of {system} has ended; its components go on.", err=True)
    return 1


def _live(client: Client, out: Console, seen: deque[Event]) -> None:
    changed, over = threading.Event(), threading.Event()

    def listen() -> None:
        try:
            for event in client.events():
                if event["kind"] not in UNINTERESTING:
                    seen.append(event)
                changed.set()
        except MidstrideError:  # it ended meanwhile
            pass
        over.set()
        changed.set()

    threading.Thread(target=listen, daemon=True).start()
    with Live(console=out, auto_refresh=False, transient=False) as live:
        while not over.is_set():
            try:
                status = render.status(client.get("/status"))
            except MidstrideError:
                break
            hint = Text("Ctrl-C leaves the view; the system goes on.", style="dim")
            live.update(Group(status, Text(""), *map(render.event, list(seen)), hint), refresh=True)
            changed.wait(REFRESH)
            changed.clear()
    over.wait(REFRESH)

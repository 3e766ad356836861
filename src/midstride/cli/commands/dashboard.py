"""``dashboard``: the live page of a running system, on loopback."""

from __future__ import annotations

import asyncio
import os
import webbrowser
from contextlib import suppress
from pathlib import Path
from threading import Thread

import click

from midstride.cli import shell_completion
from midstride.cli.output import json_option, show
from midstride.cli.running_systems import find, system_option
from midstride.cli.staying import ended_by_signals
from midstride.runtime.workspace import Workspace


@click.command("dashboard")
@click.argument("named", required=False, metavar="[SYSTEM]", shell_complete=shell_completion.systems)
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    metavar="N",
    help="Listen on this port of the loopback address; by default on 7420, or any free one if that is taken.",
)
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@system_option
@json_option
def dashboard_command(named: str | None, port: int | None, no_browser: bool, system: str | None) -> int:
    """Show the running SYSTEM on a live page in the browser, until Ctrl-C.

    The page shows the graph, its rates and modes, and every change as it happens, and does what the commands do. Only a
    browser that is given the printed address can use it. The name is needed only if several systems are running.
    """
    from midstride.server.auth import new_token
    from midstride.server.gateway import listen, run_gateway

    if named is not None and system is not None:
        raise click.UsageError("name the system once, as SYSTEM or with --system")
    _, workspace = find(named or system)
    token = new_token()
    with ended_by_signals(), listen(port) as listening:
        url = f"http://{listening.getsockname()[0]}:{listening.getsockname()[1]}/?token={token}"
        # A browser that opens no window would take this terminal.
        graphical = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
        opened = _open(workspace, url) if graphical and not no_browser else None
        words = f"The dashboard of {workspace.name}: {url}\nCtrl-C closes it; the system keeps running."
        show({"system": workspace.name, "url": url, "port": listening.getsockname()[1]}, [words])
        try:
            asyncio.run(run_gateway(listening, workspace.socket, workspace.name, token))
        except KeyboardInterrupt:
            return 0
        finally:
            if opened is not None:
                opened.unlink(missing_ok=True)
    return 0


def _open(workspace: Workspace, url: str) -> Path:
    """Open ``url`` in a browser, by way of a file that leads there.

    The arguments of a browser's process are no secret on this machine; the file is, as the workspace is.
    """
    page = f'<!doctype html><meta http-equiv="refresh" content="0;url={url}"><title>Midstride</title>\n'
    path = workspace.write_private("dashboard.html", page)

    def open_browser() -> None:
        with suppress(webbrowser.Error, OSError):
            webbrowser.open(path.as_uri())

    Thread(target=open_browser, daemon=True).start()
    return path

"""``up``: a manager of its own, the system under it, and a view of both."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from midstride.backends import NAMES
from midstride.cli.app import json_option
from midstride.cli.client import Client, Document
from midstride.errors import ManagerBusy, ManagerError

if TYPE_CHECKING:
    from midstride.runtime.workspace import Workspace

# How long a manager may take to answer for the first time (s): a cold start on a busy machine.
FIRST_ANSWER = 30.0
POLL = 0.02


@click.command("up")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--backend",
    type=click.Choice(NAMES),
    default="ros2",
    show_default=True,
    envvar="MIDSTRIDE_BACKEND",
    show_envvar=True,
    help="What it runs on.",
)
@click.option("--detach", "-d", is_flag=True, help="Return as soon as the system is up.")
@click.option("--http", type=click.IntRange(1, 65535), metavar="PORT", help="Serve the API on loopback TCP as well.")
@click.option("--http-host", metavar="ADDRESS", help="With --http: on this address of the machine instead of loopback.")
@json_option
def up_command(file: Path, backend: str, detach: bool, http: int | None, http_host: str | None) -> int:
    """Start the system of FILE under a manager of its own, and watch it.

    Components and manager go on when the view is left (Ctrl-C); a manager that was killed is followed by the next
    `up`, which finds its components again. `midstride down` ends everything.
    """
    from midstride.cli.files import load
    from midstride.cli.output import print_json, wants_json
    from midstride.codec.specification import encode_specification
    from midstride.runtime.workspace import Workspace

    if http_host is not None and http is None:
        raise click.UsageError("--http-host needs --http PORT")
    wanted = load(file)
    workspace = Workspace.of(wanted.name)
    client = Client(workspace.socket)
    if (running := client.service()) is not None:
        raise ManagerBusy(
            f"{workspace.name} is running already, under the manager with process {running['pid']}: "
            "`midstride status` shows it, `midstride apply` changes it, `midstride down` ends it"
        )
    workspace.require_room()
    arguments = [str(file.resolve()), "--backend", backend]
    if http is not None:
        arguments += ["--http", str(http), *(["--http-host", http_host] if http_host else [])]
    log = workspace.logs / "manager.log"
    try:
        with _ctrl_c_waits():  # a manager that nobody knows of could not be ended
            manager = _start(arguments, log)
        _first_answer(client, manager, log)
        answer = _until_up(client)
    except KeyboardInterrupt:
        click.echo(f"\nEnding what has been started of {workspace.name} …", err=True)
        _take_back(client, workspace, manager, log)
        raise
    if client.get("/specification") != encode_specification(wanted):
        click.echo(
            f"{workspace.name} was running, and is not as {file} says: it has been taken up as it is. "
            f"`midstride apply {file}` changes it.",
            err=True,
        )
    if wants_json():
        print_json(answer)
        return 0
    click.echo(f"{workspace.name} is up ({', '.join(answer['components'])}).")
    if http is not None:
        click.echo(f"API: http://{http_host or '127.0.0.1'}:{http}/api/v1, token in {workspace.path / 'token'}")
    if detach:
        return 0
    from midstride.cli.view import watch

    return watch(client, workspace.name)


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Raises KeyboardInterrupt at the end of the block where Ctrl-C was pressed meanwhile."""
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


def _start(arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
    """The manager in a session of its own: what happens to this terminal does not concern it."""
    with log.open("wb") as output:
        return subprocess.Popen(
            [sys.executable, "-m", "midstride", "_manager", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )


def _first_answer(client: Client, manager: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until the manager answers. Raises ManagerError with its own words where it ends or stays silent."""
    end = time.monotonic() + FIRST_ANSWER
    while time.monotonic() < end:
        service = client.service()
        if service is not None:
            if service["pid"] != manager.pid:
                raise ManagerBusy(f"another manager of this system has just been started (process {service['pid']})")
            return
        if manager.poll() is not None:
            told = log.read_text(errors="replace").strip().splitlines() or ["it wrote nothing to its log"]
            raise ManagerError(told[-1].removeprefix("midstride: "))
        time.sleep(POLL)
    manager.kill()
    raise ManagerError(f"the manager did not answer within {FIRST_ANSWER:g} s; see {log}")


def _until_up(client: Client) -> Document:
    """Show what happens until the system is up; what the manager says then. Raises what bringing up failed with."""
    from midstride.cli.follow import Following
    from midstride.cli.output import console, wants_json
    from midstride.cli.progress import Progress

    following = Following(client, lambda: dict(client.get("/up", timeout=None)), since=0, until="up")
    with Progress(console(stderr=wants_json())) as progress:
        for event in following:
            if not wants_json():
                progress.show(event)
    return following.answer()


def _take_back(client: Client, workspace: Workspace, manager: subprocess.Popen[bytes], log: Path) -> None:
    """End the system and its manager. One that does not answer yet would bring the system up all the same."""
    from midstride.cli.shutdown import until_free

    try:
        _first_answer(client, manager, log)
    except ManagerError:  # it has ended by itself
        return
    client.post("/down")
    until_free(workspace)

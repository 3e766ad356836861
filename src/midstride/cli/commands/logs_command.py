"""``logs``: what a node's component has written."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from midstride.cli import shell_completion
from midstride.cli.client import Client
from midstride.cli.component_logs import (
    Appended,
    ended_since,
    is_of,
    known_nodes,
    last_lines,
    latest_run,
    log_files,
    with_local_time,
)
from midstride.cli.output import json_option, print_json, wants_json
from midstride.cli.remote_logs import RemoteLogs
from midstride.cli.running_systems import find_records, system_option
from midstride.errors import ManagerError, MidstrideError
from midstride.model.diagnostics import suggestion
from midstride.runtime.workspace import Workspace

if TYPE_CHECKING:
    from midstride.runtime.records.status_forms import Status

# How often followed files are read, and how often the manager is asked for new instances (s).
POLL: Final = 0.1
LOOK: Final = 0.5


@click.command("logs")
@click.argument("node", shell_complete=shell_completion.nodes_and_containers)
@click.option(
    "--follow", "-f", is_flag=True, help="Continue with what is written, also by a replacement; Ctrl-C ends it."
)
@click.option(
    "--lines",
    "-n",
    type=click.IntRange(0),
    metavar="N",
    help="Begin with the last N lines of each log.  [default: all, or 10 with --follow]",
)
@click.option("--all", "-a", "all_", is_flag=True, help="Also earlier runs of the same instance.")
@system_option
@json_option
def logs_command(node: str, follow: bool, lines: int | None, all_: bool, system: str | None) -> int:
    """Print the log of NODE, a node or one of its instances; after a crash, that of the crashed instance, too.

    Of several processes of one instance, one after the other, that is what the latest has written. ROS's stamps are
    shown as the local time.

    With --json: a JSON document on each line, with the instance and what it has written, as it is in the log.
    """
    workspace = find_records(system)
    client = Client(workspace.socket)
    status = _status(client)
    remote = RemoteLogs(workspace, lambda stem: is_of(stem, node, status))
    remote.refresh()
    for each in () if status is None else status.hosts:
        if not each.connected:  # its socket is not forwarded then
            remote.problems.setdefault(each.name, each.because or "it cannot be reached")
    for host, because in remote.problems.items():
        click.echo(f"(the logs of host {host} are as they were read last: {because})", err=True)
    paths = log_files(workspace, node, status)
    if not paths:
        known = known_nodes(workspace, status)
        if node in known:
            raise ManagerError(why_no_log(node, status, remote.problems))
        hint = suggestion(node, known) or "nothing has been started under that name"
        raise ManagerError(f"there is no log of {node} in the system {workspace.name}; {hint}")
    for name in () if status is None else ended_since(workspace, node, paths)[-1:]:
        click.echo(f"({name}, which has ended, has a log as well: `midstride logs {name}`)", err=True)
    count = 10 if lines is None and follow else lines
    following = Appended()
    shown: Path | None = None
    for path in paths:
        begin, end = last_lines(path)
        latest, runs = latest_run(begin)
        if not all_:
            begin = latest
            if len(runs) > 1:
                click.echo(_earlier(path, node, runs), err=True)
        if count is not None:
            begin = begin[len(begin) - min(count, len(begin)) :]
        following.follow(path, end)
        if begin or not follow:
            shown = _show(path, begin, shown, several=len(paths) > 1)
    if follow:
        try:
            _follow(client, workspace, node, following, shown, remote)
        except KeyboardInterrupt:
            return 0
    return 0


def why_no_log(node: str, status: Status | None, problems: Mapping[str, str]) -> str:
    """Say why a node that the manager knows has no log here. ``problems``: why those of a host could not be read."""
    for each in () if status is None else status.instances:
        if node in (each.role, each.name, each.container) and each.log_file is not None:
            if each.host is not None and each.host in problems:
                return f"the log of {node} is {each.log_file}, and cannot be read now: {problems[each.host]}"
            return f"the log of {node}, {each.log_file}, is not there: it was removed, or could not be written"
    return f"{node} was started elsewhere, so its output is there"


def _earlier(path: Path, node: str, runs: Sequence[str]) -> str:
    number = len(runs) - 1
    earlier = "1 earlier run" if number == 1 else f"{number} earlier runs"
    return f"({path.stem} was started {runs[-1]}; {earlier}: `midstride logs {node} --all`)"


def _follow(
    client: Client, workspace: Workspace, node: str, following: Appended, shown: Path | None, remote: RemoteLogs
) -> None:
    looked = 0.0
    while True:
        remote.refresh()
        if time.monotonic() - looked > LOOK:
            looked = time.monotonic()
            for path in log_files(workspace, node, _status(client)):
                following.follow(path, 0)  # a replacement: from its first line
        for path, line in following.lines():
            shown = _show(path, [line], shown, several=shown is not None)
        time.sleep(POLL)


def _status(client: Client) -> Status | None:
    """None where no manager answers: the files are there all the same."""
    try:
        return client.status()
    except MidstrideError:
        return None


def _show(path: Path, lines: list[str], shown: Path | None, *, several: bool) -> Path:
    """Print lines, below the instance's name where another one's were before or may follow; returns ``path``."""
    if wants_json():
        for line in lines:
            print_json({"instance": path.stem, "line": line}, lines=True)
        return path
    if several and path != shown:
        click.echo(f"==> {path.stem} <==")
    for line in lines:
        click.echo(with_local_time(line))
    return path

"""``up``: start a manager and its system, and watch them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Final, NoReturn

import click
from msgspec import structs

import midstride
from midstride.cli.client import Client
from midstride.cli.first_rates import await_rates
from midstride.cli.follow import FollowedRequest, explained_when_interrupted
from midstride.cli.input_files import load
from midstride.cli.live_view import watch
from midstride.cli.manager_options import ManagerOptions, manager_options
from midstride.cli.output import console, json_option, print_json, show, wants_json
from midstride.cli.progress import Progress
from midstride.cli.render import degraded_line
from midstride.cli.shutdown import stop
from midstride.cli.specification_argument import absolute, specification_argument
from midstride.cli.staying import ended_by_signals, stay
from midstride.codec.form import encode
from midstride.codec.specification_form import encode_specification
from midstride.errors import ManagerBusy, ManagerError
from midstride.model.specification import Specification
from midstride.runtime.options import SystemOptions
from midstride.runtime.records.reports import UpReport
from midstride.runtime.records.status_forms import Service
from midstride.runtime.workspace import Workspace
from midstride.verdicts.conditions import EXIT_STATUS, not_yet_judged
from midstride.wire.frames import PROTOCOL

# How long a manager may take to answer for the first time (s): a cold start on a busy machine.
START_TIMEOUT = 30.0
# How much longer where another one ends before (s).
TAKE_OVER_TIMEOUT = 40.0
POLL = 0.02
_MANAGER: Final = (sys.executable, "-m", "midstride", "_manager")
_UNBUFFERED: Final = {"PYTHONUNBUFFERED": "1"}
_BECAUSE: Final = {
    "--stop-on-exit": "one returns at once, the other stays",
    "--foreground": "it is the manager, which leaves its components running when it ends",
}


@click.command("up")
@specification_argument()
@manager_options
@click.option("--detach", "-d", is_flag=True, help="Return once the system is up; show no view.")
@click.option(
    "--dry-run",
    is_flag=True,
    help="Show what would be started, with which arguments, files and environment, in which order; start nothing.",
)
@click.option(
    "--stop-on-exit",
    is_flag=True,
    help="Show no view, and stop the system when this command ends: for launch files and supervisors.",
)
@click.option(
    "--foreground",
    is_flag=True,
    help="Be the manager, without a view: for systemd; see docs/how-to/systemd.md.",
)
@click.option(
    "--take-over",
    metavar="SYSTEM",
    help="With --foreground: take over what runs of this system, whatever has become of FILE.",
)
@click.option(
    "--replace-manager",
    is_flag=True,
    help="End the manager that runs, and have one of this version take over; see docs/how-to/upgrade.md.",
)
@json_option
def up_command(
    file: Path,
    options: ManagerOptions,
    detach: bool,
    dry_run: bool,
    stop_on_exit: bool,
    foreground: bool,
    take_over: str | None,
    replace_manager: bool,
) -> int:
    """Start the system of FILE and its manager, and watch them. Exit status 3 if not all is up, 1 if nothing is.

    What can be started runs, in the best modes that this allows; a node that cannot is restarted if it has `respawn`.

    Ctrl-C leaves the view; components and manager keep running. If the manager is killed, the next `up` reattaches to
    its components. `midstride down` stops everything.
    """
    alone = {"--detach": detach, "--stop-on-exit": stop_on_exit, "--foreground": foreground}
    if len(given := [name for name, is_given in alone.items() if is_given]) > 1:
        raise click.UsageError(f"{given[0]} and {given[1]} exclude each other: {_BECAUSE[given[1]]}")
    if take_over is not None and not foreground:
        raise click.UsageError("--take-over is for --foreground; without it, the name in FILE is the system's")
    arguments = [*options.arguments(file), *["--replace-manager"] * replace_manager]
    if foreground and not dry_run:
        if wants_json():
            raise click.UsageError("--foreground prints events, and no document; `midstride log --follow --json` does")
        _become_manager([*arguments, *(["--take-over", take_over] if take_over else [])])
    specification = load(file)
    if dry_run:
        started = SystemOptions(
            options.use_sim_time, not options.no_middleware_settings, options.spares, not options.no_diagnostics
        )
        return _dry_run(specification, options.backend, absolute(file).parent, started)
    workspace = Workspace.of(specification.name)
    client = Client(workspace.socket)
    earlier = workspace.manager() if replace_manager else None
    if earlier is None and (running := client.service()) is not None:
        raise ManagerBusy(
            f"{workspace.name} is already running (manager process {running.pid}): `midstride status` shows it, "
            f"`midstride apply` changes it, `midstride down` stops it{_of_another_version(running)}"
        )
    workspace.require_room()
    with ended_by_signals() if stop_on_exit else nullcontext() as request:
        answer = bring_up(client, workspace, arguments, earlier)
        shown = partial(_show_how_it_came_up, client, workspace, specification, file, answer, options)
        if request is not None:
            return stay(client, workspace.name, shown, request)
    name = workspace.name
    goes_on = f"{name} is up and keeps running: `midstride status` shows it, `midstride down` stops it."
    with explained_when_interrupted(lambda: goes_on):
        status = shown()
    return status if detach or wants_json() else watch(client, workspace.name) or status


def _of_another_version(running: Service) -> str:
    """Advise what to do about a manager of another version; empty for one of this version."""
    if (running.version, running.protocol) == (midstride.__version__, PROTOCOL):
        return ""
    return "; it is of another version of Midstride, and `up --replace-manager` has this one manage it while it runs"


def _dry_run(specification: Specification, backend: str, directory: Path, options: SystemOptions) -> int:
    """Show what would be started; the exit status that `up` would have for what is known to be missing."""
    from midstride.cli.dry_run import dry_run, lines

    found = dry_run(specification, backend, directory, options)
    show(found, list(lines(found)))
    failed = [each for each in found.processes if each.because is not None]
    if not failed:
        return EXIT_STATUS["up"]
    return EXIT_STATUS["degraded" if len(failed) < len(found.processes) + len(found.by_hand) else "down"]


def _show_how_it_came_up(
    client: Client,
    workspace: Workspace,
    specification: Specification,
    file: Path,
    answer: UpReport,
    options: ManagerOptions,
) -> int:
    """Print how bringing the system up went; returns the exit status: 3 if not all is up, 1 if nothing is."""
    if encode_specification(client.specification()) != encode_specification(specification):
        click.echo(
            f"{workspace.name} was already running and differs from {file}; it was reattached unchanged. "
            f"Run `midstride apply {file}` to change it.",
            err=True,
        )
    found, pending = await_rates(client)
    status = EXIT_STATUS[found.condition.state]
    if wants_json():
        print_json({**encode(answer), "condition": encode(found.condition)})
        return status
    without = f" without {', '.join(answer.missing)}" if answer.missing else ""
    click.echo(f"{workspace.name} is up{without} ({', '.join(answer.instances)}).")
    for each in answer.degraded:
        if each.functionality.partition(".")[0] in answer.missing:  # the reason follows
            each = structs.replace(each, because=None)
        click.echo(f"Degraded: {degraded_line(each)}")
    for line in missing_lines(answer):
        click.echo(line)
    condition = found.condition
    # Why it is not up has been said line by line.
    words = condition.besides if answer.degraded or answer.missing else condition.headline
    if words and (condition.state != "up" or condition.unknown or condition.slow):
        click.echo(f"{words[0].upper()}{words[1:]}.")
    if pending:
        click.echo(f"{not_yet_judged(pending)}; `midstride status` shows it.")
    if options.http is not None:
        click.echo(
            f"API: http://{options.http_host or '127.0.0.1'}:{options.http}/api/v1, token in {workspace.path / 'token'}"
        )
    return status


def missing_lines(report: UpReport) -> Iterator[str]:
    """Yield what could not be started beside what runs, and what to do."""
    for node, because in report.missing.items():
        yield f"Missing: {because if because.startswith(node) else f'{node}: {because}'}"
    if report.missing:
        yield f"Fix the cause, then `midstride restart {' '.join(report.missing)}`. The others keep running meanwhile."


def bring_up(client: Client, workspace: Workspace, arguments: list[str], earlier: int | None = None) -> UpReport:
    """Start a manager, show its progress until its system is up, and return its report. Raises the manager's error.

    ``earlier`` is the process of the manager that it takes over from.
    """
    log = workspace.manager_log
    try:
        with _interrupt_deferred():  # until the manager's process is known and can be stopped
            manager = _start(arguments, log, after=earlier is not None)
        _wait_for_manager(client, manager, log, earlier)
        return _wait_until_up(client)
    except KeyboardInterrupt:
        if earlier is not None:  # its components keep running
            click.echo(f"\n{workspace.name} is taken over all the same; `midstride status` shows it.", err=True)
            raise
        click.echo(f"\nStopping everything started for {workspace.name} …", err=True)
        _undo(client, workspace, manager, log)
        raise


@contextmanager
def _interrupt_deferred() -> Iterator[None]:
    """Raises KeyboardInterrupt at the end of the block if Ctrl-C was pressed in it."""
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


def _become_manager(arguments: list[str]) -> NoReturn:
    """Go on as the manager, in this process: what has started it watches the manager, and reads what it prints."""
    sys.stdout.flush()
    command = [*_MANAGER, "--foreground", *arguments]
    os.execve(command[0], command, {**os.environ, **_UNBUFFERED})


def _start(arguments: list[str], log: Path, *, after: bool) -> subprocess.Popen[bytes]:
    """Start the manager in a new session, which does not end with this terminal; ``after`` another one, which logs."""
    with log.open("ab") as output:  # for appending, so that the manager can cut it
        if not after:
            output.truncate(0)
        return subprocess.Popen(
            [*_MANAGER, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, **_UNBUFFERED},
        )


def _wait_for_manager(client: Client, manager: subprocess.Popen[bytes], log: Path, earlier: int | None = None) -> None:
    """Wait until the manager answers, and not the ``earlier`` one, which it ends.

    Raises ManagerError, with the last line of its log, if it exits.
    """
    limit = START_TIMEOUT + (TAKE_OVER_TIMEOUT if earlier is not None else 0.0)
    end = time.monotonic() + limit
    while time.monotonic() < end:
        service = client.service()
        if service is not None and service.pid != earlier:
            if service.pid != manager.pid:
                raise ManagerBusy(f"another manager of this system was just started (process {service.pid})")
            return
        if manager.poll() is not None:
            lines = log.read_text(errors="replace").strip().splitlines() or ["the manager exited without a message"]
            raise ManagerError(lines[-1].removeprefix("midstride: "))
        time.sleep(POLL)
    manager.kill()
    raise ManagerError(f"the manager did not answer within {limit:g} s; see {log}")


def _wait_until_up(client: Client) -> UpReport:
    """Show progress until the system is up. Raises the manager's error if it does not come up."""
    followed = FollowedRequest(client, client.up, since=0, until="up")
    with Progress(console(stderr=wants_json())) as progress:
        for event in followed:
            if not wants_json() and event.kind != "up":  # the answer says so
                progress.show(event)
    return followed.answer()


def _undo(client: Client, workspace: Workspace, manager: subprocess.Popen[bytes], log: Path) -> None:
    """Stop the system and its manager. A manager that does not answer yet would still start the system: wait for it."""
    name = workspace.name
    goes_on = f"The manager of {name} may still start it: `midstride down --system {name}` stops it."
    try:
        with explained_when_interrupted(lambda: goes_on):
            _wait_for_manager(client, manager, log)
    except ManagerError:  # it has exited
        return
    stop(client, workspace)

"""``up``: start a manager and its system, and watch them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

import click
from msgspec import structs

from midstride.backends import NAMES
from midstride.cli.client import Client
from midstride.cli.first_rates import await_rates
from midstride.cli.follow import FollowedRequest, explained_when_interrupted
from midstride.cli.input_files import load
from midstride.cli.live_view import watch
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
from midstride.runtime.workspace import Workspace
from midstride.verdicts.conditions import EXIT_STATUS, not_yet_judged

# How long a manager may take to answer for the first time (s): a cold start on a busy machine.
START_TIMEOUT = 30.0
POLL = 0.02
MOST_SPARES = 20


def backend_option(help: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    return click.option(
        "--backend",
        type=click.Choice(NAMES),
        default="ros2",
        show_default=True,
        envvar="MIDSTRIDE_BACKEND",
        show_envvar=True,
        help=help,
    )


def platform_options(spares: int) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """The options that hold for every process of the system: the last arguments of :func:`manager_arguments`.

    ``spares`` is how many spare processes there are by default.
    """
    sim_time = click.option(
        "--use-sim-time",
        is_flag=True,
        help="Have /clock drive every node that does not set use_sim_time itself, also those added later (ROS 2).",
    )
    no_settings = click.option(
        "--no-middleware-settings",
        is_flag=True,
        help="Leave transports and discovery of the middleware as they are; see docs/how-to/middleware-settings.md.",
    )
    no_diagnostics = click.option(
        "--no-diagnostics", is_flag=True, help="Do not publish on /diagnostics; see docs/how-to/diagnostics.md."
    )
    kept = click.option(
        "--spares",
        type=click.IntRange(0, MOST_SPARES),
        default=spares,
        show_default=True,
        metavar="N",
        help="Keep N processes ready that have loaded ROS, so that components start sooner; see docs/how-to/spares.md.",
    )
    return lambda function: sim_time(no_settings(no_diagnostics(kept(function))))


def manager_arguments(
    file: Path, backend: str, use_sim_time: bool, no_middleware_settings: bool, no_diagnostics: bool, spares: int
) -> list[str]:
    """The arguments of a manager for the system of ``file``. Raises UsageError for what the back end does not have."""
    if use_sim_time and backend != "ros2":
        raise click.UsageError(
            "--use-sim-time is for ROS 2; on ROS 1, `rosparam set use_sim_time true` before `up` does it for every node"
        )
    options = ["--use-sim-time"] * use_sim_time + ["--no-middleware-settings"] * no_middleware_settings
    options += [*["--no-diagnostics"] * no_diagnostics, "--spares", str(spares)]
    return [str(absolute(file)), "--backend", backend, *options]


@click.command("up")
@specification_argument()
@backend_option("The platform.")
@click.option("--detach", "-d", is_flag=True, help="Return once the system is up; show no view.")
@click.option(
    "--http",
    type=click.IntRange(1, 65535),
    metavar="PORT",
    help="Serve the HTTP API on a TCP port of the loopback address as well; see docs/http.md.",
)
@click.option("--http-host", metavar="ADDRESS", help="With --http: listen on this address instead.")
@click.option(
    "--metrics-file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="PATH",
    help="Keep metrics in this file for node_exporter's textfile collector; see docs/how-to/monitoring.md.",
)
@platform_options(spares=0)
@click.option(
    "--finish-interrupted",
    is_flag=True,
    help="Finish a change that was interrupted because the manager was killed, instead of rolling it back.",
)
@click.option(
    "--keep-degraded",
    is_flag=True,
    help="Do not restore what has degraded because an input failed: a command does.",
)
@click.option(
    "--strict",
    is_flag=True,
    help="Start all nodes or none: if one of them cannot be started, stop the others.",
)
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
@json_option
def up_command(
    file: Path,
    backend: str,
    detach: bool,
    http: int | None,
    http_host: str | None,
    metrics_file: Path | None,
    use_sim_time: bool,
    no_middleware_settings: bool,
    no_diagnostics: bool,
    finish_interrupted: bool,
    keep_degraded: bool,
    strict: bool,
    dry_run: bool,
    stop_on_exit: bool,
    spares: int,
) -> int:
    """Start the system of FILE and its manager, and watch them. Exit status 3 if not all is up, 1 if nothing is.

    What can be started runs, in the best modes that this allows; a node that cannot is restarted if it has `respawn`.

    Ctrl-C leaves the view; components and manager keep running. If the manager is killed, the next `up` reattaches to
    its components. `midstride down` stops everything.
    """
    if detach and stop_on_exit:
        raise click.UsageError("--detach returns at once, so it excludes --stop-on-exit")
    if http_host is not None and http is None:
        raise click.UsageError("--http-host needs --http PORT")
    arguments = manager_arguments(file, backend, use_sim_time, no_middleware_settings, no_diagnostics, spares)
    specification = load(file)
    if dry_run:
        options = SystemOptions(use_sim_time, not no_middleware_settings, spares, not no_diagnostics)
        return _dry_run(specification, backend, absolute(file).parent, options)
    workspace = Workspace.of(specification.name)
    client = Client(workspace.socket)
    if (running := client.service()) is not None:
        raise ManagerBusy(
            f"{workspace.name} is already running (manager process {running.pid}): "
            "`midstride status` shows it, `midstride apply` changes it, `midstride down` stops it"
        )
    workspace.require_room()
    if http is not None:
        arguments += ["--http", str(http), *(["--http-host", http_host] if http_host else [])]
    arguments += ["--finish-interrupted"] * finish_interrupted + ["--keep-degraded"] * keep_degraded
    arguments += ["--strict"] * strict
    if metrics_file is not None:
        arguments += ["--metrics-file", str(metrics_file.absolute())]
    with ended_by_signals() if stop_on_exit else nullcontext() as request:
        answer = bring_up(client, workspace, arguments)
        shown = partial(_show_how_it_came_up, client, workspace, specification, file, answer, http, http_host)
        if request is not None:
            return stay(client, workspace.name, shown, request)
    name = workspace.name
    goes_on = f"{name} is up and keeps running: `midstride status` shows it, `midstride down` stops it."
    with explained_when_interrupted(lambda: goes_on):
        status = shown()
    return status if detach or wants_json() else watch(client, workspace.name) or status


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
    http: int | None,
    http_host: str | None,
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
    if http is not None:
        click.echo(f"API: http://{http_host or '127.0.0.1'}:{http}/api/v1, token in {workspace.path / 'token'}")
    return status


def missing_lines(report: UpReport) -> Iterator[str]:
    """Yield what could not be started beside what runs, and what to do."""
    for node, because in report.missing.items():
        yield f"Missing: {because if because.startswith(node) else f'{node}: {because}'}"
    if report.missing:
        yield f"Fix the cause, then `midstride restart {' '.join(report.missing)}`. The others go on meanwhile."


def bring_up(client: Client, workspace: Workspace, arguments: list[str]) -> UpReport:
    """Start a manager, show its progress until its system is up, and return its report. Raises the manager's error."""
    log = workspace.manager_log
    try:
        with _interrupt_deferred():  # until the manager's process is known and can be stopped
            manager = _start(arguments, log)
        _wait_for_manager(client, manager, log)
        return _wait_until_up(client)
    except KeyboardInterrupt:
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


def _start(arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
    """Start the manager in a new session, which does not end with this terminal."""
    with log.open("ab") as output:  # for appending, so that the manager can cut it
        output.truncate(0)
        return subprocess.Popen(
            [sys.executable, "-m", "midstride", "_manager", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )


def _wait_for_manager(client: Client, manager: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until the manager answers. Raises ManagerError, with the last line of its log, if it exits."""
    end = time.monotonic() + START_TIMEOUT
    while time.monotonic() < end:
        service = client.service()
        if service is not None:
            if service.pid != manager.pid:
                raise ManagerBusy(f"another manager of this system was just started (process {service.pid})")
            return
        if manager.poll() is not None:
            lines = log.read_text(errors="replace").strip().splitlines() or ["the manager exited without a message"]
            raise ManagerError(lines[-1].removeprefix("midstride: "))
        time.sleep(POLL)
    manager.kill()
    raise ManagerError(f"the manager did not answer within {START_TIMEOUT:g} s; see {log}")


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

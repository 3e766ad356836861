"""``status``, ``why``, ``log``, ``watch``, ``down``: the running system."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import click

from midstride.cli import shell_completion
from midstride.cli.client import Client
from midstride.cli.durations import duration
from midstride.cli.follow import last_event_number
from midstride.cli.output import console, json_option, print_json, show, wants_json
from midstride.cli.running_systems import find, not_running, system_option
from midstride.verdicts.conditions import EXIT_STATUS

if TYPE_CHECKING:
    from midstride.runtime.records.reports import Event
    from midstride.runtime.records.status_forms import Status


@click.command("status")
@click.argument("nodes", nargs=-1, metavar="[NODE]...", shell_complete=shell_completion.nodes)
@click.option("--verbose", "-v", is_flag=True, help="Also what each port measures, and how each component runs.")
@click.option(
    "--for",
    "watched",
    type=click.FloatRange(0),
    metavar="SECONDS",
    help="Wait until all has been up for so long, or is not, and show the status then.",
)
@system_option
@json_option
def status_command(nodes: tuple[str, ...], verbose: bool, watched: float | None, system: str | None) -> int:
    """Show nodes, modes and topics, as the components report them. Exit status 3 if not all is up, 1 if nothing runs.

    With names of nodes or instances, these and their topics, and the problems of the system.
    """
    client, _ = find(system)
    if watched is None:
        status = client.status()
    else:
        from midstride.cli.first_fault import status_at_first_fault

        status = status_at_first_fault(client, watched)
    if nodes:
        status = _narrowed(status, nodes)
    if wants_json():
        print_json(status)
    else:
        from midstride.cli import render_status

        console().print(render_status.status(status))
        if verbose:
            console().print(render_status.measured(status))
            console().print(render_status.platform(status))
    return EXIT_STATUS[status.condition.state]


def _narrowed(status: Status, nodes: Sequence[str]) -> Status:
    """The status with these nodes and their topics only. Raises PlanRefused for a node that does not run."""
    from msgspec import structs

    live = [(each.name, each.role) for each in status.instances]
    crashed = [(each.name, each.role) for each in status.crashed if each.role]
    known = {name for names in [*live, *crashed] for name in names}
    for node in nodes:
        if node not in known:
            raise not_running(status, node)
    instances = [each for each in status.instances if {each.name, each.role} & {*nodes}]
    attached = {port.topic for each in instances for port in each.ports}
    topics = [topic for topic in status.topics if topic.name in attached]
    return structs.replace(status, instances=instances, topics=topics)


@click.command("why")
@click.argument("functionality", metavar="NODE.FUNCTIONALITY", shell_complete=shell_completion.functionalities)
@system_option
@json_option
def why_command(functionality: str, system: str | None) -> int:
    """Explain why a functionality is in its mode, and what to do: `midstride why listener.listen`."""
    client, _ = find(system)
    why = client.why(functionality)
    role, _, _ = why.functionality.rpartition(".")
    instance = "" if why.instance == role else f" ({why.instance})"
    on = f" on {why.host}" if why.host else ""
    lines = [f"{why.functionality}{instance}{on} is in mode {why.mode}"]
    lines += [f"  because: {why.because}"] if why.because else []
    lines += [f"  {reason}" for reason in why.chain]
    lines += [f"  next: {remedy}" for remedy in why.remedies]
    show(why, lines)
    return 0


# How many events `log` shows to people.
LATEST: Final = 20


class Since(click.ParamType):  # type: ignore[type-arg]  # generic in the newest Click only
    """The number of an event, or a time before now: ``90s``, ``5m``, ``2h``."""

    name = "since"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or minus the time of day (s) from which on."""
        if isinstance(value, str) and (seconds := duration(value)) is not None:
            return seconds - time.time()
        if isinstance(value, str) and not value.lstrip("-").isdecimal():
            self.fail(f"{value!r} is neither the number of an event nor a time such as 90s, 5m or 2h", param, ctx)
        return int(click.IntRange(0).convert(value, param, ctx))


def _since_option(function: Any) -> Any:
    summary = "Show the events after number N, or of the last 90s, 5m, 2h."
    return click.option("--since", type=Since(), metavar="N|TIME", help=summary)(function)


def _after(since: float, events: Sequence[Event]) -> int:
    """The number of the last event that ``since`` leaves out."""
    if since >= 0:
        return int(since)
    return max((event.n for event in events if event.at < -since), default=0)


@click.command("log")
@_since_option
@click.option("--all", "-a", "all_", is_flag=True, help="Show all events since the manager started.")
@click.option("--follow", "-f", is_flag=True, help="Continue with the events that come, until Ctrl-C.")
@system_option
@json_option
def log_command(since: float | None, all_: bool, follow: bool, system: str | None) -> int:
    """Show the latest 20 events; with --json, all since the manager started.

    With --follow and --json: the events as they come, a JSON document on each line.

    `midstride logs NODE` shows what a component has written.
    """
    client, _ = find(system)
    known = client.log()
    last = known[-1].n if known else 0
    events = known if since is None else [event for event in known if event.n > _after(since, known)]
    if follow:
        begin = events if all_ or since is not None or wants_json() else events[-LATEST:]
        return _follow(client, begin[0].n - 1 if begin else last)
    if wants_json():
        print_json(events)
        return 0
    if since is None and not all_ and len(events) > LATEST:
        click.echo(f"({len(events) - LATEST} earlier events: `midstride log --all`)", err=True)
        events = events[-LATEST:]
    from midstride.cli import render

    for event in events:
        console().print(render.event(event))
    return 0


@click.command("watch")
@_since_option
@click.option("--all", "-a", "all_", is_flag=True, help="Begin with all events since the manager started.")
@system_option
@json_option
def watch_command(since: float | None, all_: bool, system: str | None) -> int:
    """Watch the running system until Ctrl-C, which does not affect it.

    With --json: the events as they come, a JSON document on each line.
    """
    client, workspace = find(system)
    if all_ or since is not None:
        begin = 0 if all_ or since is None else _after(since, client.log())
    else:
        begin = last_event_number(client)
    if wants_json():
        return _follow(client, begin)
    from midstride.cli.live_view import watch

    return watch(client, workspace.name, begin)


def _follow(client: Client, since: int) -> int:
    """Print the events after number ``since`` and those that come, one on each line, until Ctrl-C."""
    from midstride.cli import render

    try:
        for event in client.events(since):
            if wants_json():
                print_json(event, lines=True)
            else:
                console().print(render.event(event))
    except KeyboardInterrupt:
        pass
    return 0


@click.command("down")
@system_option
@json_option
def down_command(system: str | None) -> int:
    """Stop all components of a system, and its manager.

    What the manager is doing is broken off: a start that waits for a node, or a change, which is rolled back first.
    A roll-back is not broken off: `down` waits for its end.
    """
    from midstride.cli.shutdown import shut_down
    from midstride.codec.form import encode

    name, report = shut_down(system)
    lines = [f"{name} is down.", *(f"{each.words}." for each in report.killed)]
    show({**encode(report), "system": name}, lines)
    return 0

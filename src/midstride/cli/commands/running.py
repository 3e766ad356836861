"""``status``, ``why``, ``log``, ``watch``, ``down``: the running system."""

from __future__ import annotations

from collections.abc import Iterable

import click

from midstride.cli import completion
from midstride.cli.client import Event
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.systems import find, system_option


@click.command("status")
@system_option
@json_option
def status_command(system: str | None) -> int:
    """Show nodes, modes and topics, as the components report them. Exit status 1 if the system is not valid."""
    client, _ = find(system)
    document = client.get("/status")
    if wants_json():
        print_json(document)
    else:
        from midstride.cli import render

        console().print(render.status(document))
    return 0 if document["valid"] else 1


@click.command("why")
@click.argument("functionality", metavar="NODE.FUNCTIONALITY", shell_complete=completion.functionalities)
@system_option
@json_option
def why_command(functionality: str, system: str | None) -> int:
    """Explain why a functionality is in its mode: `midstride why listener.listen`."""
    client, _ = find(system)
    document = client.get("/why", functionality=functionality)
    if wants_json():
        print_json(document)
        return 0
    click.echo(f"{document['functionality']} is in mode {document['mode']}")
    if document.get("because"):
        click.echo(f"  because: {document['because']}")
    for reason in document["chain"]:
        click.echo(f"  {reason}")
    return 0


@click.command("log")
@click.option(
    "--since",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    metavar="N",
    help="Skip the events up to number N.",
)
@system_option
@json_option
def log_command(since: int, system: str | None) -> int:
    """Show the events since the manager started."""
    client, _ = find(system)
    events = client.get("/log", since=since)
    if wants_json():
        print_json(events)
        return 0
    from midstride.cli import render

    for event in events:
        console().print(render.event(event))
    return 0


@click.command("watch")
@system_option
@json_option
def watch_command(system: str | None) -> int:
    """Watch the running system until Ctrl-C, which does not affect it.

    With --json: the events as one JSON array, one per line, as they come.
    """
    client, workspace = find(system)
    if wants_json():
        _stream(client.events())
        return 0
    from midstride.cli.view import watch

    return watch(client, workspace.name, 0)


def _stream(events: Iterable[Event]) -> None:
    """Write an array event by event; Ctrl-C ends it between two events, so that it stays valid JSON."""
    import json
    import signal

    lead = "["
    try:
        for event in events:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            print(f"{lead}\n{json.dumps(event)}", end="", flush=True)
            lead = ","
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    except KeyboardInterrupt:
        pass
    print("[]" if lead == "[" else "\n]")


@click.command("down")
@system_option
@json_option
def down_command(system: str | None) -> int:
    """Stop all components of a system, and its manager."""
    from midstride.cli.shutdown import shut_down

    name = shut_down(system)
    if wants_json():
        print_json({"outcome": "done", "system": name})
    else:
        click.echo(f"{name} is down.")
    return 0

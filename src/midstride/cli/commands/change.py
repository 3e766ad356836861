"""``replace``, ``add``, ``remove``, ``apply``: a change of the running system, shown before it is made."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Any

import click

from midstride.cli import change_options
from midstride.cli.app import json_option
from midstride.cli.client import Client, Document
from midstride.cli.systems import find, system_option


def _change_options(function: Any) -> Any:
    yes = click.option("--yes", "-y", is_flag=True, help="Do not ask.")
    told = "Begin only if Alloy finds every step safe, and go on only if what is live is so after each."
    verify = click.option("--verify", is_flag=True, help=told)
    return json_option(system_option(change_options.strategy_option(verify(yes(function)))))


def _declarations(function: Any) -> Any:
    return click.option(
        "--from",
        "file",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Another specification, whose components may be named as well.",
    )(function)


@click.command("replace")
@click.argument("node")
@click.argument("component")
@_declarations
@_change_options
def replace_command(
    node: str, component: str, file: Path | None, system: str | None, strategy: str, verify: bool, yes: bool
) -> int:
    """Replace what plays NODE by COMPONENT, on the same topics."""
    request = {"replace": [[node, component]], "components": _components(file), "strategy": strategy}
    return change(system, request, f"replace {node} by {component}", yes, verify)


@click.command("add")
@click.argument("node")
@click.argument("component")
@click.argument("attachments", nargs=-1, metavar="[PORT=TOPIC]...")
@click.option("--param", "parameters", multiple=True, metavar="NAME=VALUE", help="A parameter of the node.")
@_declarations
@_change_options
def add_command(
    node: str,
    component: str,
    attachments: tuple[str, ...],
    parameters: tuple[str, ...],
    file: Path | None,
    system: str | None,
    strategy: str,
    verify: bool,
    yes: bool,
) -> int:
    """Add NODE, a COMPONENT, and attach its ports to topics."""
    new = change_options.node(node, component, attachments, parameters)
    request = {"add": [new], "components": _components(file), "strategy": strategy}
    return change(system, request, f"add {node} ({component})", yes, verify)


@click.command("remove")
@click.argument("nodes", nargs=-1, required=True, metavar="NODE...")
@_change_options
def remove_command(nodes: tuple[str, ...], system: str | None, strategy: str, verify: bool, yes: bool) -> int:
    """Remove nodes; what relies on them falls as far as it must."""
    request = {"remove": list(nodes), "strategy": strategy}
    return change(system, request, f"remove {', '.join(nodes)}", yes, verify)


@click.command("apply")
@click.argument("new", type=click.Path(path_type=Path))
@_change_options
def apply_command(new: Path, system: str | None, strategy: str, verify: bool, yes: bool) -> int:
    """Change the running system to the specification NEW."""
    from midstride.cli.files import load
    from midstride.codec.specification import encode_specification

    request = {"to": encode_specification(load(new)), "strategy": strategy}
    return change(system, request, f"apply {new.name}", yes, verify)


def _components(file: Path | None) -> list[Document]:
    if file is None:
        return []
    from midstride.cli.files import load
    from midstride.codec.component import encode_component

    specification = load(file)
    return [encode_component(specification.components[name]) for name in sorted(specification.components)]


def change(system: str | None, request: Document, title: str, yes: bool, verify: bool) -> int:
    """Show the plan, ask, carry it out with its progress, and report. The exit status."""
    from midstride.cli.output import is_interactive, print_json, wants_json

    if not yes and not is_interactive():
        raise click.UsageError("nobody can be asked here (no terminal): say --yes to go ahead")
    client, _ = find(system)
    expected = None
    if not yes:
        preview = client.post("/plan", request)
        _show_plan(preview, title, to_stderr=wants_json())
        if preview["steps"] and not click.confirm("Go ahead?", err=True):
            click.echo("Nothing was changed.", err=True)
            return 1
        expected = preview["revision"]
    answer = carry_out(client, {"request": request, "expected": expected, "verify": verify}, title, show_plan=yes)
    if wants_json():
        print_json(answer)
    return 0 if answer["outcome"] == "done" else 1


def carry_out(client: Client, change: Document, title: str, *, show_plan: bool) -> Document:
    """Have the manager carry a change out, showing what happens; what came of it, as the manager tells it."""
    from midstride.cli.follow import Following, last_number
    from midstride.cli.output import console, wants_json

    if wants_json():
        return dict(client.post("/change", change))
    from midstride.cli import render
    from midstride.cli.progress import Progress

    own = {**change, "id": uuid.uuid4().hex}
    following = Following(
        client, lambda: dict(client.post("/change", own)), since=last_number(client), until="outcome", id=own["id"]
    )
    out = console()
    try:
        with Progress(out) as progress:
            for event in following:
                if event["kind"] == "plan" and show_plan:
                    out.print(render.plan(event["plan"], title))
                progress.show(event)
    except KeyboardInterrupt:
        click.echo("\nThe manager goes on with the change; `midstride log` tells how it ends.", err=True)
        raise
    answer = following.answer()
    out.print(render.outcome(answer))
    return answer


def _show_plan(preview: Document, title: str, *, to_stderr: bool) -> None:
    from midstride.cli import render
    from midstride.cli.output import console

    console(stderr=to_stderr).print(render.plan(preview, title))

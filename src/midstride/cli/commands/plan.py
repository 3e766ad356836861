"""``plan``: the plan for a change of a specification with nothing running, or of the running system."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import click

from midstride.cli import completion, render
from midstride.cli.change_options import declared_parameters_option, parse_new_node, parse_pair, strategy_option
from midstride.cli.client import Document
from midstride.cli.files import load
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.systems import find, system_option
from midstride.codec.specification import encode_specification
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms import encode_plan
from midstride.plan.registry import planner
from midstride.plan.request_form import decode_request


@click.command("plan")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--to", type=click.Path(path_type=Path), metavar="NEW", help="Change to the specification NEW.")
@click.option(
    "--replace",
    "replaced",
    multiple=True,
    metavar="NODE=COMPONENT",
    shell_complete=completion.replacements,
    help="Replace the component of NODE.",
)
@click.option(
    "--restart", "restarted", multiple=True, metavar="NODE", shell_complete=completion.nodes, help="Restart a node."
)
@click.option("--add", "added", multiple=True, metavar="'NODE COMPONENT PORT=TOPIC...'", help="Add a node.")
@click.option(
    "--remove", "removed", multiple=True, metavar="NODE", shell_complete=completion.nodes, help="Remove a node."
)
@declared_parameters_option
@strategy_option
@system_option
@json_option
def plan_command(
    file: Path | None,
    to: Path | None,
    replaced: tuple[str, ...],
    restarted: tuple[str, ...],
    added: tuple[str, ...],
    removed: tuple[str, ...],
    declared_parameters: bool,
    strategy: str,
    system: str | None,
) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    Without FILE, that for the running system, from its present state; nothing is changed. Only there can parameters
    have been set at run time, so --declared-parameters needs it.

    \b
    midstride plan talker.json --replace talker=NewTalker
    midstride plan talker.json --add 'second Listener in=/chatter'
    midstride plan --restart talker --declared-parameters
    """
    single = replaced or restarted or added or removed
    if not (to or single):
        raise click.UsageError("nothing to change: pass --to NEW, --replace, --restart, --add or --remove")
    if to is not None and single:
        raise click.UsageError("--to cannot be combined with --replace, --restart, --add or --remove")
    if file is not None and (declared_parameters or system):
        option = "--declared-parameters" if declared_parameters else "--system"
        raise click.UsageError(f"{option} is for the running system: leave FILE out")
    asked: Document = {
        "replace": [parse_pair(text, "NODE=COMPONENT, such as talker=NewTalker") for text in replaced],
        "restart": list(restarted),
        "add": [parse_new_node(shlex.split(text)) for text in added],
        "remove": list(removed),
        "strategy": strategy,
        "declared_parameters": declared_parameters,
    }
    request = replace(decode_request(asked), to=None if to is None else load(to))
    if file is None:
        client, workspace = find(system)
        target = {} if request.to is None else {"to": encode_specification(request.to)}
        name, document = workspace.name, client.post("/plan", {**asked, **target})
    else:
        name, specification = file.name, load(file)
        change = change_between(
            initial(specification), specification, request.target(specification), renewed=request.renewed()
        )
        document = encode_plan(planner(strategy)(change))
    if wants_json():
        print_json(document)
    else:
        title = f"from {name} to {to.name}" if to else f"{name}: {request.describe()}"
        console().print(render.plan(document, title))
    return 0

"""``plan``: a plan for a change of a specification, with nothing running."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from midstride.cli import completion, render
from midstride.cli.change_options import parse_new_node, parse_pair, strategy_option
from midstride.cli.files import load
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms import encode_plan
from midstride.plan.registry import planner
from midstride.plan.request_form import decode_request


@click.command("plan")
@click.argument("file", type=click.Path(path_type=Path))
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
@strategy_option
@json_option
def plan_command(
    file: Path,
    to: Path | None,
    replaced: tuple[str, ...],
    restarted: tuple[str, ...],
    added: tuple[str, ...],
    removed: tuple[str, ...],
    strategy: str,
) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    \b
    midstride plan talker.json --replace talker=NewTalker
    midstride plan talker.json --add 'second Listener in=/chatter'
    """
    single = replaced or restarted or added or removed
    if not (to or single):
        raise click.UsageError("nothing to change: pass --to NEW, --replace, --restart, --add or --remove")
    specification = load(file)
    request = decode_request(
        {
            "replace": [parse_pair(text, "NODE=COMPONENT, such as talker=NewTalker") for text in replaced],
            "restart": list(restarted),
            "add": [parse_new_node(shlex.split(text)) for text in added],
            "remove": list(removed),
            "strategy": strategy,
        }
    )
    if to is not None:
        if single:
            raise click.UsageError("--to cannot be combined with --replace, --restart, --add or --remove")
        target = load(to)
    else:
        target = request.target(specification)
    document = encode_plan(
        planner(strategy)(change_between(initial(specification), specification, target, renewed=request.renewed()))
    )
    if wants_json():
        print_json(document)
    else:
        title = f"from {file.name} to {to.name}" if to else f"{file.name}: {request.describe()}"
        console().print(render.plan(document, title))
    return 0

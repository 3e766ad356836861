"""``plan``: a plan for a change of a specification, with nothing running."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from midstride.cli import render
from midstride.cli.files import load
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.planned_change import planned_change, planned_change_options
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms import encode_plan
from midstride.plan.registry import planner


@click.command("plan")
@click.argument("file", type=click.Path(path_type=Path))
@planned_change_options
@json_option
def plan_command(file: Path, **options: Any) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    \b
    midstride plan talker.json --replace talker=NewTalker
    midstride plan talker.json --add 'second Listener in=/chatter'
    """
    request = planned_change(**options)
    specification = load(file)
    target = request.target(specification)
    document = encode_plan(
        planner(request.strategy)(
            change_between(initial(specification), specification, target, renewed=request.renewed())
        )
    )
    if wants_json():
        print_json(document)
    else:
        title = f"from {file.name} to {options['to'].name}" if request.to else f"{file.name}: {request.describe()}"
        console().print(render.plan(document, title))
    return 0

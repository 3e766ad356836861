"""``plan``: the plan for a change of a specification with nothing running, or of the running system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from midstride.cli import render
from midstride.cli.change_options import declared_parameters_option
from midstride.cli.client import Document
from midstride.cli.files import load
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.planned_change import planned_change, planned_change_options
from midstride.cli.systems import find, system_option
from midstride.codec.specification import encode_specification
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms import encode_plan
from midstride.plan.registry import planner
from midstride.plan.request_form import decode_request


@click.command("plan")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@planned_change_options
@declared_parameters_option
@system_option
@json_option
def plan_command(
    file: Path | None, to: Path | None, declared_parameters: bool, system: str | None, **options: Any
) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    Without FILE, that for the running system, from its present state; nothing is changed. Only there can parameters
    have been set at run time, so --declared-parameters needs it.

    \b
    midstride plan talker.json --replace talker=NewTalker
    midstride plan talker.json --add 'second Listener in=/chatter'
    midstride plan --restart talker --declared-parameters
    """
    change = planned_change(to, **options)
    if file is not None and (declared_parameters or system):
        option = "--declared-parameters" if declared_parameters else "--system"
        raise click.UsageError(f"{option} is for the running system: leave FILE out")
    asked: Document = {**change, "declared_parameters": declared_parameters}
    request = replace(decode_request(asked), to=None if to is None else load(to))
    if file is None:
        client, workspace = find(system)
        new = {} if request.to is None else {"to": encode_specification(request.to)}
        name, document = workspace.name, client.post("/plan", {**asked, **new})
    else:
        name, specification = file.name, load(file)
        target = request.target(specification)
        document = encode_plan(
            planner(request.strategy)(
                change_between(initial(specification), specification, target, renewed=request.renewed())
            )
        )
    if wants_json():
        print_json(document)
    else:
        title = f"from {name} to {to.name}" if to else f"{name}: {request.describe()}"
        console().print(render.plan(document, title))
    return 0

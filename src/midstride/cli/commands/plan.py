"""``plan``: the plan for a change of a specification with nothing running, or of the running system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import RenderableType

from midstride.cli import render, render_comparison
from midstride.cli.change_options import STRATEGIES, declared_parameters_option
from midstride.cli.client import Document
from midstride.cli.files import load
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.planned_change import planned_change, planned_change_options
from midstride.cli.systems import find, system_option
from midstride.codec.specification import encode_specification
from midstride.errors import MidstrideError
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms import encode_plan
from midstride.plan.registry import planner
from midstride.plan.request_form import decode_request


@click.command("plan")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@planned_change_options
@click.option("--compare", is_flag=True, help="Show the plans of every strategy side by side, on a time axis.")
@click.option("--explain", is_flag=True, help="Say what it would cost to keep what degrades, if that is possible.")
@declared_parameters_option
@system_option
@json_option
def plan_command(
    file: Path | None,
    to: Path | None,
    compare: bool,
    explain: bool,
    declared_parameters: bool,
    system: str | None,
    **options: Any,
) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    Without FILE, that for the running system, from its present state; nothing is changed. Only there can parameters
    have been set at run time, so --declared-parameters needs it.

    \b
    midstride plan talker.json --replace talker=NewTalker
    midstride plan talker.json --add 'second Listener in=/chatter'
    midstride plan --restart talker --declared-parameters
    midstride plan talker.json --replace talker=NewTalker --compare
    """
    context = click.get_current_context()
    if compare and explain:
        raise click.UsageError("--compare and --explain cannot be combined: --explain is about one plan")
    if compare and context.get_parameter_source("strategy") is not ParameterSource.DEFAULT:
        raise click.UsageError("--compare shows every strategy: leave --strategy out")
    change = planned_change(to, **options)
    if file is not None and (declared_parameters or system):
        option = "--declared-parameters" if declared_parameters else "--system"
        raise click.UsageError(f"{option} is for the running system: leave FILE out")
    asked: Document = {**change, "declared_parameters": declared_parameters, "explain": explain}
    request = replace(decode_request(asked), to=None if to is None else load(to))
    if file is None:
        client, workspace = find(system)
        new = {} if request.to is None else {"to": encode_specification(request.to)}
        name = workspace.name

        def planned(strategy: str) -> Document:
            document: Document = client.post("/plan", {**asked, **new, "strategy": strategy})
            return document

    else:
        specification = load(file)
        name = file.name

        def planned(strategy: str) -> Document:
            asked = replace(request, strategy=strategy)
            target = asked.target(specification)
            start, renewed = initial(specification), asked.renewed(target)
            plan = planner(strategy)(change_between(start, specification, target, renewed=renewed))
            return encode_plan(plan, explain=explain)

    title = f"from {name} to {to.name}" if to else f"{name}: {request.describe()}"
    if compare:
        documents = {strategy: _or_refused(planned, strategy) for strategy in STRATEGIES}
        if all("refused" in document for document in documents.values()):
            planned(request.strategy)  # raises what it raised before
        shown: RenderableType = render_comparison.comparison(documents, title)
        document: Document = {"strategies": documents}
    else:
        document = planned(request.strategy)
        shown = render.plan(document, title)
    if wants_json():
        print_json(document)
    else:
        console().print(shown)
    return 0


def _or_refused(planned: Callable[[str], Document], strategy: str) -> Document:
    """The plan of a strategy, or why it has none: one that refuses does not hide the others."""
    try:
        return planned(strategy)
    except MidstrideError as error:
        return {"refused": str(error)}

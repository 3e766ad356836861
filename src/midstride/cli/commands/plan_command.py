"""``plan``: the plan for a change of a specification with nothing running, or of the running system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import inf, nan
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import RenderableType

from midstride.cli import render, render_comparison
from midstride.cli.change_options import (
    STRATEGIES,
    declared_parameters_option,
    same_process_option,
    with_other_nodes_option,
)
from midstride.cli.client import Client
from midstride.cli.input_files import load, write
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.planned_change import planned_change, planned_change_options
from midstride.cli.running_systems import find, system_option
from midstride.cli.specification_argument import specification_argument
from midstride.codec.form import Document, encode
from midstride.codec.specification_form import encode_specification
from midstride.errors import MidstrideError
from midstride.model.specification import Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import PlanForm, plan_form
from midstride.plan.forms.request_form import decode_request
from midstride.plan.goals_in_progress import with_time_for_goals
from midstride.plan.lifecycle_bonds import require_unbroken_bonds
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import planner
from midstride.runtime.change.lost_endpoints import unseen_endpoints


def _seconds(_context: click.Context, _parameter: click.Parameter, text: str | None) -> float | None:
    """``5s`` or ``5``."""
    try:
        seconds = None if text is None else float(text.removesuffix("s"))
    except ValueError:
        seconds = nan
    if seconds is not None and not 0 <= seconds < inf:
        raise click.BadParameter(f"{text} is not a number of seconds, such as 5s")
    return seconds


@click.command("plan")
@specification_argument(required=False)
@planned_change_options
@click.option("--compare", is_flag=True, help="Show the plans of every strategy side by side, on a time axis.")
@click.option("--explain", is_flag=True, help="Say what it would cost to keep what degrades, if that is possible.")
@click.option("--within", metavar="SECONDS", callback=_seconds, help="How long to search for the proof of minimality.")
@click.option("--html", "page", type=click.Path(path_type=Path), metavar="FILE", help="Write it as one HTML file, too.")
@declared_parameters_option
@same_process_option
@with_other_nodes_option
@system_option
@json_option
def plan_command(
    file: Path | None,
    to: Path | None,
    compare: bool,
    explain: bool,
    within: float | None,
    page: Path | None,
    declared_parameters: bool,
    same_process: bool,
    with_other_nodes: bool,
    system: str | None,
    **options: Any,
) -> int:
    """Show the plan for a change of the system of FILE: its steps, what degrades and for how long.

    Without FILE, that for the running system, from its present state; nothing is changed. Only there can parameters
    have been set at run time, so --declared-parameters needs it; and only there can it be known which other nodes would
    end with a process, so --with-other-nodes needs it, too.

    The search for the proof that nothing degrades less ends after a fixed number of states, or with FILE after --within
    SECONDS or at Ctrl-C; then the plan says how much is lost at least.

    \b
    midstride plan talker.stride --replace talker=NewTalker
    midstride plan talker.stride --add 'second Listener in=/chatter'
    midstride plan --restart talker --declared-parameters
    midstride plan talker.stride --replace talker=NewTalker --compare
    midstride plan talker.stride --replace talker=NewTalker --html plan.html
    """
    context = click.get_current_context()
    if compare and explain:
        raise click.UsageError("--compare and --explain cannot be combined: --explain is about one plan")
    if compare and context.get_parameter_source("strategy") is not ParameterSource.DEFAULT:
        raise click.UsageError("--compare shows every strategy: leave --strategy out")
    described = planned_change(to, **options)
    if described["detours"] and described["strategy"] != "minimal":
        raise click.UsageError("--detours is for the strategy minimal alone")
    of_running = {
        "--declared-parameters": declared_parameters,
        "--with-other-nodes": with_other_nodes,
        "--system": system,
    }
    if file is not None and any(of_running.values()):
        option = next(name for name, given in of_running.items() if given)
        raise click.UsageError(f"{option} is for the running system: leave FILE out")
    if file is None and within is not None:
        raise click.UsageError("--within needs FILE: the manager of a running system does not search for long")
    asked: Document = {**described, "declared_parameters": declared_parameters, "explain": explain}
    asked |= {"with_other_nodes": with_other_nodes, "same_process": same_process}
    request = replace(decode_request(asked), to=None if to is None else load(to))
    if file is None:
        client, workspace = find(system)
        name, planned = workspace.name, partial(_for_running, client, request.to, asked)
    else:
        name, planned = file.name, partial(_for_file, load(file), request, within)
    title = f"from {name} to {to.name}" if to else f"{name}: {request.describe()}"
    if compare:
        plans = {strategy: _or_refused(planned, strategy) for strategy in STRATEGIES}
        if all(isinstance(plan, str) for plan in plans.values()):
            planned(request.strategy)  # raises what it raised before
        shown: RenderableType = render_comparison.comparison(plans, title)
        documents = {name: {"refused": plan} if isinstance(plan, str) else encode(plan) for name, plan in plans.items()}
        document: Document = {"strategies": documents}
    else:
        plan = planned(request.strategy)
        document, shown = encode(plan), render.plan(plan, title)
    if page is not None:
        from midstride.server.report.documents import plan_file

        write(page, plan_file(documents if compare else {request.strategy: document}, name, title))
    if wants_json():
        print_json(document)
    else:
        console().print(shown)
    return 0


def _for_running(client: Client, to: Specification | None, asked: Document, strategy: str) -> PlanForm:
    new = {} if to is None else {"to": encode_specification(to)}
    more = {"strategy": strategy, "detours": asked["detours"] and strategy == "minimal"}
    return client.plan({**asked, **new, **more})


def _for_file(specification: Specification, request: PlanRequest, within: float | None, strategy: str) -> PlanForm:
    request = replace(request, strategy=strategy)
    request = request.for_members(request.to or specification)
    target = request.target(specification)
    start, renewed, same = initial(specification), request.renewed(target), request.same_process
    change = change_between(start, specification, target, renewed=renewed, same_process=same)
    detours = request.detours and strategy == "minimal"
    plan = with_time_for_goals(planner(strategy, within, detours=detours)(change))
    require_unbroken_bonds(plan)
    return plan_form(replace(plan, besides=tuple(unseen_endpoints(plan))), explain=request.explain)


def _or_refused(planned: Callable[[str], PlanForm], strategy: str) -> PlanForm | str:
    """The plan of a strategy, or why it has none: one that refuses does not hide the others."""
    try:
        return planned(strategy)
    except MidstrideError as error:
        return str(error)

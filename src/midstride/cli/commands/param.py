"""``param list``, ``param get``, ``param set``: parameters of running nodes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from midstride.cli import shell_completion
from midstride.cli.change_options import despite_options, misread, parse_pair, parse_value
from midstride.cli.command_list import Group
from midstride.cli.commands.change_commands import RequestOptions, change
from midstride.cli.follow import Sending, explained_when_interrupted
from midstride.cli.output import json_option, print_json, show, wants_json
from midstride.cli.running_systems import find, not_running, system_option
from midstride.cli.user_name import user_name
from midstride.errors import CommandRefused, ManagerError, MidstrideError, PlanRefused
from midstride.model.diagnostics import suggestion, unknown_name

if TYPE_CHECKING:
    from midstride.cli.client import Client
    from midstride.model.specification import Specification
    from midstride.runtime.records.status_forms import InstanceStatus, ParametersReport, ParameterStatus, Status

_node = click.argument("node", shell_complete=shell_completion.nodes)
_name = click.argument("name", shell_complete=shell_completion.parameters)


@click.group("param", cls=Group)
@json_option
def param_command() -> None:
    """Show and set parameters of running nodes.

    A value that is set while a node runs is kept when the node is replaced or restarted.
    """


@param_command.command("list")
@click.argument("node", required=False, shell_complete=shell_completion.nodes)
@system_option
@json_option
def list_command(node: str | None, system: str | None) -> int:
    """List the parameters of NODE, or of every node, with their values."""
    client, _ = find(system)
    status = client.status()
    found = status.instances if node is None else [_component(status, node)]
    said = {report.instance: report for report in client.parameters(None if node is None else found[0].name)}
    if wants_json():
        print_json({each.name: said[each.name].parameters if each.name in said else [] for each in found})
        return 0
    stated = client.specification()
    lines = [line for component in found for line in _lines(component, said.get(component.name), stated)]
    for line in lines:
        click.echo(line)
    if not lines:
        click.echo("No parameters.", err=True)
    return 0


def _lines(component: InstanceStatus, said: ParametersReport | None, specification: Specification) -> Iterator[str]:
    """The parameters of an instance with their values, and those that are stated and that it does not report."""
    parameters = [] if said is None else said.parameters
    since = "" if said is None or not said.unread else " (when it last answered)"
    for parameter in parameters:
        yield f"{component.name}: {_line(parameter)}{since}"
    for name, words in sorted(_only_stated(component, parameters, specification).items()):
        yield f"{component.name}: {name} = {words}"
    if said is not None and said.unread:
        yield said.unread


def _only_stated(
    component: InstanceStatus, parameters: list[ParameterStatus], specification: Specification
) -> dict[str, str]:
    """By name, the values that the specification states for an instance, and that it does not report."""
    if component.role not in specification.nodes:
        return {}
    instance = specification.instance(component.role)
    stated: dict[str, Any] = {}
    for section in instance.sections:
        if component.node is not None and section.matches(component.node):
            stated |= section.parameters
    stated |= instance.parameters
    because = "the node has no such parameter" if parameters else "the node does not say which it has"
    reported = {parameter.name for parameter in parameters}
    return {name: f"{value!r} is stated; {because}" for name, value in stated.items() if name not in reported}


@param_command.command("get")
@_node
@_name
@system_option
@json_option
def get_command(node: str, name: str, system: str | None) -> int:
    """Show the value of a parameter of NODE."""
    client, _ = find(system)
    component = _component(client.status(), node)
    (said,) = client.parameters(component.name)
    if said.unread:
        raise ManagerError(f"{name} of {component.name} is not known: {said.unread}")
    parameters = {parameter.name: parameter for parameter in said.parameters}
    only_stated = {} if name in parameters else _only_stated(component, said.parameters, client.specification())
    if (words := only_stated.get(name)) is not None:
        raise PlanRefused(f"{name} of {component.name} is not known: {words}")
    if name not in parameters:
        hint = suggestion(name, parameters)
        raise PlanRefused(unknown_name("parameter", name) + f" of {node}" + (f"; {hint}" if hint else ""))
    show(parameters[name], [_line(parameters[name])])
    return 0


# A negative number is no option.
@param_command.command(
    "set",
    short_help="Set parameters of running nodes, of several as one change.",
    context_settings={"ignore_unknown_options": True},
)
@click.argument(
    "words",
    nargs=-1,
    required=True,
    metavar="NODE NAME VALUE | NODE.NAME=VALUE...",
    shell_complete=shell_completion.settings,
)
@click.option("--dry-run", is_flag=True, help="Of NODE.NAME=VALUE: show the plan, and change nothing.")
@despite_options
@system_option
@json_option
def set_command(
    words: tuple[str, ...], dry_run: bool, despite_lock: bool, despite_requirements: bool, system: str | None
) -> int:
    """Set parameters of running nodes, by their own callbacks, as `ros2 param set` does.

    With NODE NAME VALUE, a parameter of one node is set, and that is all. With NODE.NAME=VALUE, once or several times,
    it is a change like any other: all values are set, or none; then the nodes are watched, and if one breaks its
    contract, all of them get their old values back. It is in the history.

    VALUE is read as YAML: 2, 0.5 and [1.0, 2.0] are numbers, true and on are booleans, and '"on"' is a string.

    It waits for a change that is being carried out.

    \b
    midstride param set camera rate 10
    midstride param set camera.rate=10 detector.threshold=0.3
    midstride param set camera.rate=10 detector.threshold=0.3 --dry-run
    """
    if "=" in words[0]:
        options = RequestOptions(system, "minimal", False, 5.0, False, True, despite_lock, despite_requirements, False)
        return _change(options, _settings(words), dry_run)
    if len(words) != 3 or dry_run:
        raise click.UsageError("write NODE NAME VALUE, or NODE.NAME=VALUE for each parameter, such as camera.rate=10")
    node, name, value = words
    client, _ = find(system)
    sending = Sending()
    try:
        values = {name: parse_value(value)}
        with explained_when_interrupted(lambda: sending.interrupted(client)):
            report = client.set_parameters(
                node,
                values,
                by=user_name(),
                id=sending.id,
                despite_lock=despite_lock,
                despite_requirements=despite_requirements,
                begin=sending.begin,
            )
    except CommandRefused as error:
        hint = _misread(client, {node: {name: value}})
        raise CommandRefused(f"{error}; {hint}" if hint else str(error)) from None
    show(report, [f"{report.instance}: {_line(parameter)}" for parameter in report.parameters])
    return 0


def _settings(words: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """By node and parameter, the text of each value. Raises UsageError."""
    found: dict[str, dict[str, str]] = {}
    for word in words:
        left, value = parse_pair(word, "NODE.NAME=VALUE, such as camera.rate=10")
        node, _, name = left.partition(".")
        if not (node and name):
            raise click.UsageError(f"`{word}` is not of the form NODE.NAME=VALUE, such as camera.rate=10")
        values = found.setdefault(node.removeprefix("/"), {})
        if name in values:
            raise click.UsageError(f"{left} is given twice")
        values[name] = value
    return found


def _change(options: RequestOptions, texts: dict[str, dict[str, str]], dry_run: bool) -> int:
    """Set what ``texts`` say as one change. The exit status."""
    from midstride.codec.parameter import json_values

    given = {node: {name: parse_value(text) for name, text in each.items()} for node, each in texts.items()}
    settings = [f"{node}.{name} = {value!r}" for node, each in given.items() for name, value in each.items()]
    request = {"parameters": {node: json_values(values) for node, values in given.items()}}
    try:
        return change(options, request, f"set {', '.join(settings)}", dry_run)
    except PlanRefused as error:
        hint = _misread(find(options.system)[0], texts)
        raise PlanRefused(f"{error}; {hint}" if hint else str(error)) from None


def _misread(client: Client, texts: dict[str, dict[str, str]]) -> str | None:
    """Return what to write for values that YAML reads as another type than their parameters have; None without any."""
    from midstride.codec.parameter import value_of

    hints: list[str] = []
    for node, values in texts.items():
        with suppress(MidstrideError):
            for each in client.parameters(node):
                declared = {parameter.name: value_of(parameter.declared) for parameter in each.parameters}
                hints += filter(None, (misread(name, text, declared) for name, text in values.items()))
    return "; ".join(hints) or None


def _component(status: Status, node: str) -> InstanceStatus:
    """The live instance of that name or role. Raises PlanRefused if none runs, ManagerError if it does not answer."""
    found = next((each for each in status.instances if node in (each.name, each.role)), None)
    if found is None:
        raise not_running(status, node)
    if not found.reachable:
        raise ManagerError(f"{node} does not answer: see `midstride status`")
    return found


def _line(parameter: ParameterStatus) -> str:
    from midstride.codec.parameter import from_json
    from midstride.plan.runtime_values import SET_BY, time_of

    started = f" (started with {from_json(parameter.declared)!r})"
    at = f" at {time_of(parameter.set_at)}" if parameter.set_at else ""
    started = f", {SET_BY[parameter.origin or 'set']}{at}{started}" if parameter.set_at_run_time else ""
    return f"{parameter.name} = {from_json(parameter.value)!r}{started}"

"""``param list``, ``param get``, ``param set``: parameters of running nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from midstride.cli import shell_completion
from midstride.cli.change_options import despite_options, misread, parse_value
from midstride.cli.command_list import Group
from midstride.cli.follow import Sending, explained_when_interrupted
from midstride.cli.output import json_option, print_json, show, wants_json
from midstride.cli.running_systems import find, not_running, system_option
from midstride.cli.user_name import user_name
from midstride.errors import CommandRefused, ManagerError, PlanRefused
from midstride.model.diagnostics import suggestion, unknown_name

if TYPE_CHECKING:
    from midstride.model.specification import Specification
    from midstride.runtime.records.status_forms import InstanceStatus, ParameterStatus, Status

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
    if wants_json():
        print_json({component.name: component.parameters for component in found})
        return 0
    stated = client.specification()
    lines = [line for component in found for line in _lines(component, stated)]
    for line in lines:
        click.echo(line)
    if not lines:
        click.echo("No parameters.", err=True)
    return 0


def _lines(component: InstanceStatus, specification: Specification) -> Iterator[str]:
    """The parameters of an instance with their values, and those that are stated and that it does not report."""
    for parameter in component.parameters:
        yield f"{component.name}: {_line(parameter)}"
    for name, words in sorted(_only_stated(component, specification).items()):
        yield f"{component.name}: {name} = {words}"


def _only_stated(component: InstanceStatus, specification: Specification) -> dict[str, str]:
    """By name, the values that the specification states for an instance, and that it does not report."""
    if component.role not in specification.nodes:
        return {}
    instance = specification.instance(component.role)
    stated: dict[str, Any] = {}
    for section in instance.sections:
        if component.node is not None and section.matches(component.node):
            stated |= section.parameters
    stated |= instance.parameters
    because = "the node has no such parameter" if component.parameters else "the node does not say which it has"
    reported = {parameter.name for parameter in component.parameters}
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
    parameters = {parameter.name: parameter for parameter in component.parameters}
    if name not in parameters and (words := _only_stated(component, client.specification()).get(name)) is not None:
        raise PlanRefused(f"{name} of {component.name} is not known: {words}")
    if name not in parameters:
        hint = suggestion(name, parameters)
        raise PlanRefused(unknown_name("parameter", name) + f" of {node}" + (f"; {hint}" if hint else ""))
    show(parameters[name], [_line(parameters[name])])
    return 0


# A negative number is no option.
@param_command.command(
    "set",
    short_help="Set a parameter of NODE, as `ros2 param set` does.",
    context_settings={"ignore_unknown_options": True},
)
@_node
@_name
@click.argument("value")
@despite_options
@system_option
@json_option
def set_command(
    node: str, name: str, value: str, despite_lock: bool, despite_requirements: bool, system: str | None
) -> int:
    """Set a parameter of NODE, by its own callback, as `ros2 param set` does.

    VALUE is read as YAML: 2, 0.5 and [1.0, 2.0] are numbers, true and on are booleans, and '"on"' is a string.

    It waits for a change that is being carried out.
    """
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
        from midstride.codec.parameter import value_of

        found = [each for each in client.status().instances if node in (each.name, each.role)]
        declared = {parameter.name: value_of(parameter.declared) for each in found for parameter in each.parameters}
        hint = misread(name, value, declared)
        raise CommandRefused(f"{error}; {hint}" if hint else str(error)) from None
    show(report, [f"{report.instance}: {_line(parameter)}" for parameter in report.parameters])
    return 0


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

    started = f", set at run time (started with {from_json(parameter.declared)!r})" if parameter.set_at_run_time else ""
    return f"{parameter.name} = {from_json(parameter.value)!r}{started}"

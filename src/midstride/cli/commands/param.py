"""``param list``, ``param get``, ``param set``: parameters of running nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from midstride.cli import completion
from midstride.cli.output import json_option, print_json, wants_json
from midstride.cli.systems import find, system_option
from midstride.errors import ManagerError, PlanRefused
from midstride.model.diagnostics import suggestion, unknown_name

if TYPE_CHECKING:
    from midstride.runtime.status_forms import ComponentStatus, ParameterStatus

_node = click.argument("node", shell_complete=completion.nodes)
_name = click.argument("name", shell_complete=completion.parameters)


@click.group("param")
@json_option
def param_command() -> None:
    """Show and set parameters of running nodes.

    A value that is set while a node runs is kept when the node is replaced or restarted.
    """


@param_command.command("list")
@click.argument("node", required=False, shell_complete=completion.nodes)
@system_option
@json_option
def list_command(node: str | None, system: str | None) -> int:
    """List the parameters of NODE, or of every node, with their values."""
    client, _ = find(system)
    components = client.status().components
    found = components if node is None else [_component(components, node)]
    if wants_json():
        print_json({component.name: component.parameters for component in found})
        return 0
    for component in found:
        for parameter in component.parameters:
            click.echo(f"{component.name}: {_line(parameter)}")
    return 0


@param_command.command("get")
@_node
@_name
@system_option
@json_option
def get_command(node: str, name: str, system: str | None) -> int:
    """Show the value of a parameter of NODE."""
    client, _ = find(system)
    component = _component(client.status().components, node)
    parameters = {parameter.name: parameter for parameter in component.parameters}
    if name not in parameters:
        hint = suggestion(name, parameters)
        raise PlanRefused(unknown_name("parameter", name) + f" of {node}" + (f"; {hint}" if hint else ""))
    if wants_json():
        print_json(parameters[name])
    else:
        click.echo(_line(parameters[name]))
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
@system_option
@json_option
def set_command(node: str, name: str, value: str, system: str | None) -> int:
    """Set a parameter of NODE, by its own callback, as `ros2 param set` does. VALUE is read as YAML.

    It waits for a change that is being carried out.
    """
    client, _ = find(system)
    report = client.set_parameters(node, {name: yaml_value(value)})
    if wants_json():
        print_json(report)
        return 0
    for parameter in report.parameters:
        click.echo(f"{report.instance}: {_line(parameter)}")
    return 0


def _component(components: Sequence[ComponentStatus], node: str) -> ComponentStatus:
    """The live instance of that name or role. Raises ManagerError where it does not run or does not answer."""
    found = [each for each in components if node in (each.name, each.role)]
    if not found:
        hint = suggestion(node, [each.role for each in components])
        raise PlanRefused(f"no node {node} is running" + (f"; {hint}" if hint else ""))
    if not found[0].reachable:
        raise ManagerError(f"{node} does not answer: see `midstride status`")
    return found[0]


def _line(parameter: ParameterStatus) -> str:
    started = f", set at run time (started with {parameter.declared!r})" if parameter.set_at_run_time else ""
    return f"{parameter.name} = {parameter.value!r}{started}"


def yaml_value(text: str) -> Any:
    """The value that ``ros2 param set`` makes of ``text``: what is no value of a parameter in YAML is a string."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        return text
    if isinstance(value, list):
        return value if {type(member) for member in value} in ({bool}, {int}, {float}, {str}) else text
    return value if isinstance(value, (bool, int, float, str)) else text

"""Options that describe a change, as the JSON document of a request (``midstride.plan.request``)."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from midstride.cli import shell_completion
from midstride.errors import NOT_OF_TAG

if TYPE_CHECKING:  # completion must not wait for it
    from midstride.model.component import ParameterValue

STRATEGIES = ("minimal", "paper", "quiesce", "stop")


def strategy_options(function: Any) -> Any:
    summary = (
        "With strategy minimal: also try to move nodes that stay, and stand-ins that exist during the change only."
    )
    detours = click.option("--detours", is_flag=True, help=summary)
    return click.option(
        "--strategy",
        type=click.Choice(STRATEGIES),
        default="minimal",
        show_default=True,
        help="minimal loses the least; paper follows the paper's algorithm; quiesce first degrades all that is "
        "affected; stop stops everything, and starts it again.",
    )(detours(function))


def wait_option(function: Any) -> Any:
    summary = "How long to wait for a hung node that is being replaced before its outputs are blocked."
    return click.option(
        "--wait", type=click.FloatRange(0), default=5.0, show_default=True, metavar="SECONDS", help=summary
    )(function)


def despite_options(function: Any) -> Any:
    summary = "Change the system although it is locked; the history says that you did."
    lock = click.option("--despite-lock", is_flag=True, help=summary)
    summary = "Change the system although what its changes require does not hold; the history says that you did."
    return lock(click.option("--despite-requirements", is_flag=True, help=summary)(function))


def declared_parameters_option(function: Any) -> Any:
    summary = "Start with the declared values of parameters instead of those that were set at run time."
    return click.option("--declared-parameters", is_flag=True, help=summary)(function)


def with_other_nodes_option(function: Any) -> Any:
    summary = (
        "Also where other nodes end with a process that the change ends, as the components in a container do. Without "
        "this option, such a change is refused with their names."
    )
    return click.option("--with-other-nodes", is_flag=True, help=summary)(function)


def same_process_option(function: Any) -> Any:
    summary = (
        "A replaced node of a container starts in the process that it is in: with the code that is loaded there, and "
        "ending with the others if it crashes. Without this option it has a process for itself, with its code on disk."
    )
    return click.option("--same-process", is_flag=True, help=summary)(function)


def on_host_option(function: Any) -> Any:
    summary = "The host that the node is to run on; `manager` is that of the manager."
    return click.option("--on", "host", metavar="HOST", shell_complete=shell_completion.hosts, help=summary)(function)


def parse_pair(text: str, form: str) -> tuple[str, str]:
    """``NAME=VALUE``. Raises UsageError, which names the expected form."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise click.UsageError(f"`{text}` is not of the form {form}")
    return name, value


def parse_parameter(text: str) -> tuple[str, str]:
    """``NAME=VALUE``. Raises UsageError."""
    return parse_pair(text, "NAME=VALUE, such as threshold=0.5")


def new_node(role: str, component: str, attachments: Iterable[str], parameters: Iterable[str] = ()) -> dict[str, Any]:
    """A node to add, from arguments of the forms ``PORT=TOPIC`` and ``NAME=VALUE``."""
    from midstride.codec.parameter import json_values

    topics: dict[str, list[str]] = {}
    for text in attachments:
        port, topic = parse_pair(text, "PORT=TOPIC, such as out=/chatter")
        topics.setdefault(port, []).append(topic)
    values = dict(map(parse_parameter, parameters))
    return {
        "role": role.removeprefix("/"),  # as ROS writes the full name of a node
        "component": component,
        "attachments": topics,
        "parameters": json_values({name: parse_value(text) for name, text in values.items()}),
    }


def parse_new_node(words: Sequence[str]) -> dict[str, Any]:
    """A node to add, from ``NODE COMPONENT PORT=TOPIC…``. Raises UsageError."""
    if len(words) < 2 or "=" in words[0] or "=" in words[1]:
        raise click.UsageError(f"`{' '.join(words)}` is not of the form 'NODE COMPONENT PORT=TOPIC…'")
    return new_node(words[0], words[1], words[2:])


def parse_value(text: str) -> Any:
    """The value that ``ros2 param set`` makes of ``text``: what is no value of a parameter in YAML is a string."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, *NOT_OF_TAG):
        return text
    if isinstance(value, list):
        return value if not value or {type(member) for member in value} in ({bool}, {int}, {float}, {str}) else text
    return value if isinstance(value, (bool, int, float, str)) else text


def misread(name: str, text: str, declared: Mapping[str, ParameterValue]) -> str | None:
    """Advise what to write instead of ``text``, where YAML reads another type than the parameter ``name`` has.

    None where it does not, or the parameter is neither ``declared`` nor ROS's own.
    """
    from midstride.model.component import ROS_PARAMETERS, value_fits, value_kind

    value, like = parse_value(text), declared.get(name, ROS_PARAMETERS.get(name))
    if like is None or value_fits(value, like):
        return None
    candidates = [json.dumps(text, ensure_ascii=False), f"[{text}]", json.dumps([text], ensure_ascii=False)]
    with suppress(ValueError):
        candidates.append(repr(float(text)))  # `1e3` is a string in YAML 1.1
    fitting = next((_quoted(each) for each in candidates if value_fits(parse_value(each), like)), None)
    instead = f", such as {_quoted(json.dumps(like, ensure_ascii=False))}" if fitting is None else f": {fitting}"
    return f"YAML reads `{text}` as {value_kind(value)}; write {value_kind(like)}{instead}"


def _quoted(text: str) -> str:
    return text if text.replace(".", "").isalnum() else shlex.quote(text)

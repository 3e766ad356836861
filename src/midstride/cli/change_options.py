"""Options that describe a change, as the JSON document of a request (``midstride.plan.request``)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import click

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
        help="minimal hands over; paper follows the paper's algorithm; quiesce first degrades everything affected; "
        "stop stops everything, and starts it again.",
    )(detours(function))


def wait_option(function: Any) -> Any:
    summary = "How long to try before a node that hangs, and is to go, is fenced: replaced inside a call of its code."
    return click.option(
        "--wait", type=click.FloatRange(0), default=5.0, show_default=True, metavar="SECONDS", help=summary
    )(function)


def declared_parameters_option(function: Any) -> Any:
    summary = "Start with the declared values of parameters instead of those that were set at run time."
    return click.option("--declared-parameters", is_flag=True, help=summary)(function)


def parse_pair(text: str, form: str) -> tuple[str, str]:
    """``NAME=VALUE``. Raises UsageError, which names the expected form."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise click.UsageError(f"`{text}` is not of the form {form}")
    return name, value


def new_node(role: str, component: str, attachments: Iterable[str], parameters: Iterable[str] = ()) -> dict[str, Any]:
    """A node to add, from arguments of the forms ``PORT=TOPIC`` and ``NAME=VALUE``."""
    topics: dict[str, list[str]] = {}
    for text in attachments:
        port, topic = parse_pair(text, "PORT=TOPIC, such as out=/chatter")
        topics.setdefault(port, []).append(topic)
    values = dict(parse_pair(text, "NAME=VALUE, such as threshold=0.5") for text in parameters)
    return {
        "role": role.removeprefix("/"),  # as ROS writes the full name of a node
        "component": component,
        "attachments": topics,
        "parameters": {name: parse_value(text) for name, text in values.items()},
    }


def parse_new_node(words: Sequence[str]) -> dict[str, Any]:
    """A node to add, from ``NODE COMPONENT PORT=TOPIC…``. Raises UsageError."""
    if len(words) < 2 or "=" in words[0] or "=" in words[1]:
        raise click.UsageError(f"`{' '.join(words)}` is not of the form 'NODE COMPONENT PORT=TOPIC…'")
    return new_node(words[0], words[1], words[2:])


def parse_value(text: str) -> Any:
    """The value of a parameter, written as in JSON; text that is not JSON is a string."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text

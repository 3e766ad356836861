"""What a change is asked with on the command line, as the document of a request (plan/request.py)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import click

STRATEGIES = ("minimal", "paper", "quiesce")


def strategy_option(function: Any) -> Any:
    return click.option(
        "--strategy",
        type=click.Choice(STRATEGIES),
        default="minimal",
        show_default=True,
        help="minimal hands over; paper is the paper's algorithm; quiesce lowers everything in reach first.",
    )(function)


def pair(text: str, what: str) -> tuple[str, str]:
    """``NAME=VALUE``. Raises UsageError where it is none."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise click.UsageError(f"`{text}` is not of the form {what}")
    return name, value


def node(role: str, component: str, attachments: Iterable[str], parameters: Iterable[str] = ()) -> dict[str, Any]:
    """A node to add, from ``PORT=TOPIC`` and ``NAME=VALUE`` words."""
    topics: dict[str, list[str]] = {}
    for word in attachments:
        port, topic = pair(word, "PORT=TOPIC, such as out=/chatter")
        topics.setdefault(port, []).append(topic)
    values = dict(pair(word, "NAME=VALUE, such as threshold=0.5") for word in parameters)
    return {
        "role": role,
        "component": component,
        "attachments": topics,
        "parameters": {name: value_of(text) for name, text in values.items()},
    }


def added(words: Sequence[str]) -> dict[str, Any]:
    """A node to add, from ``NODE COMPONENT PORT=TOPIC…``. Raises UsageError."""
    if len(words) < 2 or "=" in words[0] or "=" in words[1]:
        raise click.UsageError(f"`{' '.join(words)}` is not of the form 'NODE COMPONENT PORT=TOPIC…'")
    return node(words[0], words[1], words[2:])


def value_of(text: str) -> Any:
    """A parameter's value as JSON has it; what is not JSON is a word."""
    try:
        return json.loads(text)
    except ValueError:
        return text

"""The options of a change of a specification, with nothing running: for ``plan`` and ``simulate``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from midstride.cli import shell_completion
from midstride.cli.change_options import parse_new_node, parse_pair, strategy_options
from midstride.cli.specification_argument import SpecificationPath


def planned_change_options(function: Any) -> Any:
    """The options of a change of a specification, with nothing running; :func:`planned_change` reads them."""
    node: dict[str, Any] = {
        "metavar": "NODE",
        "multiple": True,
        "shell_complete": shell_completion.nodes_and_containers,
    }
    pair: dict[str, Any] = {
        "metavar": "NODE=COMPONENT",
        "multiple": True,
        "shell_complete": shell_completion.replacements,
    }
    for option in (
        click.option("--remove", "removed", **node, help="Remove a node."),
        click.option("--add", "added", multiple=True, metavar="'NODE COMPONENT PORT=TOPIC...'", help="Add a node."),
        click.option("--restart", "restarted", **node, help="Restart a node."),
        click.option("--replace", "replaced", **pair, help="Replace the component of NODE."),
        click.option("--on", "moved", multiple=True, metavar="NODE=HOST", help="Run NODE on another host."),
        click.option("--to", type=SpecificationPath(), metavar="NEW", help="Change to the specification NEW."),
    ):
        function = option(function)
    return strategy_options(function)


def planned_change(
    to: Path | None,
    replaced: tuple[str, ...],
    restarted: tuple[str, ...],
    added: tuple[str, ...],
    removed: tuple[str, ...],
    moved: tuple[str, ...],
    strategy: str,
    detours: bool,
) -> dict[str, Any]:
    """The change that the options describe, without NEW, as the document of a request. Raises UsageError."""
    single = replaced or restarted or added or removed or moved
    if not (to or single):
        raise click.UsageError("nothing to change: pass --to NEW, --replace, --restart, --add, --remove or --on")
    if to is not None and single:
        raise click.UsageError("--to cannot be combined with --replace, --restart, --add, --remove or --on")
    return {
        "replace": [parse_pair(text, "NODE=COMPONENT, such as talker=NewTalker") for text in replaced],
        "restart": list(restarted),
        "add": [parse_new_node(shlex.split(text)) for text in added],
        "remove": list(removed),
        "on": dict(parse_pair(text, "NODE=HOST, such as gripper=arm") for text in moved),
        "strategy": strategy,
        "detours": detours,
    }

"""``demo``: an example from beginning to end."""

from __future__ import annotations

import asyncio

import click

from midstride.backends import NAMES
from midstride.cli.app import json_option


@click.command("demo")
@click.argument("name", default="talker")
@click.option(
    "--backend",
    type=click.Choice(NAMES),
    envvar="MIDSTRIDE_BACKEND",
    show_envvar=True,
    help="What it runs on; ros2 where it can be had, else sim.",
)
@json_option
def demo_command(name: str, backend: str | None) -> int:
    """Run the example NAME (talker, obstacle or filter): its plans, each step, and what was measured.

    Everything it starts ends with it, however it ends.
    """
    from rich.console import Console

    from midstride import backends
    from midstride.cli import INTERRUPTED
    from midstride.cli.demo_runner import run_demo
    from midstride.cli.example import find
    from midstride.cli.output import console, print_json, wants_json

    example = find(name)
    if backend is None:
        backend = backends.default()
        if backend != "ros2":
            instead = "the simulator" if backend == "sim" else backend
            click.echo(f"ROS 2 cannot be imported here, so this runs on {instead}.", err=True)
    out = Console(quiet=True) if wants_json() else console()
    try:
        outcomes = asyncio.run(run_demo(example, backend, out))
    except asyncio.CancelledError:
        click.echo("\nInterrupted; everything that was started has ended.", err=True)
        return INTERRUPTED
    if wants_json():
        acts = [{"name": act.name, **outcome} for act, outcome in zip(example.acts, outcomes, strict=False)]
        print_json(
            {**outcomes[0], "outcome": outcomes[-1]["outcome"], "example": name, "backend": backend, "acts": acts}
        )
    return 0 if outcomes[-1]["outcome"] == "done" else 1

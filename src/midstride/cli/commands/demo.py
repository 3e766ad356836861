"""``demo``: an example from start to finish."""

from __future__ import annotations

import asyncio

import click

from midstride import backends
from midstride.backends import NAMES
from midstride.cli import completion
from midstride.cli.demo_runner import run_demo
from midstride.cli.example import find
from midstride.cli.output import INTERRUPTED, console, json_option, print_json, wants_json


@click.command("demo")
@click.argument("name", default="talker", shell_complete=completion.examples)
@click.option(
    "--backend",
    type=click.Choice(NAMES),
    envvar="MIDSTRIDE_BACKEND",
    show_envvar=True,
    help="The platform; by default ros2 where it is available, else sim.",
)
@json_option
def demo_command(name: str, backend: str | None) -> int:
    """Run the example NAME (talker, obstacle or filter): its plans, each step, and the measurements.

    It stops every process that it has started, even if it is interrupted or killed.
    """
    from rich.console import Console

    example = find(name)
    if backend is None:
        backend = backends.default()
        if backend != "ros2":
            fallback = "the simulator" if backend == "sim" else backend
            click.echo(f"ROS 2 is not available; running on {fallback}.", err=True)
    out = Console(quiet=True) if wants_json() else console()
    try:
        outcomes = asyncio.run(run_demo(example, backend, out))
    except asyncio.CancelledError:
        click.echo("\nInterrupted; all processes have been stopped.", err=True)
        return INTERRUPTED
    if wants_json():
        acts = [{"name": step.name, **outcome} for step, outcome in zip(example.steps, outcomes, strict=False)]
        print_json(
            {**outcomes[0], "outcome": outcomes[-1]["outcome"], "example": name, "backend": backend, "acts": acts}
        )
    return 0 if outcomes[-1]["outcome"] == "done" else 1

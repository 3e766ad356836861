"""``demo``: an example from start to finish."""

from __future__ import annotations

import asyncio
import runpy
from dataclasses import replace

import click

from midstride import backends
from midstride.backends import NAMES
from midstride.cli import shell_completion
from midstride.cli.demo_runner import run_demo
from midstride.cli.example import find, matching
from midstride.cli.output import INTERRUPTED, console, json_option, print_json, wants_json


@click.command("demo")
@click.argument("name", default="talker", shell_complete=shell_completion.examples)
@click.option(
    "--backend",
    type=click.Choice(NAMES),
    envvar="MIDSTRIDE_BACKEND",
    show_envvar=True,
    help="The platform; by default ros2 where it is available, else sim.",
)
@click.option("--only", multiple=True, metavar="TEXT", help="Only the steps with TEXT in their name (repeatable).")
@json_option
def demo_command(name: str, backend: str | None, only: tuple[str, ...]) -> int:
    """Run the example NAME: its plans, each step, and the measurements.

    `talker`, `obstacle` and `filter` take seconds. `patrol` takes two minutes: it shows a map of a robot while its
    software is replaced, dies and hangs, and a table of what that came to; `--only dies` has it do a part of that.

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
    if example.program is None:
        names = matching([step.name for step in example.steps], only)
        example = replace(example, steps=tuple(step for step in example.steps if step.name in names))
        run = run_demo(example, backend, out)
    else:
        run = runpy.run_path(str(example.program))["run"](example, backend, out, only)
    try:
        outcomes = backends.run(backend, run)
    except asyncio.CancelledError:
        click.echo("\nInterrupted; all processes have been stopped.", err=True)
        return INTERRUPTED
    if wants_json():
        names = (
            [step.name for step in example.steps] if example.program is None else [each["name"] for each in outcomes]
        )
        acts = [{"name": name, **outcome} for name, outcome in zip(names, outcomes, strict=False)]
        print_json(
            {**outcomes[0], "outcome": outcomes[-1]["outcome"], "example": name, "backend": backend, "acts": acts}
        )
    return 0 if outcomes[-1]["outcome"] == "done" else 1

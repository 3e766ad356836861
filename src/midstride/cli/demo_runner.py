"""Runs an example from start to finish: up, each change with its plan, steps and measurements, and down."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from midstride.backends.simulator import Simulator
from midstride.cli import render
from midstride.cli.demo_environment import DemoEnvironment, demo_environment
from midstride.cli.example import Demo, DemoStep
from midstride.cli.log_excerpt import LogFollower, excerpt
from midstride.cli.progress import Progress
from midstride.codec.form import Document, encode
from midstride.model.instance_names import log_file_name
from midstride.plan.forms.plan_forms import plan_form
from midstride.runtime.records.reports import Outcome

# How often the latest log line of the subscriber is shown (s).
LOG_INTERVAL: Final = 0.1
# How long the system runs before the first step (s), so that the subscriber has received messages before.
RUN_IN: Final = 1.0


async def run_demo(example: Demo, backend: str, out: Console) -> list[Document]:
    """Run an example; the outcome of each step, as `replace --json` prints it. Stops at the first step that fails.

    Raises MidstrideError if the system does not come up, CancelledError on SIGINT and SIGTERM. Every process that
    it started has ended when this returns or raises.
    """
    with cancelled_by_signals() as interrupted:
        async with demo_environment(example, backend) as environment:
            out.print(f"[bold]{escape(example.title)}[/bold]  [dim](examples/{example.name}, on {backend})[/dim]")
            async with _progress(environment, example, out):
                await environment.manager.up()
                await environment.backend.clock.sleep(RUN_IN)
            outcomes: list[Outcome] = []
            for step in example.steps:
                outcomes.append(await _run_step(environment, example, step, out))
                if interrupted.is_set():  # while it measured, which completes a change
                    raise asyncio.CancelledError
                if outcomes[-1].outcome != "done":
                    break
            out.print("\n[bold]Side by side[/bold]")
            out.print(_comparison(example, outcomes))
            return [encode(outcome) for outcome in outcomes]


async def _run_step(environment: DemoEnvironment, example: Demo, step: DemoStep, out: Console) -> Outcome:
    out.print(f"\n[bold]{escape(step.name)}[/bold]  {escape(step.summary)}")
    plan = await environment.manager.plan(step.request)
    out.print(render.plan(plan_form(plan), "Plan"))
    async with _progress(environment, example, out) as log:
        outcome = await environment.manager.change(step.request)
    out.print(render.outcome(outcome))
    if lines := excerpt(log.new_lines()):
        out.print(Text(f"Log of {example.subscriber} during the change:", style="dim"))
    for line in lines:
        out.print(Text(f"  {line or '…'}", style="cyan" if line else "dim"))
    for component in (await environment.manager.status()).instances:
        for row in component.functionalities:
            if not row.normal:
                out.print(Text(f"{component.name}.{row.name} is now in mode {row.mode}.", style="yellow"))
    return outcome


@asynccontextmanager
async def _progress(environment: DemoEnvironment, example: Demo, out: Console) -> AsyncIterator[LogFollower]:
    """While inside, shows the manager's events as they come, and the latest log line of the subscriber."""
    log, latest = (LogFollower(_reader(environment, example.subscriber)) for _ in range(2))
    log.new_lines()
    past = environment.manager.log()
    stream = environment.manager.subscribe(past[-1].n if past else 0)
    with Progress(out) as progress:

        async def show_events() -> None:
            async for event in stream:
                progress.show(event)

        async def show_log() -> None:
            while True:
                if lines := latest.new_lines():
                    progress.set_note(f"{example.subscriber}: {lines[-1].text}")
                await asyncio.sleep(LOG_INTERVAL)

        tasks = [asyncio.ensure_future(show_events()), asyncio.ensure_future(show_log())]
        try:
            yield log
            await asyncio.sleep(0)  # show the events so far
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def _reader(environment: DemoEnvironment, instance: str) -> Callable[[], str]:
    """A function that returns the log of a component. A simulated one keeps it in memory until it exits."""
    backend = environment.backend
    if isinstance(backend, Simulator):
        return lambda: backend.log(instance) if instance in backend.processes else ""
    file = environment.workspace.logs / log_file_name(instance)
    return lambda: file.read_text(encoding="utf-8", errors="replace") if file.exists() else ""


def _comparison(example: Demo, outcomes: list[Outcome]) -> Table:
    table = render.table(["", "degraded for"], render.MEASUREMENTS)
    for step, outcome in zip(example.steps, outcomes, strict=False):
        for swap in (*outcome.swaps,) or (None,):
            measured = ["–"] * len(render.MEASUREMENTS) if swap is None else render.measurements(swap)
            table.add_row(step.name, render.fallen_line(outcome), *measured)
    return table


@contextmanager
def cancelled_by_signals() -> Iterator[asyncio.Event]:
    """The first signal sets the event and cancels this task. Later ones are ignored: the demo is already stopping."""
    loop, task, interrupted = asyncio.get_running_loop(), asyncio.current_task(), asyncio.Event()
    assert task is not None
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def interrupt() -> None:
        if not interrupted.is_set():
            interrupted.set()
            task.cancel()

    for number in numbers:
        loop.add_signal_handler(number, interrupt)
    try:
        yield interrupted
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)

"""Runs an example from start to finish: up, each change with its plan, steps and measurements, and down."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from midstride.backends.simulator import Simulator
from midstride.cli import render
from midstride.cli.demo_environment import DemoEnvironment, demo_environment
from midstride.cli.example import Demo, DemoStep
from midstride.cli.log_excerpt import LogFile, LogFollower, LogLine, excerpt
from midstride.cli.progress import Progress
from midstride.codec.form import encode
from midstride.plan.forms import encode_plan

Document = dict[str, Any]
# How often the latest log line of the subscriber is shown (s).
LOG_INTERVAL = 0.1


# How long the system runs before the first act (s): what is replaced then has been heard before.
RUN_IN: Final = 1.0


async def run_demo(example: Demo, backend: str, out: Console) -> list[Document]:
    """Run an example; the outcome of each step, as `replace --json` prints it. Stops at the first step that fails.

    Raises MidstrideError where the system does not come up, CancelledError on SIGINT and SIGTERM. Every process that
    it started has ended when this returns or raises.
    """
    with demo_environment(example, backend) as environment, _cancelled_by_signals():
        try:
            out.print(f"[bold]{escape(example.title)}[/bold]  [dim](examples/{example.name}, on {backend})[/dim]")
            async with _progress(environment, example, out):
                await environment.manager.up()
                await environment.backend.clock.sleep(RUN_IN)
            outcomes: list[Document] = []
            for step in example.steps:
                outcomes.append(await _run_step(environment, example, step, out))
                if outcomes[-1]["outcome"] != "done":
                    break
            out.print("\n[bold]Side by side[/bold]")
            out.print(_comparison(example, outcomes))
            return outcomes
        finally:
            await _shut_down(environment)


async def _run_step(environment: DemoEnvironment, example: Demo, step: DemoStep, out: Console) -> Document:
    out.print(f"\n[bold]{escape(step.name)}[/bold]  {escape(step.summary)}")
    plan = await environment.manager.plan(step.request)
    out.print(render.plan(encode_plan(plan), "Plan"))
    async with _progress(environment, example, out) as log:
        outcome = encode(await environment.manager.change(step.request))
    out.print(render.outcome(outcome))
    _print_excerpt(example.subscriber, excerpt(log.new_lines()), out)
    for line in _degraded(encode(await environment.manager.status())):
        out.print(line)
    return outcome


@asynccontextmanager
async def _progress(environment: DemoEnvironment, example: Demo, out: Console) -> AsyncIterator[LogFollower]:
    """While inside, shows the manager's events as they come, and the latest log line of the subscriber."""
    log, latest = (LogFollower(_log_of(environment, example)) for _ in range(2))
    log.new_lines()
    past = environment.manager.log()
    stream = environment.manager.subscribe(past[-1].n if past else 0)
    with Progress(out) as progress:

        async def show_events() -> None:
            async for event in stream:
                progress.show(encode(event))

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


class _SimulatedLog:
    """The output of a simulated component, which is in memory and ends with the component."""

    def __init__(self, simulator: Simulator, instance: str) -> None:
        self._simulator, self._instance = simulator, instance

    def read(self) -> str:
        return self._simulator.log(self._instance) if self._instance in self._simulator.processes else ""


def _log_of(environment: DemoEnvironment, example: Demo) -> LogFile | _SimulatedLog:
    if isinstance(environment.backend, Simulator):
        return _SimulatedLog(environment.backend, example.subscriber)
    return LogFile(environment.workspace.logs / f"{example.subscriber}.log")


def _print_excerpt(name: str, lines: list[LogLine | None], out: Console) -> None:
    if lines:
        out.print(Text(f"Log of {name} during the change:", style="dim"))
    for line in lines:
        out.print(Text(f"  {line or '…'}", style="cyan" if line else "dim"))


def _degraded(status: Document) -> Iterator[Text]:
    """The functionalities that are not in their normal mode now."""
    for component in status["components"]:
        for row in component["functionalities"]:
            if not row["normal"]:
                yield Text(f"{row['name']} is now in mode {row['mode']}.", style="yellow")


def _comparison(example: Demo, outcomes: list[Document]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("", "degraded for"):
        table.add_column(name)
    for name in ("longest gap", "in periods", "missed", "lost", "duplicates"):
        table.add_column(name, justify="right")
    for step, outcome in zip(example.steps, outcomes, strict=False):
        rows: list[Document] = outcome["swaps"] or [{}]
        for swap in rows:
            table.add_row(step.name, render.fallen_line(outcome), *_measurements(swap))
    return table


def _measurements(swap: Document) -> list[str]:
    if not swap:
        return ["–"] * 5
    periods = swap["gap_periods"]
    counts = [swap[name] for name in ("missed", "lost", "duplicates")]
    cells = [render.UNKNOWN if count is None else str(count) for count in counts]
    return [render.seconds(swap["gap"]), render.UNKNOWN if periods is None else f"{periods:.2f}", *cells]


async def _shut_down(environment: DemoEnvironment) -> None:
    """Stop the components in order, and the simulator's threads."""
    try:
        await environment.manager.down()
    finally:
        await environment.manager.close()
        if isinstance(environment.backend, Simulator):
            await environment.backend.shutdown()


@contextmanager
def _cancelled_by_signals() -> Iterator[None]:
    """The first signal cancels this task; later ones are ignored, since the demo is already stopping."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    cancelled = False

    def cancel() -> None:
        nonlocal cancelled
        if not cancelled:
            cancelled = True
            task.cancel()

    for number in numbers:
        loop.add_signal_handler(number, cancel)
    try:
        yield
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)

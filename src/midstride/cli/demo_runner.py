"""An example from beginning to end: up, each of its acts with its plan, its steps and its measure, and down."""

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
# How often the newest word of the component that is listened to is shown (s).
ASIDE = 0.1


# How long the system runs before the first act (s): what is replaced then has been heard before.
RUN_IN: Final = 1.0


async def run_demo(example: Demo, backend: str, out: Console) -> list[Document]:
    """Play an example; what came of each act, as `replace --json` prints it. Stops at the first act that fails.

    Raises MidstrideError where the system does not come up, CancelledError on SIGINT and SIGTERM; in any
    case everything that was started has ended when this returns.
    """
    with demo_environment(example, backend) as scene, _cancelled_by_signals():
        try:
            out.print(f"[bold]{escape(example.title)}[/bold]  [dim](examples/{example.name}, on {backend})[/dim]")
            async with _shown(scene, example, out):
                await scene.manager.up()
                await scene.backend.clock.sleep(RUN_IN)
            outcomes: list[Document] = []
            for act in example.acts:
                outcomes.append(await _act(scene, example, act, out))
                if outcomes[-1]["outcome"] != "done":
                    break
            out.print("\n[bold]Side by side[/bold]")
            out.print(_side_by_side(example, outcomes))
            return outcomes
        finally:
            await _end(scene)


async def _act(scene: DemoEnvironment, example: Demo, act: DemoStep, out: Console) -> Document:
    out.print(f"\n[bold]{escape(act.name)}[/bold]  {escape(act.says)}")
    plan = await scene.manager.plan(act.request)
    out.print(render.plan(encode_plan(plan), "The plan"))
    async with _shown(scene, example, out) as listening:
        answer = encode(await scene.manager.change(act.request))
    out.print(render.outcome(answer))
    _print_excerpt(example.listen_to, excerpt(listening.new()), out)
    for line in _standing(encode(await scene.manager.status())):
        out.print(line)
    return answer


@asynccontextmanager
async def _shown(scene: DemoEnvironment, example: Demo, out: Console) -> AsyncIterator[LogFollower]:
    """While inside: the events of the manager as they come, and the newest word of who is listened to."""
    listening, beside = (LogFollower(_log_of(scene, example)) for _ in range(2))
    listening.new()
    log = scene.manager.log()
    stream = scene.manager.subscribe(log[-1].n if log else 0)
    with Progress(out) as progress:

        async def events() -> None:
            async for event in stream:
                progress.show(encode(event))

        async def aside() -> None:
            while True:
                if said := beside.new():
                    progress.aside(f"{example.listen_to}: {said[-1].words}")
                await asyncio.sleep(ASIDE)

        tasks = [asyncio.ensure_future(events()), asyncio.ensure_future(aside())]
        try:
            yield listening
            await asyncio.sleep(0)  # what has happened by now is shown
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


class _SimulatedLog:
    """The output of a simulated component. It is kept in memory, and gone with it."""

    def __init__(self, simulator: Simulator, instance: str) -> None:
        self._simulator, self._instance = simulator, instance

    def read(self) -> str:
        return self._simulator.log(self._instance) if self._instance in self._simulator.processes else ""


def _log_of(scene: DemoEnvironment, example: Demo) -> LogFile | _SimulatedLog:
    if isinstance(scene.backend, Simulator):
        return _SimulatedLog(scene.backend, example.listen_to)
    return LogFile(scene.workspace.logs / f"{example.listen_to}.log")


def _print_excerpt(who: str, said: list[LogLine | None], out: Console) -> None:
    if said:
        out.print(Text(f"{who} said meanwhile:", style="dim"))
    for line in said:
        out.print(Text(f"  {line or '…'}", style="cyan" if line else "dim"))


def _standing(status: Document) -> Iterator[Text]:
    """The functionalities that are not in their normal mode now."""
    for component in status["components"]:
        for row in component["functionalities"]:
            if not row["normal"]:
                yield Text(f"Now {row['name']} is in mode {row['mode']}.", style="yellow")


def _side_by_side(example: Demo, outcomes: list[Document]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("", "fell, and for how long"):
        table.add_column(name)
    for name in ("longest gap", "in periods", "missed", "lost", "duplicates"):
        table.add_column(name, justify="right")
    for act, outcome in zip(example.acts, outcomes, strict=False):
        rows: list[Document] = outcome["swaps"] or [{}]
        for swap in rows:
            table.add_row(act.name, render.fell(outcome), *_figures(swap))
    return table


def _figures(swap: Document) -> list[str]:
    if not swap:
        return ["–"] * 5
    periods = swap["gap_periods"]
    counts = [swap[name] for name in ("missed", "lost", "duplicates")]
    told = [render.UNKNOWN if count is None else str(count) for count in counts]
    return [render.seconds(swap["gap"]), render.UNKNOWN if periods is None else f"{periods:.2f}", *told]


async def _end(scene: DemoEnvironment) -> None:
    """End the components in order; the simulator's threads with them."""
    try:
        await scene.manager.down()
    finally:
        await scene.manager.close()
        if isinstance(scene.backend, Simulator):
            await scene.backend.shutdown()


@contextmanager
def _cancelled_by_signals() -> Iterator[None]:
    """The first Ctrl-C or SIGTERM cancels this task; further ones are ignored, since the end is on its way."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    came = False

    def cancel() -> None:
        nonlocal came
        if not came:
            came = True
            task.cancel()

    for number in numbers:
        loop.add_signal_handler(number, cancel)
    try:
        yield
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)

"""What the steps of one replacement cost the manager among 10, 100 and 1,000 nodes, on the simulator.

The same source is replaced, under the same sink; all other nodes are idle. For each step: the processor time of the
manager's own work (its tasks alone, neither the components' nor the reading of what they report twice a second), and
the statements and bytes that the state store writes. What a change costs before its first step and after its last is
shown as well, and so is what one report of a component costs.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import shutil
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Coroutine, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from _control_plane_worker import HERE, specification

from midstride.backends.simulator import Simulator
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace

SIZES = (10, 100, 1000)
BEFORE, AFTER = "before the first step", "after the last step"
LIMIT_RATIO = 2.0  # caches are colder among many; what is linear in the nodes is 100 times as long


def among(nodes: int) -> Any:
    """A source, a sink, and idle nodes in a chain."""
    idle = nodes - 2
    lines = ["topic /ticks : Ticks", "node source : Source { out -> /ticks }", "node sink : Sink { in <- /ticks }"]
    lines += [f"topic /t{index} : Text" for index in range(idle)]
    lines += ["node n0 : Head { out -> /t0 }"]
    lines += [f"node n{i} : Link {{ in <- /t{i - 1}\n out -> /t{i} }}" for i in range(1, idle)]
    return specification("\n".join(lines))


@dataclass
class Spent:
    """What the manager has spent so far: seconds of work, of reading reports, statements, bytes."""

    work: float = 0.0
    reports: float = 0.0
    read: int = 0
    statements: int = 0
    written: int = 0

    def minus(self, other: Spent) -> Spent:
        return Spent(*(getattr(self, name) - getattr(other, name) for name in self.__dataclass_fields__))


@dataclass
class Meter:
    """Counts what the tasks of the manager do; they are known by the module of their coroutine."""

    spent: Spent = field(default_factory=Spent)
    # What runs now, and since when (s).
    running: str | None = None
    since: float = 0.0

    def task(self, loop: asyncio.AbstractEventLoop, coroutine: Any, **options: Any) -> Any:
        code = getattr(coroutine, "cr_code", None)
        file = "" if code is None else code.co_filename
        if "/midstride/runtime/" in file:
            coroutine = self._timed(coroutine, "work")
        elif code is not None and file.endswith("/wire/channel.py"):
            coroutine = self._timed(coroutine, "reports" if code.co_name == "_read" else "work")
        return asyncio.Task(coroutine, loop=loop, **options)

    async def _timed(self, coroutine: Coroutine[Any, Any, Any], kind: str) -> Any:
        return await _Timed(self, coroutine, kind)

    def watch(self, store: Any) -> None:
        """Count the statements of a state store, and the bytes of its pages."""
        database: sqlite3.Connection = store._open()
        database.execute("PRAGMA wal_autocheckpoint = 0")  # so that the log grows by what is written
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.set_trace_callback(self._statement)
        self._log = Path(f"{store.path}-wal")

    def _statement(self, words: str) -> None:
        if words.split(" ", 1)[0] in ("INSERT", "DELETE", "UPDATE"):
            self.spent.statements += 1

    def count(self) -> None:
        """Add the time of what runs now, up to now."""
        now = time.thread_time()
        if self.running is not None:
            setattr(self.spent, self.running, getattr(self.spent, self.running) + now - self.since)
        self.since = now

    def snapshot(self) -> Spent:
        self.count()
        self.spent.written = self._log.stat().st_size
        return Spent(**self.spent.__dict__)


class _Timed:
    """Awaits a coroutine, and adds up the time in which it runs."""

    def __init__(self, meter: Meter, coroutine: Coroutine[Any, Any, Any], kind: str) -> None:
        self._meter, self._coroutine, self._kind = meter, coroutine, kind

    def __await__(self) -> Generator[Any, Any, Any]:
        value: Any = None
        error: BaseException | None = None
        while True:
            meter = self._meter
            meter.count()
            meter.running = self._kind
            try:
                waiting = self._coroutine.send(value) if error is None else self._coroutine.throw(error)
            except StopIteration as stop:
                return stop.value
            finally:
                meter.count()
                meter.running = None
                meter.spent.read += self._kind == "reports"
            value, error = None, None
            try:
                value = yield waiting
            except BaseException as raised:
                error = raised


async def replaced(manager: Manager, meter: Meter, component: str) -> tuple[dict[str, Spent], Spent]:
    """What each step of one replacement took, by its words; and the whole change."""
    found: dict[str, Spent] = {}
    current: list[str] = []
    marks = [meter.snapshot()]
    add = manager.events.add

    def marking(kind: str, words: str, **details: Any) -> Any:
        if kind in ("step", "step_done"):
            now = meter.snapshot()
            if kind == "step":
                current.append(words.split(" ", 1)[1])
                if len(current) == 1:
                    found[BEFORE] = now.minus(marks[-1])
            else:
                kind = "hand over" if current[-1].startswith("hand") else current[-1].split(" ")[0]
                found[f"{len(current)}. {kind}"] = now.minus(marks[-1])
            marks.append(now)
        return add(kind, words, **details)

    manager.events.add = marking  # type: ignore[method-assign]
    first = marks[0]
    try:
        outcome = await asyncio.create_task(manager.change(PlanRequest(replace=(("source", component),))))
    finally:
        manager.events.add = add  # type: ignore[method-assign]
    if outcome.outcome != "done":
        raise SystemExit(f"{outcome.outcome}: {outcome.because}")
    last = meter.snapshot()
    found[AFTER] = last.minus(marks[-1])
    return found, last.minus(first)


async def measure(simulator: Simulator, nodes: int, times: int) -> dict[str, list[Spent]]:
    meter = Meter()
    asyncio.get_running_loop().set_task_factory(meter.task)
    folder = Path(tempfile.mkdtemp(prefix="ms"))
    manager = Manager(among(nodes), simulator, Workspace(folder), HERE)
    rows: dict[str, list[Spent]] = {}
    try:
        begun = time.perf_counter()
        await manager.up()
        print(f"{nodes} nodes: up in {time.perf_counter() - begun:.1f} s of real time", file=sys.stderr, flush=True)
        meter.watch(manager._store)
        gc.collect()
        gc.freeze()
        for turn in range(times + 1):
            steps, whole = await replaced(manager, meter, ("OtherSource", "Source")[turn % 2])
            if turn:  # the first is not warm
                for name, spent in {**steps, "whole change": whole}.items():
                    rows.setdefault(name, []).append(spent)
    finally:
        await manager.close()
        shutil.rmtree(folder)
    return rows


def milliseconds(rows: list[Spent]) -> float:
    return 1000 * statistics.median(each.work for each in rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--times", type=int, default=20, help="replacements of each size")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "steps.json")
    options = parser.parse_args()
    found: dict[int, dict[str, list[Spent]]] = {}
    for size in options.sizes:
        simulator = Simulator()
        found[size] = simulator.run(measure(simulator, size, options.times))
    sizes = list(found)
    heads = "".join(f"{f'{size:,} nodes':>32}" for size in sizes)
    print(f"{'manager, ms / statements / bytes':<34}{heads}{'ratio':>8}")
    ratios: dict[str, float] = {}
    for name, smallest in found[sizes[0]].items():
        line = f"{name:<34}"
        for size in sizes:
            rows = found[size][name]
            statements, written = (statistics.median(getattr(r, n) for r in rows) for n in ("statements", "written"))
            line += f"{f'{milliseconds(rows):.3f} / {statements:g} / {written:,.0f}':>32}"
        ratios[name] = milliseconds(found[sizes[-1]][name]) / milliseconds(smallest)
        print(f"{line}{ratios[name]:>8.2f}")
    per_report = {
        size: 1e6 * sum(r.reports for r in rows["whole change"]) / max(1, sum(r.read for r in rows["whole change"]))
        for size, rows in found.items()
    }
    print(f"{'one frame from a component, µs':<34}" + "".join(f"{value:>32.1f}" for value in per_report.values()))
    options.out.parent.mkdir(exist_ok=True)
    document = {
        "steps": {
            size: {name: [each.__dict__ for each in rows] for name, rows in steps.items()}
            for size, steps in found.items()
        },
        "ratios": ratios,
        "report_microseconds": per_report,
    }
    options.out.write_text(json.dumps(document, indent=1) + "\n")
    steps = {name: ratio for name, ratio in ratios.items() if name[0].isdigit()}
    same = max(steps.values()) <= LIMIT_RATIO
    print(f"every step costs the same at any size, within a factor of {LIMIT_RATIO:g}: {'yes' if same else 'NO'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())

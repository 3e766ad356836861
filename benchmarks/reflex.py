"""How soon the dependants of a publisher at 50 Hz are in their safe mode after it fails, on real ROS 2.

A chain of four components, ``a`` to ``d``, each relying on the one before. ``a`` crashes (kill -9), hangs in its code,
is stopped (SIGSTOP), or writes every fifth message, with a manager and without one; the time is from the fault to the
entry of each degraded mode. Then the system is restored by a plan. Beside it, in the same runs, a bare publisher with
the same fault, and a bare subscriber with a heartbeat of 4 s (as Nav2's bond), a deadline of 1 s, and a watchdog that a
careful author would write. ``--healthy SECONDS`` runs without a fault, and counts false alarms.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from _guard import guard
from _reflex_nodes import BOND_TIMEOUT, RATE, TOLERATED

HERE = Path(__file__).resolve().parent
NODES = HERE / "_reflex_nodes.py"
CHAIN = ("a", "b", "c", "d")
FAULTS = ("crash", "hang", "stop", "slow")
REMEDIES = {"heartbeat, 4 s": "bond", "DDS deadline, 1 s": "deadline", "watchdog, 1 s": "watchdog"}
# How long after a fault it is watched (s): a chain without a manager takes three times the slowest window.
WATCHED = {"crash": 5.5, "hang": 5.5, "stop": 5.5, "slow": 8.5}


def specification(folder: Path, rate: float = RATE, tolerated: float = TOLERATED) -> str:
    stages = "\n".join(
        f"topic /{name} : Text\nnode {name} : Stage {{ in <- /{before}   out -> /{name} }}"
        for before, name in pairwise(CHAIN)
    )
    return f"""
system reflex_benchmark
contract Text = std_msgs/msg/String @ {rate:g} Hz
topic /a : Text
component Source {{
  run "python3 {NODES} source {folder}"
  output out
  functionality work {{ produces out   mode normal {{ guarantee out : Text }}   mode degraded {{ }} }}
}}
component Stage {{
  run "python3 {NODES} stage {folder}"
  input in : Text tolerates {tolerated * rate - 1:.0f} missed
  output out
  functionality work {{
    uses in   produces out
    mode normal {{ assume in   guarantee out : Text }}
    mode degraded {{ }}
  }}
}}
node a : Source {{ out -> /a }}
{stages}
"""


@dataclass
class Falls:
    """When each of the names fell, as the nodes have written down."""

    folder: Path

    def since(self, name: str, begun: int) -> float | None:
        """How long after ``begun`` (steady ns) it first fell (s)."""
        path = self.folder / f"{name}.fell"
        times = [int(line) for line in path.read_text().split()] if path.exists() else []
        return next(((at - begun) / 1e9 for at in times if at > begun), None)

    def count(self, name: str) -> int:
        path = self.folder / f"{name}.fell"
        return len(path.read_text().split()) if path.exists() else 0


@dataclass
class Bare:
    """The bare publisher and its subscriber."""

    folder: Path
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, *names: str) -> None:
        for name in names:
            self.processes[name] = subprocess.Popen([sys.executable, str(NODES), name, str(self.folder)])

    def close(self) -> None:
        for process in self.processes.values():
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


@dataclass
class Runs:
    """Seconds to the safe mode, by fault, manager and who fell; None where it did not."""

    found: dict[tuple[str, str, str], list[float | None]] = field(default_factory=dict)

    def add(self, fault: str, manager: str, name: str, seconds: float | None) -> None:
        self.found.setdefault((fault, manager, name), []).append(seconds)


class System:
    """The chain, with a manager in this process. A manager that is closed is as good as dead to the components."""

    def __init__(self, folder: Path, text: str = "") -> None:
        """``text``: another specification of the chain."""
        from midstride.lang import load

        self.folder = folder
        file = folder / "reflex.stride"
        file.write_text(text or specification(folder))
        self.specification = load(file).require()
        self.manager: Any = None

    async def up(self) -> None:
        from midstride import backends
        from midstride.runtime.manager import Manager
        from midstride.runtime.workspace import Workspace

        (self.folder / "system").mkdir(mode=0o700, exist_ok=True)
        workspace = Workspace(self.folder / "system")
        self.manager = Manager(self.specification, backends.make("ros2", workspace), workspace, self.folder)
        await self.manager.up()

    async def close(self) -> None:
        await self.manager.close()
        self.manager = None

    async def restored(self) -> None:
        """All four in their normal modes, and messages flow."""
        from midstride.plan.request import PlanRequest

        deadline = time.monotonic() + 60
        while True:
            await self.manager.change(PlanRequest(to=self.specification))
            await asyncio.sleep(2.0)
            status = await self.manager.status()
            modes = [each.mode for component in status.instances for each in component.functionalities]
            if modes == ["normal"] * 4 and status.valid:
                return
            if time.monotonic() > deadline:
                raise SystemExit(f"not restored: {status}")

    async def pid(self) -> int:
        (found,) = (each.pid for each in (await self.manager.status()).instances if each.role == "a")
        return int(found)


async def one_run(system: System, bare: Bare, falls: Falls, runs: Runs, fault: str, manager: str) -> None:
    await system.restored()
    pid, speaker = await system.pid(), bare.processes["speaker"]
    if manager == "dead":
        await system.close()
        await asyncio.sleep(0.5)
    flag = falls.folder / {"hang": "hung", "slow": "slow"}.get(fault, "")
    begun = time.monotonic_ns()
    if fault in ("hang", "slow"):
        flag.touch()
    else:
        for each in (pid, speaker.pid):
            os.kill(each, signal.SIGKILL if fault == "crash" else signal.SIGSTOP)
    await asyncio.sleep(WATCHED[fault])
    if fault in ("hang", "slow"):
        flag.unlink()
    elif fault == "stop":
        for each in (pid, speaker.pid):
            os.kill(each, signal.SIGCONT)
    else:
        speaker.wait()
        bare.start("speaker")
    for name in CHAIN[1:]:
        runs.add(fault, manager, name, falls.since(name, begun))
    for words, name in REMEDIES.items():
        runs.add(fault, manager, words, falls.since(name, begun))
    if system.manager is None:
        await system.up()


def table(runs: Runs) -> list[dict[str, Any]]:
    print(f"{'fault':<8}{'manager':<9}{'':<20}{'runs':>6}{'fell':>6}{'p50':>9}{'p99':>9}{'longest':>9}   (s)")
    rows = []
    for (fault, manager, name), seconds in runs.found.items():
        fell = sorted(each for each in seconds if each is not None)
        p99 = statistics.quantiles(fell, n=100, method="inclusive")[98] if len(fell) > 1 else max(fell, default=None)
        figures = [statistics.median(fell) if fell else None, p99, fell[-1] if fell else None]
        shown = "".join("    never" if figure is None else f"{figure:>9.3f}" for figure in figures)
        print(f"{fault:<8}{manager:<9}{name:<20}{len(seconds):>6}{len(fell):>6}{shown}")
        keys = dict(zip(("p50", "p99", "longest"), figures, strict=True))
        rows.append({"fault": fault, "manager": manager, "who": name, "runs": len(seconds), "fell": len(fell), **keys})
    return rows


def processor_time() -> tuple[float, float]:
    """How long the processors have been idle, and all together, since the machine was started."""
    ticks = [float(each) for each in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return ticks[3] + ticks[4], sum(ticks)


async def healthy(system: System, falls: Falls, seconds: float, nice: int, count: int) -> list[dict[str, Any]]:
    """Every processor busy, and no fault. ``nice``: the niceness of the ``count`` busy processes."""
    await system.restored()
    names = {**{name: name for name in CHAIN[1:]}, **REMEDIES}
    before = {words: falls.count(name) for words, name in names.items()}
    burn = ["nice", "-n", str(nice), sys.executable, "-c", "while True: pass"]
    burners = [subprocess.Popen(burn) for _ in range(count)]
    idle, total = processor_time()
    try:
        await asyncio.sleep(seconds)
        idle, total = (after - before for after, before in zip(processor_time(), (idle, total), strict=True))
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    rows = []
    print(f"{seconds:g} s without a fault, {count} busy processes, processors idle for {idle / total:.1%} of it")
    for words, name in names.items():
        rows.append({"who": words, "seconds": seconds, "false": falls.count(name) - before[words]})
        print(f"{words:<20}{rows[-1]['false']:>4} false alarms")
    for component in (await system.manager.status()).instances:
        for each in component.functionalities:
            if not each.normal:
                print(f"{component.name}.{each.name}: {each.because}")
    return rows


async def measure(
    folder: Path, count: int, faults: list[str], managers: list[str], seconds: float, nice: int = 0, busy: int = 4
) -> Any:
    falls, runs, bare, system = Falls(folder), Runs(), Bare(folder), System(folder)
    bare.start("speaker", "reader")
    try:
        await system.up()
        for _ in range(count):
            for fault in faults:
                for manager in managers:
                    await one_run(system, bare, falls, runs, fault, manager)
        rows = table(runs)
        return rows + (await healthy(system, falls, seconds, nice, busy) if seconds else [])
    finally:
        bare.close()
        for flag in ("hung", "slow"):
            (folder / flag).unlink(missing_ok=True)
        if system.manager is None:
            await system.up()
        await system.manager.down()
        await system.manager.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=int(os.environ.get("MIDSTRIDE_REFLEX_RUNS", "10")))
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--managers", nargs="+", choices=("alive", "dead"), default=["alive", "dead"])
    parser.add_argument("--healthy", type=float, default=60.0, metavar="SECONDS")
    parser.add_argument("--nice", type=int, default=0, help="the niceness of the busy processes of --healthy")
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 2), help="how many busy processes")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "reflex.json")
    options = parser.parse_args()
    guard()
    from _tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "87")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    print(f"silence is tolerated for {TOLERATED:g} s, a missing heartbeat for {BOND_TIMEOUT:g} s\n")
    with tempfile.TemporaryDirectory() as folder:
        wanted = (options.runs, options.faults, options.managers, options.healthy, options.nice, options.busy)
        rows = asyncio.run(measure(Path(folder), *wanted))
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

"""Many components on ROS 2 in one domain, beside as many bare rclpy nodes: up, idle, a replacement, down.

The bare nodes have the endpoints of the components and the discovery settings of `midstride up`, and are started at the
same pace, or all at once; `ros-settings` are started at once with ROS's own settings on one host. Instead of a
replacement, one more node joins until it is matched. All figures of a row are of one run; the replacement is that of a
source at 50 Hz. Idle time and memory leave that source and its sink out. For `up` alone, each way in turns:

    python benchmarks/many.py --nodes 30 --kinds spares bare at-once ros-settings --idle 0 --replacements 0 --rounds 5

A replacement that uses a spare has another one join, which the others take seconds to discover where they are many.
`--rest S` leaves them that time before the next.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import _control_plane_worker as worker
from _guard import guard

HERE = Path(__file__).resolve().parent
FEW = 10
KINDS = ("spares", "components", "bare", "at-once", "ros-settings")
# How long after `up` the idle time begins (s): until then the middleware acknowledges what it has discovered.
SETTLE = 15.0

Figures = dict[str, float]


def system(nodes: int) -> Any:
    """A source at 50 Hz and a sink, and a chain of the others, which are idle."""
    topics = [f"topic /t{index} : Text" for index in range(nodes - 2)]
    chain = ["node n0 : Head { out -> /t0 }"]
    chain += [f"node n{i} : Link {{ in <- /t{i - 1}\n out -> /t{i} }}" for i in range(1, nodes - 2)]
    pair = ["topic /ticks : Ticks", "node source : Source { out -> /ticks }", "node sink : Sink { in <- /ticks }"]
    return worker.specification("\n".join(topics + chain + pair))


def memory(pids: list[int]) -> float:
    """Of these processes together, shared pages counted once (MiB)."""
    rolled = "".join(Path(f"/proc/{pid}/smaps_rollup").read_text() for pid in pids)
    return sum(int(line.split()[1]) for line in rolled.splitlines() if line.startswith("Pss:")) / 1024


async def idle(pids: list[int], seconds: float) -> Figures:
    await asyncio.sleep(SETTLE)
    before = worker.processor_time(pids)
    await asyncio.sleep(seconds)
    used = 100 * (worker.processor_time(pids) - before) / seconds
    return {"idle, % of a core": used, "memory, MiB": memory(pids)}


async def components(nodes: int, seconds: float, replacements: int, spares: int, rest: float) -> Figures:
    from midstride.plan.request import PlanRequest
    from midstride.runtime.options import SystemOptions

    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        options = SystemOptions(spares=spares)
        session = worker.Session(worker.Plane(), "ros2", Path(folder), system(nodes), options=options)
        async with session:
            # The pair is what the replacement is about; it is not idle.
            handles = session.manager.system.life.handles
            pids = [handle.pid for name, handle in handles.items() if name not in ("source", "sink")]
            figures = {"up, s": session.up, "processor time of up, s": worker.processor_time(session.pids())}
            figures["memory, MiB"] = memory(pids)
            if seconds:
                figures |= await idle(pids, seconds)
                figures["manager idle, % of a core"] = (await idle([os.getpid()], seconds))["idle, % of a core"]
            taken, until_handed_over = [], []
            request = (("source", "OtherSource"),)
            for _ in range(replacements):
                async with asyncio.timeout(60):
                    while session.manager._backend.spares() < spares:
                        await asyncio.sleep(0.1)
                await asyncio.sleep(rest)
                asked, last = time.time(), session.events()[-1].n
                outcome = await session.manager.change(PlanRequest(replace=request))
                if outcome.outcome == "done":
                    steps = worker.steps(session.events(last))
                    taken.append(steps[-1][2] - asked)
                    until_handed_over += [done - asked for words, _, done in steps if " hand over " in words]
                    request = (("source", "Source" if request[0][1] == "OtherSource" else "OtherSource"),)
                else:
                    print(f"{nodes:4} components  a replacement was {outcome.outcome}: {outcome.because}", flush=True)
            figures["replaced"] = len(taken)
            if taken:
                figures |= {"replace, median, s": statistics.median(taken), "replace, longest, s": max(taken)}
                figures["until handed over, median, s"] = statistics.median(until_handed_over)
            begun = time.monotonic()
        figures["down, s"] = time.monotonic() - begun
        return figures


async def bare(nodes: int, seconds: float, joins: int, *, paced: bool, tuned: bool) -> Figures:
    from _tuned import tuned_environment

    from midstride.runtime.manager_clock import SystemClock
    from midstride.runtime.process.launcher import STOP_GRACE
    from midstride.runtime.process.pacing import room_for_a_start

    environment = tuned_environment(dict(os.environ)) if tuned else dict(os.environ)
    clock = SystemClock()
    processes: list[asyncio.subprocess.Process] = []
    created, matched = 0, asyncio.Semaphore(0)

    async def read(process: asyncio.subprocess.Process) -> None:
        nonlocal created
        assert process.stdout is not None
        while line := await process.stdout.readline():
            if line.strip() == b"created":
                created += 1
            elif line.strip() == b"matched":
                matched.release()

    async def start(number: int, count: int) -> asyncio.subprocess.Process:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, str(HERE / "_many_nodes.py"), str(number), str(count)),
            env=environment,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        processes.append(process)
        readers.append(asyncio.ensure_future(read(process)))
        return process

    readers: list[asyncio.Future[None]] = []
    begun = time.monotonic()
    try:
        for number in range(nodes):
            if paced:
                await room_for_a_start(clock, lambda: len(processes) - created)
            await start(number, nodes)
        async with asyncio.timeout(300):
            for _ in range(nodes):
                await matched.acquire()
        pids = [process.pid for process in processes]
        figures = {"up, s": time.monotonic() - begun, "processor time of up, s": worker.processor_time(pids)}
        figures["memory, MiB"] = memory(pids)
        if seconds:
            figures |= await idle(pids, seconds)
        taken = []
        for _ in range(joins):
            begun = time.monotonic()
            process = await start(nodes, nodes + 1)
            await matched.acquire()
            taken.append(time.monotonic() - begun)
            process.kill()
            await process.wait()
            await asyncio.sleep(1.0)
        if taken:
            figures |= {"one more, median, s": statistics.median(taken), "one more, longest, s": max(taken)}
        begun = time.monotonic()
        for process in processes:
            if process.returncode is None:
                process.terminate()
        _, late = await asyncio.wait({asyncio.ensure_future(p.wait()) for p in processes}, timeout=STOP_GRACE)
        for process in processes:
            if process.returncode is None:  # an idle rclpy node misses SIGTERM now and then
                process.kill()
        if late:
            await asyncio.wait(late)
        figures["down, s"] = time.monotonic() - begun
        return figures
    finally:
        for process in processes:
            if process.returncode is None:
                process.kill()
        await asyncio.gather(*readers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, nargs="+", default=[FEW, 30, 60, 100])
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=["components", "bare"])
    parser.add_argument("--spares", type=int, default=2, help="for the kind `spares`")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--idle", type=float, default=20.0, help="how long the idle ones are watched (s)")
    parser.add_argument("--replacements", type=int, default=5)
    parser.add_argument("--rest", type=float, default=0.0, help="how long before each replacement of a component (s)")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "many.json")
    options = parser.parse_args()
    guard()
    os.environ.setdefault("ROS_DOMAIN_ID", "86")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rows: list[dict[str, Any]] = []
    for nodes in options.nodes:
        for kind in options.kinds * options.rounds:
            if kind in ("spares", "components"):
                spares = options.spares if kind == "spares" else 0
                measured = components(nodes, options.idle, options.replacements, spares, options.rest)
            else:
                measured = bare(
                    nodes, options.idle, options.replacements, paced=kind == "bare", tuned=kind != "ros-settings"
                )
            figures = {name: round(value, 2) for name, value in asyncio.run(measured).items()}
            rows.append({"nodes": nodes, "kind": kind, **figures})
            print(f"{nodes:4} {kind:<11}", ", ".join(f"{name} {value}" for name, value in figures.items()), flush=True)
        for figure in ("up, s", "processor time of up, s"):
            medians = {
                kind: statistics.median(row[figure] for row in rows if (row["nodes"], row["kind"]) == (nodes, kind))
                for kind in options.kinds
            }
            print(f"{nodes:4} {figure}, median of {options.rounds}:", medians, flush=True)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""What a relay (`gate relay`) costs: latency, and processor time per message, beside the direct path (`gate none`).

A bare rclpy publisher, run by a manager with one gate or the other, and a bare subscriber. Runs are interleaved
(direct, relay, direct again); a figure is the median of the ratios within each three, with a bootstrapped 95 %
interval. ``direct again / direct`` is the control: what this machine calls the same. The processor time is that of all
processes on the path, all their threads: the publisher, the relay and the subscriber.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
from _guard import guard
from overhead import HERE, PATIENCE, NoFigures, environment, interval

from midstride import backends
from midstride.lang.load import load
from midstride.runtime.manager import Manager
from midstride.runtime.timeouts import within
from midstride.runtime.workspace import Workspace

SIZES = {"1 kB at 50 Hz": (1_000, 50.0), "1 kB at 200 Hz": (1_000, 200.0), "1 MB at 30 Hz": (1_000_000, 30.0)}
KINDS = ("none", "relay", "none")
# Until the path is warm (s).
WARM = 1.0
TEXT = """system relayed

topic /measured : sensor_msgs/msg/Image

component Camera {
  run "%s" gate %s
  output out as /overhead
  functionality film {
    produces out
    mode normal { guarantee out : sensor_msgs/msg/Image }
    mode degraded { }
  }
}

node camera : Camera { out -> /measured }
"""


def seconds_of(processes: list[psutil.Process]) -> list[float]:
    return [sum(process.cpu_times()[:2]) for process in processes]


async def measure(folder: Path, gate: str, size: int, rate: float, seconds: float) -> dict[str, float]:
    """One run: latency (ms), and the processor time per message (µs) and the memory (MB) of each process."""
    nodes = [sys.executable, str(HERE / "_overhead_nodes.py"), "bare"]
    options = ["--size", str(size), "--rate", str(rate), "--seconds"]
    (folder / "system").mkdir()
    path = folder / "relayed.stride"
    path.write_text(TEXT % (" ".join([*nodes, "publisher", *options, "1e9"]), gate), encoding="utf-8")
    workspace = Workspace(folder / "system")
    manager = Manager(load(path).require(), backends.make("ros2", workspace), workspace, folder)
    command = [*nodes, "subscriber", *options, str(WARM + seconds), "--ros-args", "-r", "/overhead:=/measured"]
    subscriber = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        await manager.up()
        started = psutil.Process((await manager.peek("camera")).pid)
        processes = [psutil.Process(subscriber.pid), *started.children(), started]
        await asyncio.sleep(WARM)
        before = seconds_of(processes)
        await asyncio.sleep(seconds)
        used = [after - begun for after, begun in zip(seconds_of(processes), before, strict=True)]
        assert subscriber.stdout is not None
        async with within(PATIENCE):
            line = await asyncio.to_thread(subscriber.stdout.readline)
        if not line:
            raise NoFigures("the subscriber ended without figures")
        found = json.loads(line)
        return {
            "median_ms": found["median_ms"],
            "p99_ms": found["p99_ms"],
            "processor_us": sum(used) / (seconds * rate) * 1e6,
            "relay_us": used[-1] / (seconds * rate) * 1e6 if gate == "relay" else 0.0,
            "memory_mb": processes[-1].memory_full_info().uss / 1e6,
        }
    finally:
        subscriber.kill()
        subscriber.wait()
        await manager.down()
        await manager.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--out", type=Path, default=HERE / "results" / "relay.json")
    options = parser.parse_args()
    guard()
    os.environ.update({name: value for name, value in environment().items() if name.startswith("ROS_")})
    results: dict[str, list[list[dict[str, float]]]] = {}
    print("| | direct | relay | relay / direct | 95 % | control |\n|---|---|---|---|---|---|")
    for label, (size, rate) in SIZES.items():
        runs = results[label] = []
        for _ in range(options.runs):
            three = []
            for gate in KINDS:
                with tempfile.TemporaryDirectory() as folder:
                    three.append(asyncio.run(measure(Path(folder), gate, size, rate, options.seconds)))
            runs.append(three)
        for what in ("median_ms", "p99_ms", "processor_us"):
            direct, relay = (statistics.median(three[index][what] for three in runs) for index in (0, 1))
            ratio, low, high = interval([three[1][what] / three[0][what] for three in runs])
            control = statistics.median(three[2][what] / three[0][what] for three in runs)
            row = f"{direct:.3g} | {relay:.3g} | {ratio:.2f} | {low:.2f} to {high:.2f} | {control:.2f}"
            print(f"| {what}, {label} | {row} |", flush=True)
        own = [statistics.median(three[1][what] for three in runs) for what in ("relay_us", "memory_mb")]
        print(f"| of the relay alone, {label} | – | {own[0]:.0f} µs, {own[1]:.0f} MB | | | |", flush=True)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()

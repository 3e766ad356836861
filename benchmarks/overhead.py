"""What a port costs over bare rclpy: latency at 100 Hz, throughput flat out, and processor time, at 100 B, 1 kB, 1 MB.

Interleaved pairs of runs (bare, component, bare again), so that a drift of the machine falls on
all alike; the ratio of each pair, its median over the pairs, and a bootstrapped 95 % interval.
``bare again / bare`` is the control: what this machine calls the same. Latency and throughput hang on
when the machine lets a process run; the processor time of the publisher's and the subscriber's process
per message, all their threads, much less: it is what shows a cost of a few per cent.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import selectors
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from _guard import guard

HERE = Path(__file__).resolve().parent
# How long starting up and finding each other may take (s).
PATIENCE = 30
SIZES = {"100 B": 100, "1 kB": 1_000, "1 MB": 1_000_000}
# What is measured at which rate (Hz; 0: flat out), and the figure of the nodes that tells it.
MEASURED = {
    100.0: {"latency": "median_ms", "processor, publisher": "write_us", "processor, subscriber": "take_us"},
    0.0: {"throughput": "per_second", "processor flat out, pub.": "write_us", "processor flat out, sub.": "take_us"},
}


class NoFigures(Exception):
    """A run that came to nothing: which, and why."""


def environment() -> dict[str, str]:
    from _tuned import tuned_environment

    own = {"ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "87"), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return tuned_environment({**os.environ, **own})


def run(kind: str, size: int, rate: float, seconds: float, env: dict[str, str]) -> dict[str, Any]:
    """One publisher and one subscriber process; the figures of both."""
    common = ["--size", str(size), "--rate", str(rate), "--seconds", str(seconds)]
    remap = {"publisher": ["--standalone", "out:=/overhead"], "subscriber": ["--standalone", "in:=/overhead"]}
    processes = {}
    for side in ("subscriber", "publisher"):
        command = [sys.executable, str(HERE / "_overhead_nodes.py"), kind, side, *common]
        processes[side] = subprocess.Popen(
            command + (remap[side] if kind == "component" else []),
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
    try:
        # A component lives until it is asked to end; its figures are one line.
        figures: dict[str, Any] = {}
        for side, process in processes.items():
            stream = process.stdout
            assert stream is not None
            with selectors.DefaultSelector() as selector:
                selector.register(stream, selectors.EVENT_READ)
                if not selector.select(timeout=seconds + PATIENCE):
                    raise NoFigures(f"{kind}, {size} B: the {side} had no figures within {seconds + PATIENCE:g} s")
            line = stream.readline()
            if not line:
                raise NoFigures(f"{kind}, {size} B: the {side} ended without figures")
            figures |= json.loads(line)
        return figures
    finally:
        for process in processes.values():
            process.kill()
        for process in processes.values():
            process.wait()


def interval(ratios: list[float], seed: int = 1) -> tuple[float, float, float]:
    """Median, and the 95 % interval of it by bootstrap."""
    chance = random.Random(seed)
    medians = sorted(statistics.median(chance.choices(ratios, k=len(ratios))) for _ in range(4000))
    return statistics.median(ratios), medians[100], medians[3899]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=3)
    parser.add_argument("--out", type=Path, default=HERE / "results" / "overhead.json")
    options = parser.parse_args()
    guard()
    env = environment()
    results = []
    print(f"{'what':<34}{'component/bare':>16}{'95 %':>18}{'bare/bare':>12}{'95 %':>18}")
    for label, size in SIZES.items():
        for rate, measured in MEASURED.items():
            runs: list[list[dict[str, Any]]] = []
            failed: list[str] = []
            while len(runs) < options.pairs:
                try:
                    runs.append([run(kind, size, rate, options.seconds, env) for kind in ("bare", "component", "bare")])
                except NoFigures as error:  # told and kept, and the pair run again, so that the others are not lost
                    print(error, flush=True)
                    failed.append(str(error))
                    if len(failed) > options.pairs:
                        raise SystemExit("too many runs came to nothing") from None
                time.sleep(0.2)
            for what, figure in measured.items():
                pairs = [
                    dict(zip(("bare", "component", "again"), (one[figure] for one in three), strict=True))
                    for three in runs
                ]
                component = interval([pair["component"] / pair["bare"] for pair in pairs])
                control = interval([pair["again"] / pair["bare"] for pair in pairs])
                shown = [f"{values[0]:.3f} {values[1]:.3f}..{values[2]:.3f}".split() for values in (component, control)]
                name = f"{what}, {label}"
                print(f"{name:<34}{shown[0][0]:>16}{shown[0][1]:>18}{shown[1][0]:>12}{shown[1][1]:>18}", flush=True)
                results.append(
                    {
                        "what": what,
                        "size": size,
                        "rate": rate,
                        "ratio": component,
                        "control": control,
                        "figure": figure,
                        "pairs": pairs,
                        "failed": failed,
                    }
                )
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps({"results": results}, indent=1))


if __name__ == "__main__":
    main()

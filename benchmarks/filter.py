"""A message-driven filter replaced again and again at 200 Hz on real ROS 2: is every measurement answered once?

The source counts its measurements in each message and the filters pass the count on, so a bare
recorder behind them can tell by content alone: a count that is absent was missed or lost, one that comes twice
is a duplicate. Counts that the source itself skipped were never written, and are seen on its own topic.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

from _guard import guard

HERE = Path(__file__).resolve().parent
EXAMPLE = HERE.parent / "examples" / "filter"


def recorder(path: str) -> None:
    """The program behind the filter: notes every count on ``/smooth`` until SIGTERM, then writes them to ``path``."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Range

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("recorder")
    counts: list[int] = []
    going = [True]

    def end(signum: int, frame: FrameType | None) -> None:
        going[0] = False

    signal.signal(signal.SIGTERM, end)
    node.create_subscription(Range, "/smooth", lambda message: counts.append(int(message.field_of_view)), 1000)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while going[0]:
        executor.spin_once(timeout_sec=0.1)
    Path(path).write_text(json.dumps(counts))


async def swapped(swaps: int, folder: Path) -> dict[str, Any]:
    from midstride import backends
    from midstride.lang import load
    from midstride.plan.request import PlanRequest
    from midstride.runtime.manager import Manager
    from midstride.runtime.workspace import Workspace

    specification = load(EXAMPLE / "filter.stride").require()
    manager = Manager(specification, backends.make("ros2", Workspace(folder)), Workspace(folder), EXAMPLE)
    path = folder / "counts.json"
    reported: Counter[str] = Counter()
    unknown = 0
    try:
        await manager.up()
        process = subprocess.Popen([sys.executable, __file__, "--recorder", str(path)], env=dict(os.environ))
        try:
            await asyncio.sleep(2)
            for index in range(swaps):
                component = ("MedianFilter", "MeanFilter")[index % 2]
                outcome = await manager.change(PlanRequest(replace=(("filter", component),)))
                if outcome.outcome != "done":
                    raise SystemExit(f"swap {index}: {outcome.because}")
                for swap in outcome.swaps:
                    for figure in ("missed", "lost", "duplicates"):
                        found: int | None = getattr(swap, figure)
                        if found is None:
                            unknown += 1
                        else:
                            reported[figure] += found
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)
        finally:
            process.kill()
            process.wait()
        counts = json.loads(path.read_text())
    finally:
        await manager.down()
        await manager.close()
    seen = Counter(counts)
    return {
        "swaps": swaps,
        "messages": len(counts),
        "absent": max(counts) - min(counts) + 1 - len(seen),
        "twice": sum(1 for times in seen.values() if times > 1),
        "reported": {**reported, "unknown": unknown},
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--swaps", type=int, default=200)
    parser.add_argument("--out", type=Path, default=HERE / "results" / "filter.json")
    parser.add_argument("--recorder", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.recorder:
        recorder(options.recorder)
        return
    guard()
    from _tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "85")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        result = asyncio.run(swapped(options.swaps, Path(folder)))
    print(f"{'swaps':>8}{'messages':>12}{'absent':>10}{'twice':>8}   reported missed/lost/duplicates (unknown)")
    told = result["reported"]
    figures = "/".join(str(told.get(name, 0)) for name in ("missed", "lost", "duplicates"))
    print(
        f"{result['swaps']:>8}{result['messages']:>12}{result['absent']:>10}{result['twice']:>8}"
        f"   {figures} ({told['unknown']}), in {time.monotonic() - begun:.0f} s"
    )
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

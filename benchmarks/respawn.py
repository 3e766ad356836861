"""Restart policies on ROS 2: how long from a crash until what relied on the node is safe, and until all is restored.

A publisher at 50 Hz is killed with -9 while a bare rclpy subscriber records what it writes. Times are from the kill:
until its dependant is in its safe mode, until the dependant is back in its normal mode, and until the bare subscriber
hears the publisher again. `--spares N` keeps N processes ready.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from _guard import guard
from _recorder import recording

from midstride import backends
from midstride.lang.load import load_text
from midstride.model.respawn import RespawnPolicy
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.workspace import Workspace

FOLDER = Path(__file__).resolve().parent
sys.path.append(str(FOLDER.parent))

from benchmarks.swap.streams import Stream  # noqa: E402
from benchmarks.swap.systems import with_api  # noqa: E402

# How long anything may take (s), on a busy machine.
PATIENCE = 120.0
# How long it runs before the next kill (s).
PAUSE = 3.0
FIGURES = ("safe", "restored", "heard")
# At once, however often.
POLICY = RespawnPolicy(delay=0.0, max_delay=0.0, max_retries=1_000_000)


async def until(holds: Callable[[], Any], what: str) -> float:
    """When it holds (monotonic s)."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what} within {PATIENCE:g} s")
        await asyncio.sleep(0.001)
    return time.monotonic()


async def crash(manager: Manager, heard: list[float]) -> dict[str, float]:
    """Kill the publisher; the figures of its restart, in seconds from the kill."""

    def mode() -> str:
        latest = manager.system.life.latest("sink")
        return "" if latest is None else latest.state.functionalities["listen"].mode

    await until(lambda: mode() == "normal" and heard and time.monotonic() - heard[-1] < 0.1, "it does not run")
    killed = time.monotonic()
    os.kill(manager.system.life.handles["source"].pid, signal.SIGKILL)
    safe = await until(lambda: mode() == "degraded", "the dependant is not safe")
    restored = await until(lambda: mode() == "normal", "the dependant is not restored")
    # What had been sent before the kill is received within 50 ms.
    await until(lambda: heard[-1] > killed + 0.05, "the bare subscriber hears nothing")
    again = next(at for at in heard if at > killed + 0.05)
    return dict(zip(FIGURES, (at - killed for at in (safe, restored, again)), strict=True))


async def measure(crashes: int, options: SystemOptions) -> list[dict[str, float]]:
    wanted = load_text(with_api(FOLDER / "swap" / "programs" / "nodes.py", Stream())).require()
    wanted = wanted.with_node(replace(wanted.nodes["source"], respawn=POLICY))
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        workspace = Workspace(Path(folder))
        manager = Manager(wanted, backends.make("ros2", workspace), workspace, FOLDER, options=options)
        try:
            await manager.up()  # before the subscriber: it sets transports and discovery for this process
            found, heard = [], list[float]()
            with recording("/swap", lambda _: heard.append(time.monotonic())):
                for _ in range(crashes):
                    await asyncio.sleep(PAUSE)
                    found.append(await crash(manager, heard))
            return found
        finally:
            await manager.down()
            await manager.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--crashes", type=int, default=20)
    parser.add_argument("--spares", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    guard()
    options = SystemOptions(**({"spares": arguments.spares} if arguments.spares else {}))
    found = asyncio.run(measure(arguments.crashes, options))
    print(f"{'until':>10} {'median':>9} {'longest':>9}   ({len(found)} crashes, {arguments.spares} spares)")
    for name in FIGURES:
        times = [figures[name] for figures in found]
        print(f"{name:>10} {statistics.median(times) * 1000:>6.0f} ms {max(times) * 1000:>6.0f} ms")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"spares": arguments.spares, "crashes": found}, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())

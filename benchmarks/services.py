"""What replacing a server costs its clients: 20 bare clients at 10 Hz, each with one request at a time, on real ROS 2.

Components with Midstride's API, and nodes without it behind `gate preload`, in plain rclpy and in C on rcl, replaced by
Midstride. Beside them: a server that is killed and another one started; lifecycle nodes that serve while they
are active, of which one is deactivated and then the next one activated, as a lifecycle manager would; a server
that stays; and one that stays and stalls for 0.15 s now and then, with ROS's queue of ten requests and with one of 200.
Clients of the servers that Midstride does not replace give a request up after 1 s, but for those of the one that stays.
Clients and servers count, in the same way for each. *At the cut* is what was sent between the last response of the old
server and the first one of the new server, or at most a period (0.1 s) before or after.

The results of each block of replacements are kept as soon as it is done, and the next run goes on with the rest; remove
the file to begin anew. Interrupted or terminated, it ends what it has started.
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
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from _guard import guard

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from midstride.lang.load import load  # noqa: E402
from tests.acceptance.foreign_support import robot  # noqa: E402
from tests.acceptance.serving import SERVER, Answered, Calls, calling, written, written_with_the_api  # noqa: E402
from tests.backends.ros2_support import Bare, without_midstride  # noqa: E402

PERIOD = 0.1
# How many replacements one block has.
BLOCK = 20
# After how long a client gives up a request to a server that was killed (s).
PATIENCE = 1.0
# How long after a replacement, or between two looks at what the clients have written, nothing is done (s).
REST, LOOK = 0.5, 0.2
COLUMNS = ("swaps", "requests", "unanswered", "twice", "out of order")
Figures = dict[str, Any]
# The transitions of a lifecycle node, by ROS's numbers.
CONFIGURE, ACTIVATE, DEACTIVATE = 1, 3, 4
NODE = """
class Server(LifecycleNode):
    def on_activate(self, state):
        self.served = self.create_service(ListParameters, "count", count)
        return super().on_activate(state)

    def on_deactivate(self, state):
        self.destroy_service(self.served)
        return super().on_deactivate(state)

node = Server("talker")
"""


def cuts(answered: Sequence[Answered]) -> list[tuple[float, float]]:
    """When each server answered last, and when the next one did first (monotonic, s)."""
    done: dict[str, list[float]] = {}
    for each in answered:
        if each.server != "-":
            done.setdefault(each.server, []).append(each.at + each.latency)
    servers = sorted(done.values(), key=min)
    return [(max(old), min(new)) for old, new in pairwise(servers)]


def figures(calls: Calls, swaps: int) -> Figures:
    """Of one block; times in s."""
    answered = calls.answered
    found = cuts(answered)

    def at_the_cut(each: Answered) -> bool:
        return any(min(old, new) - PERIOD <= each.at <= max(old, new) + PERIOD for old, new in found)

    return {
        "swaps": swaps,
        "requests": len(answered),
        "unanswered": len(calls.unanswered),
        "twice": len(calls.handled_twice),
        "out of order": len(calls.out_of_order),
        "latencies": [each.latency for each in answered if each.server != "-"],
        "at the cut": [each.latency for each in answered if each.server != "-" and at_the_cut(each)],
        "silences": [max(0.0, new - old) for old, new in found],
        "load": os.getloadavg()[0],
    }


async def replaced(folder: Path, swaps: int, kinds: tuple[str, str]) -> tuple[Figures, list[str]]:
    """Midstride replaces the server; with the reasons of what was rolled back."""
    rolled_back: list[str] = []
    path = written_with_the_api(folder) if "Ours" in kinds else written(folder)
    async with robot(load(path).require(), folder) as system:
        done = 0
        if kinds[1] not in ("Plain", "Ours"):
            await system.replaced(kinds[1])
        async with calling(folder, system.until) as calls:
            while done < swaps:
                outcome = await system.change(kinds[done % 2])
                done += outcome.outcome == "done"
                if outcome.outcome != "done":
                    rolled_back.append(str(outcome.because))
                await asyncio.sleep(REST)
        return figures(calls, swaps), rolled_back


def started(folder: Path, name: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(folder / "server.py"), "--ros-args", "-r", f"__node:={name}"]
    return subprocess.Popen(command, env={**without_midstride(), "MIDSTRIDE_INSTANCE": name}, cwd=folder)


def end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


async def looked(condition: Callable[[], bool], seconds: float = 60) -> None:
    """Wait for a condition that takes a while to look at."""
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(LOOK)


async def killed(folder: Path, swaps: int) -> tuple[Figures, list[str]]:
    """Each server is killed and another one started."""
    written(folder)
    server = started(folder, "server_0")

    def handles(name: str) -> bool:
        return any(server == name for _, server in calls.handled[-BLOCK:])

    try:
        async with calling(folder, looked, patience=PATIENCE) as calls:
            for number in range(1, swaps + 1):
                end(server)
                server = started(folder, f"server_{number}")
                await looked(partial(handles, f"server_{number}"))
                await asyncio.sleep(10 * PERIOD)
    finally:
        end(server)
    return figures(calls, swaps), []


# The server as a lifecycle node, which serves while it is active.
LIFECYCLE = (
    SERVER.replace("from rclpy.node import Node", "from rclpy.lifecycle import LifecycleNode")
    .replace('node = Node("talker")\n', NODE)
    .replace('node.create_service(ListParameters, "count", count)\n', "")
)


async def switched(folder: Path, swaps: int) -> tuple[Figures, list[str]]:
    """Each server is deactivated once another one is configured, and then that is activated."""
    from lifecycle_msgs.srv import ChangeState

    written(folder)
    (folder / "server.py").write_text(LIFECYCLE)
    server = started(folder, "server_0")

    with Bare("switch") as bare:

        async def takes(name: str, *transitions: int) -> None:
            client = bare.node.create_client(ChangeState, f"/{name}/change_state")
            for number in transitions:
                request = ChangeState.Request()
                request.transition.id = number
                answer = await bare.ask(client, request)
                assert answer.success, f"{name} refuses transition {number}"
            bare.node.destroy_client(client)

        try:
            await takes("server_0", CONFIGURE, ACTIVATE)
            async with calling(folder, looked, patience=PATIENCE) as calls:
                for number in range(1, swaps + 1):
                    new = started(folder, f"server_{number}")
                    try:
                        await takes(f"server_{number}", CONFIGURE)
                        await takes(f"server_{number - 1}", DEACTIVATE)
                        await takes(f"server_{number}", ACTIVATE)
                    finally:
                        end(server)
                        server = new
                    await asyncio.sleep(10 * PERIOD)
        finally:
            end(server)
    return figures(calls, swaps), []


async def steady(folder: Path, swaps: int) -> tuple[Figures, list[str]]:
    """One server for as long as the replacements of one block take."""
    written(folder)
    server = started(folder, "server")
    try:
        async with calling(folder, looked) as calls:
            await asyncio.sleep(5.0 * swaps)
    finally:
        end(server)
    return figures(calls, 0), []


# How long a server that stalls gets no processor (s), as on a machine with too much to do.
STALL = 0.15


async def stalled(folder: Path, swaps: int, depth: int) -> tuple[Figures, list[str]]:
    """One server, which is stopped for a moment now and then. ``depth``: for how many requests its queue has room."""
    written(folder)
    profile = f"qos_profile=__import__('rclpy.qos').qos.QoSProfile(depth={depth})"
    (folder / "server.py").write_text(SERVER.replace('"count", count)', f'"count", count, {profile})'))
    server = started(folder, "server")
    try:
        async with calling(folder, looked, patience=PATIENCE) as calls:
            for _ in range(swaps):
                server.send_signal(signal.SIGSTOP)
                await asyncio.sleep(STALL)
                server.send_signal(signal.SIGCONT)
                await asyncio.sleep(10 * PERIOD)
    finally:
        end(server)
    return figures(calls, 0), []


Way = Callable[[Path, int], Awaitable[tuple[Figures, list[str]]]]
WAYS: Mapping[str, Way] = {
    "replaced, API": lambda folder, swaps: replaced(folder, swaps, ("OurOther", "Ours")),
    "replaced, rclpy": lambda folder, swaps: replaced(folder, swaps, ("Other", "Plain")),
    "replaced, C": lambda folder, swaps: replaced(folder, swaps, ("Info", "Id")),
    "killed": killed,
    "lifecycle": switched,
    "none": steady,
    "stalled, 10": lambda folder, swaps: stalled(folder, swaps, 10),
    "stalled, 200": lambda folder, swaps: stalled(folder, swaps, 200),
}


def quantiles(latencies: Sequence[float]) -> str:
    """The median, 99 % and the longest, in ms."""
    found = sorted(latencies)
    if not found:
        return f"{'–':>9}" * 3
    chosen = (found[len(found) // 2], found[len(found) * 99 // 100], found[-1])
    return "".join(f"{each * 1e3:>9.1f}" for each in chosen)


def show(blocks: Sequence[Figures]) -> None:
    print(f"{'':16}" + "".join(f"{name:>13}" for name in COLUMNS), end="")
    print(f"{'all: median, 99 %, longest, ms':>33}{'at the cut':>18}{'no response':>24}{'load':>12}")
    for way in WAYS:
        if own := [block for block in blocks if block["way"] == way]:
            sums = "".join(f"{sum(block[name] for block in own):>13}" for name in COLUMNS)
            loads = [block["load"] for block in own]
            keys = ("latencies", "at the cut", "silences")
            times = "".join(quantiles([each for block in own for each in block[key]]) for key in keys)
            print(f"{way:16}{sums}      {times}  {min(loads):.1f} to {max(loads):.1f}")
            for because in (each for block in own for each in block["rolled back"]):
                print(f"{'':16}one was rolled back: {because}")


def blocks_in(out: Path) -> list[Figures]:
    """What has been measured."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


async def measure(ways: Mapping[str, Way], chosen: Sequence[str], swaps: int, out: Path) -> None:
    """Measure what is not in ``out`` yet. SIGTERM and SIGINT end it, and what it has started."""
    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    while True:
        blocks = blocks_in(out)
        done = {way: sum(block["wanted"] for block in blocks if block["way"] == way) for way in chosen}
        way = min(chosen, key=lambda each: done[each])
        if done[way] >= swaps:
            return
        wanted = min(BLOCK, swaps - done[way])
        with tempfile.TemporaryDirectory(prefix="ms") as folder:
            found, rolled_back = await ways[way](Path(folder), wanted)
        with out.open("a") as file:
            print(json.dumps({"way": way, "wanted": wanted, "rolled back": rolled_back, **found}), file=file)
        print(f"{way}: {done[way] + wanted} of {swaps}", flush=True)


def run(
    description: str | None,
    ways: Mapping[str, Way],
    swaps: int,
    name: str,
    columns: Sequence[str],
    show: Callable[[Sequence[Figures]], None],
) -> int:
    """The command of a benchmark, which keeps what it measures in ``name``; the exit status.

    ``swaps``: how many replacements of each way, unless stated. From the third of ``columns`` on, each counts faults.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--swaps", type=int, default=swaps)
    parser.add_argument("--ways", nargs="+", choices=ways, default=list(ways))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / name)
    options = parser.parse_args()
    guard()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    options.out.parent.mkdir(exist_ok=True)
    try:
        asyncio.run(measure(ways, options.ways, options.swaps, options.out))
    except asyncio.CancelledError:
        return 1
    blocks = blocks_in(options.out)
    show(blocks)
    return int(any(block[name] for block in blocks if block["way"].startswith("replaced") for name in columns[2:]))


if __name__ == "__main__":
    sys.exit(run(__doc__, WAYS, 200, "services.jsonl", COLUMNS, show))

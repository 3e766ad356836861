"""What measuring a publisher's rate costs its process: by the library of the gate, by a subscription, and not at all.

The watched process publishes to a reader in its own process, as rclcpp does with intra-process communication, which
serializes a message only if there is a reader elsewhere. In turns, it runs alone, with the library in it and its counts
read as `midstride capture` reads them, and with the subscription that `midstride capture` makes otherwise. The figure
is the processor time of the watched process. With `--command`, another program is watched, as one of rclcpp, whose node
is `--node` and publishes on `--topic`.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from benchmarks._guard import guard  # noqa: E402
from midstride.capture.rates import MeasuredRate, measured  # noqa: E402
from midstride.codec.component_form import NamedComponentForm  # noqa: E402
from midstride.foreign import build  # noqa: E402
from midstride.foreign.gates import Gates  # noqa: E402
from midstride.foreign.page import PAGE, Page  # noqa: E402
from midstride.foreign.record import ForeignRecord  # noqa: E402
from midstride.model.component import ComponentSpec  # noqa: E402
from tests.native import compiled, environment_of_compiled  # noqa: E402

WAYS = ("nothing", "library", "subscription")
# As `midstride import` writes it: without ports.
WATCHED = ComponentSpec.of("Watched", run="watched", gate="preload")


@contextmanager
def watched(command: list[str], more: dict[str, str]) -> Iterator[psutil.Process]:
    process = subprocess.Popen(command, env={**os.environ, **more}, stdout=subprocess.DEVNULL)
    try:
        yield psutil.Process(process.pid)
    finally:
        process.kill()
        process.wait()


def used_by_family(process: psutil.Process) -> dict[int, float]:
    """The processor time of a process, and of each below it (s), by its number."""
    return {each.pid: sum(each.cpu_times()[:2]) for each in [process, *process.children(recursive=True)]}


def cost(process: psutil.Process, seconds: float) -> float:
    """The processor time of a process and those below it that last, of one core (%)."""
    before, begun = used_by_family(process), time.monotonic()
    time.sleep(seconds)
    used = sum(after - before[pid] for pid, after in used_by_family(process).items() if pid in before)
    return 100 * used / (time.monotonic() - begun)


def in_page(folder: Path, node: str) -> dict[str, str]:
    """What the process of a node has in its environment, so that the library counts there; its record is written."""
    library = build.library()
    page = Page(folder / PAGE, library)
    index = page.allocate("watched")
    Gates(page, index, WATCHED).prepare({})
    record = ForeignRecord(
        instance="watched",
        node=node,
        token="",
        uuid="",
        pid=0,
        started=time.time_ns(),
        declaration=NamedComponentForm.of(WATCHED),
        index=index,
        topics={},
        modes={},
    )
    record.write(folder)
    return {
        "LD_PRELOAD": str(library),
        "MIDSTRIDE_GATE_PAGE": str(page.path),
        "MIDSTRIDE_GATE_NODE": str(index),
    }


def observe(folder: str, seconds: str, topic: str) -> None:
    """Prints the rate of a topic as `midstride capture` sees it, and whether it has subscribed to it.

    ``folder``: of the page; empty where there is none.
    """
    from midstride.backends import ros2

    graph = ros2.observe(float(seconds), (), Path(folder) if folder else None)
    rates = {}
    for endpoint in graph.publishers(topic):
        rate = measured(graph.times(endpoint) or ())
        rates[endpoint.node] = None if rate is None else [rate.mean, rate.median, rate.p95, rate.longest]
    print(json.dumps({"rates": rates, "subscribed": topic in graph.subscribed}))


def measure(way: str, asked: argparse.Namespace, command: list[str], run: Path) -> tuple[float, dict[str, Any]]:
    """The processor time of the watched process (%), and what was seen of it meanwhile."""
    run.mkdir()
    more = in_page(run, asked.node) if way == "library" else {}
    with watched(command, more) as process:
        time.sleep(asked.warming)
        if way == "nothing":
            return cost(process, asked.seconds), {}
        seconds = str(asked.seconds + 2 * asked.warming)
        words = [sys.executable, __file__, "observe", str(run) if more else "", seconds, asked.topic]
        observer = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        try:
            time.sleep(asked.warming)
            found = cost(process, asked.seconds)
            said, _ = observer.communicate(timeout=60)
        finally:
            observer.kill()
            observer.wait()
    seen = json.loads(said)
    if seen["subscribed"] != (way == "subscription"):
        raise SystemExit(f"{way}: {'it' if seen['subscribed'] else 'nothing'} has subscribed")
    return found, seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--warming", type=float, default=3.0, help="until what is measured is what goes on (s)")
    parser.add_argument("--bytes", type=int, default=1_500_000)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--command", help="the program that is watched, instead")
    parser.add_argument("--topic", default="/images")
    parser.add_argument("--node", default="/within")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "counting.json")
    asked = parser.parse_args()
    guard()
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if asked.command:
            command = shlex.split(asked.command)
        else:
            program = compiled(folder, ROOT / "tests" / "foreign" / "within.c", "within", besides=["tracetools"])
            os.environ.update(environment_of_compiled(os.environ))
            command = [str(program), str(int(1e9 / asked.rate)), asked.topic, str(asked.bytes)]
        found: dict[str, list[float]] = {way: [] for way in WAYS}
        rates: dict[str, list[Any]] = {way: [] for way in WAYS}
        for number in range(asked.runs):
            for way in WAYS:
                used, seen = measure(way, asked, command, folder / f"{way}_{number}")
                found[way].append(used)
                rates[way].append(seen.get("rates", {}).get(asked.node))
    for way, used in found.items():
        middle, low, high = statistics.median(used), min(used), max(used)
        seen = [MeasuredRate(*each) for each in rates[way] if each]
        words = f"; measured {seen[0].mean:.4g} Hz, gaps of {seen[0].median * 1e3:.4g} ms" if seen else ""
        print(f"{way:13} {middle:6.2f} % of a core ({low:.2f} to {high:.2f}){words}")
    asked.out.parent.mkdir(exist_ok=True)
    asked.out.write_text(json.dumps({"percent": found, "rates": rates}, indent=1) + "\n")


if __name__ == "__main__":
    if sys.argv[1:2] == ["observe"]:
        observe(*sys.argv[2:])
    else:
        main()

"""What the gate in a node without Midstride's API costs per message: processor time, beside the same node without it.

The node publishes in a loop through a library that stands in for librcl, so nothing but the gate differs. With
`--requests` it takes requests and answers them instead. With `--rcl` it is one on rcl: its throughput and calls without
subscribers, and at 1 kHz the latency to a subscriber on rcl.
The runs are interleaved; a figure is the median over the runs, with the lowest and the highest.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from _guard import guard

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from midstride.foreign import build  # noqa: E402
from midstride.foreign.page import Page  # noqa: E402
from midstride.foreign.page_layout import OPEN, OUTPUT, PortFlag  # noqa: E402
from tests.native import LISTENER, compiled, environment_of_compiled  # noqa: E402

SOURCES = ROOT / "tests" / "foreign"
LOG_SIZE = 16 + 24 * 4_000_000
KINDS = ("bare", "library, no page", "gate")
PERIOD = 1000  # of the messages whose latency is measured (us)


def variables(folder: Path) -> list[dict[str, str]]:
    """What each of KINDS has in its environment: the library, and a page with an open gate and its baton."""
    library = build.library()
    page = Page(folder / "page", library)
    index = page.allocate("node")
    page.have_requests(index)
    page.set_ports(index, [("/chat", OUTPUT)])
    port = page.ports(index)[0]
    port.flags, port.baton, port.gate = PortFlag.RATED | PortFlag.OFFERS, page.new_baton(index), OPEN
    loaded = {"LD_PRELOAD": str(library)}
    return [{}, loaded, {**loaded, "MIDSTRIDE_GATE_PAGE": str(page.path), "MIDSTRIDE_GATE_NODE": str(index)}]


def measure(folder: Path, runs: int, messages: int, requests: bool = False) -> dict[str, list[float]]:
    """The processor time of a message, or of a request (ns)."""
    compiler = build.compiler()
    assert compiler is not None, "there is no C compiler"
    options = [*compiler, "-std=c11", "-O2"]
    subprocess.run([*options, "-shared", "-fPIC", "-o", folder / "librcl.so", SOURCES / "fake_rcl.c"], check=True)
    for program in ("node", "server"):
        source = SOURCES / f"fake_{program}.c"
        subprocess.run([*options, "-o", folder / program, source, "-L", folder, "-lrcl"], check=True)
    log = folder / "log"
    base = {**os.environ, "LD_LIBRARY_PATH": str(folder), "FAKE_LOG": str(log)}
    kinds = dict(zip(KINDS, variables(folder), strict=True))
    figures: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for _ in range(runs):
        for kind, more in kinds.items():
            log.write_bytes(b"")
            os.truncate(log, LOG_SIZE)
            command = [str(folder / "node"), "1", "/chat", "0", str(messages), "time"]
            if requests:
                command = [str(folder / "server"), "/count", str(messages)]
            done = subprocess.run(command, env={**base, **more}, capture_output=True, text=True, check=True)
            figures[kind].append(float(done.stdout))
    return figures


def measure_rcl(folder: Path, runs: int, messages: int) -> dict[str, list[list[float]]]:
    """Of a node on rcl, in ns: the mean time of a message, then the median and 99 % of a call, and of the latency."""
    import rclpy  # noqa: F401  # it sets the paths of the libraries

    program = compiled(folder, Path(__file__).with_name("_rcl_publisher.c"), "rcl_publisher")
    listener, record = compiled(folder, LISTENER, "listener"), folder / "record"
    base = environment_of_compiled(os.environ)
    base |= {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    kinds = dict(zip(KINDS, variables(folder), strict=True))
    figures: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    for _ in range(runs):
        for kind, more in kinds.items():
            environment, command = {**base, **more}, [str(program), "/chat"]
            fast = [*command, str(messages)]
            done = subprocess.run(fast, env=environment, capture_output=True, text=True, check=True)
            with subprocess.Popen([str(listener), "/chat", str(record)], env=base) as recorder:
                try:
                    subprocess.run([*command, str(messages // 20), str(PERIOD)], env=environment, check=True)
                    latencies = latencies_of(record, messages // 20)
                finally:
                    recorder.terminate()
            figures[kind].append([*map(float, done.stdout.split()), *latencies])
    return figures


def latencies_of(record: Path, messages: int) -> list[int]:
    """The median and the 99 % quantile (ns), once all messages have been recorded."""
    deadline = time.monotonic() + 5.0
    while (count := (text := record.read_text()).count("\n")) < messages:
        assert time.monotonic() < deadline, f"{count} of {messages} messages have arrived"
        time.sleep(0.01)
    found = sorted(taken - published for taken, published in (map(int, line.split()) for line in text.splitlines()))
    return [found[messages // 2], found[messages * 99 // 100]]


def interval(values: list[float]) -> str:
    return f"{statistics.median(values):.4g} ({min(values):.4g} to {max(values):.4g})"


def print_rcl(figures: dict[str, list[list[float]]]) -> None:
    print("| node on rcl | messages per second | a call, median, ns | 99 % | latency, median, us | 99 % |")
    print("|---|---|---|---|---|---|")
    for name, found in figures.items():
        means, medians, tails, *latencies = (list(column) for column in zip(*found, strict=True))
        times = [interval(medians), interval(tails), *(interval([each / 1e3 for each in some]) for some in latencies)]
        print(f"| {name} | {interval([1e9 / each for each in means])} | {' | '.join(times)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--messages", type=int)
    parser.add_argument("--rcl", action="store_true")
    parser.add_argument("--requests", action="store_true", help="what a request to a server costs")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    guard()
    with tempfile.TemporaryDirectory() as folder:
        if options.rcl:
            found = measure_rcl(Path(folder), options.runs, options.messages or 200_000)
            print_rcl(found)
            if options.json:
                options.json.write_text(json.dumps(found))
            return
        figures = measure(Path(folder), options.runs, options.messages or 2_000_000, options.requests)
    bare = figures["bare"]
    what = "request" if options.requests else "message"
    print(f"| | ns per {what}, median | more than bare: median | lowest to highest |\n|---|---|---|---|")
    for name, found in figures.items():
        more = [each - other for each, other in zip(found, bare, strict=True)]
        span = f"{min(more):.0f} to {max(more):.0f}"
        print(f"| {name} | {statistics.median(found):.0f} | {statistics.median(more):.0f} | {span} |")
    if options.json:
        options.json.write_text(json.dumps(figures))


if __name__ == "__main__":
    main()

"""What the gate in a node without Midstride's API costs per message: processor time, beside the same node without it.

The node publishes in a loop through a library that stands in for librcl, so nothing but the gate differs. With
`--rcl` it is one on rcl, whose throughput and calls are timed. The runs are interleaved; a figure is the
median over the runs, with the lowest and the highest.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from midstride.foreign import build  # noqa: E402
from midstride.foreign.page import OPEN, OUTPUT, Page, PortFlag  # noqa: E402
from tests.native import compiled, environment_of_compiled  # noqa: E402

SOURCES = ROOT / "tests" / "foreign"
LOG_SIZE = 16 + 24 * 4_000_000
KINDS = ("bare", "library, no page", "gate")


def variables(folder: Path) -> list[dict[str, str]]:
    """What each of KINDS has in its environment: the library, and a page with an open gate and its baton."""
    library = build.library()
    page = Page(folder / "page", library)
    index = page.allocate("node")
    page.set_ports(index, [("/chat", OUTPUT)])
    port = page.layout.nodes[index].ports[0]
    port.flags, port.baton, port.gate = PortFlag.RATED | PortFlag.LAYS, page.new_baton(index), OPEN
    loaded = {"LD_PRELOAD": str(library)}
    return [{}, loaded, {**loaded, "MIDSTRIDE_GATE_PAGE": str(page.path), "MIDSTRIDE_GATE_NODE": str(index)}]


def measure(folder: Path, runs: int, messages: int) -> dict[str, list[float]]:
    """The processor time of a message (ns)."""
    compiler = build.compiler()
    assert compiler is not None, "there is no C compiler"
    options = [*compiler, "-std=c11", "-O2"]
    subprocess.run([*options, "-shared", "-fPIC", "-o", folder / "librcl.so", SOURCES / "fake_rcl.c"], check=True)
    subprocess.run([*options, "-o", folder / "node", SOURCES / "fake_node.c", "-L", folder, "-lrcl"], check=True)
    log = folder / "log"
    base = {**os.environ, "LD_LIBRARY_PATH": str(folder), "FAKE_LOG": str(log)}
    kinds = dict(zip(KINDS, variables(folder), strict=True))
    figures: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for _ in range(runs):
        for kind, more in kinds.items():
            log.write_bytes(b"")
            os.truncate(log, LOG_SIZE)
            command = [str(folder / "node"), "1", "/chat", "0", str(messages), "time"]
            done = subprocess.run(command, env={**base, **more}, capture_output=True, text=True, check=True)
            figures[kind].append(float(done.stdout))
    return figures


def measure_rcl(folder: Path, runs: int, messages: int) -> dict[str, list[list[float]]]:
    """The mean time of a message, and the median and 99 % of a call (ns), of a node on rcl without subscribers."""
    import rclpy  # noqa: F401  # it sets the paths of the libraries

    program = compiled(folder, Path(__file__).with_name("_rcl_publisher.c"), "rcl_publisher")
    kinds = dict(zip(KINDS, variables(folder), strict=True))
    figures: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    for _ in range(runs):
        for kind, more in kinds.items():
            command = [str(program), "/chat", str(messages)]
            environment = {**environment_of_compiled(os.environ), **more}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            figures[kind].append([float(word) for word in done.stdout.split()])
    return figures


def interval(values: list[float]) -> str:
    return f"{statistics.median(values):.4g} ({min(values):.4g} to {max(values):.4g})"


def print_rcl(figures: dict[str, list[list[float]]]) -> None:
    print("| node on rcl | messages per second | a call, median, ns | a call, 99 %, ns |\n|---|---|---|---|")
    for name, found in figures.items():
        means, medians, tails = (list(column) for column in zip(*found, strict=True))
        print(f"| {name} | {interval([1e9 / each for each in means])} | {interval(medians)} | {interval(tails)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--messages", type=int)
    parser.add_argument("--rcl", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.rcl:
            found = measure_rcl(Path(folder), options.runs, options.messages or 200_000)
            print_rcl(found)
            if options.json:
                options.json.write_text(json.dumps(found))
            return
        figures = measure(Path(folder), options.runs, options.messages or 2_000_000)
    bare = figures["bare"]
    print("| | ns per message, median | more than bare: median | lowest to highest |\n|---|---|---|---|")
    for name, found in figures.items():
        more = [each - other for each, other in zip(found, bare, strict=True)]
        span = f"{min(more):.0f} to {max(more):.0f}"
        print(f"| {name} | {statistics.median(found):.0f} | {statistics.median(more):.0f} | {span} |")
    if options.json:
        options.json.write_text(json.dumps(figures))


if __name__ == "__main__":
    main()

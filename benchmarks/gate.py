"""What the gate in a node without Midstride's API costs per message: processor time, beside the same node without it.

The node publishes in a loop through a library that stands in for librcl, so nothing but the gate differs. The runs are
interleaved; a figure is the median over the runs, with the lowest and the highest.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
from pathlib import Path

from midstride.foreign import build
from midstride.foreign.page import OPEN, OUTPUT, Page, PortFlag

SOURCES = Path(__file__).resolve().parents[1] / "tests" / "foreign"
LOG_SIZE = 16 + 24 * 4_000_000


def measure(folder: Path, runs: int, messages: int) -> dict[str, list[float]]:
    compiler = build.compiler()
    assert compiler is not None, "there is no C compiler"
    options = [*compiler, "-std=c11", "-O2"]
    subprocess.run([*options, "-shared", "-fPIC", "-o", folder / "librcl.so", SOURCES / "fake_rcl.c"], check=True)
    subprocess.run([*options, "-o", folder / "node", SOURCES / "fake_node.c", "-L", folder, "-lrcl"], check=True)
    library = build.library()
    page = Page(folder / "page", library)
    index = page.allocate("node")
    page.set_ports(index, [("/chat", OUTPUT)])
    port = page.layout.nodes[index].ports[0]
    port.flags, port.baton, port.gate = PortFlag.RATED | PortFlag.LAYS, page.new_baton(index), OPEN
    log = folder / "log"
    base = {**os.environ, "LD_LIBRARY_PATH": str(folder), "FAKE_LOG": str(log)}
    loaded = {**base, "LD_PRELOAD": str(library)}
    gated = {**loaded, "MIDSTRIDE_GATE_PAGE": str(page.path), "MIDSTRIDE_GATE_NODE": str(index)}
    figures: dict[str, list[float]] = {"bare": [], "library, no page": [], "gate": []}
    for _ in range(runs):
        for (_, found), environment in zip(figures.items(), (base, loaded, gated), strict=True):
            log.write_bytes(b"")
            os.truncate(log, LOG_SIZE)
            command = [str(folder / "node"), "1", "/chat", "0", str(messages), "time"]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            found.append(float(done.stdout))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--messages", type=int, default=2_000_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder), options.runs, options.messages)
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

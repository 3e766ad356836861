"""What open dashboards cost the data plane: the hand-over of benchmarks/swap on real ROS 2, with and without five tabs.

One system, one manager, one recorder; swaps in blocks that take turns, so that what else the machine does strikes all:
without a client; with five clients of the live view that draw nothing, as a robot has them whose page is open
elsewhere; and with five tabs of Chromium on the same machine, through the gateway that `midstride dashboard` runs.
Clients, browser and gateway have a lower priority (nice 10) than the system.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from _guard import guard
from playwright.sync_api import Browser, sync_playwright

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

sys.path.append(str(HERE.parent))

from dashboard import spent  # noqa: E402

from benchmarks.swap import hosts  # noqa: E402
from benchmarks.swap.judging import judged  # noqa: E402
from benchmarks.swap.measure import Window  # noqa: E402
from benchmarks.swap.streams import Host, Stream, recording  # noqa: E402
from benchmarks.swap.summary import COUNTS, summary  # noqa: E402
from benchmarks.swap.systems import NAME, System, with_api  # noqa: E402

STREAM = Stream()
COLUMNS = ("watched by", "swaps", "gap_median", "gap_max", *COUNTS)
# How long a page may take to show its graph on a busy machine, and rests before it is measured (s).
PATIENCE, SETTLE = 60.0, 3.0
# Longer than any block (s).
FOREVER = 3600


@contextmanager
def gateway(system: System) -> Iterator[str]:
    """The address of a gateway to the system's dashboard, which runs inside."""
    process = system.command("dashboard", NAME, "--no-browser", preexec_fn=lambda: os.nice(10))
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        url = re.search(r"http://\S+", line)
        if url is None:
            raise SystemExit(f"the gateway has not begun: {line}")
        yield url[0]
    finally:
        process.terminate()
        process.wait()


def swap(system: System) -> Window:
    """By the API, as every client."""
    time.sleep(STREAM.tail)
    begun = time.monotonic_ns()
    outcome = system.change()
    return Window(begun, time.monotonic_ns(), None if outcome.outcome == "done" else str(outcome.because))


@contextmanager
def streams(system: System, number: int) -> Iterator[None]:
    """So many clients of the live view that draw nothing."""
    command = ["nice", "-n", "10", sys.executable, str(HERE / "dashboard.py"), "--clients", str(system.socket)]
    process = subprocess.Popen([*command, str(number), str(FOREVER)], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def tabs(browser: Browser, url: str, number: int) -> Iterator[None]:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    for _ in range(number):
        page = context.new_page()
        page.goto(url)
        page.wait_for_selector(".graph .component[transform]", timeout=PATIENCE * 1000)
    yield
    shown = [page.locator("#connection").inner_text() for page in context.pages]
    if shown != ["● live"] * number:
        raise SystemExit(f"the tabs were not live: {shown}")
    context.close()


def measure(options: argparse.Namespace, host: Host, chromium: str) -> list[dict[str, Any]]:
    """A row for each kind of watching: the figures of its swaps, and the share of a core that the manager took."""
    number = options.tabs
    names = ["no tab", f"{number} streams", f"{number} tabs"]
    windows: list[list[Window]] = [[] for _ in names]
    taken, lasted = [0.0] * len(names), [0.0] * len(names)
    with ExitStack() as context:
        folder = Path(context.enter_context(tempfile.TemporaryDirectory(prefix="ms")))
        system = System(host, with_api(host.nodes, STREAM), folder)
        recorded = context.enter_context(recording(host, STREAM, folder / "rows.jsonl"))
        context.enter_context(system.up())
        url = context.enter_context(gateway(system))
        launcher = folder / "chromium"
        launcher.write_text(f'#!/bin/sh\nexec nice -n 10 {chromium} "$@"\n')
        launcher.chmod(0o700)
        playwright = context.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=launcher, args=["--no-sandbox"])
        context.callback(browser.close)
        for block in range(len(names) * options.blocks):
            place = (block + block // len(names)) % len(names)  # each round begins with another one
            watching: AbstractContextManager[None] = [
                nullcontext(),
                streams(system, number),
                tabs(browser, url, number),
            ][place]
            with watching:
                time.sleep(SETTLE)
                begun, before = time.monotonic(), spent(system.manager)
                windows[place] += [swap(system) for _ in range(options.swaps)]
                taken[place] += spent(system.manager) - before
                lasted[place] += time.monotonic() - begun
    rows = []
    for name, own, spent_, seconds in zip(names, windows, taken, lasted, strict=True):
        back = [each.taken_back for each in own if each.taken_back is not None]
        figures = [judged(recorded.rows, each.begun, each.ended, STREAM.period) for each in own]
        found = summary(figures, STREAM.period, len(back))
        rows.append(
            {
                "watched by": name,
                "swaps": len(found.gaps),
                "gap_median": found.median,
                "gap_max": max(found.gaps),
                **found.counts,
                "taken_back": back,
                "manager": spent_ / seconds,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tabs", type=int, default=5)
    parser.add_argument("--blocks", type=int, default=10, help="of each kind")
    parser.add_argument("--swaps", type=int, default=10, help="in each block")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "dashboard_swap.json")
    options = parser.parse_args()
    guard()
    chromium = shutil.which("chromium")
    if chromium is None:
        print("skipped: Chromium is not installed (tools/browser)")
        return
    os.environ.setdefault("ROS_DOMAIN_ID", "87")
    with hosts.ros2() as host:
        rows = measure(options, host, chromium)
    print("  ".join(f"{column:>11}" for column in COLUMNS) + "  manager, of a core")
    for row in rows:
        cells = [f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in (row[name] for name in COLUMNS)]
        print("  ".join(f"{cell:>11}" for cell in cells) + f"{100 * row['manager']:>18.1f} %")
        for because in row["taken_back"]:
            print(f"            one was taken back: {because}")
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps({"load": os.getloadavg()[0], "results": rows}, indent=1))


if __name__ == "__main__":
    main()

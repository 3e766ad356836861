"""What open dashboards cost the data plane: the swap of benchmarks/swap.py on real ROS 2, with and without five tabs.

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
import urllib.request
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from _guard import guard
from playwright.sync_api import Browser, sync_playwright

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from dashboard import spent  # noqa: E402
from swap import TAIL, Platform, Way, recorded, specification, summary  # noqa: E402

from midstride.codec.specification_form import encode_specification  # noqa: E402

SYSTEM = "swap_benchmark"
COLUMNS = ("way", "swaps", "gap_median", "gap_p99", "gap_max", "missed", "lost", "duplicates")
# How long a page may take to show its graph on a busy machine, and rests before it is measured (s).
PATIENCE, SETTLE = 60.0, 3.0
# Longer than any block (s).
FOREVER = 3600


class System:
    """The benchmark's system, brought up by the command line, and changed over HTTP."""

    def __init__(self, platform: Platform, folder: Path) -> None:
        self._environment = {**platform.env, "XDG_RUNTIME_DIR": str(folder)}
        self._file = folder / "swap.json"
        self._file.write_text(json.dumps(encode_specification(specification(platform))))
        self._component, self._other = "OtherSource", "Source"
        self._folder = folder / "midstride" / SYSTEM

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "midstride", *words]

    @contextmanager
    def up(self) -> Iterator[None]:
        up = self.command("up", str(self._file), "--backend", "ros2", "--detach")
        subprocess.run(up, env=self._environment, check=True, stdout=subprocess.DEVNULL, timeout=120)
        try:
            yield
        finally:
            down = self.command("down", "--system", SYSTEM)
            subprocess.run(down, env=self._environment, check=False, stdout=subprocess.DEVNULL, timeout=120)

    @property
    def socket(self) -> Path:
        return self._folder / "manager.sock"

    @property
    def manager(self) -> int:
        return int((self._folder / "lock").read_text())

    @contextmanager
    def gateway(self) -> Iterator[str]:
        words = ["nice", "-n", "10", *self.command("dashboard", SYSTEM, "--no-browser")]
        process = subprocess.Popen(words, env=self._environment, stdout=subprocess.PIPE, text=True)
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

    def swap(self, way: Way, url: str) -> None:
        """By the API, as every client."""
        time.sleep(TAIL)
        begun = time.monotonic_ns()
        outcome = change(url, {"request": {"replace": [["source", self._component]]}})
        way.windows.append((begun, time.monotonic_ns()))
        way.own.extend(outcome["swaps"])
        way.lost_seconds.append(sum(outcome["below_baseline_seconds"].values()))
        if outcome["outcome"] == "done":
            self._component, self._other = self._other, self._component
        elif outcome["outcome"] == "rolled_back":
            way.rolled_back.append(str(outcome["because"]))
        else:
            raise SystemExit(f"{way.name}: {outcome['because']}")


def change(url: str, document: dict[str, Any]) -> dict[str, Any]:
    address, _, token = url.partition("/?token=")
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    request = urllib.request.Request(f"{address}/api/v1/change", json.dumps(document).encode(), headers)
    with urllib.request.urlopen(request, timeout=120) as answer:
        return dict(json.load(answer))


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


def measure(options: argparse.Namespace, platform: Platform, chromium: str) -> tuple[list[Way], list[float]]:
    """The ways, and the share of a core that the manager took in each."""
    number = options.tabs
    ways = [Way("no tab"), Way(f"{number} streams"), Way(f"{number} tabs")]
    taken, lasted = [0.0] * len(ways), [0.0] * len(ways)
    with ExitStack() as context:
        folder = Path(context.enter_context(tempfile.TemporaryDirectory(prefix="ms")))
        system = System(platform, folder)
        context.enter_context(recorded(ways[0], platform))
        context.enter_context(system.up())
        url = context.enter_context(system.gateway())
        launcher = folder / "chromium"
        launcher.write_text(f'#!/bin/sh\nexec nice -n 10 {chromium} "$@"\n')
        launcher.chmod(0o700)
        playwright = context.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=launcher, args=["--no-sandbox"])
        context.callback(browser.close)
        for block in range(len(ways) * options.blocks):
            place = (block + block // len(ways)) % len(ways)  # each round begins with another one
            watching: AbstractContextManager[None] = [
                nullcontext(),
                streams(system, number),
                tabs(browser, url, number),
            ][place]
            with watching:
                time.sleep(SETTLE)
                begun, before = time.monotonic(), spent(system.manager)
                for _ in range(options.swaps):
                    system.swap(ways[place], url)
                taken[place] += spent(system.manager) - before
                lasted[place] += time.monotonic() - begun
    for way in ways:
        way.rows = ways[0].rows
    return ways, [one / other for one, other in zip(taken, lasted, strict=True)]


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
    from _tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "87")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    platform = Platform("ros2", sys.executable, HERE / "_swap_nodes.py", "std_msgs/msg/String", dict(os.environ))
    ways, shares = measure(options, platform, chromium)
    print("  ".join(f"{column:>10}" for column in COLUMNS) + "  manager, of a core")
    rows = []
    for way, share in zip(ways, shares, strict=True):
        row = summary(way)
        rows.append({**row, "manager": share})
        cells = [f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in (row[name] for name in COLUMNS)]
        print("  ".join(f"{cell:>10}" for cell in cells) + f"{100 * share:>18.1f} %")
        for because in row["rolled_back"]:
            print(f"            one was taken back: {because}")
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps({"load": os.getloadavg()[0], "results": rows}, indent=1))


if __name__ == "__main__":
    main()

"""Whether memory stays flat while the dashboard is open and much changes: the page's heap, the manager and its gateway.

The manager of benchmarks/dashboard.py, whose 500 nodes are made up, and of which 150 change at 10 Hz; the gateway of
`midstride dashboard`; and the page in headless Chromium, with the groups open that change. The heap is what is in use
after a collection that is forced before each sample. What is bounded fills first (the manager keeps its latest 10,000
events, which takes 42 minutes here), so the slope is that of the second half.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from _guard import guard
from playwright.sync_api import Page, sync_playwright

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from dashboard import resident, served  # noqa: E402

# Those groups of the manager's whose nodes change: it has 10, and nodes change in the order of their names.
GROUP_OF, SETTLE = 10, 20.0
SAMPLES = ("page", "shapes", "manager", "gateway")
UNITS = {"page": "MB", "shapes": "", "manager": "MB", "gateway": "MB"}


@contextmanager
def gateway(socket: Path) -> Iterator[tuple[int, str]]:
    """The gateway while the context is open: the id of its process, and its URL."""
    command = [sys.executable, __file__, "--gateway", str(socket)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        if not url:
            raise SystemExit("the gateway has not begun")
        yield process.pid, url
    finally:
        process.kill()  # nothing runs that it would have to leave in order
        process.wait()


def serve_gateway(socket: Path) -> None:
    """What `midstride dashboard` runs; it would not find a manager that has no state."""
    from midstride.server.auth import new_token
    from midstride.server.gateway import listen, run_gateway

    token = new_token()
    with listen(None) as listening:
        print(f"http://127.0.0.1:{listening.getsockname()[1]}/?token={token}", flush=True)
        asyncio.run(run_gateway(listening, socket, "ring", token))


def opened(context: ExitStack, url: str, groups: list[str]) -> Page:
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is not installed (tools/browser)")
    playwright = context.enter_context(sync_playwright())
    browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
    context.callback(browser.close)
    page = browser.new_context(viewport={"width": 1920, "height": 1080}).new_page()
    page.set_default_timeout(600_000)
    page.goto(url)
    for group in groups:
        page.locator(f'.collapsed[data-group="{group}"]').dispatch_event("click")
        page.wait_for_selector(f'.handle[data-group="{group}"]', state="attached")
    page.locator(".component").first.dispatch_event("click")  # its details have figures; from afar, the graph has none
    return page


def sample(page: Page, session: Any, manager: int, gateway_process: int) -> dict[str, float]:
    session.send("HeapProfiler.collectGarbage")
    return {
        "page": session.send("Runtime.getHeapUsage")["usedSize"] / 1e6,
        "shapes": session.send("Memory.getDOMCounters")["nodes"],
        "manager": resident(manager),
        "gateway": resident(gateway_process),
    }


def changes(page: Page) -> bool:
    """Whether the picture still follows the system: a test of a page that stands still would show flat memory too."""
    shown = "() => document.querySelector('#details').textContent"
    before = page.evaluate(shown)
    page.wait_for_timeout(2_000)
    return bool(page.evaluate(shown) != before) and page.locator("#connection").inner_text() == "● live"


def slope(rows: list[dict[str, float]], name: str) -> float:
    """Of the second half, per hour."""
    half = rows[len(rows) // 2 :]
    return statistics.linear_regression([row["at"] for row in half], [row[name] for row in half]).slope * 3600


def measured(options: argparse.Namespace) -> tuple[list[dict[str, float]], bool]:
    """The samples, and whether the page still followed the system after the last of them."""
    with ExitStack() as context:
        manager, socket = context.enter_context(served(options, modes=False, view=True))
        process, url = context.enter_context(gateway(socket))
        groups = [f"g:/group_{number}" for number in range(options.changing * GROUP_OF // options.nodes)]
        page = opened(context, url, groups)
        page.wait_for_timeout(SETTLE * 1000)
        session = page.context.new_cdp_session(page)
        session.send("HeapProfiler.enable")
        rows: list[dict[str, float]] = []
        begun = time.monotonic()
        with suppress(KeyboardInterrupt):  # what has been seen by then is shown
            while (at := time.monotonic() - begun) <= options.seconds:
                rows.append({"at": at, **sample(page, session, manager, process)})
                time.sleep(max(0.0, options.every - (time.monotonic() - begun - at)))
        return rows, changes(page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--every", type=float, default=10.0, help="how often memory is looked at (s)")
    parser.add_argument("--nodes", type=int, default=500)
    parser.add_argument("--changing", type=int, default=150, help="of the nodes")
    parser.add_argument("--rate", type=float, default=10.0, help="how often these change (Hz)")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "dashboard_memory.json")
    options = parser.parse_args()
    guard()
    rows, followed = measured(options)
    print(f"{options.nodes} nodes, {options.changing} change at {options.rate:g} Hz, {rows[-1]['at']:.0f} s")
    print(f"{'':>10}{'first':>10}{'median':>10}{'largest':>10}{'last':>10}{'per hour, second half':>24}")
    for name in SAMPLES:
        values = [row[name] for row in rows]
        cells = [values[0], statistics.median(values), max(values), values[-1]]
        shown = "".join(f"{cell:>10.1f}" for cell in cells)
        print(f"{name:>10}{shown}{slope(rows, name):>+20.2f} {UNITS[name]}")
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps({"seconds": options.seconds, "followed": followed, "rows": rows}, indent=1))
    if not followed:
        raise SystemExit("the page does not follow the system any more: these figures say nothing of a page that does")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--gateway", path]:
            serve_gateway(Path(path))
        case _:
            main()

"""The dashboard's page in headless Chromium: how soon a large graph is there, frames while much changes, late changes.

The views are made up and served from here, so that the figures are those of the page; what the manager spends on
views is measured elsewhere. The browser has no cache and no stored layout. Without a graphics card, Chromium draws on
the processor.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
from _guard import guard
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from midstride.runtime.records.status_forms import InstanceStatus  # noqa: E402
from tests.browser.synthetic import MODES, Synthetic, functionality, large, serving  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results" / "dashboard_page.json"
NODES, TOPICS = 500, 1500
# Until a new window has made its own toolbars (s): a page is asked for in a browser that is there.
SETTLED = 3.0
CHANGING, PER_SECOND, SECONDS = 150, 10.0, 10.0
LAID_OUT_LIMIT, FRAMES_LIMIT, SEEN_LIMIT = 1.0, 60.0, 0.1

# When the first shape has its place, in milliseconds after the page was asked for; drawn with the next frame.
_WATCH_LAYOUT = """
window.laidOut = new Promise((resolve) => {
  const look = () => document.querySelector(".graph .nodes [transform]")
    ? requestAnimationFrame(() => resolve(performance.now())) : requestAnimationFrame(look);
  look();
});
"""
_FRAMES = """(milliseconds) => new Promise((resolve) => {
  const frames = [];
  const begun = performance.now();
  const step = (now) => {
    frames.push(now);
    now - begun < milliseconds ? requestAnimationFrame(step) : resolve(frames);
  };
  requestAnimationFrame(step);
})"""
# The time of the frame in which the first component shows another mode, in unix milliseconds.
_NEXT_CHANGE = """(name) => new Promise((resolve) => {
  const element = document.querySelector(`.component[data-name="${name}"]`);
  new MutationObserver((_, observer) => {
    observer.disconnect();
    requestAnimationFrame(() => resolve(Date.now()));
  }).observe(element, {attributes: true, attributeFilter: ["data-kind"]});
})"""


@dataclass(frozen=True)
class Figures:
    """Times in seconds. ``load``: how many processes waited for a processor, with ``cores`` of them there."""

    laid_out: list[float]
    frames_per_second: float
    slow_frames: float
    longest_frame: float
    seen: list[float]
    cores: int
    load: float


def opened(browser: Browser, synthetic: Synthetic) -> tuple[Page, float]:
    """The page of ``synthetic`` in a new profile, and after how many seconds its graph was laid out."""
    page = browser.new_context(viewport={"width": 1920, "height": 1080}).new_page()
    page.add_init_script(_WATCH_LAYOUT)
    page.set_default_timeout(120_000)
    page.wait_for_timeout(SETTLED * 1000)
    page.goto(synthetic.url, wait_until="commit")
    return page, page.evaluate("window.laidOut") / 1000


def measure_layout(browser: Browser, runs: int) -> list[float]:
    with serving(Synthetic(large(NODES, TOPICS))) as synthetic:
        found = []
        for _ in range(runs):
            page, seconds = opened(browser, synthetic)
            found.append(seconds)
            page.context.close()
    return found


def changed(found: InstanceStatus, drawn: random.Random) -> InstanceStatus:
    ports = [msgspec.structs.replace(each, rate=round(drawn.uniform(8.5, 10.5), 2)) for each in found.ports]
    mode = functionality("work", drawn.choice(MODES))
    return msgspec.structs.replace(found, ports=ports, functionalities=[mode])


def measure_changes(browser: Browser) -> tuple[list[float], list[float]]:
    """The times of frames (s) while components change, and how late one of the changes was seen (s)."""
    drawn = random.Random(5)
    with serving(Synthetic(large(CHANGING, CHANGING * 2, groups=10))) as synthetic:
        page, _ = opened(browser, synthetic)
        page.get_by_role("button", name="Open all groups").click()
        page.wait_for_selector(".component[transform]")
        assert page.locator(".component").count() == CHANGING
        page.wait_for_timeout(2000)
        page.evaluate(f"() => {{ window.frames_ = ({_FRAMES})({SECONDS * 1000}); }}")
        begun = time.monotonic()
        rounds = 0
        while time.monotonic() - begun < SECONDS:
            synthetic.patch([changed(each, drawn) for each in synthetic.components.values()])
            rounds += 1
            time.sleep(max(0.0, begun + rounds / PER_SECOND - time.monotonic()))
        stamps = page.evaluate("window.frames_")
        seen = []
        name = next(iter(synthetic.components))
        for number in range(20):
            page.evaluate(f"() => {{ window.seen_ = ({_NEXT_CHANGE})({json.dumps(name)}); }}")
            page.wait_for_timeout(50)
            found = msgspec.structs.replace(
                synthetic.components[name], functionalities=[functionality("work", MODES[number % 2])]
            )
            if synthetic.components[name].functionalities == found.functionalities:
                continue
            sent = time.time()
            synthetic.patch([found])
            seen.append(page.evaluate("window.seen_") / 1000 - sent)
        page.context.close()
    return [(after - before) / 1000 for before, after in pairwise(stamps)], seen


def table(figures: Figures) -> str:
    late = max(figures.seen)
    rows = [
        (f"graph of {NODES} nodes, {TOPICS} topics laid out", f"{statistics.median(figures.laid_out):.2f} s", "1 s"),
        ("  the slowest", f"{max(figures.laid_out):.2f} s", ""),
        (f"frames/s, {CHANGING} components at {PER_SECOND:g} Hz", f"{figures.frames_per_second:.1f}", "60"),
        ("  frames that took over 1.5 periods", f"{figures.slow_frames:.1%}", ""),
        ("  the longest frame", f"{figures.longest_frame * 1000:.0f} ms", ""),
        ("a change seen after, median", f"{statistics.median(figures.seen) * 1000:.0f} ms", "100 ms"),
        ("  the latest", f"{late * 1000:.0f} ms", ""),
    ]
    lines = [f"{what:<48}{found:>10}{limit:>10}" for what, found, limit in [("", "measured", "aim"), *rows]]
    return "\n".join([*lines, f"load of the machine: {figures.load:.1f} on {figures.cores} cores"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="how often the large graph is opened")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    guard()
    chromium = shutil.which("chromium")
    if chromium is None:
        print("skipped: Chromium is not installed (tools/browser)")
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        laid_out = measure_layout(browser, options.runs)
        frames, seen = measure_changes(browser)
        browser.close()
    figures = Figures(
        laid_out=laid_out,
        frames_per_second=len(frames) / sum(frames),
        slow_frames=sum(each > 1.5 / FRAMES_LIMIT for each in frames) / len(frames),
        longest_frame=max(frames),
        seen=seen,
        cores=os.cpu_count() or 0,
        load=os.getloadavg()[0],
    )
    print(table(figures))
    document: dict[str, Any] = asdict(figures)
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()

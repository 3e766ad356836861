"""screenshots.py FOLDER: pictures of the dashboard, of systems on the simulator and of a large one that is made up."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.browser.conftest import System, system  # noqa: E402
from tests.browser.synthetic import Synthetic, large, serving  # noqa: E402
from tests.cli.conftest import EXAMPLES  # noqa: E402

WIDE: ViewportSize = {"width": 1440, "height": 810}
PHONE: ViewportSize = {"width": 390, "height": 844}
# The simulator's first rates are measured over a window that fills slowly on a busy machine (ms).
SETTLED = 8_000


def opened(browser: Browser, system: System, **options: object) -> Page:
    page = system.context(browser, **{"viewport": WIDE, "device_scale_factor": 1.5, **options}).new_page()
    page.goto(system.url)
    page.wait_for_selector(".graph .component[transform]")
    page.wait_for_timeout(SETTLED)
    return page


def take(browser: Browser, folder: Path) -> None:
    with system("talker", EXAMPLES / "talker" / "talker.stride") as talker:
        page = opened(browser, talker)
        page.locator('.component[data-name="listener"]').click()
        page.screenshot(path=folder / "dashboard-talker.png")
        page.context.close()
        page = opened(browser, talker, viewport=PHONE, device_scale_factor=2, is_mobile=True, has_touch=True)
        page.screenshot(path=folder / "dashboard-phone.png")
        page.context.close()
    with serving(Synthetic(large(500, 1500))) as synthetic:
        page = browser.new_context(viewport=WIDE, device_scale_factor=1.5).new_page()
        page.goto(synthetic.url)
        page.wait_for_selector(".graph .collapsed[transform]")
        page.wait_for_timeout(1_000)
        page.screenshot(path=folder / "dashboard-large.png")
        page.context.close()
    with system("patrol", EXAMPLES / "patrol" / "patrol.stride") as patrol:
        page = opened(browser, patrol, color_scheme="dark")
        page.locator('.component[data-name="fusion"]').click()
        page.screenshot(path=folder / "dashboard-patrol.png")
        page.context.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is not installed: tools/browser")
    options.folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        take(browser, options.folder)
        browser.close()


if __name__ == "__main__":
    main()

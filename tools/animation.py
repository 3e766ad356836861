"""animation.py FILE.svg: a swap on the dashboard, as an animation of the real page.

`make animation` writes docs/pictures/dashboard-swap.svg, which the README shows. The talker of the example is replaced
on the simulator; the page is photographed as fast as the browser allows, and of each photograph the file has the parts
that differ from the one before, in WebP as Chromium writes it. Only pauses are shortened.
"""

from __future__ import annotations

import argparse
import base64
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from playwright.sync_api import Browser, Page, expect, sync_playwright

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.browser.conftest import system  # noqa: E402
from tests.browser.test_changes import choose, press  # noqa: E402
from tests.cli.conftest import EXAMPLES  # noqa: E402

TITLE: Final = "The dashboard: a replacement of the talker is planned, carried out, and its gap is shown"
WIDTH, HEIGHT = 1120, 640
SCALE: Final = 1.0
# How long the page rests before and after (s), and the longest pause in between.
SETTLED, BEFORE, LOOK, END, PAUSE = 8.0, 1.0, 2.0, 4.0, 1.5
INTERVAL: Final = 0.25  # between two photographs (s)
TILE: Final = 160  # px
LARGEST: Final = 600_000  # bytes of the file
# The parts of a photograph that differ from the one before, at most one in each tile: [x, y, width, height, data URL].
DIFFERENCES: Final = """async ([url, tile]) => {
  const image = await createImageBitmap(await (await fetch(url)).blob());
  const { width, height } = image;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const pixels = new Uint32Array(context.getImageData(0, 0, width, height).data.buffer);
  const before = window.before;
  window.before = pixels;
  const part = (left, top, right, bottom) => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [right - left, bottom - top];
    canvas.getContext("2d").drawImage(image, -left, -top);
    return [left, top, canvas.width, canvas.height, canvas.toDataURL("image/webp", 0.9)];
  };
  if (before === undefined) return [part(0, 0, width, height)];
  const found = [];
  for (let y0 = 0; y0 < height; y0 += tile) {
    for (let x0 = 0; x0 < width; x0 += tile) {
      let [left, top, right, bottom] = [width, height, 0, 0];
      for (let y = y0; y < Math.min(y0 + tile, height); y++) {
        for (let x = x0; x < Math.min(x0 + tile, width); x++) {
          if (pixels[y * width + x] === before[y * width + x]) continue;
          [left, right] = [Math.min(left, x), Math.max(right, x + 1)];
          [top, bottom] = [Math.min(top, y), y + 1];
        }
      }
      if (right > 0) found.push(part(left, top, right, bottom));
    }
  }
  return found;
}"""


# When it is shown (s), and what: the place of each part (px), and its picture.
Shown: TypeAlias = tuple[float, list[tuple[int, int, int, int, str]]]


@dataclass(frozen=True)
class Photograph:
    """What the page showed at a time (s)."""

    at: float
    png: bytes


class Camera:
    """Photographs a page, and leaves out what lasts too long."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._begun = time.monotonic()
        self.taken: list[Photograph] = []

    def take(self) -> None:
        due = self.taken[-1].at + INTERVAL if self.taken else 0.0
        time.sleep(max(0.0, due - (time.monotonic() - self._begun)))
        at = time.monotonic() - self._begun
        self.taken.append(Photograph(at, self._page.screenshot(animations="allow", caret="hide")))

    def watch(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.take()


def photographs(browser: Browser) -> list[Photograph]:
    with system("talker", EXAMPLES / "talker" / "talker.stride") as talker:
        context = talker.context(
            browser, viewport={"width": WIDTH, "height": HEIGHT}, device_scale_factor=SCALE, color_scheme="light"
        )
        page = context.new_page()
        page.goto(talker.url)
        page.wait_for_selector(".graph .component[transform]")
        page.wait_for_timeout(SETTLED * 1000)  # the first rates are measured over a window that fills
        camera = Camera(page)
        camera.watch(BEFORE)
        choose(page, "talker", "NewTalker")
        camera.watch(BEFORE)
        press(page, "Plan")
        camera.watch(LOOK)
        press(page, "Execute")
        done = page.locator("#change .outcome")
        while done.count() == 0:
            camera.take()
        expect(done).to_contain_text("Done in")
        counts = page.locator("#change .counts").inner_text()
        camera.watch(LOOK)
        context.close()
        if talker.faults:
            raise SystemExit(f"animation: the page had errors: {talker.faults}")
        if "missed 0, lost 0, duplicates 0" not in counts:
            raise SystemExit(f"animation: the machine is too busy for the simulator: {counts}")
    return camera.taken


def changed(browser: Browser, taken: list[Photograph]) -> list[Shown]:
    """What changed, and when it is shown (s): pauses in which nothing changes are shortened."""
    page = browser.new_page()
    found: list[Shown] = []
    shown, last = 0.0, taken[0].at
    for each in taken:
        url = f"data:image/png;base64,{base64.b64encode(each.png).decode()}"
        differing = page.evaluate(DIFFERENCES, [url, TILE])
        if differing:
            shown += min(each.at - last, PAUSE)
            last = each.at
            found.append((shown, differing))
    page.close()
    return found


def svg(shown: list[Shown], duration: float) -> str:
    """Each part lies on those before it from its time on; where motion is not wanted, all do."""
    styles, images = [], []
    for number, (at, parts) in enumerate(shown):
        styles.append(f"@keyframes p{number}{{0%{{opacity:0}}{100 * at / duration:.2f}%{{opacity:1}}}}")
        inside = "".join(
            f'<image x="{x}" y="{y}" width="{width}" height="{height}" href="{url}"/>'
            for x, y, width, height, url in parts
        )
        images.append(f'<g style="animation-name:p{number}">{inside}</g>' if number else f"<g>{inside}</g>")
    box = f'viewBox="0 0 {round(WIDTH * SCALE)} {round(HEIGHT * SCALE)}" width="{WIDTH}"'
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img">',
            f"<title>{TITLE}</title>",
            "<style>",
            f"g{{animation:{duration:.2f}s step-end infinite}}",
            *styles[1:],
            "@media (prefers-reduced-motion:reduce){g{animation:none!important}}",
            "</style>",
            *images,
            "</svg>\n",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    options = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is not installed: tools/browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        shown = changed(browser, photographs(browser))
        browser.close()
    text = svg(shown, shown[-1][0] + END)
    if len(text) > LARGEST:
        raise SystemExit(f"animation: {len(text)} bytes for {len(shown)} pictures; at most {LARGEST} are wanted")
    options.file.write_text(text, encoding="utf-8")
    print(f"{options.file}: {len(shown)} pictures, {len(text) / 1000:.0f} kB")


if __name__ == "__main__":
    main()

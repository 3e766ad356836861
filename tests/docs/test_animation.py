"""The animation in the README: a swap on the real page, small enough to be loaded with it."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"
LARGEST = 600_000  # bytes
ANIMATION = ROOT / "docs" / "pictures" / "dashboard-swap.svg"


def check(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert len(text) <= LARGEST
    root = ElementTree.fromstring(text)
    pictures = root.findall(f"{SVG}g")
    assert len(pictures) > 10
    images = list(root.iter(f"{SVG}image"))
    assert {each.attrib["href"].partition(",")[0] for each in images} == {"data:image/webp;base64"}
    [whole] = pictures[0]
    assert root.attrib["viewBox"] == f"0 0 {whole.attrib['width']} {whole.attrib['height']}"
    assert "prefers-reduced-motion" in text


def test_the_readme_shows_it() -> None:
    assert f"]({ANIMATION.relative_to(ROOT)})" in (ROOT / "README.md").read_text(encoding="utf-8")
    check(ANIMATION)


@pytest.mark.browser
@pytest.mark.long
def test_the_animation_can_be_made_anew(tmp_path: Path) -> None:
    made = tmp_path / "swap.svg"
    command = [sys.executable, str(ROOT / "tools" / "animation.py"), str(made)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    if "too busy" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    check(made)

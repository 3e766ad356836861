"""The documentation site: built strictly, complete, and readable from the disk without another host."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import midstride

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.full


def build(repository: Path, site: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = ["sh", str(repository / "tools" / "docs"), str(site)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, check=False)


@dataclass
class Page(HTMLParser):
    """What a page refers to, by attribute, and the anchors that it has."""

    path: Path
    ids: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self.feed(self.path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value for name, value in attributes if value is not None}
        if "id" in found:
            self.ids.add(found["id"])
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        elif tag == "link" and found.get("rel") not in ("canonical", "search", "index", "next", "prev"):
            self.loaded.append(found["href"])
        elif tag in ("script", "img", "iframe", "object", "source") and "src" in found:
            self.loaded.append(found["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT, folder)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path.resolve(): Page(path) for path in site.rglob("*.html")}


def test_every_page_of_the_documentation_is_in_it(site: Path) -> None:
    written = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*/README.md"), ROOT / "CHANGELOG.md"]
    assert len(written) > 15
    start = Page(site / "index.html").links
    for page in written:
        assert page.relative_to(ROOT).with_suffix(".html").as_posix() in start, f"{page} is not in the navigation"


def test_every_link_leads_to_a_file_and_an_anchor(pages: dict[Path, Page]) -> None:
    checked = 0
    for path, page in pages.items():
        for link in (*page.links, *page.loaded):
            parts = urlsplit(link)
            if parts.scheme or link == "#":
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert target.is_file(), f"{path.name} links to {link}"
            if parts.fragment and target in pages:
                assert unquote(parts.fragment) in pages[target].ids, f"{path.name} links to {link}"
            checked += 1
    assert checked > 500


def test_nothing_is_loaded_from_another_host(site: Path, pages: dict[Path, Page]) -> None:
    assert sum(len(page.loaded) for page in pages.values()) > 100
    for page in pages.values():
        assert [link for link in page.loaded if urlsplit(link).netloc] == []
    for sheet in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import\s)\s*[\"']?(?:https?:)?//", sheet.read_text(encoding="utf-8")) == []


def test_the_api_page_documents_what_an_author_imports(pages: dict[Path, Page], site: Path) -> None:
    page = pages[(site / "docs" / "reference" / "api.html").resolve()]
    names = {f"midstride.{name}" for name in midstride.__all__ if not name.startswith("__")}
    assert names - page.ids == set()
    assert {"midstride.Component.create_input", "midstride.Input.latest", "midstride.Output.write"} <= page.ids


@pytest.mark.long
def test_a_fault_stops_the_build(tmp_path: Path) -> None:
    """A link to nothing, a page outside the navigation, and a reference in a docstring that nothing has.

    Most pages of the copy have a title only: they take most of the time of a build.
    """
    copy = tmp_path / "copy"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "node_modules", "tests", "site", "__pycache__"))
    for page in [*(copy / "docs").rglob("*.md"), *(copy / "examples").glob("*/README.md"), copy / "CHANGELOG.md"]:
        if page.stem not in ("tutorial", "api"):
            page.write_text("# A title\n", encoding="utf-8")
    (copy / "docs" / "lost.md").write_text("# Lost\n\n[a section](tutorial.md#no-such-section)\n", encoding="utf-8")
    ports = copy / "docs" / "reference" / "api.md"
    ports.write_text(f"{ports.read_text(encoding='utf-8')}\n```{{eval-rst}}\n:func:`midstride.no_such_function`\n```\n")
    done = build(copy, tmp_path / "site")
    assert done.returncode != 0
    assert "local id not found" in done.stderr
    assert "document isn't included in any toctree" in done.stderr
    assert "midstride.no_such_function" in done.stderr

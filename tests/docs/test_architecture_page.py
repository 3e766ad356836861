"""docs/architecture.md: every path exists, the walk is short and connected, and what packages use is what it says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "midstride"
TEXT = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PATH = re.compile(r"(?<![\w./*])(?:[\w.-]+/)*[\w-]+\.(?:py|c|h|js|als|md)\b")
MOST_FILES = 26  # that one opens who follows `midstride replace` to the gate
# The walk goes from one process to the next here: the second of each pair has no import of the first.
ENTERED = ("cli/commands/change_commands.py", "server/http_app.py", "wire/command_server.py")


def walk() -> list[str]:
    block = TEXT.partition("## A change, from the command")[2].partition("\n1. ")[0]
    lines = [line for line in block.splitlines() if line.startswith("    ")]
    return [path for line in lines for path in PATH.findall(line)]


def imported(path: Path) -> Iterator[str]:
    """The modules of `midstride` that a module imports, as paths below the package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("midstride"):
            base = (node.module or "").split(".")[1:]
            yield "/".join(base) + ".py"
            yield from ("/".join([*base, alias.name]) + ".py" for alias in node.names)


def test_every_path_exists() -> None:
    found = set(PATH.findall(TEXT))
    assert len(found) > 60
    places = (SOURCE, ROOT, ROOT / "docs")
    assert {path for path in found if not any((place / path).is_file() for place in places)} == set()


@pytest.mark.parametrize("path", ["runtime/manger.py", "manager.py", "how-to/no-such-page.md"])
def test_a_path_that_does_not_is_found(path: str) -> None:
    [found] = PATH.findall(f"see `{path}` there")
    assert found == path
    assert not (SOURCE / path).is_file() and not (ROOT / "docs" / path).is_file()


def test_the_walk_opens_few_files_each_once() -> None:
    assert len(walk()) == len(set(walk())) <= MOST_FILES
    assert len(walk()) > 20


def test_each_file_of_the_walk_is_used_by_one_before_it_or_uses_one() -> None:
    """A function that one module gives to another is an import the other way round."""
    seen: list[str] = []
    uses = {path: set(imported(SOURCE / path)) for path in walk()}
    for path in walk():
        if path not in ENTERED:
            assert any(path in uses[before] or before in uses[path] for before in seen), path
        seen.append(path)


def test_the_packages_of_the_manager_use_what_the_page_says() -> None:
    rows = re.findall(r"^\| `runtime/(\w+)` \|.*\|([^|]*)\|$", TEXT, re.MULTILINE)
    stated = {package: set(re.findall(r"`(\w+)`", cell)) for package, cell in rows}
    packages = {path.name for path in (SOURCE / "runtime").iterdir() if (path / "__init__.py").is_file()}
    assert set(stated) == packages
    order = re.findall(r"\w+", TEXT.partition("    manager ──▶ ")[2].partition("\n")[0])
    assert set(order) == packages
    for package in sorted(packages):
        used = {
            parts[1]
            for file in (SOURCE / "runtime" / package).glob("*.py")
            for module in imported(file)
            if (parts := module.split("/"))[0] == "runtime" and len(parts) > 2 and parts[1] in packages - {package}
        }
        assert used == stated[package], package
        assert used <= set(order[order.index(package) + 1 :]), package

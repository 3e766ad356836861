"""The list of public names is complete: what their signatures name is in it, and examples and pages import no other."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

import midstride

ROOT = Path(__file__).parents[1]
PUBLIC = sorted(set(midstride.__all__) - {"__version__"})
API = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
# Types that an author meets only as what a public function returns.
MADE_BY = {"AnyOf": "any_of", "Approximate": "approximate", "Guarantee": "guarantee", "Interval": "between"}


def documented() -> dict[str, set[str] | None]:
    """The classes and functions on the page of the API, each with its members on it; None: every public one."""
    found: dict[str, set[str] | None] = {}
    for name, options in re.findall(r"^\.\. (?:auto|py:)\w+:: ([\w.]+)\n((?: +\S.*\n|\n(?=   ))*)", API, re.MULTILINE):
        members = re.search(r":members:(.*)", options)
        found[name] = set(re.split(r",\s*", members[1].strip())) if members and members[1].strip() else None
        if members is None:
            found[name] = set(re.findall(r"auto\w+:: [\w.]+\.(\w+)$", options, re.MULTILINE))
    return found


DOCUMENTED = documented()


def functions(name: str) -> Iterator[tuple[str, FunctionType]]:
    """A public function, or the documented methods and properties of a public class, each with its name."""
    value = getattr(midstride, name)
    if isinstance(value, FunctionType):
        yield name, value
        return
    members = DOCUMENTED[f"midstride.{name}"]
    for base in inspect.getmro(value):
        if not base.__module__.startswith("midstride"):
            continue
        for attribute, member in vars(base).items():
            function = member.fget if isinstance(member, property) else inspect.unwrap(member)
            if not isinstance(function, FunctionType) or attribute.startswith("_") or attribute == "declaration":
                continue
            if members is None or attribute in members:
                yield f"{name}.{attribute}", function


def classes(function: FunctionType) -> Iterator[type[Any]]:
    """The classes of Midstride that the signature of a function names, also in other types."""
    home = vars(sys.modules[function.__module__])
    for annotation in function.__annotations__.values():
        for word in re.findall(r"[A-Za-z_]\w*", str(annotation)):
            found = home.get(word)
            if inspect.isclass(found) and found.__module__.startswith("midstride"):
                yield found


@pytest.mark.parametrize("name", PUBLIC)
def test_every_type_in_a_public_signature_is_public(name: str) -> None:
    assert f"midstride.{name}" in DOCUMENTED, "the page of the API lacks it"
    for where, function in functions(name):
        assert inspect.getdoc(function), f"{where} has no docstring"
        for found in classes(function):
            qualified = f"{found.__module__}.{found.__qualname__}"
            if found.__qualname__ not in PUBLIC and qualified not in DOCUMENTED:
                maker = MADE_BY.get(found.__name__)
                assert maker in PUBLIC, f"{where} names {qualified}, which midstride.__all__ does not"


def test_the_signatures_are_read() -> None:
    named = {found.__name__ for name in PUBLIC for _, function in functions(name) for found in classes(function)}
    assert {*MADE_BY, "Input", "Output", "Parameter", "QoS", "Functionality"} <= named
    assert len(list(functions("Component"))) > 15


def imported(source: str) -> Iterator[str]:
    """The names that a program imports from ``midstride``; with a dot those from within it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "midstride":
            prefix = (node.module or "")[len("midstride") :].lstrip(".")
            yield from (f"{prefix}.{alias.name}" if prefix else alias.name for alias in node.names)


def snippets() -> Iterator[tuple[str, str]]:
    """The Python programs of the examples, and those on the pages of the documentation, each with its place."""
    for path in sorted((ROOT / "examples").rglob("*.py")):
        yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        for number, block in enumerate(re.findall(r"^```python[^\n]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)):
            try:
                ast.parse(block)
            except SyntaxError:  # the part of a program
                continue
            yield f"{page.relative_to(ROOT)}, snippet {number + 1}", block


def test_nodes_of_examples_and_pages_import_public_names_alone() -> None:
    checked = 0
    for where, source in snippets():
        names = list(imported(source))
        if "Component" not in names:  # no node
            continue
        for name in names:
            assert name in midstride.__all__, f"{where} imports {name}"
            checked += 1
    assert checked > 20

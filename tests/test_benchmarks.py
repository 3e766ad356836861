"""The benchmarks use names of Midstride and of the tests that exist, also where they import them only when they run."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# Where the packages are that a benchmark imports.
FOLDERS = {"midstride": ROOT / "src", "tests": ROOT, "benchmarks": ROOT}
PROGRAMS = sorted((ROOT / "benchmarks").rglob("*.py"))


def is_ours(module: str) -> bool:
    """Return whether a module is of Midstride, of the tests or beside the benchmarks, where all have names like _x."""
    top = module.partition(".")[0]
    return top in FOLDERS or (top.startswith("_") and top not in sys.stdlib_module_names)


def source_of(module: str) -> Path | None:
    """The file of a module of ours; None where there is none."""
    path = FOLDERS.get(module.partition(".")[0], ROOT / "benchmarks") / module.replace(".", "/")
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)


def names_of(source: Path) -> Iterator[str]:
    """The names that a module has."""
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from (each.asname or each.name for each in node.names)
    if source.name == "__init__.py":
        yield from (each.stem for each in source.parent.iterdir())


def missing(program: str, package: str = "benchmarks") -> list[str]:
    """What a program of a package imports of ours, and is not there."""
    found = []
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Import):
            found += [each.name for each in node.names if is_ours(each.name) and source_of(each.name) is None]
        elif isinstance(node, ast.ImportFrom) and node.module:
            module = f"{package}.{node.module}" if node.level == 1 else node.module
            if not is_ours(module):
                continue
            source = source_of(module)
            names = set() if source is None else {*names_of(source)}
            if source is None or "__getattr__" not in names:
                found += [f"{module}.{each.name}" for each in node.names if each.name not in names]
    return found


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: str(path.relative_to(ROOT / "benchmarks")))
def test_what_a_benchmark_imports_is_there(path: Path) -> None:
    package = ".".join(path.relative_to(ROOT).parent.parts)
    assert missing(path.read_text(encoding="utf-8"), package) == []


def test_what_is_not_there_is_found() -> None:
    program = """
from __future__ import annotations
import json, midstride.runtime.workspace, midstride.runtime.gone, tests.gone, _tuned, _gone
from benchmarks._guard import guard, gone
from tests.native import compiled, uncompiled
from tests.plan import systems, system
from .check import ROOT, roots

def main():
    from midstride.backends.ros2.dds_profiles import choose, tuned
    from _gone import x
"""
    assert missing(program) == [
        "midstride.runtime.gone",
        "tests.gone",
        "_gone",
        "benchmarks._guard.gone",
        "tests.native.uncompiled",
        "tests.plan.system",
        "benchmarks.check.roots",
        "midstride.backends.ros2.dds_profiles.tuned",
        "_gone.x",
    ]

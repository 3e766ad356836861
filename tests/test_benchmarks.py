"""The benchmarks use names of Midstride that exist, also where they import them only when they run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROGRAMS = sorted((ROOT / "benchmarks").glob("*.py"))


def source_of(module: str) -> Path | None:
    """The file of a module of Midstride or of one beside the benchmarks; None where there is none."""
    path = ROOT / ("src" if module.partition(".")[0] == "midstride" else "benchmarks") / module.replace(".", "/")
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


def missing(program: str) -> list[str]:
    """What a program imports of Midstride, or of what is beside it, and is not there."""
    found = []
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(("midstride", "_")):
            if node.module == "__future__":
                continue
            source = source_of(node.module)
            names = set() if source is None else {*names_of(source)}
            if source is None or "__getattr__" not in names:
                found += [f"{node.module}.{each.name}" for each in node.names if each.name not in names]
    return found


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_what_a_benchmark_imports_is_there(path: Path) -> None:
    assert missing(path.read_text(encoding="utf-8")) == []


def test_what_is_not_there_is_found() -> None:
    program = (
        "def main():\n    from midstride.backends.ros2.dds_profiles import choose, tuned\n    from _gone import x\n"
    )
    assert missing(program) == ["midstride.backends.ros2.dds_profiles.tuned", "_gone.x"]

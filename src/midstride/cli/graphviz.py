"""Writes diagrams: dot and Mermaid as text, SVG and PNG through Graphviz."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import click

from midstride.cli.input_files import written
from midstride.errors import MidstrideError

# Graphviz is quick on diagrams that a person can read.
_TIMEOUT = 60.0


def kind_of(path: Path) -> str:
    """The kind of diagram, from the file's suffix. Raises UsageError for an unknown one."""
    kind = path.suffix.lstrip(".").lower()
    if kind not in {"dot", "gv", "mmd", "svg", "png"}:
        raise click.UsageError(f"unknown kind of diagram `{path}`: use a name ending in .svg, .png, .dot or .mmd")
    return kind


def write(path: Path, dot: Callable[[], str], mermaid: Callable[[], str]) -> None:
    """Write a diagram. Raises MidstrideError if the file cannot be written or Graphviz is needed and missing."""
    kind = kind_of(path)
    text = mermaid() if kind == "mmd" else dot()
    data = _graphviz(text, kind) if kind in {"svg", "png"} else text.encode()
    with written(path):
        path.write_bytes(data)


def _graphviz(text: str, kind: str) -> bytes:
    program = shutil.which("dot")
    if program is None:
        raise MidstrideError(
            "SVG and PNG need Graphviz (`dot`), which is not installed; "
            "install your system's package graphviz, or use .dot or .mmd"
        )
    try:
        done = subprocess.run(
            [program, f"-T{kind}"], input=text.encode(), capture_output=True, timeout=_TIMEOUT, check=True
        )
    except subprocess.TimeoutExpired:
        raise MidstrideError(
            f"Graphviz took longer than {_TIMEOUT:g} s; use .dot, or draw less (`graph --collapse`)"
        ) from None
    except subprocess.CalledProcessError as error:
        raise MidstrideError(f"Graphviz failed: {error.stderr.decode(errors='replace').strip()}") from None
    return done.stdout

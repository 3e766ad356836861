"""Writing pictures: dot and Mermaid as they are, SVG and PNG by Graphviz."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import click

from midstride.errors import MidstrideError

# Graphviz is quick on what people draw; what it has not drawn by then nobody could read.
_SECONDS = 60.0


def kind_of(path: Path) -> str:
    """What a file's name says is to be drawn. Raises UsageError where it does not say."""
    kind = path.suffix.lstrip(".").lower()
    if kind not in {"dot", "gv", "mmd", "svg", "png"}:
        raise click.UsageError(f"`{path}` does not say what to draw: its name ends in .svg, .png, .dot or .mmd")
    return kind


def write(path: Path, dot: Callable[[], str], mermaid: Callable[[], str]) -> None:
    """Draw into a file. Raises MidstrideError where it cannot be written, or Graphviz is needed and not there."""
    kind = kind_of(path)
    text = mermaid() if kind == "mmd" else dot()
    data = _graphviz(text, kind) if kind in {"svg", "png"} else text.encode()
    try:
        path.write_bytes(data)
    except OSError as error:
        raise MidstrideError(f"{path} cannot be written: {error.strerror}") from None


def _graphviz(text: str, kind: str) -> bytes:
    program = shutil.which("dot")
    if program is None:
        raise MidstrideError(
            "drawing SVG or PNG needs Graphviz (`dot`), which is not installed; "
            "install your system's package graphviz, or ask for .dot or .mmd"
        )
    try:
        done = subprocess.run(
            [program, f"-T{kind}"], input=text.encode(), capture_output=True, timeout=_SECONDS, check=True
        )
    except subprocess.TimeoutExpired:
        raise MidstrideError(
            f"Graphviz took longer than {_SECONDS:g} s; ask for .dot, or draw less (`graph --collapse`)"
        ) from None
    except subprocess.CalledProcessError as error:
        raise MidstrideError(f"Graphviz failed: {error.stderr.decode(errors='replace').strip()}") from None
    return done.stdout

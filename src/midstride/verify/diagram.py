"""Diagrams of a verdict's findings: as indented text, Graphviz dot and Mermaid.

Beside each finding is its chain: from the functionality through its assumption and inputs to their topics and
publishers. Unsatisfied parts are red.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from textwrap import wrap
from typing import Final

from midstride.verify.verdict import CauseLink, Verdict

_WIDTH: Final = 44
_RED, _GREEN = "#fce8e6", "#e6f4ea"
# Dot's shape of each thing that is not a box.
_SHAPES: Final = {"finding": "note", "assumption": "plaintext", "topic": "ellipse"}


def chain_lines(link: CauseLink, depth: int = 0) -> Iterator[str]:
    """A chain as indented lines, from the functionality down."""
    text = f"{link.name} ({link.detail})" if link.detail else link.name
    yield f"{'  ' * depth}{text}: {'satisfied' if link.satisfied else 'not satisfied'}"
    for under in link.causes:
        yield from chain_lines(under, depth + 1)


@dataclass(frozen=True, slots=True)
class _Box:
    """One box of the diagram, and the box above it. ``thing`` is ``finding``, or that of a link of the chain."""

    id: str
    above: str | None
    thing: str
    lines: tuple[str, ...]
    satisfied: bool


def to_dot(verdict: Verdict) -> str:
    """The findings of a verdict for Graphviz's ``dot``."""
    lines = [
        "digraph verdict {",
        f'  graph [rankdir=LR, fontname="Helvetica", labelloc=t, label="{_dot(verdict.headline)}"];',
        '  node [fontname="Helvetica", fontsize=11, style=filled];',
        '  edge [color="#5f6368", arrowsize=0.7];',
    ]
    for box in _boxes(verdict):
        label = "\\n".join(_dot(line) for line in box.lines)
        colour = _GREEN if box.satisfied else _RED
        lines.append(f'  {box.id} [shape={_SHAPES.get(box.thing, "box")}, fillcolor="{colour}", label="{label}"];')
        if box.above is not None:
            lines.append(f"  {box.above} -> {box.id};")
    return "\n".join([*lines, "}", ""])


def to_mermaid(verdict: Verdict) -> str:
    """The findings of a verdict as a Mermaid flow chart."""
    lines = ["flowchart LR"]
    for box in _boxes(verdict):
        left, right = ('(["', '"])') if box.thing == "topic" else ('["', '"]')
        text = "<br/>".join(_mermaid(line) for line in box.lines)
        lines.append(f"  {box.id}{left}{text}{right}:::{'good' if box.satisfied else 'bad'}")
        if box.above is not None:
            lines.append(f"  {box.above} --> {box.id}")
    lines += [f"  classDef good fill:{_GREEN},stroke:#5f6368", f"  classDef bad fill:{_RED},stroke:#5f6368", ""]
    return "\n".join(lines)


def _boxes(verdict: Verdict) -> Iterator[_Box]:
    for number, finding in enumerate(verdict.findings, start=1):
        name = f"f{number}"
        lines = (*wrap(finding.where, _WIDTH), *wrap(f"{finding.subject}: {finding.because}", _WIDTH))
        yield _Box(name, None, "finding", lines, False)
        if finding.chain is not None:
            yield from _links(finding.chain, f"{name}_1", name)


def _links(link: CauseLink, id: str, above: str) -> Iterator[_Box]:
    yield _Box(id, above, link.kind, (link.name, *wrap(link.detail, _WIDTH)), link.satisfied)
    for number, under in enumerate(link.causes, start=1):
        yield from _links(under, f"{id}_{number}", id)


def _dot(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _mermaid(text: str) -> str:
    """Text with everything escaped that Mermaid could interpret."""
    return "".join(c if c.isalnum() or c in " _-./:," else f"#{ord(c)};" for c in escape(text, quote=False))

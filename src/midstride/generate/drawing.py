"""Renders views as text for Graphviz and Mermaid."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from textwrap import wrap
from typing import Final

from midstride.generate.drawn_system import Box, Edge, Port, TopicNode, View
from midstride.generate.layout import GraphLayout, layout
from midstride.model.contract import ConnectorKind
from midstride.model.wording import KIND_WORDS

_UNBREAKABLE: Final = re.compile(r"(?<=@) | (?=k?Hz)| (?==)|(?<==) ")
_SHAPES: Final[Mapping[ConnectorKind, str]] = {"topic": "ellipse", "service": "hexagon", "action": "octagon"}
_CONNECTOR_COLOURS: Final[Mapping[ConnectorKind, str]] = {"topic": "#ffffff", "service": "#f3e8fd", "action": "#f3e8fd"}
_COLOURS: Final = {"node": "#e8f0fe", "group": "#e6f4ea", "environment": "#fef7e0"}


def to_dot(view: View) -> str:
    """The view for Graphviz's ``dot``: boxes with ports, ovals for topics, dashed lines for the environment.

    A service is a hexagon and a ROS action an octagon; their lines are dotted, and their arrows point at the server,
    which is on the side of publishers all the same: what relies on another node is on the other side of it.
    Inputs are on the side where arrows come from: on the left, or at the top if the drawing runs down the page.
    """
    ids, laid = _ids(view), layout(view)
    direction, spacing = ("TB", 0.4) if laid.down else ("LR", 0.7)
    lines = [
        f"digraph {_quoted(view.title)} {{",
        f'  graph [rankdir={direction}, fontname="Helvetica", nodesep=0.3, ranksep={spacing}];',
        '  node [fontname="Helvetica", fontsize=11];',
        '  edge [fontname="Helvetica", fontsize=9, color="#5f6368", arrowsize=0.7];',
    ]
    drawn: dict[str, str] = {}
    for box in view.boxes:
        drawn[box.id] = f"[shape=plain, label=<{_table(box, laid)}>]"
    for topic in view.topics:
        note = f'<br/><font point-size="9" color="#5f6368">{_wrapped(topic.note)}</font>' if topic.note else ""
        label = f"{escape(_titled(topic))}{note}"
        shape = f'shape={_SHAPES[topic.kind]}, style=filled, fillcolor="{_CONNECTOR_COLOURS[topic.kind]}"'
        style = f'{shape}, color="#5f6368", margin="0.05,0.03"'
        drawn[topic.id] = f"[{style}, label=<{label}>]"
    lines += [f"  {ids[id]} {drawn[id]};" for id in laid.order]
    lines += [f"  {_dot_edge(edge, ids, laid)};" for edge in view.edges]
    return "\n".join([*lines, "}", ""])


def _dot_edge(edge: Edge, ids: dict[str, str], laid: GraphLayout) -> str:
    """An edge. A back edge is reversed, with its arrow head at the other end, so that it does not affect the ranks."""
    out, into = ("s", "n") if laid.down else ("e", "w")
    start = ids[edge.start] + (f":{_quoted('out ' + edge.start_port)}:{out}" if edge.start_port else "")
    end = ids[edge.end] + (f":{_quoted('in ' + edge.end_port)}:{into}" if edge.end_port else "")
    back, called = edge in laid.back, edge.kind != "topic"
    style = ["style=dashed"] if edge.assumed else ["style=dotted"] if called else []
    looks = [*(["dir=back"] if back != called else []), *style]
    return (f"{end} -> {start}" if back else f"{start} -> {end}") + (f" [{', '.join(looks)}]" if looks else "")


def _table(box: Box, laid: GraphLayout) -> str:
    """A box as a table: inputs, then title and functionalities, then outputs; from left to right, or downwards."""
    border = 'style="dashed"' if box.kind == "environment" else 'style="rounded"'
    lines = box.lines if box.kind == "node" else [f"  {line}" for line in box.lines]
    middle = "<br align='left'/>".join(_line(line) for line in lines)
    if middle:
        middle += "<br align='left'/>"
    title, text = f"<b>{escape(box.title)}</b>", f"<td>{middle}</td>" if middle else "<td></td>"
    inputs, outputs = _ports(box.inputs, "in", laid.down), _ports(box.outputs, "out", laid.down)
    if laid.down:
        cells = [inputs] if box.inputs else []
        cells += [f"<td>{title}</td>", *([text] if middle else []), *([outputs] if box.outputs else [])]
        rows = "".join(f"<tr>{cell}</tr>" for cell in cells)
    else:
        rows = f"<tr><td colspan='3'>{title}</td></tr>"
        if box.inputs or box.outputs or box.lines:
            rows += f"<tr>{inputs}{text}{outputs}</tr>"
    attributes = f"bgcolor='{_COLOURS[box.kind]}' border='1' cellborder='0' cellspacing='2' cellpadding='3' {border}"
    return f"<table {attributes}>{rows}</table>"


def _line(line: str) -> str:
    if not line.startswith("  "):
        return f"<i>{escape(line)}</i>"
    text = _wrapped(line.strip(), end="<br align='left'/>")
    return f'<font point-size="9" color="#5f6368">{text}</font>'


def _ports(ports: tuple[Port, ...], side: str, beside: bool) -> str:
    """Ports in a cell, below or ``beside`` each other."""
    if not ports:
        return "<td></td>"
    cells = []
    for port in ports:
        width = 20 if beside and len(ports) > 2 else 34
        note = f'<br/><font point-size="9" color="#5f6368">{_wrapped(port.note, width)}</font>' if port.note else ""
        attributes = f"port='{escape(side + ' ' + port.name)}' border='1' bgcolor='white'"
        cells.append(f"<td {attributes}>{escape(_signed(port))}{note}</td>")
    rows = f"<tr>{''.join(cells)}</tr>" if beside else "".join(f"<tr>{cell}</tr>" for cell in cells)
    return f"<td><table border='0' cellborder='0' cellspacing='2' cellpadding='2'>{rows}</table></td>"


def _wrapped(text: str, width: int = 46, end: str = "<br/>") -> str:
    """``text`` wrapped at spaces; a rate (`@ 10 Hz`) or a setting (`depth = 5`) is not broken."""
    unbroken = _UNBREAKABLE.sub("\u00a0", text)
    return end.join(map(escape, wrap(unbroken, width, break_long_words=False, break_on_hyphens=False)))


def _titled(topic: TopicNode) -> str:
    return topic.name if topic.kind == "topic" else f"{KIND_WORDS[topic.kind].connector} {topic.name}"


def _signed(port: Port) -> str:
    return port.name if port.kind == "topic" else f"⇄ {port.name}"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def to_mermaid(view: View) -> str:
    """The view as a Mermaid flow chart, with ports as labels of the arrows. Those of services point at the server."""
    ids = _ids(view)
    lines = ["flowchart TB" if layout(view).down else "flowchart LR"]
    for box in view.boxes:
        sides = ("in", box.inputs), ("out", box.outputs)
        notes = [
            f"{_side(side, port)} {port.name}: {port.note}" for side, ports in sides for port in ports if port.note
        ]
        text = "<br/>".join([f"<b>{_mermaid(box.title)}</b>", *(_mermaid(line) for line in [*box.lines, *notes])])
        lines.append(f'  {ids[box.id]}["{text}"]:::{box.kind}')
    for topic in view.topics:
        note = f"<br/>{_mermaid(topic.note)}" if topic.note else ""
        left, right = ("([", "])") if topic.kind == "topic" else ("{{", "}}")
        lines.append(f'  {ids[topic.id]}{left}"{_mermaid(_titled(topic))}{note}"{right}:::{topic.kind}')
    for edge in view.edges:
        port = edge.start_port or edge.end_port
        arrow = "-.->" if edge.assumed else "-->"
        label = f"|{_mermaid(port)}|" if port else ""
        start, end = (edge.start, edge.end) if edge.kind == "topic" else (edge.end, edge.start)
        lines.append(f"  {ids[start]} {arrow}{label} {ids[end]}")
    lines += [f"  classDef {kind} fill:{colour},stroke:#5f6368" for kind, colour in _COLOURS.items()]
    kinds = {topic.kind: None for topic in view.topics} or {"topic": None}
    lines += [f"  classDef {kind} fill:{_CONNECTOR_COLOURS[kind]},stroke:#5f6368" for kind in kinds]
    return "\n".join([*lines, ""])


def _side(side: str, port: Port) -> str:
    """The label of a port beside its contract: ``in`` and ``out``, ``client`` and ``server``."""
    words = KIND_WORDS[port.kind]
    return side if port.kind == "topic" else words.output if side == "out" else words.input


def _mermaid(text: str) -> str:
    """Text with the special characters of Mermaid escaped."""
    return "".join(c if c.isalnum() or c in " _-./:,@" else f"#{ord(c)};" for c in text.strip())


def _ids(view: View) -> dict[str, str]:
    """Identifiers `n0`, `n1`, …, which cannot be keywords of the drawing language."""
    names = [*(box.id for box in view.boxes), *(topic.id for topic in view.topics)]
    return {name: f"n{index}" for index, name in enumerate(names)}

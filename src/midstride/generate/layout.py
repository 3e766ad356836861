"""The order in which a view is drawn, so that most arrows point one way, and the direction: across or down.

Robots have feedback loops, so some arrows must point back. Minimising their number (the feedback arc set) is NP-hard;
the greedy heuristic of Eades, Lin and Smyth, tried from each possible entry of a loop, comes close.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from midstride.generate.drawn_system import Edge, View

# The longest chain of boxes that fits across a page, without and with contracts; longer ones run down the page.
ACROSS: Final = 4
ACROSS_ANNOTATED: Final = 2
# Trying every entry takes quadratic time.
_MAX_TRIED: Final = 120


@dataclass(frozen=True, slots=True)
class GraphLayout:
    """``order``: the ids of boxes and topics, sources first. ``back``: the edges against that order. ``down``: whether
    the drawing runs down the page."""

    order: tuple[str, ...]
    back: frozenset[Edge]
    down: bool


def layout(view: View) -> GraphLayout:
    """The layout of a view. Deterministic."""
    ids = [*(box.id for box in view.boxes), *(topic.id for topic in view.topics)]
    pairs = list(dict.fromkeys((edge.start, edge.end) for edge in view.edges if edge.start != edge.end))
    order = _greedy(ids, pairs, None)
    if len(ids) <= _MAX_TRIED and (looped := _back_edges(order, pairs)):
        entries = sorted({id for pair in looped for id in pair} | set(_successors(looped, pairs)), key=ids.index)
        order = min(
            (order, *(_greedy(ids, pairs, entry) for entry in entries)),
            key=lambda order: len(_back_edges(order, pairs)),
        )
    back = _back_edges(order, pairs)
    across = ACROSS_ANNOTATED if any(topic.note for topic in view.topics) else ACROSS
    return GraphLayout(
        tuple(order),
        frozenset(edge for edge in view.edges if (edge.start, edge.end) in back),
        _longest_path(view, order, [pair for pair in pairs if pair not in back]) > across,
    )


def _successors(looped: Iterable[tuple[str, str]], pairs: list[tuple[str, str]]) -> Iterable[str]:
    """Everything reachable from the ends of ``looped``: the other possible entries of the loops."""
    follow: dict[str, list[str]] = {}
    for start, end in pairs:
        follow.setdefault(start, []).append(end)
    reached: dict[str, None] = {}
    ahead = [end for _, end in looped]
    while ahead:
        id = ahead.pop()
        if id not in reached:
            reached[id] = None
            ahead += follow.get(id, [])
    return reached


def _greedy(ids: list[str], pairs: list[tuple[str, str]], entry: str | None) -> list[str]:
    """Sources first, sinks last; of the rest ``entry`` first, then the vertex with the greatest surplus of outgoing
    edges."""
    into: dict[str, dict[str, None]] = {id: {} for id in ids}
    out: dict[str, dict[str, None]] = {id: {} for id in ids}
    for start, end in pairs:
        out[start][end] = None
        into[end][start] = None
    first: list[str] = []
    last: list[str] = []

    def take(id: str, where: list[str]) -> None:
        where.append(id)
        for other in into.pop(id):
            del out[other][id]
        for other in out.pop(id):
            del into[other][id]

    while into:
        source = next((id for id in into if not into[id]), None)
        sink = next((id for id in into if not out[id]), None)
        if source is not None:
            take(source, first)
        elif sink is not None:
            take(sink, last)
        elif entry in into:
            take(entry, first)
        else:
            take(max(into, key=lambda id: len(out[id]) - len(into[id])), first)
    return first + last[::-1]


def _back_edges(order: list[str], pairs: list[tuple[str, str]]) -> set[tuple[str, str]]:
    rank = {id: index for index, id in enumerate(order)}
    return {(start, end) for start, end in pairs if rank[start] > rank[end]}


def _longest_path(view: View, order: list[str], forward: list[tuple[str, str]]) -> int:
    """The number of boxes on the longest path through the drawing."""
    boxes = {box.id for box in view.boxes}
    before: dict[str, list[str]] = {}
    for start, end in forward:
        before.setdefault(end, []).append(start)
    length: dict[str, int] = {}
    for id in order:
        length[id] = max((length[other] for other in before.get(id, [])), default=0) + (id in boxes)
    return max(length.values(), default=0)

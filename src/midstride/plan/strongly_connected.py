"""Strongly connected components of a graph, in a stable order."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import TypeVar

N = TypeVar("N", bound=Hashable)


def strongly_connected(graph: Mapping[N, Sequence[N]]) -> list[list[N]]:
    """Tarjan's algorithm, without recursion: what a component leads to comes before it.

    ``graph`` maps each node to those it leads to; nodes that are no keys are ignored. The order
    follows the order of ``graph`` alone.
    """
    number: dict[N, int] = {}
    low: dict[N, int] = {}
    stack: list[N] = []
    work: list[tuple[N, Iterator[N]]] = []
    found: list[list[N]] = []

    def visit(node: N) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        work.append((node, iter(graph[node])))

    for root in graph:
        if root not in number:
            visit(root)
        while work:
            node, rest = work[-1]
            for following in rest:
                if following in number:
                    low[node] = min(low[node], number[following])
                elif following in graph:
                    visit(following)
                    break
            else:
                work.pop()
                if work:
                    parent = work[-1][0]
                    low[parent] = min(low[parent], low[node])
                if low[node] == number[node]:
                    first = len(stack) - 1
                    while stack[first] != node:
                        first -= 1
                    found.append(stack[first:])
                    number.update(dict.fromkeys(stack[first:], len(graph)))  # so that they lower no other
                    del stack[first:]
    return found

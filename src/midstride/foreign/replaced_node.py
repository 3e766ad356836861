"""The check that a node without ports which replaces another one is up: the graph shows of it what it shows of that."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from midstride.foreign.graph_check import GraphEndpoint


def lacks(found: Iterable[GraphEndpoint], node: str, before: Sequence[GraphEndpoint], old: str) -> list[str]:
    """Return what the graph shows of the node ``old``, and not yet of ``node`` (full names), in words.

    Topics below the name of the one, as of `~/state`, are those below the name of the other.
    """
    there = {(each.output, _relative(each.topic, node)) for each in found}
    return [
        f"{'publishes on' if each.output else 'subscribes to'} {each}"
        for each in before
        if (each.output, _relative(each.topic, old)) not in there
    ]


def _relative(topic: str, node: str) -> str:
    return f"~{topic.removeprefix(node)}" if topic.startswith(f"{node}/") else topic

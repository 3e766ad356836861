"""The reflex of a node without Midstride's API: its agent degrades what relies on a publisher that has fallen silent.

docs/protocols/foreign.md. Publishers are judged by when they wrote last, which the
page shows of those with a preloaded library, and others report: the node itself may be too busy to take messages.
Servers with a bound are judged by what they have answered, which the page shows, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from midstride.foreign.node import ForeignNode
from midstride.model.component import Assumption, ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import satisfies
from midstride.model.wording import KIND_WORDS
from midstride.node.control.shortfall import LONG_FLOOR, tolerated_periods


def broken_assumptions(node: ForeignNode) -> dict[str, tuple[str, str]]:
    """By functionality whose mode assumes what has fallen silent: the best mode below that does not, and why.

    Silent is also a server that breaks its bound.
    """
    if node.gates is None:
        return {}
    found = {}
    for functionality in node.component:
        index = functionality.mode_index(node.record.modes[functionality.name])
        below = functionality.modes[index + 1 :]
        silent = {port: words for port in functionality.inputs if (words := _silence(node, functionality.name, port))}
        if below and silent and not _supported(node, functionality, functionality.modes[index], silent):
            mode = next((each for each in below if _supported(node, functionality, each, silent)), below[-1])
            because = f"the assumption of mode {functionality.modes[index].name} broke: {'; '.join(silent.values())}"
            found[functionality.name] = mode.name, because
    return found


def _silence(node: ForeignNode, functionality: str, port: str) -> str | None:
    """In words, that an input has been silent for too long because its publishers have; None where that is not so."""
    if node.component.is_service(port):
        return _unanswered(node, functionality, port)
    gates, rate = node.gates, node.component.stated_rate(port, node.record.modes)
    if node.record.simulated_time:  # times of writes on `/clock` are not compared
        return None
    if gates is None or port not in node.record.links or not rate or (received := gates.age(port)) is None:
        return None
    topic, tolerates = node.record.topics[port], node.component.tolerates.get(port)
    publishers = [age for age in (gates.page.silence(topic), node.others.silence(topic)) if age is not None]
    if not publishers:
        return None
    tolerated = tolerated_periods(rate, tolerates, LONG_FLOOR) / rate
    if min(received, *publishers, node.seconds_in_mode(functionality)) <= tolerated:
        return None
    words = f"input {port} received nothing on {topic} for {received:.2f} s"
    return f"{words} ({rate:g} Hz is assumed; silence is tolerated for {tolerated:.2g} s)"


def _unanswered(node: ForeignNode, functionality: str, port: str) -> str | None:
    """In words, that the server of a client breaks the bound that is assumed of it; None where it does not."""
    found = node.responses(port)
    entered = node.due(node.seconds_in_mode(functionality))
    if found is None or found.broken is None or entered is None or entered <= found.tolerated:
        return None
    client = KIND_WORDS[node.component.kind_of(port)].input
    tolerated = f"silence is tolerated for {found.tolerated:.2g} s"
    return f"{client} {port}: the server of {node.record.topics[port]} {found.words} ({tolerated})"


def _supported(node: ForeignNode, functionality: FunctionalitySpec, mode: Mode, silent: Iterable[str]) -> bool:
    return all(
        any(
            port in node.record.links and port not in silent
            for port in inputs_of(node.component, functionality, assumption)
        )
        for assumption in mode.assumptions
    )


def inputs_of(component: ComponentSpec, functionality: FunctionalitySpec, assumption: Assumption) -> Sequence[str]:
    """The inputs that may satisfy ``assumption``."""
    if isinstance(assumption, InputAlternatives):
        return assumption.inputs
    return [name for name in functionality.inputs if satisfies(component.inputs[name], assumption)]

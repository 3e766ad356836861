"""``best``: the one best valid mode assignment of a structure (semantics.md section 5, F2 and F3).

It is a greatest fixed point, so no search is needed: start every functionality at its best mode
and lower whatever is unsatisfied until nothing changes. :func:`rebalanced` does the same after a
change, at a cost that follows the forward cone of what changed and not the system (F5).
"""

from __future__ import annotations

from collections.abc import Iterable

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import Judge


def best(s: Configuration) -> Configuration:
    """``s`` with every functionality in the best mode its structure allows. Walks the system."""
    overlay = dict.fromkeys(s.modes, 0)
    _lower(s, overlay, list(overlay))
    return s.with_modes(overlay)


def rebalanced(s: Configuration, seeds: Iterable[FunctionalityRef]) -> dict[FunctionalityRef, int]:
    """The modes that differ between ``s`` and ``best`` of its structure.

    ``s`` stands in ``best`` of a structure from which its own differs only at ``seeds``: the
    functionalities whose inputs or connectors were touched (:func:`consumers_of` names them).
    """
    overlay: dict[FunctionalityRef, int] = {}
    judge = Judge(s, overlay)
    pending = list(seeds)
    touched: dict[FunctionalityRef, None] = dict.fromkeys(pending)
    while pending:  # raise, hoping for the best: whoever could gain stands at its normal mode for a moment
        ref = pending.pop()
        before = judge.mode_index(ref)
        if before == 0:
            continue
        overlay[ref] = 0
        for consumer in _affected_by(s, ref, before, 0):
            touched[consumer] = None
            if judge.mode_index(consumer) > 0:
                pending.append(consumer)
    _lower(s, overlay, list(touched))
    return {ref: index for ref, index in overlay.items() if s.modes[ref] != index}


def lowered(s: Configuration, seeds: Iterable[FunctionalityRef]) -> dict[FunctionalityRef, int]:
    """The modes to which losing something takes whoever stands above what is left, and nobody is raised.

    ``seeds`` are the functionalities that what was lost bears on directly.
    """
    overlay: dict[FunctionalityRef, int] = {}
    _lower(s, overlay, list(dict.fromkeys(seeds)))
    return overlay


def consumers_of(s: Configuration, port: PortRef, connector: str) -> list[FunctionalityRef]:
    """The functionalities that an attachment of ``port`` to ``connector`` bears on directly."""
    return list(s.consumers(connector)) if s.is_output(port) else s.users(port)


def _lower(s: Configuration, overlay: dict[FunctionalityRef, int], pending: list[FunctionalityRef]) -> None:
    judge = Judge(s, overlay)
    waiting = set(pending)
    while pending:
        ref = pending.pop()
        waiting.discard(ref)
        before = judge.mode_index(ref)
        after = judge.best_satisfied_mode(ref, before)
        if after == before:
            continue
        overlay[ref] = after
        for consumer in _affected_by(s, ref, before, after):
            if consumer not in waiting:
                waiting.add(consumer)
                pending.append(consumer)


def _affected_by(s: Configuration, ref: FunctionalityRef, before: int, after: int) -> Iterable[FunctionalityRef]:
    """The consumers of the connectors that ``ref`` satisfies in one of the two modes and not in the other."""
    functionality = s.functionality(ref)
    for output in functionality.outputs:
        was, will = functionality.modes[before].guarantee(output), functionality.modes[after].guarantee(output)
        if was is will:
            continue
        for name in s.connectors_of.get(PortRef(ref.component, output), ()):
            connector = s.world.connectors.get(name)
            if connector is None:
                continue
            if satisfies(was, connector.guarantee) != satisfies(will, connector.guarantee):
                yield from s.consumers(name)

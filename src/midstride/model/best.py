"""``best``: the one best valid mode assignment of a structure (semantics.md section 5, F2 and F3).

It is a greatest fixed point, so no search is needed: start every functionality at its best mode
and lower whatever is unsatisfied until nothing changes. :func:`rebalanced` does the same after a
change, at a cost that follows the forward cone of what changed and not the system (F5).
Both rely on M2: a publisher that falls short in one mode falls short in every worse one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import Evaluator


def best(configuration: Configuration) -> Configuration:
    """``configuration`` with every functionality in the best mode its structure allows. Walks the system."""
    overlay = dict.fromkeys(configuration.modes, 0)
    _lower(configuration, overlay, list(overlay))
    return configuration.with_modes({ref: index for ref, index in overlay.items() if configuration.modes[ref] != index})


def rebalanced(
    configuration: Configuration,
    seeds: Iterable[FunctionalityRef],
    ceiling: Callable[[FunctionalityRef], int] | None = None,
) -> dict[FunctionalityRef, int]:
    """The modes that differ between ``configuration`` and ``best`` of its structure.

    ``configuration`` stands in ``best`` of a structure from which its own differs only at ``seeds``: the
    functionalities whose inputs or connectors were touched (:func:`consumers_of` names them), and
    those of new instances.
    Where a ``ceiling`` is given, nobody is raised above it, and "best" means the best below it.
    """
    overlay: dict[FunctionalityRef, int] = {}
    judge = Evaluator(configuration, overlay)
    pending = list(seeds)
    touched: dict[FunctionalityRef, None] = dict.fromkeys(pending)
    settled: set[str] = set()  # connectors that are satisfied: a further publisher changes nothing for anyone
    while pending:  # raise, hoping for the best: whoever could gain stands at its highest mode for a moment
        ref = pending.pop()
        before, highest = judge.mode_index(ref), 0 if ceiling is None else ceiling(ref)
        if before <= highest:
            continue
        gained = [name for name in affected_connectors(configuration, ref, before, highest) if name not in settled]
        settled.update(gained)
        gained = [name for name in gained if not judge.connector_satisfied(name)]
        overlay[ref] = highest
        for name in gained:
            for consumer in configuration.consumers(name):
                touched[consumer] = None
                pending.append(consumer)
    _lower(configuration, overlay, list(touched))
    return {ref: index for ref, index in overlay.items() if configuration.modes[ref] != index}


def lowered(configuration: Configuration, seeds: Iterable[FunctionalityRef]) -> dict[FunctionalityRef, int]:
    """The modes to fall to so that everybody is satisfied, from those of ``configuration``; nobody is raised.

    Only ``seeds`` may be unsatisfied in ``configuration``, and whoever depends on them. This is the least degradation.
    """
    overlay: dict[FunctionalityRef, int] = {}
    _lower(configuration, overlay, list(dict.fromkeys(seeds)))
    return overlay


def consumers_of(configuration: Configuration, port: PortRef, connector: str) -> list[FunctionalityRef]:
    """The functionalities that an attachment of ``port`` to ``connector`` bears on directly."""
    return list(configuration.consumers(connector)) if configuration.is_output(port) else configuration.users(port)


class MonotoneEvaluator(Evaluator):
    """A judge for modes that only ever get worse.

    For each connector it keeps one publisher that satisfies it and looks for the next when that one falls; it
    never looks back. So a topic with many publishers costs one walk over them in all, not one for each that falls.
    """

    __slots__ = ("_supports",)

    def __init__(self, configuration: Configuration, overlay: Mapping[FunctionalityRef, int]) -> None:
        super().__init__(configuration, overlay)
        self._supports: dict[str, tuple[PortRef | None, Iterator[PortRef]]] = {}

    def connector_satisfied(self, name: str) -> bool:
        connector = self.configuration.context.connectors.get(name)
        if connector is None:
            return False
        needed = connector.guarantee
        if name in self._supports:
            support, others = self._supports[name]
        else:
            if any(
                satisfies(offer.guarantee, needed)
                for offer in self.configuration.context.publishers_out_of_scope(connector)
            ):
                return True
            others = iter(self.configuration.publishers_on(name))
            support = next(others, None)
        while support is not None and not satisfies(self.guarantee(support), needed):
            support = next(others, None)
        self._supports[name] = support, others
        return support is not None


def _lower(configuration: Configuration, overlay: dict[FunctionalityRef, int], pending: list[FunctionalityRef]) -> None:
    """Lower in ``overlay`` whatever is unsatisfied, and whatever is so in turn. All that may be is in ``pending``."""
    judge = MonotoneEvaluator(configuration, overlay)
    waiting = set(pending)
    fallen: set[str] = set()
    while pending:
        ref = pending.pop()
        waiting.discard(ref)
        before = judge.mode_index(ref)
        after = judge.best_satisfied_mode(ref, before)
        if after == before:
            continue
        overlay[ref] = after
        for name in affected_connectors(configuration, ref, before, after):
            if name in fallen or judge.connector_satisfied(name):
                continue
            fallen.add(name)
            for consumer in configuration.consumers(name):
                if consumer not in waiting:
                    waiting.add(consumer)
                    pending.append(consumer)


def affected_connectors(configuration: Configuration, ref: FunctionalityRef, before: int, after: int) -> Iterator[str]:
    """The connectors that ``ref`` satisfies in one of the two modes and not in the other."""
    functionality = configuration.functionality(ref)
    for output in functionality.outputs:
        was, will = functionality.modes[before].guarantee(output), functionality.modes[after].guarantee(output)
        if was is will:
            continue
        for name in configuration.connectors_of.get(PortRef(ref.instance, output), ()):
            connector = configuration.context.connectors.get(name)
            if connector is None:
                continue
            if satisfies(was, connector.guarantee) != satisfies(will, connector.guarantee):
                yield name

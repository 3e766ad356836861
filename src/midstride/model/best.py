"""``best``: the one best valid mode assignment of a structure (docs/semantics.md section 5, F2 and F3).

It is a greatest fixed point, so no search is needed: start every functionality at its best mode
and lower whatever is unsatisfied until nothing changes. :func:`rebalanced` does the same after a
change, at a cost that follows the forward cone of what changed and not the system (F5).
Both rely on M2: a publisher that falls short in one mode falls short in every worse one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Contract, satisfies
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

    The modes of ``configuration`` are ``best`` of a structure that differs from its own only at ``seeds``: the
    functionalities whose inputs or connectors were touched (:func:`consumers_of` lists them), and those of new
    instances. With a ``ceiling``, no functionality is raised above it, and "best" means the best within it.
    """
    overlay: dict[FunctionalityRef, int] = {}
    evaluator = Evaluator(configuration, overlay)
    pending = list(seeds)
    touched: dict[FunctionalityRef, None] = dict.fromkeys(pending)
    satisfied: set[str] = set()  # connectors: a further publisher makes no difference to any consumer
    while pending:  # raise optimistically: every functionality that could gain goes to its highest mode first
        ref = pending.pop()
        before, highest = evaluator.mode_index(ref), 0 if ceiling is None else ceiling(ref)
        if before <= highest:
            continue
        gained = [name for name in affected_connectors(configuration, ref, before, highest) if name not in satisfied]
        satisfied.update(gained)
        gained = [name for name in gained if not evaluator.connector_satisfied(name)]
        overlay[ref] = highest
        for name in gained:
            for consumer in configuration.consumers(name):
                touched[consumer] = None
                pending.append(consumer)
    _lower(configuration, overlay, list(touched))
    return {ref: index for ref, index in overlay.items() if configuration.modes[ref] != index}


def lowered(configuration: Configuration, seeds: Iterable[FunctionalityRef]) -> dict[FunctionalityRef, int]:
    """The modes to degrade to so that every functionality is satisfied again; none is raised.

    In ``configuration`` only ``seeds``, and what depends on them, may be unsatisfied. The degradation is the least.
    """
    overlay: dict[FunctionalityRef, int] = {}
    _lower(configuration, overlay, list(dict.fromkeys(seeds)))
    return overlay


def consumers_of(configuration: Configuration, port: PortRef, connector: str) -> list[FunctionalityRef]:
    """The functionalities that an attachment of ``port`` to ``connector`` affects directly."""
    return list(configuration.consumers(connector)) if configuration.is_output(port) else configuration.users(port)


class MonotoneEvaluator(Evaluator):
    """An evaluator for modes that only ever get worse.

    For each connector it remembers one publisher that satisfies it and, when that one degrades, moves on to the next
    without looking back. So a topic with many publishers costs one walk over them, not one for each that degrades.
    """

    __slots__ = ("_supports",)

    def __init__(self, configuration: Configuration, overlay: Mapping[FunctionalityRef, int]) -> None:
        super().__init__(configuration, overlay)
        self._supports: dict[str, tuple[PortRef | None, Iterator[PortRef]]] = {}

    def _published(self, name: str, needed: Contract) -> bool:
        if name in self._supports:
            support, others = self._supports[name]
        else:
            others = iter(self.configuration.publishers_on(name))
            support = next(others, None)
        while support is not None and not satisfies(self.guarantee(support), needed):
            support = next(others, None)
        self._supports[name] = support, others
        return support is not None


def _lower(configuration: Configuration, overlay: dict[FunctionalityRef, int], pending: list[FunctionalityRef]) -> None:
    """Lower in ``overlay`` what is unsatisfied, and what becomes so by that. ``pending`` holds every candidate."""
    evaluator = MonotoneEvaluator(configuration, overlay)
    waiting = set(pending)
    unsatisfied: set[str] = set()
    while pending:
        ref = pending.pop()
        waiting.discard(ref)
        before = evaluator.mode_index(ref)
        after = evaluator.best_satisfied_mode(ref, before)
        if after == before:
            continue
        overlay[ref] = after
        for name in affected_connectors(configuration, ref, before, after):
            if name in unsatisfied or evaluator.connector_satisfied(name):
                continue
            unsatisfied.add(name)
            for consumer in configuration.consumers(name):
                if consumer not in waiting:
                    waiting.add(consumer)
                    pending.append(consumer)


def affected_connectors(configuration: Configuration, ref: FunctionalityRef, before: int, after: int) -> Iterator[str]:
    """The connectors that ``ref`` satisfies in one of the two modes and not in the other."""
    functionality = configuration.functionality(ref)
    for output, name in configuration.published(ref):
        was, will = functionality.modes[before].guarantee(output), functionality.modes[after].guarantee(output)
        connector = configuration.context.connectors.get(name)
        if was is will or connector is None:
            continue
        if satisfies(was, connector.guarantee) != satisfies(will, connector.guarantee):
            yield name

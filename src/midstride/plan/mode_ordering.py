"""The way between two valid mode assignments of one structure, by steps that are each valid.

Raising goes upstream first, lowering downstream first. A step names one functionality wherever
that is valid. Where functionalities support each other in a cycle, so that no sequence of single
steps can move them, a step names a smallest group of them (semantics.md section 4).

Raising is confluent: what has been raised never hinders another. So the order is found for
raising alone, and lowering is raising backwards; a degrade is valid wherever its undo is.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final, Protocol, TypeAlias

from immutables import Map

from midstride.model.action import Degrade, Upgrade
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator
from midstride.plan.strongly_connected import strongly_connected

Modes: TypeAlias = dict[FunctionalityRef, int]


class Support(Protocol):
    """Whether each of ``asked`` (by default the whole group) is satisfied once the group has risen."""

    def __call__(self, group: Sequence[FunctionalityRef], asked: Sequence[FunctionalityRef] | None = None) -> bool: ...


# Up to this size of a tangle with alternatives, the smallest group is looked for; beyond, a least one.
_ENUMERABLE: Final = 12


def upgrades(configuration: Configuration, modes: Mapping[FunctionalityRef, int]) -> list[Upgrade]:
    """From ``configuration`` to the better ``modes``, which are valid in it."""
    return [
        Upgrade(Map(step))
        for step in _raised(configuration, {r: i for r, i in modes.items() if i != configuration.modes[r]})
    ]


def degradations(configuration: Configuration, modes: Mapping[FunctionalityRef, int]) -> list[Degrade]:
    """From ``configuration`` to the worse ``modes``, which are valid in it.

    Where ``configuration`` itself is not valid (a publisher is gone), those that lost their support come in
    an order, and if need be in groups, in which each step's own precondition holds.
    """
    below = configuration.with_modes(dict(modes))
    steps: list[Degrade] = []
    for step in _raised(
        below, {ref: configuration.modes[ref] for ref, index in modes.items() if index != configuration.modes[ref]}
    ):
        steps.append(Degrade(Map({ref: below.modes[ref] for ref in step})))
        below = below.with_modes(step)
    return steps[::-1]


def _raised(configuration: Configuration, wanted: Modes) -> Iterator[Modes]:
    """The groups that rise together, in order, until every one stands as ``wanted``."""
    rank = {ref: place for place, ref in enumerate(sorted(wanted, key=lambda ref: _declared(configuration, ref)))}
    by_rank = list(rank)
    overlay: Modes = {}
    judge = Evaluator(configuration, overlay)
    waiting = list(range(len(by_rank)))

    def rise(step: Modes) -> Modes:
        overlay.update(step)
        for ref, index in step.items():
            if wanted[ref] == index:
                del wanted[ref]
        for ref in step:
            for consumer in _consumers(configuration, ref):
                if consumer in wanted:
                    heapq.heappush(waiting, rank[consumer])
        return step

    while wanted:
        while waiting:
            ref = by_rank[heapq.heappop(waiting)]
            if ref in wanted and judge.mode_satisfied(ref, wanted[ref]):
                yield rise({ref: wanted[ref]})
        if wanted:
            ordered = sorted(wanted, key=rank.__getitem__)
            yield rise(_part_way(judge, wanted, ordered) or _group(configuration, overlay, wanted, ordered))


def _declared(configuration: Configuration, ref: FunctionalityRef) -> tuple[str, int]:
    return ref.instance, configuration.component(ref.instance).functionality_order.index(ref.functionality)


def _consumers(configuration: Configuration, ref: FunctionalityRef) -> Iterator[FunctionalityRef]:
    for output in configuration.functionality(ref).outputs:
        for name in configuration.connectors_of.get(PortRef(ref.instance, output), ()):
            yield from configuration.consumers(name)


def _part_way(judge: Evaluator, wanted: Modes, ordered: list[FunctionalityRef]) -> Modes:
    """One functionality that can rise by itself to a mode on its way, which may spare a group."""
    for ref in ordered:
        now = judge.mode_index(ref)
        for index in range(wanted[ref] + 1, now):
            if judge.mode_satisfied(ref, index):
                return {ref: index}
    return {}


def _group(configuration: Configuration, overlay: Modes, wanted: Modes, ordered: list[FunctionalityRef]) -> Modes:
    """A smallest group of ``wanted`` that can rise together, none being able to rise alone."""

    def supports_itself(group: Sequence[FunctionalityRef], asked: Sequence[FunctionalityRef] | None = None) -> bool:
        judge = Evaluator(configuration, {**overlay, **{ref: wanted[ref] for ref in group}})
        return all(judge.mode_satisfied(ref, wanted[ref]) for ref in (group if asked is None else asked))

    # Whom each one cannot do without, even if all the others rise: a tangle of these must rise as one.
    raised = {**overlay, **wanted}
    judge = Evaluator(configuration, raised)
    suppliers: dict[FunctionalityRef, list[FunctionalityRef]] = {ref: [] for ref in ordered}
    for ref in ordered:
        for consumer in dict.fromkeys(_consumers(configuration, ref)):
            if consumer in suppliers and consumer != ref:
                suppliers[consumer].append(ref)
    needed: dict[FunctionalityRef, list[FunctionalityRef]] = {ref: [] for ref in ordered}
    for ref, candidates in suppliers.items():
        for supplier in candidates:
            raised[supplier] = overlay.get(supplier, configuration.modes[supplier])
            if not judge.mode_satisfied(ref, wanted[ref]):
                needed[ref].append(supplier)
            raised[supplier] = wanted[supplier]
    tangles = [
        tangle
        for tangle in strongly_connected(needed)
        if {supplier for ref in tangle for supplier in needed[ref]} <= set(tangle) and supports_itself(tangle)
    ]
    if tangles:
        return {ref: wanted[ref] for ref in min(tangles, key=len)}

    # Some have alternatives among each other: look within a tangle that depends on no other.
    tangle = strongly_connected(suppliers)[0]
    if supports_itself(tangle):
        tangle = _least(tangle, supports_itself)
    return {ref: wanted[ref] for ref in tangle}


def _least(tangle: list[FunctionalityRef], supports_itself: Support) -> list[FunctionalityRef]:
    """A smallest part of the tangle that supports itself; of a large one, a part that has no smaller one in it."""
    if len(tangle) <= _ENUMERABLE:
        for size in range(2, len(tangle)):
            for group in combinations(tangle, size):
                if supports_itself(group):
                    return list(group)
        return tangle
    for ref in list(tangle):
        rest = [other for other in tangle if other != ref]
        while rest and not supports_itself(rest):
            rest = [other for other in rest if supports_itself(rest, (other,))]
        tangle = rest or tangle
    return tangle

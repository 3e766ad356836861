"""The order of mode changes between two valid mode assignments of one structure, such that every step is valid.

Upgrades go upstream first, degradations downstream first. A step names one functionality wherever that is valid.
Where functionalities support each other in a cycle, so that no sequence of single steps can change them, a step names
a smallest group of them (docs/semantics.md section 4).

Upgrading is confluent: what has been upgraded never hinders another. So the order is found for upgrades alone, and
degradations are upgrades in reverse; a degrade is valid wherever its undo is.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final, TypeAlias

from immutables import Map

from midstride.model.action import Degrade, Upgrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator
from midstride.plan.strongly_connected import strongly_connected

Modes: TypeAlias = dict[FunctionalityRef, int]
Refs: TypeAlias = Sequence[FunctionalityRef]

# Up to this size of a cycle with alternatives, the smallest group is searched for; beyond, a minimal one.
_ENUMERABLE: Final = 12


def upgrades(configuration: Configuration, modes: Mapping[FunctionalityRef, int]) -> list[Upgrade]:
    """From ``configuration`` to the better ``modes``, which are valid in it."""
    return [Upgrade(Map(step)) for step in _raised(configuration, modes)]


def degradations(configuration: Configuration, modes: Mapping[FunctionalityRef, int]) -> list[Degrade]:
    """From ``configuration`` to the worse ``modes``, which are valid in it.

    Where ``configuration`` itself is not valid (a publisher has crashed), the functionalities that lost their support
    come in an order, and if need be in groups, in which each step's own precondition holds.
    """
    below = configuration.with_modes(dict(modes))
    steps: list[Degrade] = []
    for step in _raised(below, {ref: configuration.modes[ref] for ref in modes}):
        steps.append(Degrade(Map({ref: below.modes[ref] for ref in step})))
        below = below.with_modes(step)
    return steps[::-1]


def _raised(configuration: Configuration, modes: Mapping[FunctionalityRef, int]) -> Iterator[Modes]:
    """The groups that are upgraded together, in order, until every functionality is in its mode of ``modes``."""
    wanted = {ref: index for ref, index in modes.items() if index != configuration.modes[ref]}
    rank = {ref: place for place, ref in enumerate(sorted(wanted, key=lambda ref: _declared(configuration, ref)))}
    by_rank = list(rank)
    overlay: Modes = {}
    evaluator = Evaluator(configuration, overlay)
    waiting = list(range(len(by_rank)))

    def rise(step: Modes) -> Modes:
        overlay.update(step)
        for ref, index in step.items():
            if wanted[ref] == index:
                del wanted[ref]
        for ref in step:
            for consumer in configuration.downstream(ref):
                if consumer in wanted:
                    heapq.heappush(waiting, rank[consumer])
        return step

    while wanted:
        while waiting:
            ref = by_rank[heapq.heappop(waiting)]
            if ref in wanted and evaluator.mode_satisfied(ref, wanted[ref]):
                yield rise({ref: wanted[ref]})
        if wanted:
            ordered = sorted(wanted, key=rank.__getitem__)
            yield rise(_part_way(evaluator, wanted, ordered) or _group(configuration, overlay, wanted, ordered))


def _declared(configuration: Configuration, ref: FunctionalityRef) -> tuple[str, int]:
    return ref.instance, configuration.component(ref.instance).functionality_order.index(ref.functionality)


def _part_way(evaluator: Evaluator, wanted: Modes, ordered: list[FunctionalityRef]) -> Modes:
    """One functionality that can be upgraded alone to an intermediate mode, which may make a group unnecessary."""
    for ref in ordered:
        now = evaluator.mode_index(ref)
        for index in range(wanted[ref] + 1, now):
            if evaluator.mode_satisfied(ref, index):
                return {ref: index}
    return {}


def _group(configuration: Configuration, overlay: Modes, wanted: Modes, ordered: list[FunctionalityRef]) -> Modes:
    """A smallest group of ``wanted`` that can be upgraded together, where none can be upgraded alone."""

    def supports(group: Refs, asked: Refs) -> bool:
        """Return whether each of ``asked`` is satisfied once the group is upgraded."""
        evaluator = Evaluator(configuration, {**overlay, **{ref: wanted[ref] for ref in group}})
        return all(evaluator.mode_satisfied(ref, wanted[ref]) for ref in asked)

    # The suppliers that each one cannot do without, even if all others are upgraded: a cycle of these is one group.
    raised = {**overlay, **wanted}
    evaluator = Evaluator(configuration, raised)
    suppliers: dict[FunctionalityRef, list[FunctionalityRef]] = {ref: [] for ref in ordered}
    for ref in ordered:
        for consumer in dict.fromkeys(configuration.downstream(ref)):
            if consumer in suppliers and consumer != ref:
                suppliers[consumer].append(ref)
    needed: dict[FunctionalityRef, list[FunctionalityRef]] = {ref: [] for ref in ordered}
    for ref, candidates in suppliers.items():
        for supplier in candidates:
            raised[supplier] = overlay.get(supplier, configuration.modes[supplier])
            if not evaluator.mode_satisfied(ref, wanted[ref]):
                needed[ref].append(supplier)
            raised[supplier] = wanted[supplier]
    cycles = [
        cycle
        for cycle in strongly_connected(needed)
        if {supplier for ref in cycle for supplier in needed[ref]} <= set(cycle) and supports(cycle, cycle)
    ]
    if cycles:
        return {ref: wanted[ref] for ref in min(cycles, key=len)}

    # Some are alternatives to each other: search within a cycle that depends on no other.
    cycle = strongly_connected(suppliers)[0]
    if supports(cycle, cycle):
        cycle = _least(cycle, supports)
    return {ref: wanted[ref] for ref in cycle}


def _least(cycle: list[FunctionalityRef], supports: Callable[[Refs, Refs], bool]) -> list[FunctionalityRef]:
    """A smallest part of the cycle that supports itself; of a large cycle, a part that contains no smaller one."""
    if len(cycle) <= _ENUMERABLE:
        for size in range(2, len(cycle)):
            for group in combinations(cycle, size):
                if supports(group, group):
                    return list(group)
        return cycle
    for ref in list(cycle):
        rest = [other for other in cycle if other != ref]
        while rest and not supports(rest, rest):
            rest = [other for other in rest if supports(rest, (other,))]
        cycle = rest or cycle
    return cycle

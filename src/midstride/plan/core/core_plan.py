"""The least that any plan of a change loses, and plans that lose no more: the conflict core searched part by part.

The parts share no action, so no way through one of them makes another cheaper than it is by itself; what each costs at
least adds up to a lower bound on every plan. Plans are made of the cheapest ways and cost what they cost: what is
claimed of them never rests on the compiled core alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final

from midstride.model.action import Swap
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Constraint, Keep, Limit
from midstride.plan.constraints import ConstraintMonitor
from midstride.plan.core.conflict_core import Op, parts
from midstride.plan.core.core_losses import PartLosses, fullest
from midstride.plan.core.core_search import PartResult, PartSearch
from midstride.plan.core.search_state import SearchState
from midstride.plan.disruption import DIGITS, Levels
from midstride.plan.plan import BoundPart
from midstride.plan.strategies.plan_builder import PlanBuilder

_EPSILON: Final = 1e-7


class Budget:
    """The limit of the search: in states, where the result must not depend on the machine, or in seconds."""

    def __init__(
        self, states: float = 20_000, seconds: float = inf, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._states, self._clock, self._end = states, clock, clock() + seconds

    def is_used_up(self, states: int = 1) -> bool:
        """Counts so many states more."""
        self._states -= states
        return self._states < 0 or self._clock() > self._end

    def end(self) -> None:
        """Nothing more is to be searched."""
        self._states = 0


@dataclass(frozen=True, slots=True)
class CoreResult:
    """No plan loses less than ``lower_bound`` (infinite: there is none). ``moves`` are tied actions, in order.

    ``certificate``: the bound by independent parts of the conflict core, without those that lose nothing.
    """

    lower_bound: float = 0.0
    moves: tuple[tuple[Op, ...], ...] | None = ()
    certificate: tuple[BoundPart, ...] = ()


def search_core(
    levels: Levels,
    constraints: Sequence[Constraint],
    budget: Budget,
    ignored: Collection[str] = (),
    most: float = inf,
) -> CoreResult:
    """The lower bound, and the actions of a way through all parts that costs the least known.

    The resources and topics that are ``ignored`` count as large enough. The search ends where the bound reaches
    ``most``; then there are no actions.
    """
    change = levels.change
    keeps = _keeps(levels, constraints)
    if any(most < 0 for most in keeps.values()):
        return CoreResult(inf, None)
    found = [part for part in parts(change, constraints, ignored) if any(part.seconds) or constraints]
    if not found:
        return CoreResult()
    full = fullest(change)
    limits = {
        each.functionality: each.seconds
        for each in sorted((c for c in constraints if isinstance(c, Limit)), key=lambda limit: -limit.seconds)
        if each.seconds and levels.find(each.functionality) is not None
    }
    searches = [PartSearch(part, PartLosses(change, part, levels, full), keeps, limits) for part in found]
    # The beam does not count the seconds of limits, so under limits there is no way known at first.
    least = sum(search.bounds.of(0) for search in searches)
    if least >= most - _EPSILON:
        return CoreResult(least, None)
    results = [PartResult(0.0) if limits else search.beam() for search in searches]
    for index, search in enumerate(searches):
        known = results[index]
        left = most - sum(result.lower_bound for result in results) + known.lower_bound
        result = search.run(budget.is_used_up, PartResult(known.lower_bound, left) if left < known.cost else known)
        if result.lower_bound < result.cost - _EPSILON:
            budget.end()
        if result.lower_bound >= left - _EPSILON:
            return CoreResult(most, None)
        results[index] = replace(known, lower_bound=result.lower_bound) if result.cost == left < known.cost else result
    bound = sum(result.lower_bound for result in results)
    if any(result.cost == inf for result in results):
        return CoreResult(bound, None)
    moves = [
        tuple(op for bit, op in enumerate(part.ops) if move >> bit & 1)
        for part, result in zip(found, results, strict=True)
        for move in result.moves
    ]
    certificate = (
        BoundPart(tuple(sorted(set(part.roles))), round(result.lower_bound, DIGITS))
        for part, result in zip(found, results, strict=True)
        if result.lower_bound > 0.0
    )
    return CoreResult(bound, tuple(moves), tuple(certificate))


def _keeps(levels: Levels, constraints: Iterable[Constraint]) -> dict[FunctionalityRef, int]:
    """The number of levels below its baseline that each functionality may be that is to be kept.

    A ``limit`` of 0 s keeps it at the baseline.
    """
    never = (each.functionality for each in constraints if isinstance(each, Limit) and not each.seconds)
    found = {ref: 0 for ref in never if levels.find(ref) is not None}
    monitor = ConstraintMonitor.of(levels, [each for each in constraints if isinstance(each, Keep)])
    for keep, _, threshold in monitor.keeps:
        counted = levels.find(keep.functionality)
        if counted is not None:
            found[counted.ref] = min(found.get(counted.ref, counted.worst), threshold - counted.baseline)
    return found


# -- the plans -----------------------------------------------------------------------------------------------


def plans_along(state: SearchState, moves: Sequence[tuple[Op, ...]]) -> Iterator[PlanBuilder]:
    """The plans that make the tied actions in this order: with hand-overs, and with old and new side by side."""
    yield from _along(state, moves)
    beside = state
    for new in state.swaps:
        beside = beside.without_swaps(new)
    yield from _along(beside, moves)


def _along(state: SearchState, moves: Sequence[tuple[Op, ...]]) -> Iterator[PlanBuilder]:
    state = state.advance()
    for move in moves:
        state = _handed_over_jointly(state, move)
        for op in sorted(move, key=lambda op: ("detach", "attach", "create", "remove").index(op.kind)):
            state = _done(state, op, move)
        state = state.raise_touched().advance()
    for new in list(state.swaps):
        swaps = state.swaps[new]
        state = state.hand_over(new) if all(map(state.can_take_over, swaps)) else state.without_swaps(new)
        state = state.raise_touched()
    if state.creates:
        return
    builder = state.attach(*state.attaches).finish()
    if _is_valid(builder):
        yield builder


def _handed_over_jointly(state: SearchState, move: tuple[Op, ...]) -> SearchState:
    """The state after a move that exchanges outputs on several topics at once, if it is one and can be made so."""
    come = [op.attachment for op in move if op.kind == "attach"]
    leave = [op.attachment for op in move if op.kind == "detach"]
    if len(come) < 2 or len(move) != 2 * len(come):
        return state
    split = state
    for new, swaps in state.swaps.items():
        if any((swap.new, swap.connector) in come or (swap.old, swap.connector) in leave for swap in swaps):
            split = split.without_swaps(new)
    swaps_of_all: list[Swap] = []
    for port, connector in come:
        old = next((pair for pair in leave if pair[1] == connector and pair in split.detaches), None)
        if old is None or (port, connector) not in split.attaches or not split.satisfies_topic(port, connector):
            return state
        leave.remove(old)
        swaps_of_all.append(Swap(connector, old[0], port))
    return split.exchange(*swaps_of_all).raise_touched()


def _done(state: SearchState, op: Op, move: tuple[Op, ...]) -> SearchState:
    """The state after one tied action, unless it was made before, on the way."""
    if op.kind == "create":
        return state.create(op.instance) if op.instance in state.creates else state
    if op.kind == "remove":
        if op.instance not in state.removes:
            return state
        new = state.builder.change.replaced.get(op.instance)
        if new is not None:
            state = state.without_swaps(new)
        if op.instance in state.builder.change.stand_ins:
            state = state.giving_up(op.instance)
        return state.remove([op.instance], [pair for pair in state.detaches if pair[0].instance == op.instance])
    if any(each.kind == "remove" and each.instance == op.instance for each in move):
        return state  # comes with the removal
    port, connector = op.attachment
    for new, swaps in state.swaps.items():
        ports = ((swap, swap.new if op.kind == "attach" else swap.old) for swap in swaps)
        swap = next((swap for swap, its in ports if (its, swap.connector) == op.attachment), None)
        if swap is not None:
            both = {(each.port, each.connector) for each in move}
            if (swap.new, connector) in both and all(map(state.can_take_over, swaps)):
                return state.hand_over(new).raise_touched()
            state = state.without_swaps(new, tuple(each for each in swaps if each != swap))
            break
    if op.kind == "detach":
        taking = next((each for each in move if each.kind == "attach" and each.connector == connector), None)
        if taking is not None and taking.attachment in state.attaches and op.attachment in state.detaches:
            new_port, _ = taking.attachment
            if state.satisfies_topic(new_port, connector):
                return state.exchange(Swap(connector, port, new_port)).raise_touched()
        return state.detach([op.attachment]) if op.attachment in state.detaches else state
    return state.attach(op.attachment) if op.attachment in state.attaches else state


def _is_valid(builder: PlanBuilder) -> bool:
    configuration = builder.change.start
    for step in builder.steps:
        if step.action.check(configuration):
            return False
        configuration = step.action.effect(configuration)
    return True

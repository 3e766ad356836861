"""The exact search of one part of the conflict core: A* over the sets of actions that are done.

The cost of a step follows from the set alone (docs/semantics.md section 5, F4), so sets reached in different orders are
one state. The frontier gives a lower bound at any time; a beam search before it gives a plan at once.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import inf
from typing import Final, TypeAlias

from midstride.model.component import FunctionalityRef
from midstride.model.contract import satisfies
from midstride.plan.core.conflict_core import Part
from midstride.plan.core.core_bounds import RoleBounds
from midstride.plan.core.core_losses import PartLosses
from midstride.plan.core.lossless_steps import Ends

_EPSILON: Final = 1e-7
_BEAM: Final = 40
# Up to this many exchanges that can be made in a state, every set of them is looked at as one hand-over.
_JOINT: Final = 5

SearchNode: TypeAlias = tuple[int, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class PartResult:
    """No way through the part costs less than ``lower_bound``; ``moves``, sets of actions by bit, cost ``cost``.

    Without ``moves``, none was found; if the bound is infinite, there is none.
    """

    lower_bound: float
    cost: float = inf
    moves: tuple[int, ...] = ()


class PartSearch:
    """``keeps``: for some functionalities of roles, how many levels below the baseline they may be.

    ``limits``: for some, how many seconds they may be below it during creations and removals. ``ends``: whether to make
    replacements first or last that lose nothing then, and to try no other moment (:mod:`.lossless_steps`).
    """

    def __init__(
        self,
        part: Part,
        losses: PartLosses,
        keeps: dict[FunctionalityRef, int],
        limits: dict[FunctionalityRef, float] | None = None,
        *,
        ends: bool = True,
    ) -> None:
        self.part, self.losses, self.keeps = part, losses, keeps
        self.limits = tuple((limits or {}).items())
        self.bounds = RoleBounds(part, losses)
        ops = part.ops
        self._creates = [bit for bit, op in enumerate(ops) if op.kind == "create"]
        self._removes = [bit for bit, op in enumerate(ops) if op.kind == "remove"]
        self._attaches = sum(1 << bit for bit, op in enumerate(ops) if op.kind == "attach")
        # Where something is to be kept, the moment of each step matters.
        self._ends = Ends(part, losses, self.bounds) if ends and not (keeps or limits) else None
        # By what is attached: of two instances that do the same, it matters to nobody which one publishes.
        self._uncontended = {
            (exchange & self._attaches).bit_length() - 1: exchange
            for each in (self._ends.replacements if self._ends is not None else ())
            for exchange in each.exchanges
        }
        # A removal brings the detaching of what is still attached with it.
        self._brings = {
            bit: sum(1 << b for b, op in enumerate(ops) if op.kind == "detach" and op.instance == ops[bit].instance)
            for bit in self._removes
        }
        self._alone = [  # detaching by itself is of use only where an order waits for it
            bit for bit, op in enumerate(ops) if op.kind == "detach" and any(after >> bit & 1 for after in part.after)
        ]
        self._topic_of = {bit: topic for topic in part.topics for bit in range(len(ops)) if topic.attach >> bit & 1}
        self._goal = part.everything & ~sum(1 << bit for bit, op in enumerate(ops) if op.kind == "detach")
        self._allowed: dict[int, bool] = {}
        # Outputs that may take over in a hand-over: the others never satisfy their topics before they are attached.
        connectors, full = losses.full.context.connectors, losses.full
        self._good = sum(
            1 << bit
            for bit in self._topic_of
            for port, name in [ops[bit].attachment]
            if satisfies(full.guarantee(port), connectors[name].guarantee)
        )

    # -- one state -------------------------------------------------------------------------------------

    def _is_allowed(self, state: int) -> bool:
        if not self.keeps:
            return True
        key = self.losses.key(state)
        found = self._allowed.get(key)
        if found is None:
            lost = dict(self.losses.losses(state))
            found = self._allowed[key] = all(lost.get(ref, 0) <= most for ref, most in self.keeps.items())
        return found

    def _is_due(self, bit: int, state: int) -> bool:
        """Return whether the subject of an action exists, and the user's orders allow it now."""
        after = self.part.after[bit] | self.part.live[bit]
        return state & after == after

    def _fits(self, bit: int, state: int) -> bool:
        usage = self.part.usage
        for resource, free in enumerate(self.part.free):
            needed = usage[bit][resource]
            if needed and free < needed + sum(
                usage[done][resource] for done in (*self._creates, *self._removes) if state >> done & 1
            ):
                return False
        return True

    def moves(self, state: int) -> Iterator[tuple[int, float]]:
        """The states that follow, each with what the step to it costs."""
        part, loss = self.part, self.losses.loss
        now = loss(state)
        waiting = self._attaches & ~state
        exchanges: list[int] = []
        while waiting:
            low = waiting & -waiting
            waiting ^= low
            bit = low.bit_length() - 1
            if not self._is_due(bit, state):
                continue
            topic = self._topic_of.get(bit)
            if topic is None:
                yield state | low, 0.0
                return
            free = topic.free + (state & topic.detach).bit_count() - (state & topic.attach).bit_count()
            if free >= (topic.attach & ~state).bit_count():
                yield state | low, 0.0
                return
            if free > 0:
                exchanges.append(state | low)
                continue
            if (exchange := self._uncontended.get(bit)) is not None:
                yield state | exchange, 0.0
                return
            olds = topic.detach & ~state
            while olds:
                old = olds & -olds
                olds ^= old
                if self._is_due(old.bit_length() - 1, state) and (self._good & low or self._is_allowed(state | old)):
                    exchanges.append(state | low | old)
        removals = []
        for bit in self._removes:
            if not state >> bit & 1 and self._is_due(bit, state):
                after = state | 1 << bit | self._brings[bit]
                cost = part.seconds[bit] * loss(after)
                if not cost and any(
                    state & mask and gone >> bit & 1 and state & come == come
                    for mask, gone, come in self.losses.equivalent
                ):
                    yield after, 0.0  # superseded: to go now costs nothing, and only makes room
                    return
                removals.append((after, cost))
        yield from ((after, 0.0) for after in self._jointly(state, exchanges))
        if self._is_allowed(state):
            for bit in self._creates:
                if not state >> bit & 1 and self._is_due(bit, state) and self._fits(bit, state):
                    yield state | 1 << bit, part.seconds[bit] * now
        yield from ((after, cost) for after, cost in removals if self._is_allowed(after))
        for bit in self._alone:
            if not state >> bit & 1 and self._is_due(bit, state) and self._is_allowed(state | 1 << bit):
                yield state | 1 << bit, 0.0

    def _jointly(self, state: int, exchanges: list[int]) -> Iterable[int]:
        """The states after the exchanges, and where something is to be kept, after several of them at once.

        Of very many exchanges, each alone is taken as if nothing were to be kept: the bound is looser, not wrong.
        """
        if not self.keeps or len(exchanges) > _JOINT:
            return exchanges
        together = {state}
        for after in exchanges:
            together |= {chosen | after for chosen in together if chosen & after == state}
        return sorted(after for after in together if after != state and self._is_allowed(after))

    # -- searching -------------------------------------------------------------------------------------

    def beam(self) -> PartResult:
        """A way through the part, not always the cheapest: the most promising states with each number of actions."""
        layers: list[dict[int, tuple[float, int]]] = [{} for _ in range(len(self.part.ops) + 1)]
        layers[0][0] = (0.0, -1)
        best, end, parents = inf, -1, dict[SearchNode, SearchNode | None]()
        for layer in layers:
            ranked = heapq.nsmallest(_BEAM, layer.items(), key=lambda item: item[1][0] + self.bounds.of(item[0]))
            for state, (cost, parent) in ranked:
                parents[state, ()] = None if parent < 0 else (parent, ())
                if state & self._goal == self._goal:
                    if cost < best:
                        best, end = cost, state
                    continue
                for after, more in self.moves(state):
                    following = layers[after.bit_count()]
                    if cost + more < following.get(after, (best, 0))[0]:
                        following[after] = (cost + more, state)
        return PartResult(self.bounds.of(0), best, _moves(parents, (end, ())) if end >= 0 else ())

    def run(self, stop: Callable[[], bool], known: PartResult) -> PartResult:
        """A*, until it is proved which way is the cheapest or ``stop`` says so. ``known`` is the best way known."""
        start: SearchNode = (0, (0.0,) * len(self.limits))
        costs = {start: 0.0}
        parents: dict[SearchNode, SearchNode | None] = {start: None}
        estimate = self.bounds.of(0)
        queue = [(estimate, 0, 0.0, start)]
        try:
            while queue:
                estimate, _, cost, node = queue[0]
                if estimate >= known.cost - _EPSILON:
                    break
                if stop():
                    raise KeyboardInterrupt
                heapq.heappop(queue)
                if cost > costs[node]:
                    continue  # reached more cheaply since
                state, spent = node
                first, last, finishing = self._at_ends(state, known.cost - cost)
                if (state | last) & self._goal == self._goal:
                    return PartResult(cost, cost, (*self._moves(parents, node), *finishing))
                for after, more in [(first, 0.0)] if first != state else self.moves(state):
                    if after & last:
                        continue
                    following = after, self._spent(spent, state, after)
                    total = cost + more
                    if total < costs.get(following, inf) - 1e-12 and self._is_within(following[1]):
                        bound = total + self.bounds.of(after)
                        if bound < known.cost - _EPSILON:
                            costs[following], parents[following] = total, node
                            heapq.heappush(queue, (bound, -after.bit_count(), total, following))
        except KeyboardInterrupt:
            # The least estimate that has been looked at is a lower bound whenever the search ends.
            return PartResult(estimate, known.cost, known.moves)
        return PartResult(known.cost, known.cost, known.moves)

    def _at_ends(self, state: int, most: float) -> tuple[int, int, Iterable[int]]:
        """The state after a replacement that may be made now, the actions to be made last, and these in order.

        So it is for each way on that costs less than ``most``.
        """
        if self._ends is None:
            return state, 0, ()
        numbers = self._ends.never_absent(state, most - _EPSILON - self.bounds.of_roles(state))
        if not numbers:
            return state, 0, ()
        last, finishing = self._ends.last(numbers)
        first = state if self.losses.loss(state) else self._ends.first(state, numbers, last)
        return first, last, finishing

    def _moves(self, parents: Mapping[SearchNode, SearchNode | None], end: SearchNode) -> tuple[int, ...]:
        found = _moves(parents, end)
        return found if self._ends is None else tuple(each for move in found for each in self._ends.split(move))

    def _spent(self, spent: tuple[float, ...], before: int, after: int) -> tuple[float, ...]:
        """The seconds below the baseline that the limits count, after one more step."""
        if not spent:
            return spent
        seconds = sum(s for bit, s in enumerate(self.part.seconds) if (after & ~before) >> bit & 1)
        if not seconds:
            return spent
        lost = {ref for state in (before, after) for ref, _ in self.losses.losses(state)}
        return tuple(
            round(so_far + seconds * (ref in lost), 9) for so_far, (ref, _) in zip(spent, self.limits, strict=True)
        )

    def _is_within(self, spent: tuple[float, ...]) -> bool:
        return all(s <= most + _EPSILON for s, (_, most) in zip(spent, self.limits, strict=True))


def _moves(parents: Mapping[SearchNode, SearchNode | None], end: SearchNode) -> tuple[int, ...]:
    found = []
    node: SearchNode | None = end
    while node is not None and (before := parents[node]) is not None:
        found.append(node[0] & ~before[0])
        node = before
    return tuple(reversed(found))

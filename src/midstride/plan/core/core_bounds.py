"""A lower bound on what is still to be lost in a part of the conflict core.

Each role by itself, and for each resource the roles that have to be absent at some time, so that the others fit.

The proof is in docs/decisions/least-disruption.md.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from midstride.plan.core.conflict_core import Part
from midstride.plan.core.core_losses import PartLosses

# So many sets of roles that make room are looked at; then the cost of the next one is the bound.
_SETS: Final = 200
_EPSILON: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Replaced:
    """A role with one old and one new instance: the bits of removing and creating, and what each of them holds.

    ``extra`` is what the role's bound grows by where the old one has to go first.
    """

    remove: int
    create: int
    old: tuple[int, ...]
    new: tuple[int, ...]
    extra: float


class RoleBounds:
    """The least cost of the creations and removals of each role, from any state of that role alone.

    All other roles are as favourable as they can be, except that a creation needs room: what has to be absent for it,
    of each resource by itself, is lost meanwhile.
    """

    def __init__(self, part: Part, losses: PartLosses) -> None:
        self.part, self.losses = part, losses
        self.timed = sum(1 << bit for bit, op in enumerate(part.ops) if op.port is None)
        self._roles = list(dict.fromkeys(part.roles))
        self._of_role = {role: sum(1 << bit for bit, of in enumerate(part.roles) if of == role) for role in self._roles}
        self.masks = [self._of_role[role] & self.timed for role in self._roles]
        self._favourable = sum(1 << bit for bit, op in enumerate(part.ops) if op.kind in ("create", "attach"))
        self._options = [list(self._room(place)) for place in range(len(self._roles))]
        self._tables: list[dict[int, float]] = [{} for _ in self._roles]
        self.replacements = replaced = list(self._replacements())
        # The order in which replacements need the least room: first those that free some, by what the new one takes,
        # then the others, by what the old one frees.
        self._orders = [
            sorted(replaced, key=lambda r: (0, r.new[place]) if r.new[place] <= r.old[place] else (1, -r.old[place]))
            for place in range(len(part.free))
        ]
        self._users = [  # of each resource: the actions that change its use, and by how much
            [(bit, 1 << bit, part.usage[bit][place]) for bit in _bits(self.timed) if part.usage[bit][place]]
            for place in range(len(part.free))
        ]
        self._by_extra = sorted(replaced, key=lambda each: each.extra)
        self._rooms: dict[int, float] = {}

    def of(self, state: int) -> float:
        """The least loss between ``state`` and the end."""
        own = state & self.timed
        room = self._rooms.get(own)
        if room is None:
            room = self._rooms[own] = max(
                (self._least_absences(own, resource) for resource in range(len(self.part.free))), default=0.0
            )
        return self.of_roles(state) + room

    def of_roles(self, state: int) -> float:
        """The bound of each role alone, without the room that it needs others to make; see :meth:`of`."""
        total = 0.0
        for place, mask in enumerate(self.masks):
            table, own = self._tables[place], state & mask
            found = table.get(own)
            total += self._least(place, own) if found is None else found
        return total

    def _replacements(self) -> Iterator[Replaced]:
        part = self.part
        for place, mask in enumerate(self.masks):
            creates = [bit for bit in _bits(mask) if part.ops[bit].kind == "create"]
            removes = [bit for bit in _bits(mask) if part.ops[bit].kind == "remove"]
            if len(creates) == len(removes) == 1 and not part.live[removes[0]]:
                (create,), (remove,) = creates, removes
                absent = part.seconds[remove] * self._loss(place, 1 << remove) + self._least(place, 1 << remove)
                yield Replaced(
                    1 << remove,
                    1 << create,
                    tuple(-amount for amount in part.usage[remove]),
                    part.usage[create],
                    absent - self._least(place, 0),
                )

    def _least_absences(self, state: int, resource: int) -> float:
        """The least that the bounds grow by, for the roles that must be absent at some time to make room.

        A role that is absent stays so and takes no room; each other one is replaced in the best order.
        """
        free = self.part.free[resource]
        waiting: dict[int, None] = {}
        gone = 0
        for each in self._by_extra:
            if not state & (each.remove | each.create):
                waiting[each.remove] = None
                if each.extra <= _EPSILON:  # to be absent costs no more
                    free += each.old[resource]
                    gone |= each.remove
        for bit, action, amount in self._users[resource]:
            if state & action:
                free -= amount
            elif amount < 0 and action not in waiting and self._is_possible(bit, state):
                free -= amount  # leaves when it likes
        order = [
            (each.remove, each.old[resource], each.new[resource])
            for each in self._orders[resource]
            if each.remove in waiting
        ]

        def is_enough(absent: int, room: int) -> bool:
            for bit, old, new in order:
                if not absent & bit:
                    if new > room:
                        return False
                    room += old - new
            return True

        if is_enough(gone, free):
            return 0.0
        choices = [e for e in self._by_extra if e.remove in waiting and not gone & e.remove and e.old[resource]]
        queue = [(choices[0].extra, 0, choices[0].remove, choices[0].old[resource])] if choices else []
        for _ in range(_SETS):
            if not queue:
                return 0.0
            cost, last, absent, freed = heapq.heappop(queue)
            if is_enough(gone | absent, free + freed):
                return cost
            if last + 1 < len(choices):
                this, following = choices[last], choices[last + 1]
                more = cost + following.extra, last + 1, absent | following.remove, freed + following.old[resource]
                heapq.heappush(queue, more)
                heapq.heappush(
                    queue,
                    (
                        more[0] - this.extra,
                        last + 1,
                        more[2] & ~this.remove,
                        more[3] - this.old[resource],
                    ),
                )
        return queue[0][0]  # more sets are left: there are 2**n - 1, which is never the number of those looked at

    def _least(self, place: int, own: int) -> float:
        """The least cost of the actions of one role that are not in ``own``, in any order."""
        table = self._tables[place]
        if own in table:
            return table[own]
        mask, best = self.masks[place], float("inf")
        if own == mask:
            best = 0.0
        for bit in _bits(mask & ~own):
            if not self._is_possible(bit, own):
                continue
            after, op = own | 1 << bit, self.part.ops[bit]
            lost = self._loss_with_room(place, own, bit) if op.kind == "create" else self._loss(place, after)
            best = min(best, lost * self.part.seconds[bit] + self._least(place, after))
        table[own] = best
        return best

    def _is_possible(self, bit: int, done: int) -> bool:
        """Return whether the subject of the action has been created."""
        return not self.part.live[bit] & self.timed & ~done

    def _state(self, place: int, own: int) -> int:
        """The state in which everything but one role is as favourable as it can be."""
        part, mask = self.part, self._of_role[self._roles[place]]
        state = self._favourable & ~mask | own
        for bit in _bits(mask & ~self.timed):
            op = part.ops[bit]
            removed = any(part.ops[b].kind == "remove" and part.ops[b].instance == op.instance for b in _bits(own))
            if op.kind == "attach" or removed:
                state |= 1 << bit
        return state

    def _loss(self, place: int, own: int) -> float:
        return self.losses.loss(self._state(place, own))

    # -- room ------------------------------------------------------------------------------------------

    def _room(self, place: int) -> Iterator[tuple[int, tuple[int, ...]]]:
        """The states of a role, each with what it takes of each resource, compared with the start."""
        mask = own = self.masks[place]
        while True:
            if all(self._is_possible(bit, own) for bit in _bits(own)):
                used = [sum((self.part.usage[bit][r] for bit in _bits(own)), 0) for r in range(len(self.part.free))]
                yield own, tuple(used)
            if not own:
                return
            own = (own - 1) & mask

    def _loss_with_room(self, place: int, own: int, bit: int) -> float:
        """The least loss in a state in which the role is in ``own`` and there is room for the creation ``bit``."""
        alone, part = self._loss(place, own), self.part
        best = alone
        for resource, free in enumerate(part.free):
            needed = part.usage[bit][resource]
            if not needed:
                continue
            used = sum((part.usage[b][resource] for b in _bits(own)), 0)
            best = max(best, self._donors(place, own, resource, needed + used - free, alone))
        return best

    def _donors(self, place: int, own: int, resource: int, needed: int, alone: float) -> float:
        """The least loss in which the other roles take ``needed`` less of the resource than at the start."""
        state = self._state(place, own)
        here = dict(self.losses.losses(state))
        weight = self.losses.levels.weight
        offers: list[tuple[float, int, float]] = []  # what it adds to the loss, what it frees, the loss of both
        for other, role in enumerate(self._roles):
            if other == place:
                continue
            mask, free, gains = self._of_role[role], 0, list[tuple[float, int, float]]()
            for theirs, used in self._options[other]:
                both = state & ~mask | self._state(other, theirs) & mask
                lost = self.losses.losses(both)
                total = sum(weight(ref) * levels for ref, levels in lost)
                added = sum(weight(ref) * (levels - here.get(ref, 0)) for ref, levels in lost if ref.instance == role)
                if total <= alone + 1e-9:
                    free = max(free, -used[resource])
                else:
                    gains.append((max(0.0, added), -used[resource], total))
            needed -= free
            if gains := [(added, gain - free, total) for added, gain, total in gains if gain > free]:
                # One offer for each role: the most it can free, for the least that any of its offers adds.
                offers.append((min(g[0] for g in gains), max(g[1] for g in gains), min(g[2] for g in gains)))
        if needed <= 0:
            return alone
        offers.sort(key=lambda offer: (offer[2], offer[0]))
        return _cheapest(offers, needed, alone)


def _cheapest(offers: list[tuple[float, int, float]], needed: int, alone: float) -> float:
    """The least of max(alone + the sum of what is added, the greatest loss of a pair), over sets that free enough."""
    best = float("inf")
    rest = [0] * (len(offers) + 1)
    for index in range(len(offers) - 1, -1, -1):
        rest[index] = rest[index + 1] + offers[index][1]

    def choose(index: int, still: int, added: float, pair: float) -> None:
        nonlocal best
        if max(alone + added, pair) >= best - 1e-9 or still > rest[index]:
            return
        if still <= 0:
            best = max(alone + added, pair)
            return
        more, gain, total = offers[index]
        choose(index + 1, still - gain, added + more, max(pair, total))
        choose(index + 1, still, added, pair)

    choose(0, needed, 0.0, alone)
    return best


def _bits(mask: int) -> Iterator[int]:
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low

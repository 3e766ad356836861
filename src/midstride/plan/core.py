"""The conflict core: what caps, capacities and the user's orders tie together (semantics.md section 5, F4).

Outside the core nothing needs deciding: what may be created, attached or handed over is, at
once, and what may be detached or removed waits until the end. :meth:`Core.advance` does that. Where
it gets stuck, something must break before it is made: :meth:`Core.moves` names the ways to go
on, each of them the least that unblocks something. Choosing among them is the planner's affair
(:mod:`midstride.plan.minimal`), and the place where an exact search belongs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal, TypeAlias

from midstride.model.action import Handover, Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Instance
from midstride.model.contract import satisfies
from midstride.model.rules import publishers_count
from midstride.model.specification import Order
from midstride.plan.change import Attachment, Change
from midstride.plan.constraints import layers
from midstride.plan.draft import Draft

_EPSILON: Final = 1e-9

# Sets of components to remove for one that needs room are looked for up to this size, among so many.
_SET_SIZE: Final = 3
_SET_FROM: Final = 10

Kind: TypeAlias = Literal["create", "remove", "attach", "detach", "exchange", "finish", "hand over", "part"]


@dataclass(frozen=True, slots=True)
class Move:
    """A way to go on from where nothing goes by itself."""

    kind: Kind
    names: tuple[str, ...] = ()
    attachment: Attachment | None = None
    swap: Swap | None = None


class Core:
    """A draft, and the structural actions still to be done. Mutable; ``copy`` before trying."""

    __slots__ = ("attaches", "creates", "detaches", "draft", "orders", "removes", "swaps")

    def __init__(self, draft: Draft, orders: Iterable[Order]) -> None:
        change = draft.change
        self.draft = draft
        self.orders = tuple(order for order in orders if order.first != order.then)
        self.creates: dict[str, Instance] = {instance.name: instance for instance in change.coming}
        self.removes: dict[str, None] = dict.fromkeys(change.leaving)
        self.attaches: dict[Attachment, None] = dict.fromkeys(change.attached)
        self.detaches: dict[Attachment, None] = dict.fromkeys(change.detached)
        self.swaps: dict[str, tuple[Swap, ...]] = {}
        for new, swaps in _pairs(change).items():
            self.swaps[new] = tuple(swaps)
            for swap in swaps:
                del self.attaches[swap.new, swap.connector]
                del self.detaches[swap.old, swap.connector]

    def copy(self) -> Core:
        twin = Core.__new__(Core)
        twin.draft, twin.orders = self.draft.copy(), self.orders
        twin.creates, twin.removes = dict(self.creates), dict(self.removes)
        twin.attaches, twin.detaches, twin.swaps = dict(self.attaches), dict(self.detaches), dict(self.swaps)
        return twin

    @property
    def only_goes(self) -> bool:
        """Whether all that comes has come: the rest is detaching and removing."""
        return not (self.creates or self.attaches or self.swaps)

    # -- what needs no deciding ------------------------------------------------------------------------

    def advance(self) -> None:
        """Do all that may be done at once and is never worse early."""
        self.draft.rise()
        progress = True
        while progress and not self.only_goes:
            open_roles = self._open_roles()
            progress = self._create(open_roles)
            progress = self._attach(open_roles) or progress
            self.draft.rise()
            progress = self._hand_over(open_roles) or progress

    def _open_roles(self) -> _Open:
        """The roles whose turn it is under the user's orders."""
        return _Open(self.orders, self._busy() if self.orders else set())

    def _busy(self) -> set[str]:
        role_of = self.draft.change.role_of
        names = [*self.creates, *self.removes, *self.swaps]
        names += [port.component for port, _ in (*self.attaches, *self.detaches)]
        return {role_of(name) for name in names}

    def _create(self, open_roles: _Open) -> bool:
        """Create what fits beside everything else that is to come; not while something has fallen."""
        if self.draft.meter.below:
            return False
        demand: dict[str, float] = {}
        for instance in self.creates.values():
            for resource, amount in instance.component.holds.items():
                demand[resource] = demand.get(resource, 0.0) + amount
        tight = {resource for resource, amount in demand.items() if not self._room(resource, amount)}
        ready = [
            name
            for name, instance in self.creates.items()
            if instance.role in open_roles and tight.isdisjoint(instance.component.holds)
        ]
        for name in ready:
            self.draft.create(self.creates.pop(name))
        return bool(ready)

    def _room(self, resource: str, amount: float) -> bool:
        s = self.draft.s
        return s.held.get(resource, 0.0) + amount <= s.world.capacity(resource) + _EPSILON

    def _attach(self, open_roles: _Open) -> bool:
        """Attach what fits beside everything else that is to come on its topic, or may have to."""
        wanted: dict[str, int] = {}
        for port, connector in self.attaches:
            if not self._is_input(port):
                wanted[connector] = wanted.get(connector, 0) + 1
        for swap in (swap for swaps in self.swaps.values() for swap in swaps):
            if swap.connector in wanted and not self._good(swap):
                wanted[swap.connector] += 1
        ready = [
            (port, connector)
            for port, connector in self.attaches
            if self._may_attach(port, open_roles)
            and (self._is_input(port) or self._slots(connector) >= wanted[connector])
        ]
        for port, connector in ready:
            del self.attaches[port, connector]
            self.draft.attach(port, connector)
        return bool(ready)

    def _is_input(self, port: PortRef) -> bool:
        return port.port in self.draft.change.component_of(port.component).inputs

    def _may_attach(self, port: PortRef, open_roles: _Open) -> bool:
        return port.component in self.draft.s.instances and self.draft.change.role_of(port.component) in open_roles

    def _slots(self, connector: str) -> float:
        """How many more publishers the topic takes. What is one topic on the wire counts as one."""
        s = self.draft.s
        cap = s.world.connectors[connector].cap
        if cap is None:
            return math.inf
        sibling = self.draft.change.sibling(connector)
        beside = 0 if sibling is None else len(s.publishers_on(sibling))
        return cap - publishers_count(s, connector) - beside

    def _hand_over(self, open_roles: _Open) -> bool:
        progress = False
        for new, swaps in list(self.swaps.items()):
            if self._fits(new, swaps, open_roles) and not self._costs(swaps):
                del self.swaps[new]
                self.draft.hand_over(swaps)
                self.draft.rise()
                progress = True
        return progress

    def _fits(self, new: str, swaps: Sequence[Swap], open_roles: _Open) -> bool:
        return self.draft.change.role_of(new) in open_roles and all(self._good(swap) for swap in swaps)

    def _good(self, swap: Swap) -> bool:
        """Whether the new one may take over, as it stands now."""
        return swap.new.component in self.draft.s.instances and self._satisfies(swap.new, swap.connector)

    def _satisfies(self, output: PortRef, connector: str) -> bool:
        s = self.draft.s
        return satisfies(s.guarantee(output), s.world.connectors[connector].guarantee)

    def _costs(self, swaps: tuple[Swap, ...]) -> bool:
        """Whether the role would fall, or fall further, by handing over now."""
        draft = self.draft
        after = Handover(swaps).effect(draft.s)
        below = draft.meter.levels.below(after, draft.change.role_of(swaps[0].new.component))
        return any(loss > draft.meter.below.get(ref, 0) for ref, loss in below.items())

    def finish(self) -> None:
        """Detach and remove what is left, role after role where the user asks for an order."""
        change, draft = self.draft.change, self.draft
        layered = layers(self._busy(), self.orders) or []
        for layer in layered:
            roles = set(layer)
            draft.detach(pair for pair in self.detaches if change.role_of(pair[0].component) in roles)
            for name in self.removes:
                if change.role_of(name) in roles:
                    draft.remove(name)
        self.detaches.clear()
        self.removes.clear()
        draft.rise()
        for name, parameters in change.parameters:
            draft.set(name, parameters)

    # -- what does -----------------------------------------------------------------------------------

    def moves(self) -> list[Move]:
        """The ways to go on, the least of each kind, in a stable order; empty where the user's orders leave none."""
        open_roles = self._open_roles()
        found = dict.fromkeys(
            [
                *self._hand_overs(open_roles),
                *self._creations(open_roles),
                *self._attachments(open_roles),
                *self._closings(open_roles),
                *self._parts(open_roles),
            ]
        )
        return list(found)

    def _hand_overs(self, open_roles: _Open) -> Iterator[Move]:
        for new, swaps in self.swaps.items():
            if self._fits(new, swaps, open_roles):
                yield Move("hand over", (new,))

    def _creations(self, open_roles: _Open) -> Iterator[Move]:
        for name, instance in self.creates.items():
            if instance.role not in open_roles:
                continue
            holds = instance.component.holds
            short = [resource for resource in sorted(holds) if not self._room(resource, holds[resource])]
            if not short:
                yield Move("create", (name,))
                continue
            for names in self._making_room(short, instance, open_roles):
                yield Move("remove", names)

    def _making_room(self, short: Sequence[str], instance: Instance, open_roles: _Open) -> Iterator[tuple[str, ...]]:
        """The least sets of components whose removal makes room for ``instance``."""
        s, change = self.draft.s, self.draft.change
        need = {
            resource: s.held.get(resource, 0.0) + instance.component.holds[resource] - s.world.capacity(resource)
            for resource in short
        }
        holders = [
            name
            for name in self.removes
            if change.role_of(name) in open_roles and any(resource in s.component(name).holds for resource in short)
        ]

        def enough(names: Iterable[str]) -> bool:
            given = [s.component(name).holds for name in names]
            return all(sum(h.get(r, 0.0) for h in given) + _EPSILON >= amount for r, amount in need.items())

        found: list[tuple[str, ...]] = []
        for size in range(1, _SET_SIZE + 1):
            for names in combinations(holders[:_SET_FROM], size):
                if enough(names) and not any(set(less) <= set(names) for less in found):
                    found.append(names)
        if not found and enough(holders):
            least = list(holders)
            for name in holders:
                rest = [other for other in least if other != name]
                least = rest if enough(rest) else least
            found.append(tuple(least))
        yield from found

    def _attachments(self, open_roles: _Open) -> Iterator[Move]:
        """Taking a slot of a capped topic; or making one, by handing over to the one that waits or by detaching."""
        s, change = self.draft.s, self.draft.change
        for port, connector in self.attaches:
            if not self._may_attach(port, open_roles):
                continue
            if self._slots(connector) >= 1:
                yield Move("attach", attachment=(port, connector))
            for other, on in self.detaches:
                if on not in (connector, change.sibling(connector)) or not s.is_output(other):
                    continue
                if change.role_of(other.component) not in open_roles:
                    continue
                if on == connector and self._satisfies(port, connector):
                    yield Move("exchange", swap=Swap(connector, other, port))
                yield Move("detach", attachment=(other, on))

    def _closings(self, open_roles: _Open) -> Iterator[Move]:
        """A role after which another is to come, and of which only the going is left."""
        role_of = self.draft.change.role_of
        coming = {role_of(name) for name in (*self.creates, *self.swaps)}
        coming |= {role_of(port.component) for port, _ in self.attaches}
        for role in sorted({order.first for order in self.orders} & self._busy()):
            if role in open_roles and role not in coming:
                yield Move("finish", (role,))

    def _parts(self, open_roles: _Open) -> Iterator[Move]:
        """A replacement that is not good enough for all its topics: those are not handed over."""
        for new, swaps in self.swaps.items():
            live = new in self.draft.s.instances and self.draft.change.role_of(new) in open_roles
            if live and not self._fits(new, swaps, open_roles):
                yield Move("part", (new,))

    def play(self, move: Move) -> None:
        """Make a move."""
        draft = self.draft
        match move.kind:
            case "create":
                draft.create(self.creates.pop(move.names[0]))
            case "hand over":
                draft.hand_over(self.swaps.pop(move.names[0]))
            case "remove":
                for name in move.names:
                    self._take_down(name)
            case "attach":
                assert move.attachment is not None
                del self.attaches[move.attachment]
                draft.attach(*move.attachment)
            case "detach":
                assert move.attachment is not None
                del self.detaches[move.attachment]
                draft.detach([move.attachment])
            case "exchange":
                assert move.swap is not None
                del self.attaches[move.swap.new, move.swap.connector]
                del self.detaches[move.swap.old, move.swap.connector]
                draft.hand_over([move.swap])
            case "finish":
                self._close(move.names[0])
            case "part":
                swaps = self.swaps.pop(move.names[0])
                good = tuple(swap for swap in swaps if self._good(swap))
                if good:
                    self.swaps[move.names[0]] = good
                self._dissolve(swap for swap in swaps if swap not in good)
        draft.rise()

    def _dissolve(self, swaps: Iterable[Swap]) -> None:
        """Attach and detach by themselves what cannot be handed over."""
        for swap in swaps:
            self.attaches[swap.new, swap.connector] = None
            self.detaches[swap.old, swap.connector] = None

    def _take_down(self, name: str) -> None:
        """Break before make: detach all that ``name`` is attached to, and remove it."""
        new = self.draft.change.replaced.get(name)
        if new is not None:
            self._dissolve(self.swaps.pop(new, ()))
            self._attach(self._open_roles())
        pairs = [pair for pair in self.detaches if pair[0].component == name]
        self.draft.detach(pairs)
        for pair in pairs:
            del self.detaches[pair]
        del self.removes[name]
        self.draft.remove(name)

    def _close(self, role: str) -> None:
        role_of = self.draft.change.role_of
        pairs = [pair for pair in self.detaches if role_of(pair[0].component) == role]
        self.draft.detach(pairs)
        for pair in pairs:
            del self.detaches[pair]
        for name in [name for name in self.removes if role_of(name) == role]:
            del self.removes[name]
            self.draft.remove(name)


@dataclass(frozen=True, slots=True)
class _Open:
    """Membership test: may the structural actions of a role be taken now?"""

    orders: tuple[Order, ...]
    busy: set[str]

    def __contains__(self, role: str) -> bool:
        return not any(order.then == role and order.first in self.busy for order in self.orders)


def _pairs(change: Change) -> dict[str, list[Swap]]:
    """The exchanges of each replaced role: same port where there is one, else any other on the same topic."""
    going: dict[str, list[Attachment]] = {}
    for port, connector in change.detached:
        if port.component in change.replaced and port.port not in change.component_of(port.component).inputs:
            going.setdefault(port.component, []).append((port, connector))
    coming: dict[str, list[Attachment]] = {}
    for port, connector in change.attached:
        if port.port not in change.component_of(port.component).inputs:
            coming.setdefault(port.component, []).append((port, connector))
    found: dict[str, list[Swap]] = {}
    for old, olds in going.items():
        new = change.replaced[old]
        free = dict.fromkeys(coming.get(new, ()))
        for same_port in (True, False):
            for port, connector in list(olds):
                match = next(
                    (pair for pair in free if pair[1] == connector and (not same_port or pair[0].port == port.port)),
                    None,
                )
                if match is not None:
                    del free[match]
                    olds.remove((port, connector))
                    found.setdefault(new, []).append(Swap(connector, port, match[0]))
    return found

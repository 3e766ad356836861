"""The conflict core: what caps, capacities and the user's orders tie together (semantics.md section 5, F4).

Outside the core nothing needs deciding: what may be created, attached or handed over is, at
once, and what may be detached or removed waits until the end. :meth:`SearchState.advance` does that. Where
it gets stuck, something must break before it is made: :mod:`midstride.plan.moves` names
the ways to go on. Choosing among them is the planner's affair (:mod:`midstride.plan.minimal`), and the
place where an exact search belongs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from midstride.model.action import Handover, Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Instance, to_fraction
from midstride.model.contract import satisfies
from midstride.model.rules import publishers_count
from midstride.model.specification import Order
from midstride.plan.change import Attachment
from midstride.plan.constraints import layers
from midstride.plan.moves import Move
from midstride.plan.plan_builder import PlanBuilder

_NOTHING: Final = Fraction()


@dataclass(frozen=True, slots=True)
class OrderGate:
    """Membership test: may the structural actions of a role be taken now?"""

    orders: tuple[Order, ...]
    busy: set[str]

    def __contains__(self, role: str) -> bool:
        return not any(order.then == role and order.first in self.busy for order in self.orders)


class SearchState:
    """A draft, and the structural actions still to be done. Mutable; ``copy`` before trying.

    ``eager``: a hand-over that costs nothing is made at once, even where others wait for a place on its topic.
    """

    __slots__ = ("attaches", "creates", "detaches", "draft", "eager", "orders", "removes", "swaps")

    def __init__(self, draft: PlanBuilder, orders: Iterable[Order], *, eager: bool = True) -> None:
        change = draft.change
        self.draft = draft
        self.eager = eager
        self.orders = tuple(order for order in orders if order.first != order.then)
        self.creates: dict[str, Instance] = {instance.name: instance for instance in change.coming}
        self.removes: dict[str, None] = dict.fromkeys(change.leaving)
        self.attaches: dict[Attachment, None] = dict.fromkeys(change.attached)
        self.detaches: dict[Attachment, None] = dict.fromkeys(change.detached)
        self.swaps: dict[str, tuple[Swap, ...]] = {}
        for new, swaps in change.exchanges().items():
            self.swaps[new] = swaps
            for swap in swaps:
                del self.attaches[swap.new, swap.connector]
                del self.detaches[swap.old, swap.connector]

    def copy(self) -> SearchState:
        twin = SearchState.__new__(SearchState)
        twin.draft, twin.orders, twin.eager = self.draft.copy(), self.orders, self.eager
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
            turn = self.turn()
            progress = self._create(turn)
            progress = self._attach(turn) or progress
            self.draft.rise()
            progress = self._hand_over(turn) or progress

    def turn(self) -> OrderGate:
        """The roles whose turn it is under the user's orders."""
        return OrderGate(self.orders, self.busy() if self.orders else set())

    def layers(self) -> list[list[str]] | None:
        """The roles with something left to do, in the order asked for; None where the orders contradict each other."""
        return layers(self.busy(), self.orders)

    def busy(self) -> set[str]:
        role_of = self.draft.change.role_of
        names = [*self.creates, *self.removes, *self.swaps]
        names += [port.instance for port, _ in (*self.attaches, *self.detaches)]
        return {role_of(name) for name in names}

    def _create(self, turn: OrderGate) -> bool:
        """Create what fits beside everything else that is to come; not while something has fallen."""
        if self.draft.meter.below:
            return False
        demand: dict[str, Fraction] = {}
        for instance in self.creates.values():
            for resource, amount in instance.component.resource_usage.items():
                demand[resource] = demand.get(resource, _NOTHING) + to_fraction(amount)
        tight = {resource for resource, amount in demand.items() if self.lack(resource, amount) > 0}
        ready = [
            name
            for name, instance in self.creates.items()
            if instance.role in turn and tight.isdisjoint(instance.component.resource_usage)
        ]
        for name in ready:
            self.draft.create(self.creates.pop(name))
        return bool(ready)

    def is_relieved(self, name: str) -> bool:
        """Whether a component that leaves has been replaced already, and nothing rests on its outputs any more."""
        new = self.draft.change.replaced.get(name)
        return new in self.draft.configuration.instances and new not in self.swaps

    def lack(self, resource: str, amount: Fraction) -> Fraction:
        """How much of the resource is missing for so much more of it; more than 0 where there is no room."""
        configuration = self.draft.configuration
        return (
            configuration.held.get(resource, _NOTHING) + amount - to_fraction(configuration.context.capacity(resource))
        )

    def _attach(self, turn: OrderGate) -> bool:
        """Attach what fits beside everything else that is to come on its topic, or may have to."""
        wanted: dict[str, int] = {}
        for port, connector in self.attaches:
            if not self._is_input(port):
                wanted[connector] = wanted.get(connector, 0) + 1
        for swap in (swap for swaps in self.swaps.values() for swap in swaps):
            if swap.connector in wanted and not self.good(swap):
                wanted[swap.connector] += 1
        ready = [
            (port, connector)
            for port, connector in self.attaches
            if self.may_attach(port, turn) and (self._is_input(port) or self.slots(connector) >= wanted[connector])
        ]
        for port, connector in ready:
            del self.attaches[port, connector]
            self.draft.attach(port, connector)
        return bool(ready)

    def _is_input(self, port: PortRef) -> bool:
        return port.port in self.draft.change.component_of(port.instance).inputs

    def may_attach(self, port: PortRef, turn: OrderGate) -> bool:
        return port.instance in self.draft.configuration.instances and self.draft.change.role_of(port.instance) in turn

    def slots(self, connector: str) -> float:
        """How many more publishers the topic takes. What is one topic on the wire counts as one."""
        configuration = self.draft.configuration
        cap = configuration.context.connectors[connector].max_publishers
        if cap is None:
            return math.inf
        sibling = self.draft.change.sibling(connector)
        beside = 0 if sibling is None else len(configuration.publishers_on(sibling))
        return cap - publishers_count(configuration, connector) - beside

    def _hand_over(self, turn: OrderGate) -> bool:
        progress = False
        for new, swaps in list(self.swaps.items()):
            if self.fits(new, swaps, turn) and not self.costs(swaps) and not self._may_wait(new, swaps):
                del self.swaps[new]
                self.draft.hand_over(swaps)
                self.draft.rise()
                progress = True
        return progress

    def _may_wait(self, new: str, swaps: Iterable[Swap]) -> bool:
        """Whether it may be better to hand over later, or not at all, because of a topic that is full."""
        own = any(port.instance == new and self._is_capped(connector) for port, connector in self.attaches)
        return not self.eager and (own or self.is_wanted(swaps))

    def is_wanted(self, swaps: Iterable[Swap]) -> bool:
        """Whether another output could do with a place that these would hand on, if it were given up instead."""
        return not self.eager and any(self._is_wanted(swap) for swap in swaps)

    def _is_wanted(self, swap: Swap) -> bool:
        if not self._is_capped(swap.connector):
            return False
        others = [other for swaps in self.swaps.values() for other in swaps if other.connector == swap.connector]
        if any(other != swap and not self.good(other) for other in others):
            return True
        return any(connector == swap.connector and not self._is_input(port) for port, connector in self.attaches)

    def _is_capped(self, connector: str) -> bool:
        return self.draft.configuration.context.connectors[connector].max_publishers is not None

    def fits(self, new: str, swaps: Sequence[Swap], turn: OrderGate) -> bool:
        return self.draft.change.role_of(new) in turn and all(self.good(swap) for swap in swaps)

    def good(self, swap: Swap) -> bool:
        """Whether the new one may take over, as it stands now."""
        return swap.new.instance in self.draft.configuration.instances and self.satisfies_topic(
            swap.new, swap.connector
        )

    def satisfies_topic(self, output: PortRef, connector: str) -> bool:
        configuration = self.draft.configuration
        return satisfies(configuration.guarantee(output), configuration.context.connectors[connector].guarantee)

    def costs(self, swaps: tuple[Swap, ...]) -> bool:
        """Whether the role would fall, or fall further, by handing over now."""
        draft = self.draft
        after = Handover(swaps).effect(draft.configuration)
        below = draft.meter.levels.below(after, draft.change.role_of(swaps[0].new.instance))
        return any(loss > draft.meter.below.get(ref, 0) for ref, loss in below.items())

    def finish(self) -> None:
        """Detach and remove what is left, role after role where the user asks for an order."""
        change, draft = self.draft.change, self.draft
        for layer in self.layers() or ():
            roles = set(layer)
            draft.detach(pair for pair in self.detaches if change.role_of(pair[0].instance) in roles)
            for name in self.removes:
                if change.role_of(name) in roles:
                    draft.remove(name)
        self.detaches.clear()
        self.removes.clear()
        draft.rise()
        for name, parameters in change.parameters:
            draft.set(name, parameters)

    # -- what does -----------------------------------------------------------------------------------

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
                good = tuple(swap for swap in swaps if self.good(swap) and not self.is_wanted([swap]))
                if good == swaps:
                    good = ()
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
            self._attach(self.turn())
        pairs = [pair for pair in self.detaches if pair[0].instance == name]
        self.draft.detach(pairs)
        for pair in pairs:
            del self.detaches[pair]
        del self.removes[name]
        self.draft.remove(name)

    def _close(self, role: str) -> None:
        role_of = self.draft.change.role_of
        pairs = [pair for pair in self.detaches if role_of(pair[0].instance) == role]
        self.draft.detach(pairs)
        for pair in pairs:
            del self.detaches[pair]
        for name in [name for name in self.removes if role_of(name) == role]:
            del self.removes[name]
            self.draft.remove(name)

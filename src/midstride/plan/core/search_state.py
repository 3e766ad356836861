"""A state of the search through the conflict core: what caps, capacities and the user's orders tie together.

docs/semantics.md section 5, F4. Outside the core nothing needs deciding: what can be created, attached or handed
over is done at once, and what can be detached or removed waits until the end. :meth:`SearchState.advance` does
that. Where it gets stuck, something has to break before it is made: :mod:`midstride.plan.core.moves` lists the ways to
go on, and the planner (:mod:`midstride.plan.strategies.minimal`) chooses among them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final, TypeVar

from midstride.model.action import Handover, Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Instance, to_fraction
from midstride.model.contract import satisfies
from midstride.model.rules import publishers_count
from midstride.model.specification import Order
from midstride.plan.change import PortAttachment
from midstride.plan.constraints import layers
from midstride.plan.strategies.plan_builder import PlanBuilder

_NOTHING: Final = Fraction()

K = TypeVar("K")
V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class UnblockedRoles:
    """Membership test: does no order of the user hold back the structural actions of a role now?"""

    orders: tuple[Order, ...]
    unfinished: frozenset[str]

    def __contains__(self, role: str) -> bool:
        return not any(order.then == role and order.first in self.unfinished for order in self.orders)


@dataclass(frozen=True, slots=True)
class SearchState:
    """The plan so far, and the structural actions still to be done. An immutable value.

    The order of ``creates`` and ``swaps`` (by the name of the new instance) decides the order of the steps, so they
    are dicts rather than Maps, and never mutated. ``eager``: a hand-over that costs nothing is made at once, even
    where other outputs wait for a slot on its topic.
    """

    builder: PlanBuilder
    orders: tuple[Order, ...]
    creates: Mapping[str, Instance]
    removes: tuple[str, ...]
    attaches: tuple[PortAttachment, ...]
    detaches: tuple[PortAttachment, ...]
    swaps: Mapping[str, tuple[Swap, ...]]
    eager: bool = True

    @classmethod
    def at_start(cls, builder: PlanBuilder, orders: Iterable[Order], *, eager: bool = True) -> SearchState:
        """The state in which everything is still to be done."""
        change, swaps = builder.change, builder.change.exchanges()
        gained = {(swap.new, swap.connector) for group in swaps.values() for swap in group}
        given = {(swap.old, swap.connector) for group in swaps.values() for swap in group}
        return cls(
            builder=builder,
            orders=tuple(order for order in orders if order.first != order.then),
            creates={instance.name: instance for instance in change.coming},
            removes=change.leaving,
            attaches=_minus(change.attached, gained),
            detaches=_minus(change.detached, given),
            swaps=swaps,
            eager=eager,
        )

    @property
    def only_removals_left(self) -> bool:
        """Return whether everything new is in place: only detaching and removing is left."""
        return not (self.creates or self.attaches or self.swaps)

    # -- what needs no decision ------------------------------------------------------------------------

    def advance(self) -> SearchState:
        """Do everything that can be done at once and is never worse early."""
        state, before = self.raise_touched(), None
        while state is not before and not state.only_removals_left:
            before = state
            unblocked = state.unblocked_roles()
            state = state._create_what_fits(unblocked)._attach_what_fits(unblocked).raise_touched()
            state = state._hand_over_for_free(unblocked)
        return state

    def raise_touched(self) -> SearchState:
        builder = self.builder.raise_touched()
        return self if builder is self.builder else replace(self, builder=builder)

    def unblocked_roles(self) -> UnblockedRoles:
        """The roles for which the user's orders allow structural actions now."""
        return UnblockedRoles(self.orders, self.unfinished_roles() if self.orders else frozenset())

    def layers(self) -> list[list[str]] | None:
        """The unfinished roles in the order asked for; None where the orders contradict each other."""
        return layers(self.unfinished_roles(), self.orders)

    def unfinished_roles(self) -> frozenset[str]:
        """The roles with structural actions still to be done."""
        ports = (port.instance for port, _ in (*self.attaches, *self.detaches))
        role_of = self.builder.change.role_of
        return frozenset(role_of(name) for name in (*self.creates, *self.removes, *self.swaps, *ports))

    def _create_what_fits(self, unblocked: UnblockedRoles) -> SearchState:
        """Create what fits beside everything else that is to come; not while something is below its baseline."""
        if self.builder.meter.below:
            return self
        demand: dict[str, Fraction] = {}
        for instance in self.creates.values():
            for resource, amount in instance.resource_usage.items():
                demand[resource] = demand.get(resource, _NOTHING) + to_fraction(amount)
        scarce = {resource for resource, amount in demand.items() if self.shortage(resource, amount) > 0}
        ready = [
            name
            for name, instance in self.creates.items()
            if instance.role in unblocked and scarce.isdisjoint(instance.resource_usage)
        ]
        return self.create(*ready) if ready else self

    def create(self, *names: str) -> SearchState:
        builder = self.builder.create(*(self.creates[name] for name in names))
        return replace(self, builder=builder, creates=_without(self.creates, names))

    def is_superseded(self, name: str) -> bool:
        """Return whether an instance that leaves has been replaced already, and nothing relies on its outputs any
        more.
        """
        new = self.builder.change.replaced.get(name)
        return new in self.builder.configuration.instances and new not in self.swaps

    def shortage(self, resource: str, amount: Fraction) -> Fraction:
        """The amount of the resource that is missing for ``amount`` more of it; at most 0 where there is room."""
        configuration = self.builder.configuration
        capacity = to_fraction(configuration.context.capacity(resource))
        return configuration.held.get(resource, _NOTHING) + amount - capacity

    def _attach_what_fits(self, unblocked: UnblockedRoles) -> SearchState:
        """Attach what fits beside every other publisher that is, or may have to be, attached to the same topic."""
        is_output = self.builder.change.is_output
        wanted = Counter(connector for port, connector in self.attaches if is_output(port))
        for swap in (swap for swaps in self.swaps.values() for swap in swaps):
            if swap.connector in wanted and not self.can_take_over(swap):
                wanted[swap.connector] += 1
        ready = [
            (port, connector)
            for port, connector in self.attaches
            if self.may_attach(port, unblocked)
            and (not is_output(port) or self.free_slots(connector) >= wanted[connector])
        ]
        return self.attach(*ready) if ready else self

    def attach(self, *attachments: PortAttachment) -> SearchState:
        return replace(
            self, builder=self.builder.attach(*attachments), attaches=_minus(self.attaches, set(attachments))
        )

    def may_attach(self, port: PortRef, unblocked: UnblockedRoles) -> bool:
        builder = self.builder
        return port.instance in builder.configuration.instances and builder.change.role_of(port.instance) in unblocked

    def free_slots(self, connector: str) -> float:
        """The number of further publishers that the topic admits. Old and new contract of one topic count together."""
        configuration = self.builder.configuration
        cap = configuration.context.connectors[connector].max_publishers
        if cap is None:
            return math.inf
        sibling = self.builder.change.sibling(connector)
        beside = 0 if sibling is None else len(configuration.publishers_on(sibling))
        return cap - publishers_count(configuration, connector) - beside

    def _hand_over_for_free(self, unblocked: UnblockedRoles) -> SearchState:
        state = self
        for new, swaps in self.swaps.items():
            if (
                state.can_hand_over(new, swaps, unblocked)
                and not state.lowers_role(swaps)
                and not state._may_wait(new, swaps)
            ):
                state = state.hand_over(new).raise_touched()
        return state

    def hand_over(self, new: str) -> SearchState:
        """Make all the swaps of the instance ``new``."""
        return replace(self, builder=self.builder.hand_over(self.swaps[new]), swaps=_without(self.swaps, (new,)))

    def _may_wait(self, new: str, swaps: Iterable[Swap]) -> bool:
        """Return whether handing over later may be better, or not at all, because of a topic that is full."""
        waiting = any(port.instance == new and self._is_capped(connector) for port, connector in self.attaches)
        return not self.eager and (waiting or self.is_contended(swaps))

    def is_contended(self, swaps: Iterable[Swap]) -> bool:
        """Return whether another output could use a slot that these swaps hand on, if the slot were given up
        instead.
        """
        return not self.eager and any(self._is_capped(swap.connector) and self._is_awaited(swap) for swap in swaps)

    def _is_awaited(self, swap: Swap) -> bool:
        others = (other for group in self.swaps.values() for other in group if other.connector == swap.connector)
        is_output = self.builder.change.is_output
        return any(other != swap and not self.can_take_over(other) for other in others) or any(
            connector == swap.connector and is_output(port) for port, connector in self.attaches
        )

    def _is_capped(self, connector: str) -> bool:
        return self.builder.configuration.context.connectors[connector].max_publishers is not None

    def can_hand_over(self, new: str, swaps: Sequence[Swap], unblocked: UnblockedRoles) -> bool:
        return self.builder.change.role_of(new) in unblocked and all(self.can_take_over(swap) for swap in swaps)

    def can_take_over(self, swap: Swap) -> bool:
        """Return whether the new output, in its current mode, satisfies the topic."""
        configuration = self.builder.configuration
        ready = swap.new.instance in configuration.instances and configuration.is_attached(swap.old, swap.connector)
        return ready and self.satisfies_topic(swap.new, swap.connector)

    def satisfies_topic(self, output: PortRef, connector: str) -> bool:
        configuration = self.builder.configuration
        return satisfies(configuration.guarantee(output), configuration.context.connectors[connector].guarantee)

    def lowers_role(self, swaps: tuple[Swap, ...]) -> bool:
        """Return whether the role would fall below its baseline, or further below it, by handing over now."""
        meter = self.builder.meter
        after = Handover(swaps).effect(self.builder.configuration)
        below = meter.levels.below(after, self.builder.change.role_of(swaps[0].new.instance))
        return any(loss > meter.below.get(ref, 0) for ref, loss in below.items())

    # -- building blocks of the moves ------------------------------------------------------------------

    def detach(self, attachments: Sequence[PortAttachment]) -> SearchState:
        return replace(self, builder=self.builder.detach(attachments), detaches=_minus(self.detaches, set(attachments)))

    def exchange(self, *swaps: Swap) -> SearchState:
        """Hand topics over from outputs that are to be detached to ones that are to be attached, all at once."""
        return replace(
            self,
            builder=self.builder.hand_over(swaps),
            attaches=_minus(self.attaches, {(swap.new, swap.connector) for swap in swaps}),
            detaches=_minus(self.detaches, {(swap.old, swap.connector) for swap in swaps}),
        )

    def swaps_of_others(self, new: str) -> dict[str, tuple[Swap, ...]]:
        return {name: swaps for name, swaps in self.swaps.items() if name != new}

    def without_swaps(self, new: str, kept: tuple[Swap, ...] = ()) -> SearchState:
        """Attach and detach separately what ``new`` was to take over, except for the swaps ``kept``."""
        split = [swap for swap in self.swaps.get(new, ()) if swap not in kept]
        return replace(
            self,
            attaches=(*self.attaches, *((swap.new, swap.connector) for swap in split)),
            detaches=(*self.detaches, *((swap.old, swap.connector) for swap in split)),
            swaps={**self.swaps_of_others(new), **({new: kept} if kept else {})},
        )

    def giving_up(self, stand_in: str) -> SearchState:
        """Without what the stand-in has not been attached to yet."""
        state = self.without_swaps(stand_in)
        pending = {pair for pair in state.attaches if pair[0].instance == stand_in}
        return replace(state, attaches=_minus(state.attaches, pending), detaches=_minus(state.detaches, pending))

    def remove(self, names: Sequence[str], detached: Sequence[PortAttachment]) -> SearchState:
        """Make all of ``detached``, then remove ``names``."""
        state = self.detach(detached)
        return replace(state, builder=state.builder.remove(*names), removes=_minus(state.removes, set(names)))

    def remove_rest_of(self, roles: Iterable[str]) -> SearchState:
        """Detach and remove what is left to be detached and removed of some roles."""
        chosen, role_of = set(roles), self.builder.change.role_of
        names = [name for name in self.removes if role_of(name) in chosen]
        return self.remove(names, [pair for pair in self.detaches if role_of(pair[0].instance) in chosen])

    def finish(self) -> PlanBuilder:
        """The whole plan: detaches and removes what is left, by role where the user asks for an order."""
        state = self
        for layer in self.layers() or ():
            state = state.remove_rest_of(layer)
        return state.builder.raise_touched().set_parameters(self.builder.change.parameters)


def _minus(items: tuple[K, ...], removed: set[K]) -> tuple[K, ...]:
    return tuple(item for item in items if item not in removed)


def _without(mapping: Mapping[K, V], keys: Iterable[K]) -> dict[K, V]:
    rest = dict(mapping)
    for key in keys:
        del rest[key]
    return rest

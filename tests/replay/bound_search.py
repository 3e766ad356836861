"""The search behind the check of a plan's lower bound (:mod:`tests.replay.bound_check`).

The states are sets of structural differences that are done. By F3, what adds structure and needs neither time nor a
slot is done at once, and what takes it away only when something waits for it. If nothing is lost at first, an instance
that everything else leaves room for comes first and goes last. All other orders are searched, cheapest first. Of a
`limit` of more than 0 s, only the seconds of creations and removals are counted.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from typing import Final, Protocol, TypeAlias

from midstride.model.best import best
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, to_fraction
from midstride.model.rules import publishers_count
from midstride.model.specification import Order
from midstride.plan.change import Change
from midstride.plan.constraints import in_force

_EPSILON: Final = 1e-6

# "create" and "remove" with an instance, "attach" and "detach" with a port and a connector.
StructuralOp: TypeAlias = tuple[str, str, PortRef | None, str]
OpsDone: TypeAlias = frozenset[StructuralOp]

_NOTHING: Final[OpsDone] = frozenset()
_NO_REFS: Final[frozenset[FunctionalityRef]] = frozenset()


class Definition(Protocol):
    """What plans cost and what the user's constraints allow, from the definition.

    ``limits``: for how long (s) functionalities may be below their baselines, where that is more than 0 s.
    """

    @property
    def limits(self) -> Mapping[FunctionalityRef, float]: ...

    def loss(self, configuration: Configuration) -> float:
        """The weighted sum of the levels below the baseline."""

    def is_allowed(self, configuration: Configuration) -> bool:
        """Whether no ``keep`` and no ``limit`` of 0 s forbids it."""

    def limited(self, configuration: Configuration) -> frozenset[FunctionalityRef]:
        """Those of ``limits`` that are below their baselines."""


def _create(name: str) -> StructuralOp:
    return "create", name, None, ""


def _remove(name: str) -> StructuralOp:
    return "remove", name, None, ""


def _pair(kind: str, port: PortRef, connector: str) -> StructuralOp:
    return kind, "", port, connector


class SearchTooLarge(Exception):
    """More functionalities than may be evaluated."""


class Work:
    """How many functionalities may still be evaluated."""

    def __init__(self, most: int) -> None:
        self._left = most

    def spend(self, functionalities: int) -> None:
        """Raises SearchTooLarge."""
        self._left -= functionalities
        if self._left < 0:
            raise SearchTooLarge


@dataclass(frozen=True, slots=True)
class _Found:
    """What is known of a state: its largest structure, and what of that is lost, allowed and limited."""

    configuration: Configuration
    loss: float
    is_allowed: bool
    limited: frozenset[FunctionalityRef]


class BoundSearch:
    """The creations and removals of ``roles`` (None: all); of the others, all that is new exists, and all that is old
    still does, while neither takes any room."""

    def __init__(
        self,
        change: Change,
        seconds: Callable[[str, Instance], float],
        definition: Definition,
        work: Work,
        roles: Collection[str] | None,
    ) -> None:
        self.change, self._definition, self._work = change, definition, work
        self._limits = tuple(definition.limits.items())
        self._known: dict[OpsDone, _Found] = {}
        own = {name for name in change.instances() if roles is None or change.role_of(name) in roles}
        self.creates = {_create(each.name): each for each in change.coming if each.name in own}
        self.removes = {_remove(name): name for name in change.leaving if name in own}
        self.seconds = {op: seconds("create", each) for op, each in self.creates.items()}
        self.seconds |= {op: seconds("remove", change.instance(name)) for op, name in self.removes.items()}
        capped = [pair for pair in change.attached if self._is_capped(*pair)]
        self.attaches = {_pair("attach", *pair): pair for pair in capped if pair[0].instance in own}
        freed = [pair for pair in change.detached if self._is_capped(*pair)]
        self.detaches = {_pair("detach", *pair): pair for pair in freed if pair[0].instance in own}
        # What the others hold in every state, but do not count.
        self._held = dict[str, Fraction]()
        for name in {*(each.name for each in change.coming), *change.leaving} - own:
            for resource, amount in change.instance(name).resource_usage.items():
                self._held[resource] = self._held.get(resource, Fraction()) + to_fraction(amount)
        self._publishing = Counter(connector for port, connector in (*capped, *freed) if port.instance not in own)
        self._awaited = self._orders()
        self._served = {op: self._before_leaving(op) for op in (*self.removes, *self.detaches)}
        self.first: OpsDone = frozenset()
        self.goal: OpsDone = frozenset([*self.creates, *self.removes, *self.attaches])
        if not self._state(self.first).loss:
            scarce = self._scarce()
            self.first = frozenset(
                op for op, instance in self.creates.items() if scarce.isdisjoint(instance.resource_usage)
            )
            self.goal -= {
                op for op, name in self.removes.items() if scarce.isdisjoint(change.instance(name).resource_usage)
            }

    def _orders(self) -> dict[str, OpsDone]:
        """By role, what the user's orders put before anything of it."""
        change, found = self.change, dict[str, OpsDone]()
        for order in in_force(change):
            if isinstance(order, Order) and order.first != order.then:
                first = [op for op, each in self.creates.items() if each.role == order.first]
                first += [op for op, name in self.removes.items() if change.role_of(name) == order.first]
                found[order.then] = found.get(order.then, frozenset()) | frozenset(first)
        return found

    def _before_leaving(self, op: StructuralOp) -> OpsDone:
        """What a stand-in does before it is removed or detached: it comes, and is attached there."""
        _, name, port, connector = op
        if port is not None:
            attach = _pair("attach", port, connector)
            return frozenset([attach] if attach in self.attaches else ())
        found = [_create(name)] if _create(name) in self.creates else []
        return frozenset(found + [each for each, (own, _) in self.attaches.items() if own.instance == name])

    def _is_capped(self, port: PortRef, connector: str) -> bool:
        """Whether an output is on a topic with a cap, with its old or its new contract."""
        declared = self.change.start.context.connectors
        topic = declared[connector].topic
        names = (connector, topic, self.change.identities.get(topic, topic))
        capped = any(name in declared and declared[name].max_publishers is not None for name in names)
        return capped and self.change.is_output(port)

    def _scarce(self) -> set[str]:
        """The resources that do not suffice for everything that runs and everything that comes."""
        everything = self._state(frozenset(self.creates)).configuration
        return {resource for resource in everything.held if self._excess(everything, resource, 0.0) > 0}

    def _excess(self, configuration: Configuration, resource: str, amount: float) -> Fraction:
        """By how much ``amount`` more of a resource exceeds its capacity."""
        held = configuration.held.get(resource, Fraction()) - self._held.get(resource, Fraction())
        return held + to_fraction(amount) - to_fraction(configuration.context.capacity(resource))

    def _state(self, state: OpsDone) -> _Found:
        """The largest structure in which exactly these differences are made."""
        if state not in self._known:
            change, configuration = self.change, self.change.start
            for instance in change.coming:
                op = _create(instance.name)
                if op in state or op not in self.creates:
                    configuration = configuration.with_instance(instance)
            for port, connector in change.attached:
                op = _pair("attach", port, connector)
                if op in state or (op not in self.attaches and port.instance in configuration.instances):
                    configuration = configuration.with_attachment(port, connector)
            for port, connector in change.detached:
                if _pair("detach", port, connector) in state or _remove(port.instance) in state:
                    configuration = configuration.without_attachment(port, connector)
            for op, name in self.removes.items():
                if op in state:
                    configuration = configuration.without_instance(name)
            self._work.spend(len(configuration.modes))
            raised, definition = best(configuration), self._definition
            limited = definition.limited(raised) if self._limits else _NO_REFS
            found = _Found(configuration, definition.loss(raised), definition.is_allowed(raised), limited)
            self._known[state] = found
        return self._known[state]

    def cheapest_below(self, limit: float) -> float | None:
        """The least disruption of a way to the goal; None if that is not below ``limit``. Raises SearchTooLarge."""
        start = self.first, (0.0,) * len(self._limits)
        queue: list[tuple[float, int, tuple[OpsDone, tuple[float, ...]]]] = [(0.0, 0, start)]
        costs, number = {start: 0.0}, count(1)
        while queue:
            cost, _, node = heapq.heappop(queue)
            if cost > costs[node]:
                continue
            state, spent = node
            if self.goal <= state:
                return cost
            for after, seconds, loss, limited in self._following(state):
                total, following = cost + seconds * loss, (after, self._spent(spent, seconds, limited))
                if total < min(costs.get(following, limit), limit) and self._is_within(following[1]):
                    costs[following] = total
                    heapq.heappush(queue, (total, next(number), following))
        return None

    def _spent(
        self, spent: tuple[float, ...], seconds: float, limited: Collection[FunctionalityRef]
    ) -> tuple[float, ...]:
        """The seconds below the baseline of what is limited, after one more step."""
        return tuple(
            round(so_far + seconds * (ref in limited), 9) for so_far, (ref, _) in zip(spent, self._limits, strict=True)
        )

    def _is_within(self, spent: tuple[float, ...]) -> bool:
        return all(so_far <= most + _EPSILON for so_far, (_, most) in zip(spent, self._limits, strict=True))

    def _following(self, state: OpsDone) -> Iterator[tuple[OpsDone, float, float, Collection[FunctionalityRef]]]:
        """The states after one more difference, each with how long that takes, what is lost and limited meanwhile.

        What the constraints forbid is looked at while something is created or removed only: between the two, several
        outputs may be exchanged at once.
        """
        found = self._state(state)
        configuration = found.configuration
        for op, instance in self.creates.items():
            if op not in state and found.is_allowed and self._awaited.get(instance.role, _NOTHING) <= state:
                usage = instance.resource_usage.items()
                if all(self._excess(configuration, resource, amount) <= 0 for resource, amount in usage):
                    yield state | {op}, self.seconds[op], found.loss, found.limited
        for op, name in self.removes.items():
            awaited = self._served[op] | self._awaited.get(self.change.role_of(name), _NOTHING)
            if op not in state and awaited <= state:
                then = self._state(state | {op})
                if then.is_allowed:
                    yield state | {op}, self.seconds[op], max(found.loss, then.loss), found.limited | then.limited
        for op, (port, connector) in self.attaches.items():
            if op not in state and port.instance in configuration.instances and self._slot(configuration, connector):
                yield state | {op}, 0.0, 0.0, _NO_REFS
        for op, (port, _) in self.detaches.items():
            if op not in state and port.instance in configuration.instances and self._served[op] <= state:
                yield state | {op}, 0.0, 0.0, _NO_REFS

    def _slot(self, configuration: Configuration, connector: str) -> bool:
        cap, sibling = configuration.context.connectors[connector].max_publishers, self.change.sibling(connector)
        beside = 0 if sibling is None else len(configuration.publishers_on(sibling)) - self._publishing[sibling]
        return cap is None or publishers_count(configuration, connector) - self._publishing[connector] + beside < cap

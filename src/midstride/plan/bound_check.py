"""Checks the lower bound that a plan claims, without the planner's code (docs/semantics.md section 6).

The states are sets of structural differences that are done. By F3, what adds structure and needs neither time nor a
slot is done at once, and what takes it away only when something waits for it. If nothing is lost at first, an instance
that everything else leaves room for comes first and goes last. All other orders are searched, cheapest first, up to
the claimed bound. Of the user's constraints, a `limit` of more than 0 s is left out, so that a plan may break it.

Where the plan has a certificate, its parts are searched one by one. Each is a bound by itself, whatever the planner
took for a part, so their sum is one; nothing else in the certificate is believed.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from typing import Final, Literal, TypeAlias

from midstride.model.action import Create, Remove
from midstride.model.best import best
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration, to_fraction
from midstride.model.rules import publishers_count
from midstride.model.specification import Order
from midstride.plan.change import Change
from midstride.plan.constraints import in_force
from midstride.plan.plan import Plan

# How many functionalities are evaluated in all, once for each state. One to three seconds.
WORK: Final = 40_000
_EPSILON: Final = 1e-6

# "create" with a role, "remove" with an instance, "attach" and "detach" with a port and a connector.
Op: TypeAlias = tuple[str, str, PortRef | None, str]
State: TypeAlias = frozenset[Op]

_NOTHING: Final[State] = frozenset()


@dataclass(frozen=True, slots=True)
class BoundCheck:
    """Whether no plan loses less than the claimed bound; ``because`` says why it is violated or was not checked."""

    outcome: Literal["holds", "violated", "not checked"]
    because: str = ""


def check_bound(
    plan: Plan,
    loss: Callable[[Configuration], float],
    is_allowed: Callable[[Configuration], bool] = lambda _: True,
    work: int = WORK,
) -> BoundCheck:
    """The result for a plan whose steps are valid; ``loss`` is the weighted sum of the levels below the baseline.

    ``is_allowed``: whether the user's constraints admit a configuration. ``work`` limits how many functionalities are
    evaluated.
    """
    if plan.lower_bound <= _EPSILON:
        return BoundCheck("holds")
    if plan.proof_space == "detours":
        return BoundCheck("not checked", "it speaks of plans with detours too")
    seconds, change = _seconds(plan), plan.change
    if seconds.keys() != {*(_create(each.role) for each in change.coming), *map(_remove, change.leaving)}:
        return BoundCheck("not checked", "the plan creates or removes other instances than the change needs")

    def search(roles: Collection[str] | None, limit: float) -> float | None:
        return _Search(change, seconds, loss, is_allowed, work, roles).cheapest_below(limit - _EPSILON)

    with suppress(_TooLarge):
        if _adds_up(plan) and all(search(part.roles, part.bound) is None for part in plan.certificate):
            return BoundCheck("holds")
    try:
        least = search(None, plan.lower_bound)
    except _TooLarge:
        return BoundCheck("not checked", "the change is too large")
    if least is None:
        return BoundCheck("holds")
    if in_force(change):
        return BoundCheck("not checked", "it is higher than without the constraints")
    return BoundCheck("violated", f"a plan with a disruption of {least:g} exists")


def _adds_up(plan: Plan) -> bool:
    """Whether the certificate has several parts, of different roles, and the bound is not above their sum."""
    roles = [role for part in plan.certificate for role in part.roles]
    total = sum(part.bound for part in plan.certificate)
    return len(plan.certificate) > 1 and len(set(roles)) == len(roles) and total >= plan.lower_bound - _EPSILON


def _seconds(plan: Plan) -> dict[Op, float]:
    """How long (s) each creation and removal of the plan takes."""
    found: dict[Op, float] = {}
    for step in plan.steps:
        if isinstance(step.action, Create):
            found[_create(step.action.instance.role)] = step.seconds
        elif isinstance(step.action, Remove):
            found[_remove(step.action.instance)] = step.seconds
    return found


def _create(role: str) -> Op:
    return "create", role, None, ""


def _remove(name: str) -> Op:
    return "remove", name, None, ""


def _pair(kind: str, port: PortRef, connector: str) -> Op:
    return kind, "", port, connector


class _TooLarge(Exception):
    """More functionalities than may be evaluated."""


class _Search:
    """The creations and removals of ``roles`` (None: all); of the others, all that is new exists, and all that is old
    still does, while neither takes any room."""

    def __init__(
        self,
        change: Change,
        seconds: dict[Op, float],
        loss: Callable[[Configuration], float],
        is_allowed: Callable[[Configuration], bool],
        work: int,
        roles: Collection[str] | None,
    ) -> None:
        self.change, self.seconds, self._loss, self._is_allowed, self._work = change, seconds, loss, is_allowed, work
        self._known: dict[State, tuple[Configuration, float, bool]] = {}
        own = {name for name in change.instances() if roles is None or change.role_of(name) in roles}
        self.creates = {_create(each.role): each for each in change.coming if each.name in own}
        self.removes = {_remove(name): name for name in change.leaving if name in own}
        capped = [pair for pair in change.attached if self._is_capped(*pair)]
        self.attaches = {_pair("attach", *pair): pair for pair in capped if pair[0].instance in own}
        freed = [pair for pair in change.detached if self._is_capped(*pair)]
        self.detaches = {_pair("detach", *pair): pair for pair in freed if pair[0].instance in own}
        # What the others hold in every state, but do not count.
        self._held = dict[str, Fraction]()
        for name in {*(each.name for each in change.coming), *change.leaving} - own:
            for resource, amount in change.component_of(name).resource_usage.items():
                self._held[resource] = self._held.get(resource, Fraction()) + to_fraction(amount)
        self._publishing = Counter(connector for port, connector in (*capped, *freed) if port.instance not in own)
        self._awaited = self._orders()
        self.first: State = frozenset()
        self.goal: State = frozenset([*self.creates, *self.removes, *self.attaches])
        if not self._state(self.first)[1]:
            scarce = self._scarce()
            self.first = frozenset(
                op for op, instance in self.creates.items() if scarce.isdisjoint(instance.component.resource_usage)
            )
            self.goal -= {
                op for op, name in self.removes.items() if scarce.isdisjoint(change.component_of(name).resource_usage)
            }

    def _orders(self) -> dict[str, State]:
        """By role, what the user's orders put before anything of it."""
        change, found = self.change, dict[str, State]()
        for order in in_force(change):
            if isinstance(order, Order) and order.first != order.then:
                first = [op for op, each in self.creates.items() if each.role == order.first]
                first += [op for op, name in self.removes.items() if change.role_of(name) == order.first]
                found[order.then] = found.get(order.then, frozenset()) | frozenset(first)
        return found

    def _is_capped(self, port: PortRef, connector: str) -> bool:
        """Whether an output is on a topic with a cap, with its old or its new contract."""
        declared = self.change.start.context.connectors
        topic = declared[connector].topic
        names = (connector, topic, self.change.identities.get(topic, topic))
        capped = any(name in declared and declared[name].max_publishers is not None for name in names)
        return capped and self.change.is_output(port)

    def _scarce(self) -> set[str]:
        """The resources that do not suffice for everything that runs and everything that comes."""
        everything = self._state(frozenset(self.creates))[0]
        return {resource for resource in everything.held if self._excess(everything, resource, 0.0) > 0}

    def _excess(self, configuration: Configuration, resource: str, amount: float) -> Fraction:
        """By how much ``amount`` more of a resource exceeds its capacity."""
        held = configuration.held.get(resource, Fraction()) - self._held.get(resource, Fraction())
        return held + to_fraction(amount) - to_fraction(configuration.context.capacity(resource))

    def _state(self, state: State) -> tuple[Configuration, float, bool]:
        """The largest structure in which exactly these differences are made, what is lost in it, and if it may be."""
        if state not in self._known:
            change, configuration = self.change, self.change.start
            for instance in change.coming:
                op = _create(instance.role)
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
            self._work -= len(configuration.modes)
            if self._work < 0:
                raise _TooLarge
            raised = best(configuration)
            self._known[state] = configuration, self._loss(raised), self._is_allowed(raised)
        return self._known[state]

    def cheapest_below(self, limit: float) -> float | None:
        """The least disruption of a way to the goal; None if that is not below ``limit``. Raises _TooLarge."""
        queue: list[tuple[float, int, State]] = [(0.0, 0, self.first)]
        costs, number = {self.first: 0.0}, count(1)
        while queue:
            cost, _, state = heapq.heappop(queue)
            if cost > costs[state]:
                continue
            if self.goal <= state:
                return cost
            for after, more in self._following(state):
                if cost + more < min(costs.get(after, limit), limit):
                    costs[after] = cost + more
                    heapq.heappush(queue, (cost + more, next(number), after))
        return None

    def _following(self, state: State) -> Iterator[tuple[State, float]]:
        """The states after one more difference, each with what that costs.

        What the constraints forbid is looked at while something is created or removed only: between the two, several
        outputs may be exchanged at once.
        """
        configuration, now, is_allowed = self._state(state)
        for op, instance in self.creates.items():
            if op not in state and is_allowed and self._awaited.get(instance.role, _NOTHING) <= state:
                usage = instance.component.resource_usage.items()
                if all(self._excess(configuration, resource, amount) <= 0 for resource, amount in usage):
                    yield state | {op}, self.seconds[op] * now
        for op, name in self.removes.items():
            if op not in state and self._awaited.get(self.change.role_of(name), _NOTHING) <= state:
                _, then, is_allowed_then = self._state(state | {op})
                if is_allowed_then:
                    yield state | {op}, self.seconds[op] * max(now, then)
        for op, (port, connector) in self.attaches.items():
            if op not in state and port.instance in configuration.instances and self._slot(configuration, connector):
                yield state | {op}, 0.0
        for op, (port, _) in self.detaches.items():
            if op not in state and port.instance in configuration.instances:
                yield state | {op}, 0.0

    def _slot(self, configuration: Configuration, connector: str) -> bool:
        cap, sibling = configuration.context.connectors[connector].max_publishers, self.change.sibling(connector)
        beside = 0 if sibling is None else len(configuration.publishers_on(sibling)) - self._publishing[sibling]
        return cap is None or publishers_count(configuration, connector) - self._publishing[connector] + beside < cap

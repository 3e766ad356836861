"""A small change of the published family as a classical planning problem, written from docs/semantics.md.

Classical planning has neither numbers nor time, and what an action costs may not depend on the state. So:

- A resource is one fact for each amount that may be free; a creation or a removal is one action for each amount.
- A creation or removal begins, then one action for each mode of each functionality that can be lost says whether it is
  lost, in the order in which they read each other, and costs its weight times the duration if it is; then it ends.
- Hand-overs are left out: they cost nothing and, in this family, are possible whenever they are needed. So are modes
  and attachments, which follow from what runs. Durations are whole quarters of a second.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any, Final

from unified_planning.shortcuts import (  # type: ignore[import-not-found, unused-ignore]
    And,
    BoolType,
    InstantaneousAction,
    Int,
    MinimizeActionCosts,
    Not,
    Or,
    Problem,
)

from midstride.model.component import InputAlternatives
from midstride.plan.change import Change

QUARTERS: Final = 4


class Encoding:
    """``problem`` minimizes the disruption, in quarters of a functionality-second; ``costs`` is by action name."""

    def __init__(self, change: Change) -> None:
        self.change = change
        self.problem = Problem("change")
        self.costs: dict[str, int] = {}
        self._actions: list[Any] = []
        self._goal: list[Any] = []
        self._idle = self._fact("idle", holds=True)
        # How long the step under way takes, as a fact for each duration that occurs.
        self._ops = [("create", each.name) for each in change.coming] + [("remove", name) for name in change.leaving]
        self._seconds = {op: round(change.seconds(op[0], change.component_of(op[1])) * QUARTERS) for op in self._ops}
        self._taking = {each: self._fact(f"taking_{each}") for each in sorted({*self._seconds.values()})}
        self._done = {op: self._fact(f"{op[0]}d_{op[1]}") for op in self._ops}
        self._under_way = {op: self._fact(f"during_{op[0]}_{op[1]}") for op in self._ops}
        self._free = {resource: self._amounts(resource) for resource in change.start.context.resources}
        self._places: list[Any] = [self._fact("place_0")]
        self._lost: dict[str, Any] = {}  # by topic: whether it is silent
        self._absent: dict[str, tuple[Any, Any]] = {}
        for old, new in change.replaced.items():
            self._absent[change.role_of(old)] = self._done["remove", old], self._done["create", new]
        for role in sorted(change.start.instances):  # in the order in which they read each other
            self._charge(role)
        for op in self._ops:
            self._step(op)
        for action in self._actions:
            self.problem.add_action(action)
        for fact in self._done.values():
            self.problem.add_goal(fact)
        self.problem.add_goal(self._idle)
        costs = {action: Int(self.costs.get(action.name, 0)) for action in self._actions}
        self.problem.add_quality_metric(MinimizeActionCosts(costs))

    def disruption(self, names: list[str]) -> float:
        """Of the plan with these actions, in weighted functionality-seconds."""
        return sum(self.costs.get(name, 0) for name in names) / QUARTERS

    def _fact(self, name: str, *, holds: bool = False) -> Any:
        fact = self.problem.add_fluent(name, BoolType(), default_initial_value=False)
        if holds:
            self.problem.set_initial_value(fact, True)
        return fact

    def _action(self, name: str, conditions: list[Any], effects: dict[Any, bool], cost: int = 0) -> None:
        action = InstantaneousAction(name)
        for condition in conditions:
            action.add_precondition(condition)
        for fact, value in effects.items():
            action.add_effect(fact, value)
        self._actions.append(action)
        if cost:
            self.costs[name] = cost

    # -- room ------------------------------------------------------------------------------------------

    def _usage(self, name: str, resource: str) -> int:
        return round(self.change.component_of(name).resource_usage.get(resource, 0))

    def _amounts(self, resource: str) -> dict[int, Any]:
        """The facts that so much is free, for each amount up to all of it."""
        capacity = round(self.change.start.context.capacity(resource))
        now = capacity - sum(self._usage(name, resource) for name in self.change.start.instances)
        return {k: self._fact(f"free_{resource}_{k}", holds=k == now) for k in range(capacity + 1)}

    def _room(self, op: tuple[str, str]) -> Iterator[tuple[str, list[Any], dict[Any, bool]]]:
        """For each amount that is free of what an instance holds: how it changes, if there is enough."""
        held = {resource: self._usage(op[1], resource) for resource in self._free}
        held = {resource: amount for resource, amount in held.items() if amount}
        sign = -1 if op[0] == "create" else 1
        for before in product(*(self._free[resource] for resource in held)):
            after = [k + sign * amount for k, amount in zip(before, held.values(), strict=True)]
            if all(k in self._free[resource] for resource, k in zip(held, after, strict=True)):
                facts = list(zip(held, before, after, strict=True))
                effects = {self._free[resource][k]: False for resource, k, _ in facts}
                effects |= {self._free[resource][k]: True for resource, _, k in facts}
                suffix = "_".join(str(k) for k in before)
                yield suffix, [self._free[resource][k] for resource, k, _ in facts], effects

    # -- steps -----------------------------------------------------------------------------------------

    def _step(self, op: tuple[str, str]) -> None:
        """What a creation takes is taken when it begins, what a removal frees is free when it has ended."""
        name, done = f"{op[0]}_{op[1]}", self._done[op]
        under_way, taking = self._under_way[op], self._taking[self._seconds[op]]
        begin = {self._idle: False, under_way: True, taking: True, self._places[0]: True}
        end = {under_way: False, taking: False, self._places[-1]: False, self._idle: True}
        if op[0] == "remove":  # the worse of before and after counts: gone from the beginning
            self._action(f"begin_{name}", [self._idle, Not(done)], {**begin, done: True})
        for suffix, conditions, effects in self._room(op):
            if op[0] == "create":
                self._action(f"begin_{name}_{suffix}", [self._idle, Not(done), *conditions], begin | effects)
            else:
                self._action(f"end_{name}_{suffix}", [under_way, self._places[-1], *conditions], end | effects)
        if op[0] == "create":
            self._action(f"end_{name}", [under_way, self._places[-1]], {**end, done: True})

    # -- what is lost ----------------------------------------------------------------------------------

    def _charge(self, role: str) -> None:
        """One place for each level of a role's functionality that can be lost, with the actions that leave it."""
        (functionality,) = self.change.start.component(role)
        weight = round(functionality.weight)
        absent = self._absent.get(role)
        gone = And(absent[0], Not(absent[1])) if absent else None
        *better, _ = functionality.modes
        silent: Any = None
        for mode in better:
            # By assumption: what it takes that all of its inputs are silent; those that are never silent are left out.
            needs = [
                [self._lost.get("/" + name) for name in each.inputs] for each in map(_alternatives, mode.assumptions)
            ]
            broken = [And(*each) if len(each) > 1 else each[0] for each in needs if None not in each]
            lost = [*broken, *([] if gone is None else [gone])]
            if lost:
                silent = self._fact(f"lost_{role}_{mode.name}")
                self._levels(f"{role}_{mode.name}", Or(*lost) if len(lost) > 1 else lost[0], weight, silent)
            else:
                silent = None
        if gone is not None:
            self._levels(f"{role}_absent", gone, weight, None)
        for output in functionality.outputs:
            if silent is not None:
                self._lost["/" + output] = silent

    def _levels(self, name: str, lost: Any, weight: int, fact: Any) -> None:
        here, following = self._places[-1], self._fact(f"place_{len(self._places)}")
        self._places.append(following)
        move = {here: False, following: True}
        self._action(f"kept_{name}", [here, Not(lost)], move | ({} if fact is None else {fact: False}))
        for quarters, taking in self._taking.items():
            effects = move | ({} if fact is None else {fact: True})
            self._action(f"lost_{name}_{quarters}", [here, taking, lost], effects, weight * quarters)


def _alternatives(assumption: Any) -> InputAlternatives:
    assert isinstance(assumption, InputAlternatives)
    return assumption

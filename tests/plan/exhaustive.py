"""The slow, obvious twin of ``minimal``: every order of the structural actions, over best modes (semantics.md F4).

A state is the set of structural differences already made; its configuration stands in ``best``.
Dijkstra over the states gives the least disruption there is, and, among the plans that have it,
whether one lets nothing fall.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import count

from midstride.model.best import best
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import publishers_count
from midstride.plan.change import Change

Op = tuple[str, object]
State = frozenset[Op]


class TooLarge(Exception):
    """More differences than can be searched."""


class Exhaustive:
    def __init__(self, change: Change, most: int = 11) -> None:
        self.change = change
        self.creates: list[Op] = [("create", instance.name) for instance in change.coming]
        self.removes: list[Op] = [("remove", name) for name in change.leaving]
        self.attaches: list[Op] = [("attach", pair) for pair in change.attached]
        self.detaches: list[Op] = [("detach", pair) for pair in change.detached]
        self.all: State = frozenset([*self.creates, *self.removes, *self.attaches, *self.detaches])
        if len(self.all) > most:
            raise TooLarge
        self.instances = {instance.name: instance for instance in change.coming}
        self._configurations: dict[State, Configuration] = {}
        self._losses: dict[State, dict[FunctionalityRef, float]] = {}
        self.baseline: dict[FunctionalityRef, int] = {}
        ends = self.levels(best(change.origin)), self.levels(self.configuration(self.all))
        self.baseline = {ref: max(ends[0][ref], ends[1][ref]) for ref in ends[0]}

    # -- a state -------------------------------------------------------------------------------------

    def configuration(self, state: State) -> Configuration:
        known = self._configurations.get(state)
        if known is None:
            s = self.change.start
            for kind, what in sorted(state, key=str):
                if kind == "create":
                    s = s.with_instance(self.instances[str(what)])
            for op in self.attaches:
                if op in state:
                    s = s.with_attachment(*op[1])  # type: ignore[misc]
            for op in self.detaches:
                if op in state:
                    s = s.without_attachment(*op[1])  # type: ignore[misc]
            for op in self.removes:
                if op in state:
                    s = s.without_instance(str(op[1]))
            known = self._configurations[state] = best(s)
        return known

    def levels(self, s: Configuration) -> dict[FunctionalityRef, int]:
        start, target = self.change.specification, self.change.target
        found = {}
        for role in set(start.nodes) & set(target.nodes):
            old, new = start.component_of(role), target.component_of(role)
            for name in set(old.functionalities) & set(new.functionalities):
                outputs = [
                    output
                    for output in set(old.functionalities[name].outputs) & set(new.functionalities[name].outputs)
                    if start.nodes[role].attachments.get(output) and target.nodes[role].attachments.get(output)
                ]
                level = max(len(old.functionalities[name].modes), len(new.functionalities[name].modes))
                for instance in s.instances.values():
                    if instance.role != role or name not in instance.component.functionalities:
                        continue
                    if all(s.attached_to(PortRef(instance.name, output)) for output in outputs):
                        level = min(level, s.modes[FunctionalityRef(instance.name, name)])
                found[FunctionalityRef(role, name)] = level
        return found

    def losses(self, state: State) -> dict[FunctionalityRef, float]:
        known = self._losses.get(state)
        if known is None:
            levels = self.levels(self.configuration(state))
            known = self._losses[state] = {
                ref: (level - self.baseline[ref]) * self._weight(ref)
                for ref, level in levels.items()
                if level > self.baseline[ref]
            }
        return known

    def _weight(self, ref: FunctionalityRef) -> float:
        return self.change.target.component_of(ref.component).functionalities[ref.functionality].weight

    # -- from one to the next ------------------------------------------------------------------------

    def steps(self, state: State) -> Iterator[State]:
        s = self.configuration(state)
        for op in self.creates:
            holds = self.instances[str(op[1])].component.holds
            if op not in state and all(s.held.get(r, 0.0) + a <= s.world.capacity(r) + 1e-9 for r, a in holds.items()):
                yield state | {op}
        for op in self.removes:
            if op not in state and not s.attached_ports(str(op[1])):
                yield state | {op}
        for op in self.detaches:
            if op not in state:
                yield state | {op}
        ready = [op for op in self.attaches if op not in state and op[1][0].component in s.instances]  # type: ignore[index]
        for op in ready:
            port, connector = op[1]  # type: ignore[misc]
            if not s.is_output(port) or self._slot(s, connector):
                yield state | {op}
        yield from self._hand_overs(state, s, ready)

    def _slot(self, s: Configuration, connector: str) -> bool:
        cap = s.world.connectors[connector].cap
        sibling = self.change.sibling(connector)
        beside = 0 if sibling is None else len(s.publishers_on(sibling))
        return cap is None or publishers_count(s, connector) + beside < cap

    def _hand_overs(self, state: State, s: Configuration, ready: list[Op]) -> Iterator[State]:
        """One exchange on one topic, or all of a replaced role at once."""
        together: dict[str, set[Op]] = {}
        for attach in ready:
            port, connector = attach[1]  # type: ignore[misc]
            if not s.is_output(port) or not satisfies(s.guarantee(port), s.world.connectors[connector].guarantee):
                continue
            for detach in self.detaches:
                old, on = detach[1]  # type: ignore[misc]
                if detach in state or on != connector or not s.is_output(old):
                    continue
                yield state | {attach, detach}
                if self.change.replaced.get(old.component) == port.component:
                    together.setdefault(port.component, set()).update((attach, detach))
        for pairs in together.values():
            attached = [op[1][1] for op in pairs if op[0] == "attach"]  # type: ignore[index]
            detached = [op[1][1] for op in pairs if op[0] == "detach"]  # type: ignore[index]
            if sorted(attached) == sorted(detached):
                yield state | pairs

    def cost(self, before: State, after: State) -> float:
        """The disruption of one step; only creating and removing have any."""
        (kind, what), *others = after - before
        if others or kind not in ("create", "remove"):
            return 0.0
        name = str(what)
        component = self.change.component_of(name)
        losses = self.losses(before), self.losses(after)
        refs = {*losses[0], *losses[1]}
        return sum(max(loss.get(ref, 0.0) for loss in losses) for ref in refs) * self.change.seconds(kind, component)

    def optimum(self, spotless: bool = False) -> float | None:
        """The least disruption of any plan; of those that let nothing fall, where ``spotless``. None if there is none."""
        tie = count()
        queue: list[tuple[float, int, State]] = [(0.0, next(tie), frozenset())]
        known: dict[State, float] = {frozenset(): 0.0}
        while queue:
            cost, _, state = heapq.heappop(queue)
            if cost > known[state]:
                continue
            if state == self.all:
                return round(cost, 9)
            for after in self.steps(state):
                if spotless and self.losses(after):
                    continue
                total = cost + self.cost(state, after)
                if total < known.get(after, float("inf")) - 1e-12:
                    known[after] = total
                    heapq.heappush(queue, (total, next(tie), after))
        return None

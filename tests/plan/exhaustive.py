"""The slow, obvious twin of ``minimal``: every order of structural actions (docs/semantics.md section 5, F4).

A state is the set of structural differences already made; its configuration stands in ``best``.
Dijkstra over the states gives the least disruption there is, and, among the plans that have it,
whether one lets nothing fall. :class:`Constrained` keeps to the user's constraints on the way.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, count, product

from immutables import Map

from midstride.model.best import best
from midstride.model.component import ComponentSpec, FunctionalityRef, FunctionalitySpec, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import satisfies
from midstride.model.rules import publishers_count
from midstride.model.specification import Constraint, Keep, Limit, Order
from midstride.plan.change import Change, PortAttachment
from midstride.plan.constraints import in_force

NO_PORT = PortRef("", "")


@dataclass(frozen=True, order=True)
class Op:
    """One structural difference: an instance to create or remove, or an attachment to make or undo."""

    kind: str
    name: str
    port: PortRef = NO_PORT
    connector: str = ""


State = frozenset[Op]


class TooLarge(Exception):
    """More differences than can be searched."""


class Exhaustive:
    def __init__(self, change: Change, most: int = 11) -> None:
        self.change = change
        self.creates = [Op("create", instance.name) for instance in change.coming]
        self.removes = [Op("remove", name) for name in change.leaving]
        self.attaches = [Op("attach", port.instance, port, connector) for port, connector in change.attached]
        self.detaches = [Op("detach", port.instance, port, connector) for port, connector in change.detached]
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
            configuration = self.change.start
            for op in (op for op in self.creates if op in state):
                configuration = configuration.with_instance(self.instances[op.name])
            for op in (op for op in self.attaches if op in state):
                configuration = configuration.with_attachment(op.port, op.connector)
            for op in (op for op in self.detaches if op in state):
                configuration = configuration.without_attachment(op.port, op.connector)
            for op in (op for op in self.removes if op in state):
                configuration = configuration.without_instance(op.name)
            known = self._configurations[state] = best(configuration)
        return known

    def levels(self, configuration: Configuration) -> dict[FunctionalityRef, int]:
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
                for instance in configuration.instances.values():
                    if instance.role != role or name not in instance.component.functionalities:
                        continue
                    if all(configuration.attached_to(PortRef(instance.name, output)) for output in outputs):
                        level = min(level, configuration.modes[FunctionalityRef(instance.name, name)])
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
        return self.change.target.component_of(ref.instance).functionalities[ref.functionality].weight

    # -- from one to the next ------------------------------------------------------------------------

    def steps(self, state: State) -> Iterator[State]:
        configuration = self.configuration(state)
        for op in self.creates:
            holds = self.instances[op.name].resource_usage
            if op not in state and all(
                configuration.held.get(r, 0.0) + a <= configuration.context.capacity(r) + 1e-9 for r, a in holds.items()
            ):
                yield state | {op}
        for op in self.removes:
            if op not in state and op.name in configuration.instances and not configuration.attached_ports(op.name):
                yield state | {op}
        for op in self.detaches:
            if op not in state and configuration.is_attached(op.port, op.connector):
                yield state | {op}
        ready = [op for op in self.attaches if op not in state and op.name in configuration.instances]
        for op in ready:
            if not configuration.is_output(op.port) or self._slot(configuration, op.connector):
                yield state | {op}
        yield from self._hand_overs(state, configuration, ready)

    def _slot(self, configuration: Configuration, connector: str) -> bool:
        declared = configuration.context.connectors[connector]
        cap = declared.max_publishers if declared.kind == "topic" else 1
        sibling = self.change.sibling(connector)
        beside = 0 if sibling is None else len(configuration.publishers_on(sibling))
        return cap is None or publishers_count(configuration, connector) + beside < cap

    def _hand_overs(self, state: State, configuration: Configuration, ready: list[Op]) -> Iterator[State]:
        """Every set of exchanges in which no output occurs twice on a topic, made in one step."""
        swaps: list[State] = [
            frozenset((new, old))
            for new in ready
            if configuration.is_output(new.port)
            and satisfies(configuration.guarantee(new.port), configuration.context.connectors[new.connector].guarantee)
            for old in self.detaches
            if old not in state and old.connector == new.connector
            if configuration.is_attached(old.port, old.connector) and configuration.is_output(old.port)
        ]
        together: set[State] = {frozenset()}
        for swap in swaps:
            together |= {chosen | swap for chosen in together if not chosen & swap}
        for chosen in sorted(together, key=len)[1:]:
            yield state | chosen

    def cost(self, before: State, after: State) -> float:
        """The disruption of one step; only creating and removing have any."""
        op, *others = after - before
        if others or op.kind not in ("create", "remove"):
            return 0.0
        instance = self.change.instance(op.name)
        losses = self.losses(before), self.losses(after)
        refs = {*losses[0], *losses[1]}
        return sum(max(loss.get(ref, 0.0) for loss in losses) for ref in refs) * self.change.seconds(op.kind, instance)

    def optimum(self, spotless: bool = False) -> float | None:
        """The least disruption of any plan, or of those that let nothing fall (``spotless``); None if there is none."""
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


@dataclass(frozen=True)
class Choice:
    """One thing that a role may do besides: ``instance`` comes and ``leaving`` goes, with these attachments.

    A node that is moved: ``moved`` is its instance, which is neither attached nor detached otherwise then.
    """

    role: str
    instance: Instance
    leaving: str
    attached: tuple[PortAttachment, ...]
    detached: tuple[PortAttachment, ...]
    moved: str = ""


class Detoured:
    """The least disruption of any plan in which up to two roles make a detour, as docs/semantics.md section 6 says.

    Every set of detours is tried, each with every order of what is to be done then.
    """

    def __init__(self, change: Change, most: int = 11, roles: int = 2) -> None:
        self.change, self.most, self.roles = change, most, roles

    def optimum(self) -> float | None:
        """None where there is no plan. Raises TooLarge where a set of detours makes more than ``most`` differences."""
        found = (Exhaustive(change, self.most).optimum() for change in self.changes())
        return min((least for least in found if least is not None), default=None)

    def changes(self) -> Iterator[Change]:
        by_role = [list(self._detours(role)) for role in sorted(self.change.target.nodes)]
        for number in range(self.roles + 1):
            for some in combinations(filter(None, by_role), number):
                for chosen in product(*some):
                    yield self._with([choice for detour in chosen for choice in detour])

    def _detours(self, role: str) -> Iterator[tuple[Choice, ...]]:
        choices = list(self.choices(role))
        moves = [choice for choice in choices if choice.moved]
        yield from ((choice,) for choice in choices)
        yield from ((move, choice) for move in moves for choice in choices if not choice.moved)

    def choices(self, role: str) -> Iterator[Choice]:
        start, target = self.change.specification, self.change.target
        if role not in start.nodes or role not in target.nodes:
            return
        for kept in self.change.start.instances_of(role):
            if kept.name not in self.change.leaving:
                new = target.instance(role, f"{role}_moved")
                detached = self.change.start.attached_ports(kept.name)
                yield Choice(role, new, kept.name, self._topics(new), tuple(detached), kept.name)
        old, new_component = start.component_of(role), target.component_of(role)
        both = set(old.functionalities) & set(new_component.functionalities)
        for name in sorted(set(start.components) | set(target.components)):
            component = target.components.get(name) or start.components[name]
            is_other = not component.same_body(old) and not component.same_body(new_component)
            if self._fits(role, component) and is_other and both and both <= set(component.functionalities):
                stand_in = Instance(f"{role}_as_{name}", role, component, Map())
                topics = self._topics(stand_in)
                yield Choice(role, stand_in, stand_in.name, topics, topics)

    def _fits(self, role: str, component: ComponentSpec) -> bool:
        target = self.change.target
        for port, topics in target.nodes[role].attachments.items():
            if port not in component.ports():
                return False
            for topic in topics:
                guarantee = target.connectors[topic].guarantee
                if port in component.inputs:
                    fits = satisfies(guarantee, component.inputs[port])
                else:
                    fits = satisfies(component.owner(port).modes[0].guarantee(port), guarantee)
                if not fits:
                    return False
        return True

    def _topics(self, instance: Instance) -> tuple[PortAttachment, ...]:
        return tuple(
            (PortRef(instance.name, port), self.change.identities.get(topic, topic))
            for port, topics in self.change.target.nodes[instance.role].attachments.items()
            for topic in topics
        )

    def _with(self, choices: Iterable[Choice]) -> Change:
        change = self.change
        for each in choices:
            change = replace(
                change,
                coming=(*change.coming, each.instance),
                leaving=(*change.leaving, each.leaving),
                attached=(*(pair for pair in change.attached if pair[0].instance != each.moved), *each.attached),
                detached=(*(pair for pair in change.detached if pair[0].instance != each.moved), *each.detached),
                stand_ins=change.stand_ins.set(each.instance.name, each.instance),
            )
        return change


class Constrained(Exhaustive):
    """The same among the plans that meet ``keep``, ``order`` and ``limit … 0 s``; other limits depend on the way."""

    def __init__(self, change: Change, most: int = 10) -> None:
        super().__init__(change, most)
        self.constraints = in_force(change)
        at_start = self.levels(change.start)
        self.thresholds = {
            keep: max(self._chain(keep.functionality).mode_index(keep.mode), at_start[keep.functionality])
            for keep in self.constraints
            if isinstance(keep, Keep) and keep.functionality in at_start
        }
        self.of_role: dict[str, set[Op]] = {}
        for op in self.all:
            self.of_role.setdefault(change.role_of(op.name), set()).add(op)

    def _chain(self, ref: FunctionalityRef) -> FunctionalitySpec:
        return self.change.target.component_of(ref.instance).functionalities[ref.functionality]

    def steps(self, state: State) -> Iterator[State]:
        for after in super().steps(state):
            levels = self.levels(self.configuration(after))
            kept = all(levels[keep.functionality] <= least for keep, least in self.thresholds.items())
            if kept and all(self._meets(constraint, state, after) for constraint in self.constraints):
                yield after

    def _meets(self, constraint: Constraint, before: State, after: State) -> bool:
        if isinstance(constraint, Limit):
            return constraint.functionality not in self.losses(after)
        if isinstance(constraint, Order) and constraint.first != constraint.then:
            later = any(self.change.role_of(op.name) == constraint.then for op in after - before)
            return not later or self.of_role.get(constraint.first, set()) <= before
        return True


class Limited(Exhaustive):
    """The same among the plans that meet each ``limit``, counted over creations and removals alone.

    The other steps count too, so this is at most what any plan costs that meets them.
    """

    def optimum(self, spotless: bool = False) -> float | None:
        limits = [each for each in in_force(self.change) if isinstance(each, Limit)]
        tie, start = count(), (State(), (0.0,) * len(limits))
        queue = [(0.0, next(tie), start)]
        known = {start: 0.0}
        while queue:
            cost, _, node = heapq.heappop(queue)
            state, spent = node
            if cost > known[node]:
                continue
            if state == self.all:
                return round(cost, 9)
            for after in self.steps(state):
                following = after, self._spent(limits, spent, state, after)
                total = cost + self.cost(state, after)
                if any(seconds > limit.seconds for seconds, limit in zip(following[1], limits, strict=True)):
                    continue
                if total < known.get(following, float("inf")) - 1e-12:
                    known[following] = total
                    heapq.heappush(queue, (total, next(tie), following))
        return None

    def _spent(self, limits: list[Limit], spent: tuple[float, ...], before: State, after: State) -> tuple[float, ...]:
        op, *others = after - before
        taken = 0.0
        if not others and op.kind in ("create", "remove"):
            taken = self.change.seconds(op.kind, self.change.instance(op.name))
        lost = {*self.losses(before), *self.losses(after)}
        return tuple(
            round(seconds + taken * (limit.functionality in lost), 9)
            for seconds, limit in zip(spent, limits, strict=True)
        )

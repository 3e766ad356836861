"""The disruption that a plan causes, counted by role (docs/semantics.md section 6).

:class:`Levels` yields the level of a role's functionality in a configuration, and its baseline.
:class:`DisruptionMeter` follows a plan step by step. Both look only at the roles that a step touches, so that the
effort follows the plan, not the system.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from immutables import Map

from midstride.model.action import Action, Create, Remove
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.plan.change import Change
from midstride.plan.step import Step

# Durations and sums are rounded to this many digits, so that equal plans have equal figures.
DIGITS = 9


@dataclass(frozen=True, slots=True)
class Counted:
    """A functionality that a role has in both start and target, by role."""

    ref: FunctionalityRef
    outputs: tuple[str, ...]
    worst: int
    baseline: int
    weight: float


class Levels:
    """The levels of the roles' functionalities in one change. Caches what it has looked up."""

    __slots__ = ("_counted", "change")

    def __init__(self, change: Change) -> None:
        self.change = change
        self._counted: dict[str, tuple[Counted, ...]] = {}

    def counted(self, role: str) -> tuple[Counted, ...]:
        """The functionalities of ``role`` that are counted, in order of declaration."""
        if role not in self._counted:
            self._counted[role] = tuple(self._count(role))
        return self._counted[role]

    def _count(self, role: str) -> Iterable[Counted]:
        start, target = self.change.specification, self.change.target
        if role not in start.nodes or role not in target.nodes:
            return
        was, will = start.component_of(role), target.component_of(role)
        before, after = start.nodes[role].attachments, target.nodes[role].attachments
        for new in will:
            old = was.functionalities.get(new.name)
            if old is None:
                continue
            outputs = tuple(
                name for name in new.outputs if name in old.outputs and before.get(name) and after.get(name)
            )
            worst = max(len(old.modes), len(new.modes))
            ref = FunctionalityRef(role, new.name)
            ends = self.change.baseline, self.change.final
            baseline = max(self._level(end, ref, outputs, worst) for end in ends)
            yield Counted(ref, outputs, worst, baseline, new.weight)

    @staticmethod
    def _level(configuration: Configuration, ref: FunctionalityRef, outputs: tuple[str, ...], worst: int) -> int:
        level = worst
        for instance in configuration.instances_by_role.get(ref.instance, ()):
            mode = configuration.modes.get(FunctionalityRef(instance, ref.functionality))
            if mode is None or mode >= level:
                continue
            if all(PortRef(instance, output) in configuration.connectors_of for output in outputs):
                level = mode
        return level

    def find(self, ref: FunctionalityRef) -> Counted | None:
        """The functionality of a role as it is counted; None where start or target does not have it."""
        return next((counted for counted in self.counted(ref.instance) if counted.ref == ref), None)

    def level(self, configuration: Configuration, ref: FunctionalityRef) -> int:
        """The level of a role's functionality: the best mode among those serving it. Raises KeyError if not counted."""
        counted = self.find(ref)
        if counted is None:
            raise KeyError(ref)
        return self._level(configuration, ref, counted.outputs, counted.worst)

    def below(self, configuration: Configuration, role: str) -> dict[FunctionalityRef, int]:
        """The number of levels below the baseline that the functionalities of ``role`` are, where they are below."""
        found = {}
        for counted in self.counted(role):
            loss = self._level(configuration, counted.ref, counted.outputs, counted.worst) - counted.baseline
            if loss > 0:
                found[counted.ref] = loss
        return found

    def fallen(self, configuration: Configuration, roles: Iterable[str]) -> dict[FunctionalityRef, int]:
        """The levels below the baseline of the functionalities of ``roles``, where they are below."""
        return {ref: loss for role in roles for ref, loss in self.below(configuration, role).items()}

    def weight(self, ref: FunctionalityRef) -> float:
        counted = self.find(ref)
        return 0.0 if counted is None else counted.weight


@dataclass(frozen=True, slots=True)
class LevelChange:
    """The number of levels below its baseline that a role's functionality is before a step, and after it."""

    ref: FunctionalityRef
    before: int
    after: int


@dataclass(frozen=True, slots=True)
class DisruptionMeter:
    """The disruption of a plan so far. An immutable value: :meth:`after` yields the meter after one more step.

    ``below`` maps each functionality that is below its baseline now to the number of levels, ``fallen`` holds
    every one that has ever been below, ``changes`` what the latest step changed. The cost of a step follows what
    it changes, not how much is below: ``missing`` keeps the sum of the missing levels, by weight. ``clock`` is the
    time (s) since the plan began, ``since`` when a functionality fell, ``spent`` its earlier time below.
    """

    levels: Levels
    below: Map[FunctionalityRef, int]
    fallen: Map[FunctionalityRef, None]
    missing: float
    since: Map[FunctionalityRef, float]
    spent: Map[FunctionalityRef, float]
    disruption: float = 0.0
    clock: float = 0.0
    changes: tuple[LevelChange, ...] = ()

    @classmethod
    def at_start(cls, levels: Levels) -> DisruptionMeter:
        """The meter before the first step. Some functionalities may be below their baseline already."""
        change = levels.change
        roles = dict.fromkeys(change.start.instances[ref.instance].role for ref in change.lowered)
        below = levels.fallen(change.start, roles)
        return cls(
            levels=levels,
            below=Map(below),
            fallen=Map(dict.fromkeys(below)),
            missing=sum(loss * levels.weight(ref) for ref, loss in below.items()),
            since=Map(dict.fromkeys(below, 0.0)),
            spent=Map(),
        )

    def after(self, action: Action, seconds: float, configuration: Configuration) -> DisruptionMeter:
        """The meter after an action that takes ``seconds`` and leads to ``configuration``."""
        changes = self._changes(action, configuration)
        weight = self.levels.weight
        disruption, clock = self.disruption, self.clock + seconds
        if isinstance(action, (Create, Remove)):
            during = self.missing + sum(weight(each.ref) * max(0, each.after - each.before) for each in changes)
            disruption = round(disruption + during * seconds, DIGITS)
        missing = self.missing + sum(weight(each.ref) * (each.after - each.before) for each in changes)
        below, fallen, since, spent = self.below, self.fallen, self.since, self.spent
        for each in changes:
            if each.after:
                below, fallen = below.set(each.ref, each.after), fallen.set(each.ref, None)
                since = since if each.ref in since else since.set(each.ref, self.clock)
            else:
                below = below.delete(each.ref)
                spent = spent.set(each.ref, spent.get(each.ref, 0.0) + clock - since[each.ref])
                since = since.delete(each.ref)
        # Sums of floats do not come back to exactly zero by themselves.
        missing = missing if below else 0.0
        return DisruptionMeter(self.levels, below, fallen, missing, since, spent, disruption, clock, tuple(changes))

    def _changes(self, action: Action, configuration: Configuration) -> list[LevelChange]:
        changes = []
        for role in dict.fromkeys(self.levels.change.role_of(name) for name in action.instances()):
            below = self.levels.below(configuration, role)
            for counted in self.levels.counted(role):
                before, now = self.below.get(counted.ref, 0), below.get(counted.ref, 0)
                if before != now:
                    changes.append(LevelChange(counted.ref, before, now))
        return changes

    def seconds(self, ref: FunctionalityRef) -> float:
        """The time that a functionality has been below its baseline (s), with the steps that took it there and back."""
        open_since = self.since.get(ref, self.clock)
        return round(self.spent.get(ref, 0.0) + self.clock - open_since, DIGITS)


def follow(levels: Levels, steps: Iterable[Step]) -> Iterator[tuple[Configuration, DisruptionMeter]]:
    """The configuration and the meter at the start, and then after each step."""
    configuration, meter = levels.change.start, DisruptionMeter.at_start(levels)
    yield configuration, meter
    for step in steps:
        configuration = step.action.effect(configuration)
        meter = meter.after(step.action, step.seconds, configuration)
        yield configuration, meter

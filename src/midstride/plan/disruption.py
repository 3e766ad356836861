"""What a plan costs: semantics.md section 6, counted by role.

:class:`Levels` says how a role's functionality stands in a configuration, and against what it is
measured. :class:`DisruptionMeter` follows a plan step by step. Both look only at the roles that a step
touches, so that a plan's cost is found at the cost of the plan.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from midstride.model.action import Action, Attach, Create, Degrade, Detach, Handover, Remove, SetParameters, Upgrade
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.plan.change import Change

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
    """The levels of the roles' functionalities under one change. Holds what it has looked up."""

    __slots__ = ("_counted", "change")

    def __init__(self, change: Change) -> None:
        self.change = change
        self._counted: dict[str, tuple[Counted, ...]] = {}

    def counted(self, role: str) -> tuple[Counted, ...]:
        """The functionalities of ``role`` that are counted, in order of declaration."""
        known = self._counted.get(role)
        if known is None:
            known = self._counted[role] = tuple(self._count(role))
        return known

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
            levels = (
                self._level(self.change.baseline, ref, outputs, worst),
                self._level(self.change.final, ref, outputs, worst),
            )
            yield Counted(ref, outputs, worst, max(levels), new.weight)

    @staticmethod
    def _level(configuration: Configuration, ref: FunctionalityRef, outputs: tuple[str, ...], worst: int) -> int:
        level = worst
        for instance in configuration.instances_by_role.get(ref.instance, ()):
            own = FunctionalityRef(instance, ref.functionality)
            mode = configuration.modes.get(own)
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

    def baseline(self, ref: FunctionalityRef) -> int:
        """The worse of the levels in ``best`` of start and of target. Raises KeyError if not counted."""
        counted = self.find(ref)
        if counted is None:
            raise KeyError(ref)
        return counted.baseline

    def below(self, configuration: Configuration, role: str) -> dict[FunctionalityRef, int]:
        """How many levels below the baseline the functionalities of ``role`` stand, where they do."""
        found = {}
        for counted in self.counted(role):
            loss = self._level(configuration, counted.ref, counted.outputs, counted.worst) - counted.baseline
            if loss > 0:
                found[counted.ref] = loss
        return found

    def fallen(self, configuration: Configuration, roles: Iterable[str] | None = None) -> dict[FunctionalityRef, int]:
        """The same over ``roles``; over all of them, at the cost of a walk, where None."""
        found: dict[FunctionalityRef, int] = {}
        for role in sorted(self.change.target.nodes) if roles is None else roles:
            found.update(self.below(configuration, role))
        return found

    def weight(self, ref: FunctionalityRef) -> float:
        counted = self.find(ref)
        return 0.0 if counted is None else counted.weight


def instances_touched(action: Action) -> list[str]:
    """The instances that an action changes, in a stable order."""
    match action:
        case Create():
            return [action.instance.name]
        case Remove():
            return [action.instance]
        case SetParameters():
            return [action.instance]
        case Attach() | Detach():
            return [action.port.instance]
        case Handover():
            return list(dict.fromkeys(port.instance for swap in action.swaps for port in (swap.old, swap.new)))
        case Degrade() | Upgrade():
            return list(dict.fromkeys(ref.instance for ref in sorted(action.modes)))
    return []


@dataclass(frozen=True, slots=True)
class LevelChange:
    """By how many levels a role's functionality stood below its baseline before a step, and stands after it."""

    ref: FunctionalityRef
    before: int
    after: int


class DisruptionMeter:
    """Follows a plan: the disruption so far, who stands below the baseline now, and who ever did.

    A step costs what it moves, however many stand below: the loss that stands is kept as a sum.
    """

    __slots__ = ("_clock", "_since", "_spent", "_standing", "below", "disruption", "fallen", "levels")

    def __init__(self, levels: Levels) -> None:
        self.levels = levels
        self.disruption = 0.0
        change = levels.change
        standing = dict.fromkeys(change.start.instances[ref.instance].role for ref in change.lowered)
        self.below: dict[FunctionalityRef, int] = levels.fallen(change.start, standing)
        self.fallen: dict[FunctionalityRef, None] = dict.fromkeys(self.below)
        self._clock = 0.0
        self._since: dict[FunctionalityRef, float] = dict.fromkeys(self.below, 0.0)
        self._spent: dict[FunctionalityRef, float] = {}
        self._standing = sum(loss * levels.weight(ref) for ref, loss in self.below.items())

    def copy(self) -> DisruptionMeter:
        twin = DisruptionMeter.__new__(DisruptionMeter)
        twin.levels, twin.disruption = self.levels, self.disruption
        twin._clock, twin._standing = self._clock, self._standing
        twin.below, twin.fallen = dict(self.below), dict(self.fallen)
        twin._since, twin._spent = dict(self._since), dict(self._spent)
        return twin

    def step(self, action: Action, seconds: float, after: Configuration) -> list[LevelChange]:
        """Take note of an action that has led to ``after``; what it moves, in a stable order."""
        moved = self._moved(action, after)
        weight = self.levels.weight
        during = self._standing + sum(weight(each.ref) * max(0, each.after - each.before) for each in moved)
        if isinstance(action, (Create, Remove)):
            self.disruption = round(self.disruption + during * seconds, DIGITS)
        self._standing += sum(weight(each.ref) * (each.after - each.before) for each in moved)
        begin, self._clock = self._clock, self._clock + seconds
        for each in moved:
            if not each.after:
                del self.below[each.ref]
                self._spent[each.ref] = self._spent.get(each.ref, 0.0) + self._clock - self._since.pop(each.ref)
                continue
            self.below[each.ref] = each.after
            self.fallen[each.ref] = None
            self._since.setdefault(each.ref, begin)
        if not self.below:
            self._standing = 0.0
        return moved

    def _moved(self, action: Action, after: Configuration) -> list[LevelChange]:
        moved = []
        for role in dict.fromkeys(self.levels.change.role_of(name) for name in instances_touched(action)):
            below = self.levels.below(after, role)
            for counted in self.levels.counted(role):
                before, now = self.below.get(counted.ref, 0), below.get(counted.ref, 0)
                if before != now:
                    moved.append(LevelChange(counted.ref, before, now))
        return moved

    @property
    def standing(self) -> float:
        """The weighted levels that are missing now."""
        return self._standing

    def seconds(self, ref: FunctionalityRef) -> float:
        """How long a functionality has been below its baseline, the steps that took it there and back included."""
        open_since = self._since.get(ref, self._clock)
        return round(self._spent.get(ref, 0.0) + self._clock - open_since, DIGITS)

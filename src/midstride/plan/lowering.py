"""The functionalities that a plan lowers from where it has got to: if it is finished, and if it is rolled back.

docs/protocols/permission.md. A step lowers a functionality if that is in a worse mode, or served less, after it than
before. All is compared with the start of the change, also what the target lowers for good, and what is removed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from midstride.model.action import Action, Create
from midstride.model.configuration import Configuration
from midstride.plan.disruption import DIGITS, DisruptionMeter, Levels
from midstride.plan.plan import Plan


@dataclass(frozen=True, slots=True, order=True)
class Lowering:
    """The amount that is lowered: what stays so comes first, then for how long it is so on the way.

    ``lasting``: levels below the start, by weight, when all is done. ``seconds``: the same on the way, times seconds.
    """

    lasting: float
    seconds: float

    def __str__(self) -> str:
        lasting = f"{self.lasting:.3g} weighted levels for good, and " if self.lasting else ""
        return f"{lasting}{self.seconds:.3g} weighted functionality-seconds"


@dataclass(frozen=True)
class PlanLowering:
    """The functionalities that ``plan`` lowers, step by step."""

    plan: Plan

    @cached_property
    def _levels(self) -> Levels:
        """The levels of what runs at the start, whether the target has it or not, below those at the start."""
        change = self.plan.change
        known = change.start  # with the instances that come, unattached and in their last modes: no level is higher
        for instance in change.coming:
            known = Create(instance).effect(known)
        return Levels(replace(change, target=change.specification, baseline=change.start, final=known))

    @cached_property
    def _reached(self) -> list[tuple[Configuration, DisruptionMeter, float]]:
        """The configuration at the start and after each step, the meter, and what is lowered up to there."""
        configuration = self.plan.change.start
        reached = [(configuration, DisruptionMeter.at_start(self._levels), 0.0)]
        for step in self.plan.steps:
            configuration, meter, spent = reached[-1]
            reached.append(_after(configuration, meter, spent, step.action, step.seconds))
        return reached

    def lowers(self, index: int) -> bool:
        """Return whether step ``index`` (from 0) lowers a functionality."""
        return any(each.after > each.before for each in self._reached[index + 1][1].changes)

    def finishing(self, done: int) -> Lowering:
        """The functionalities lowered between ``done`` steps and the end of the plan."""
        _, meter, spent = self._reached[-1]
        return Lowering(round(meter.missing, DIGITS), round(spent - self._reached[done][2], DIGITS))

    def rolling_back(self, done: int) -> Lowering:
        """The functionalities lowered if ``done`` steps are undone instead, the last first."""
        configuration, meter, before = self._reached[done]
        spent = before
        for action in self._undoing(done):
            seconds = self.plan.change.estimate_of(action).seconds
            configuration, meter, spent = _after(configuration, meter, spent, action, seconds)
        return Lowering(round(meter.missing, DIGITS), round(spent - before, DIGITS))

    def _undoing(self, done: int) -> Iterable[Action]:
        for index in reversed(range(done)):
            yield from self.plan.steps[index].action.undo(self._reached[index][0])

    def is_better_finished(self, done: int) -> bool:
        """Return whether finishing the plan lowers less than rolling it back, which is done where both are equal."""
        return self.finishing(done) < self.rolling_back(done)


def _after(
    configuration: Configuration, meter: DisruptionMeter, spent: float, action: Action, seconds: float
) -> tuple[Configuration, DisruptionMeter, float]:
    """After ``action``, which takes so long; what it lowers counts for all that time, what it raises from its end."""
    configuration = action.effect(configuration)
    after = meter.after(action, seconds, configuration)
    weight = meter.levels.weight
    during = meter.missing + sum(weight(each.ref) * max(0, each.after - each.before) for each in after.changes)
    return configuration, after, spent + during * seconds

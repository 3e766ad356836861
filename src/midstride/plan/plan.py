"""A plan: the steps from a running configuration to a target, and what they cost (semantics.md section 6)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from midstride.model.action import Action
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import DIGITS, DisruptionMeter, Levels
from midstride.plan.schedule import dependencies, makespan
from midstride.plan.step import Step

if TYPE_CHECKING:
    from midstride.plan.explain import Degradation, LevelShift


@dataclass(frozen=True)
class Plan:
    """A sequence of steps, each valid, that ends in ``best`` of the target.

    ``disruption`` is in weighted functionality-seconds, ``makespan`` the critical path of the
    steps that do not commute, ``seconds`` the plain sum. ``fallen`` names roles' functionalities
    that ever stand below the baseline. ``proved_minimal`` is claimed only where it is proved.
    """

    strategy: str
    change: Change
    steps: tuple[Step, ...]
    disruption: float
    lower_bound: float
    proved_minimal: bool
    makespan: float
    seconds: float
    fallen: tuple[FunctionalityRef, ...]

    @classmethod
    def of(cls, strategy: str, change: Change, steps: Sequence[Step], levels: Levels | None = None) -> Plan:
        """The plan that consists of ``steps``, with its costs worked out.

        Nothing costs less than nothing, so a plan without disruption is proved minimal by that
        alone; of any other, nothing is claimed.
        """
        meter = DisruptionMeter(levels or Levels(change))
        configuration = change.start
        for step in steps:
            configuration = step.action.effect(configuration)
            meter.step(step.action, step.seconds, configuration)
        return cls(
            strategy=strategy,
            change=change,
            steps=tuple(steps),
            disruption=meter.disruption,
            lower_bound=0.0,
            proved_minimal=meter.disruption == 0.0,
            makespan=makespan(change, steps, meter.levels),
            seconds=round(sum(step.seconds for step in steps), DIGITS),
            fallen=tuple(sorted(meter.fallen)),
        )

    @property
    def start(self) -> Specification:
        return self.change.specification

    @property
    def target(self) -> Specification:
        return self.change.target

    @property
    def actions(self) -> tuple[Action, ...]:
        return tuple(step.action for step in self.steps)

    def configurations(self) -> Iterator[Configuration]:
        """The configurations on the way: the start, and then one after each step."""
        configuration = self.change.start
        yield configuration
        for step in self.steps:
            configuration = step.action.effect(configuration)
            yield configuration

    @cached_property
    def falls(self) -> tuple[Degradation, ...]:
        """Why each functionality falls, from which step to which, and for how long."""
        from midstride.plan.explain import falls

        return falls(self)

    @cached_property
    def shifts(self) -> tuple[LevelShift, ...]:
        """What stands otherwise after the plan than before it, for good."""
        from midstride.plan.explain import shifts

        return shifts(self)

    @cached_property
    def dependencies(self) -> tuple[tuple[int, ...], ...]:
        """For each step, the earlier ones it does not commute with: it must wait for these alone."""
        return dependencies(self.change, self.steps, Levels(self.change))

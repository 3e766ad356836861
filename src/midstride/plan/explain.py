"""Why each functionality falls in a plan, from which step to which, for how long; what stands otherwise after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from midstride.model.action import Degrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator
from midstride.model.specification import Specification
from midstride.plan.disruption import DIGITS, DisruptionMeter, Levels
from midstride.plan.step import Step

if TYPE_CHECKING:
    from midstride.plan.plan import Plan


@dataclass(frozen=True, slots=True)
class Degradation:
    """A role's functionality below its baseline: the steps (from 1) that take it there and back, and why.

    ``seconds`` counts every step of the sequence during which it is below, by the steps'
    estimates. ``until`` is None where the plan begins below and does not end above. ``unserved`` is the step
    from which on no instance serves it any more, None where one always does.
    """

    functionality: FunctionalityRef
    since: int
    until: int | None
    seconds: float
    because: str
    unserved: int | None = None

    def __str__(self) -> str:
        back = "" if self.until is None else f" to step {self.until}"
        stretch = f"from step {self.since}{back} ({self.seconds:g} s)"
        return f"{self.functionality} is below its baseline {stretch}: {self.because}"


@dataclass(frozen=True, slots=True)
class LevelShift:
    """A role's functionality that stands otherwise at the end of a plan than at its beginning, for good.

    ``before`` and ``after`` are modes; None where no instance serves it. ``levels`` says by how many it ends lower.
    """

    functionality: FunctionalityRef
    before: str | None
    after: str | None
    levels: int


def shifts(plan: Plan) -> tuple[LevelShift, ...]:
    """What stands otherwise after the plan, by role, so that it is seen where a role is replaced as well.

    Of functionalities that start and target both have; greatest losses first.
    """
    levels, change = Levels(plan.change), plan.change
    *_, end = plan.configurations()
    found: list[LevelShift] = []
    for role in sorted({role for step in plan.steps for role in step.roles}):
        for counted in levels.counted(role):
            was, will = levels.level(change.start, counted.ref), levels.level(end, counted.ref)
            if was != will:
                before, after = _mode(change.specification, counted.ref, was), _mode(change.target, counted.ref, will)
                found.append(LevelShift(counted.ref, before, after, will - was))
    return tuple(sorted(found, key=lambda shift: (-shift.levels, shift.functionality)))


def _mode(specification: Specification, ref: FunctionalityRef, level: int) -> str | None:
    modes = specification.component_of(ref.instance).functionalities[ref.functionality].modes
    return modes[level].name if level < len(modes) else None


def falls(plan: Plan) -> tuple[Degradation, ...]:
    """One for each stretch in which a functionality stands below its baseline, in the order they begin."""
    levels = Levels(plan.change)
    meter = DisruptionMeter(levels)
    configurations = list(plan.configurations())
    begun: dict[FunctionalityRef, int] = dict.fromkeys(meter.below, 0)
    spent: dict[FunctionalityRef, float] = dict.fromkeys(meter.below, 0.0)
    unserved: dict[FunctionalityRef, int] = {}
    found: list[Degradation] = []

    def close(ref: FunctionalityRef, until: int | None) -> None:
        because = _because(plan.steps, configurations, ref, begun[ref])
        seconds = round(meter.seconds(ref) - spent[ref], DIGITS)
        found.append(Degradation(ref, begun.pop(ref), until, seconds, because, unserved.pop(ref, None)))

    for index, step in enumerate(plan.steps):
        for moved in meter.step(step.action, step.seconds, configurations[index + 1]):
            counted = levels.find(moved.ref)
            if counted is not None and moved.after and counted.baseline + moved.after == counted.worst:
                unserved.setdefault(moved.ref, index + 1)
            if not moved.before:
                begun[moved.ref], spent[moved.ref] = index + 1, meter.seconds(moved.ref) - step.seconds
            elif not moved.after:
                close(moved.ref, index + 1)
    for ref in sorted(begun):
        close(ref, None)
    return tuple(sorted(found, key=lambda fall: (fall.since, fall.functionality)))


def _because(steps: Sequence[Step], configurations: Sequence[Configuration], ref: FunctionalityRef, since: int) -> str:
    """The reason, as the model tells it: what would not hold if the functionality stayed as it was."""
    if since == 0:
        return "it stands below when the plan begins"
    step, before = steps[since - 1], configurations[since - 1]
    if not isinstance(step.action, Degrade):
        return f"after `{step.describe()}` no instance of {ref.instance} serves it any more"
    own = next((own for own in sorted(step.action.modes) if _by_role(before, own) == ref), None)
    for number, later in enumerate(steps[since:], start=since + 1):
        if later.is_structural:
            after = configurations[number]
            if own is not None and own.instance in after.instances:
                judge = Evaluator(after, {own: before.modes[own]})
                mode = before.mode(own)
                functionality = before.functionality(own)
                for assumption in mode.assumptions:
                    if not judge.assumption_satisfied(own, functionality, assumption):
                        why = judge.why_assumption_unsatisfied(own, assumption)
                        return f"in mode {mode.name} {own} {why}, after step {number} (`{later.describe()}`)"
            return f"the strategy lowers it before step {number} (`{later.describe()}`), without its losing anything"
    return "the strategy lowers it"


def _by_role(configuration: Configuration, own: FunctionalityRef) -> FunctionalityRef:
    return FunctionalityRef(configuration.instances[own.instance].role, own.functionality)

"""Why each functionality degrades during a plan, from which step to which, for how long; and what changes for good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from midstride.model.action import Degrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import DIGITS, DisruptionMeter, Levels
from midstride.plan.step import Step


@dataclass(frozen=True, slots=True)
class Degradation:
    """A role's functionality below its baseline: the steps (from 1) that take it there and back, and why.

    ``seconds`` counts every step of the sequence during which it is below, by the steps'
    estimates. ``since`` is 0 where the plan begins below, ``until`` is None where it ends below. ``unserved`` is the
    step from which on no instance serves the functionality, None where one always does.
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
    """A role's functionality that is in another mode at the end of a plan than at its beginning.

    ``before`` and ``after`` are modes; None where no instance serves it. ``levels`` says by how many it ends lower.
    """

    functionality: FunctionalityRef
    before: str | None
    after: str | None
    levels: int


def level_shifts(change: Change, steps: Sequence[Step]) -> tuple[LevelShift, ...]:
    """What is in another mode after the plan for good, by role, so that a replaced role is included.

    Of functionalities that both start and target have; greatest losses first.
    """
    levels, end = Levels(change), change.start
    for step in steps:
        end = step.action.effect(end)
    found: list[LevelShift] = []
    for role in sorted({role for step in steps for role in step.roles}):
        for counted in levels.counted(role):
            was, will = levels.level(change.start, counted.ref), levels.level(end, counted.ref)
            if was != will:
                before, after = _mode(change.specification, counted.ref, was), _mode(change.target, counted.ref, will)
                found.append(LevelShift(counted.ref, before, after, will - was))
    return tuple(sorted(found, key=lambda shift: (-shift.levels, shift.functionality)))


def _mode(specification: Specification, ref: FunctionalityRef, level: int) -> str | None:
    modes = specification.component_of(ref.instance).functionalities[ref.functionality].modes
    return modes[level].name if level < len(modes) else None


def degradations(change: Change, steps: Sequence[Step]) -> tuple[Degradation, ...]:
    """One for each stretch of the plan in which a functionality is below its baseline, in the order they begin."""
    levels = Levels(change)
    meter, configurations = DisruptionMeter.at_start(levels), [change.start]
    begun: dict[FunctionalityRef, int] = dict.fromkeys(meter.below, 0)
    spent: dict[FunctionalityRef, float] = dict.fromkeys(meter.below, 0.0)
    unserved: dict[FunctionalityRef, int] = {}
    ends: list[tuple[FunctionalityRef, int, int | None, float, int | None]] = []

    def close(ref: FunctionalityRef, until: int | None) -> None:
        seconds = round(meter.seconds(ref) - spent[ref], DIGITS)
        ends.append((ref, begun.pop(ref), until, seconds, unserved.pop(ref, None)))

    for number, step in enumerate(steps, start=1):
        configurations.append(step.action.effect(configurations[-1]))
        meter = meter.after(step.action, step.seconds, configurations[-1])
        for moved in meter.changes:
            counted = levels.find(moved.ref)
            if counted is not None and moved.after and counted.baseline + moved.after == counted.worst:
                unserved.setdefault(moved.ref, number)
            if not moved.before:
                begun[moved.ref], spent[moved.ref] = number, meter.seconds(moved.ref) - step.seconds
            elif not moved.after:
                close(moved.ref, number)
    for ref in sorted(begun):
        close(ref, None)
    found = [
        Degradation(ref, since, until, seconds, _because(steps, configurations, ref, since), unserved_from)
        for ref, since, until, seconds, unserved_from in ends
    ]
    return tuple(sorted(found, key=lambda each: (each.since, each.functionality)))


def _because(steps: Sequence[Step], configurations: Sequence[Configuration], ref: FunctionalityRef, since: int) -> str:
    """The reason: the assumption that would not be satisfied if the functionality stayed in its mode."""
    if since == 0:
        return "it is already below when the plan begins"
    step, before = steps[since - 1], configurations[since - 1]
    if not isinstance(step.action, Degrade):
        return f"after `{step.describe()}`, no instance of {ref.instance} serves it"
    live = next((live for live in sorted(step.action.modes) if _by_role(before, live) == ref), None)
    for number, later in enumerate(steps[since:], start=since + 1):
        if later.is_structural:
            after = configurations[number]
            if live is not None and live.instance in after.instances:
                evaluator = Evaluator(after, {live: before.modes[live]})
                mode = before.mode(live)
                functionality = before.functionality(live)
                for assumption in mode.assumptions:
                    if not evaluator.assumption_satisfied(live, functionality, assumption):
                        why = evaluator.why_assumption_unsatisfied(live, assumption)
                        return f"in mode {mode.name}, {live} {why}, after step {number} (`{later.describe()}`)"
            return (
                f"the strategy degrades it before step {number} (`{later.describe()}`), although it loses nothing there"
            )
    return "the strategy degrades it"


def _by_role(configuration: Configuration, live: FunctionalityRef) -> FunctionalityRef:
    return FunctionalityRef(configuration.instances[live.instance].role, live.functionality)

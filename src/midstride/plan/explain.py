"""The reason why each functionality degrades during a plan, from which step to which; and what changes for good."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import msgspec

from midstride.codec.form import Form, field
from midstride.model.action import Attach, Create, Degrade
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import DIGITS, DisruptionMeter, Levels, follow
from midstride.plan.step import Step


class Degradation(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """A functionality of a role below its baseline: the steps that take it there and back, how long, and why.

    Steps count from 1; from step 0: the plan begins below; to step null: it ends below. ``seconds`` adds up the
    estimates of the steps during which it is below.
    """

    functionality: str
    since: int = msgspec.field(name="from_step")
    until: int | None = msgspec.field(name="to_step")
    seconds: float
    because: str
    unserved: Annotated[
        int | None, field("a step", "from which on no instance serves it; null where one always does")
    ] = msgspec.field(name="unserved_from_step")
    forced_by: Annotated[
        list[str],
        field("a list of texts", "the capacities and caps that keep the new side from coming first"),
    ] = []


class LevelShift(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """A functionality of a role that ends in another mode than it began in; null: no instance serves it."""

    functionality: str
    before: str | None = msgspec.field(name="from")
    after: str | None = msgspec.field(name="to")
    levels: Annotated[int, field("a number of levels", "by how many it ends lower")]


def level_shifts(change: Change, steps: Sequence[Step]) -> tuple[LevelShift, ...]:
    """The functionalities that are in another mode after the plan for good, by role, so also of a replaced role.

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
                found.append(LevelShift(str(counted.ref), before, after, will - was))
    return tuple(sorted(found, key=lambda shift: (-shift.levels, shift.functionality)))


def _mode(specification: Specification, ref: FunctionalityRef, level: int) -> str | None:
    modes = specification.component_of(ref.instance).functionalities[ref.functionality].modes
    return modes[level].name if level < len(modes) else None


def degradations(change: Change, steps: Sequence[Step]) -> tuple[Degradation, ...]:
    """One for each stretch of the plan in which a functionality is below its baseline, in the order they begin."""
    levels = Levels(change)
    track = list(follow(levels, steps))
    configurations = [configuration for configuration, _ in track]
    begun: dict[FunctionalityRef, int] = dict.fromkeys(track[0][1].below, 0)
    spent: dict[FunctionalityRef, float] = dict.fromkeys(begun, 0.0)
    unserved: dict[FunctionalityRef, int] = {}
    found: list[Degradation] = []

    def close(ref: FunctionalityRef, meter: DisruptionMeter, until: int | None) -> None:
        since = begun.pop(ref)
        seconds = round(meter.seconds(ref) - spent[ref], DIGITS)
        because, cause = _because(steps, configurations, ref, since)
        last = len(steps) if until is None else until
        window, before = steps[max(since - 1, 0) : last], configurations[max(since - 1, 0)]
        forced_by = [] if cause is None else list(_forced_by(window, before, cause))
        found.append(Degradation(str(ref), since, until, seconds, because, unserved.pop(ref, None), forced_by))

    for number, (step, (_, meter)) in enumerate(zip(steps, track[1:], strict=True), start=1):
        for moved in meter.changes:
            counted = levels.find(moved.ref)
            if counted is not None and moved.after and counted.baseline + moved.after == counted.worst:
                unserved.setdefault(moved.ref, number)
            if not moved.before:
                begun[moved.ref], spent[moved.ref] = number, meter.seconds(moved.ref) - step.seconds
            elif not moved.after:
                close(moved.ref, meter, number)
    for ref in sorted(begun):
        close(ref, track[-1][1], None)
    return tuple(sorted(found, key=lambda each: (each.since, each.functionality)))


def _because(
    steps: Sequence[Step], configurations: Sequence[Configuration], ref: FunctionalityRef, since: int
) -> tuple[str, Step | None]:
    """The assumption that would be violated if the functionality stayed in its mode; and the step that causes that."""
    if since == 0:
        return "it is already below when the plan begins", None
    step, before = steps[since - 1], configurations[since - 1]
    if not isinstance(step.action, Degrade):
        return f"after `{step.describe()}`, no instance of {ref.instance} serves it", step
    degraded = (live for live in sorted(step.action.modes) if live.functionality == ref.functionality)
    live = next((live for live in degraded if before.instances[live.instance].role == ref.instance), None)
    number = next((n for n, later in enumerate(steps[since:], start=since + 1) if later.is_structural), None)
    if number is None:
        return "the strategy degrades it", None
    after, cause = configurations[number], steps[number - 1]
    next_step = f"step {number} (`{cause.describe()}`)"
    if live is not None and live.instance in after.instances:
        for violation in Evaluator(after, {live: before.modes[live]}).violations_of([live]):
            return f"in mode {before.mode(live).name}, {live} {violation.because}, after {next_step}", cause
    return f"the strategy degrades it before {next_step}, although it loses nothing there", None


def _forced_by(steps: Sequence[Step], before: Configuration, cause: Step) -> Iterator[str]:
    """Name what keeps the roles of ``cause`` from creating and attaching ``before`` it what they do only after it."""
    found: dict[str, None] = {}
    for step in steps:
        if isinstance(step.action, (Create, Attach)) and set(step.roles) & set(cause.roles):
            for reason in step.action.check(before):
                if reason.precondition in ("capacity", "cap"):
                    found[f"`{step.describe()}` has to wait: {reason}"] = None
            before = step.action.effect(before)
    yield from found

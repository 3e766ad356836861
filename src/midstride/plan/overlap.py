"""What of a plan overlaps when it is carried out (docs/semantics.md section 6).

The steps keep the order of the plan. Two things overlap: a process starts as soon as everything is done that its
``create`` step must wait for, and steps next to each other that remove instances are taken at once. How long the plan
takes follows from that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from midstride.model.action import Action, Create, Remove
from midstride.plan.disruption import DIGITS
from midstride.plan.estimate import Estimate
from midstride.plan.plan import Plan


@dataclass(frozen=True, slots=True)
class Overlap:
    """The ``rounds`` of a plan: its steps in order, those of one round are taken at once.

    ``starts``: by number of steps, the creations whose processes may start as soon as that many are done.
    """

    rounds: tuple[tuple[int, ...], ...]
    starts: dict[int, list[int]]


def one_by_one(actions: Sequence[Action]) -> Overlap:
    """One step after another; only the processes of creations next to each other start at once."""
    starts: dict[int, list[int]] = {}
    first = 0
    for index, action in enumerate(actions):
        if not isinstance(action, Create):
            first = index + 1
        else:
            starts.setdefault(first, []).append(index)
    return Overlap(tuple((index,) for index in range(len(actions))), starts)


def overlap(plan: Plan) -> Overlap:
    """What overlaps, by the plan's dependencies: whatever steps are done at a time, the configuration is valid."""
    rounds: list[tuple[int, ...]] = []
    starts: dict[int, list[int]] = {}
    for index, (step, waits) in enumerate(zip(plan.steps, plan.dependencies, strict=True)):
        last = rounds[-1] if rounds else ()
        beside = all(_may_overlap(plan.steps[each].action, step.action) for each in last)
        if last and beside and not set(last).intersection(waits):
            rounds[-1] = (*last, index)
        else:
            rounds.append((index,))
        if isinstance(step.action, Create):
            starts.setdefault(max(waits, default=-1) + 1, []).append(index)
    return Overlap(tuple(rounds), starts)


def duration(plan: Plan) -> Estimate:
    """How long the plan takes as it is carried out (s), between the critical path and the sum of its steps.

    The shortest and the longest are those with every step at its shortest and at its longest. It is assumed that
    processes do not slow each other down while they start.
    """
    found = overlap(plan)
    between = [step.between or (step.seconds, step.seconds) for step in plan.steps]
    expected = [step.seconds for step in plan.steps]
    shortest, longest = ([each[end] for each in between] for end in (0, 1))
    return Estimate(*(round(_last_end(found, seconds), DIGITS) for seconds in (expected, shortest, longest)))


def _last_end(found: Overlap, seconds: Sequence[float]) -> float:
    """When the last round ends, if the steps take so long; the process of a creation may have begun before its step."""
    now, looked = 0.0, 0
    started: dict[int, float] = {}
    for some in found.rounds:
        for number in range(looked, some[0] + 1):
            started.update(dict.fromkeys(found.starts.get(number, ()), now))
        looked = some[0] + 1
        now = max(now, *(started.get(index, now) + seconds[index] for index in some))
    return now


def _may_overlap(one: Action, other: Action) -> bool:
    return isinstance(one, Remove) and isinstance(other, Remove)

"""What of a plan overlaps when it is carried out (docs/semantics.md section 6).

The steps keep the order of the plan. Two things overlap: a process starts as soon as everything is done that its
``create`` step must wait for, and steps next to each other that remove instances are taken at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from midstride.model.action import Action, Create, Remove
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


def _may_overlap(one: Action, other: Action) -> bool:
    return isinstance(one, Remove) and isinstance(other, Remove)

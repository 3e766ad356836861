"""Checks the lower bound that a plan claims, without the planner's code (docs/semantics.md section 6).

Every order of the structural differences is searched, cheapest first, up to the claimed bound
(:mod:`tests.replay.bound_search`). Where the plan has a certificate, its parts are searched one by one. Each is a
bound, whatever the planner took for a part, so their sum is one; nothing else in the certificate is believed.
A bound on plans with detours is checked for every set of detours there is (:mod:`tests.replay.detour_space`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal

from midstride.model.action import Create, Remove
from midstride.model.configuration import Instance
from midstride.plan.change import Change
from midstride.plan.constraints import in_force
from midstride.plan.core.detours import describe
from midstride.plan.plan import Plan
from tests.replay.bound_search import BoundSearch, Definition, SearchTooLarge, Work
from tests.replay.detour_space import with_every_detour

# How many functionalities are evaluated in all, once for each state. One to three seconds.
WORK: Final = 40_000
_EPSILON: Final = 1e-6


@dataclass(frozen=True, slots=True)
class BoundCheck:
    """Whether no plan loses less than the claimed bound; ``because`` says why it is violated or was not checked."""

    outcome: Literal["holds", "violated", "not checked"]
    because: str = ""


def check_bound(plan: Plan, definition: Definition, work: int = WORK) -> BoundCheck:
    """The result for a plan whose steps are valid; ``work`` limits how many functionalities are evaluated."""
    if plan.lower_bound <= _EPSILON:
        return BoundCheck("holds")
    if not _is_plan_of(plan, plan.change):
        return BoundCheck("not checked", "the plan creates or removes other instances than the change needs")
    seconds, direct = _seconds(plan), plan.change.direct or plan.change
    with_detours = plan.proof_space == "detours"

    def cheaper(change: Change, bound: float, left: Work, roles: Collection[str] | None = None) -> float | None:
        """The least disruption of ``change``, if that is less than ``bound``."""
        return BoundSearch(change, seconds, definition, left, roles).cheapest_below(bound - _EPSILON)

    with suppress(SearchTooLarge):
        parts = plan.certificate if not with_detours and _adds_up(plan) else ()
        if parts and all(cheaper(direct, part.bound, Work(work), part.roles) is None for part in parts):
            return BoundCheck("holds")
    left = Work(work)
    try:
        for change in with_every_detour(direct) if with_detours else (direct,):
            left.spend(len(change.start.modes))
            if (least := cheaper(change, plan.lower_bound, left)) is not None:
                return _too_high(change, least)
    except SearchTooLarge:
        return BoundCheck("not checked", f"the change {'with its detours ' if with_detours else ''}is too large")
    return BoundCheck("holds")


def _too_high(change: Change, least: float) -> BoundCheck:
    if in_force(change):
        return BoundCheck("not checked", "it is higher than what follows from the constraints here")
    words = [f"a plan with a disruption of {least:g} exists", *describe(change)]
    return BoundCheck("violated", "; ".join(words))


def _is_plan_of(plan: Plan, change: Change) -> bool:
    created = [step.action.instance.role for step in plan.steps if isinstance(step.action, Create)]
    removed = [step.action.instance for step in plan.steps if isinstance(step.action, Remove)]
    return sorted(created) == sorted(each.role for each in change.coming) and sorted(removed) == sorted(change.leaving)


def _adds_up(plan: Plan) -> bool:
    """Whether the certificate has several parts, of different roles, and the bound is not above their sum."""
    roles = [role for part in plan.certificate for role in part.roles]
    total = sum(part.bound for part in plan.certificate)
    return len(plan.certificate) > 1 and len(set(roles)) == len(roles) and total >= plan.lower_bound - _EPSILON


def _seconds(plan: Plan) -> Callable[[str, Instance], float]:
    """How long (s) the creation or removal of an instance takes: as the plan says, or for a detour that it does not
    make, as is expected."""
    found: dict[tuple[str, str, str], float] = {}
    for step in plan.steps:
        match step.action:
            case Create(instance):
                found["create", instance.role, instance.component.name] = step.seconds
            case Remove(name):
                instance = plan.change.instance(name)
                found["remove", instance.role, instance.component.name] = step.seconds

    def seconds(kind: str, instance: Instance) -> float:
        stated = found.get((kind, instance.role, instance.component.name))
        return plan.change.seconds(kind, instance) if stated is None else stated

    return seconds

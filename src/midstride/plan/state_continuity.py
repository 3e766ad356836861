"""The state of replaced components as it moves in a plan, where no topic is handed over (docs/protocols/state.md)."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from midstride.model.action import Action, Create, Handover, Remove
from midstride.model.specification import handover_seconds
from midstride.plan.change import Change
from midstride.plan.plan import Plan


def without_outputs(change: Change) -> dict[str, str]:
    """The instances of ``change`` that replace another one where neither has an attached output: which one."""
    publishing = {port.instance for port, _ in (*change.detached, *change.attached) if change.is_output(port)}
    return {new: old for old, new in change.replaced.items() if not {old, new} & publishing}


def left_behind(change: Change, actions: Iterable[Action]) -> dict[str, str]:
    """The replacements to which no state moves in a plan of ``actions``: why.

    They are created beside the old one and publish, but take over none of its topics: there is no cut.
    """
    actions, receiving = list(actions), without_outputs(change)
    handed = {swap.new.instance for action in actions if isinstance(action, Handover) for swap in action.swaps}
    removed: set[str] = set()
    beside: dict[str, str] = {}
    old_of = {new: old for old, new in change.replaced.items()}
    for action in actions:
        if isinstance(action, Remove):
            removed.add(action.instance)
        elif isinstance(action, Create) and old_of.get(action.instance.name, "") not in {"", *removed}:
            beside[action.instance.name] = old_of[action.instance.name]
    return {
        new: f"it takes over no topic of {old}, so there is no cut at which the state of {old} could move"
        for new, old in beside.items()
        if new not in handed and new not in receiving
    }


def with_time_for_state(plan: Plan, keeping: Collection[str]) -> Plan:
    """``plan`` with the longest time of each hand-over at which state moves, of one of the instances ``keeping``."""
    change, steps = plan.change, list(plan.steps)
    longest = handover_seconds(change.target.timing, "state_timeout")
    for index, step in enumerate(steps):
        if not isinstance(step.action, Handover):
            continue
        pairs = {(swap.old.instance, swap.new.instance) for swap in step.action.swaps}
        if any(change.replaced.get(old) == new and old in keeping and _moves(change, old, new) for old, new in pairs):
            found = change.estimate_of(step.action)
            steps[index] = replace(step, between=found.at_most(found.longest + longest).between)
    return replace(plan, steps=tuple(steps))


def _moves(change: Change, old: str, new: str) -> bool:
    """Return whether state can move between the two at a cut: both have an agent inside, or neither, and a gate."""
    components = [change.component_of(name) for name in (old, new)]
    if any(each.has_agent for each in components):
        return all(each.has_agent for each in components)
    return all(each.gate != "none" for each in components)

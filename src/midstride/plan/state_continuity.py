"""How the state of replaced components moves in a plan, where no topic is handed over (docs/protocols/state.md)."""

from __future__ import annotations

from collections.abc import Iterable

from midstride.model.action import Action, Create, Handover, Remove
from midstride.plan.change import Change


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

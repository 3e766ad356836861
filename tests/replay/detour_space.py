"""All changes with detours that a proof may speak of, for the check of a bound (docs/semantics.md section 6).

The planner leaves out the detours that cannot help (:func:`.detours.further`); here none is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product

from midstride.plan.change import Change, Detour
from midstride.plan.core.detours import MOST, kept_instance, stand_ins, with_detours


def with_every_detour(change: Change) -> Iterator[Change]:
    """``change``, which has none, and then with each set of detours of so many roles as one plan may have."""
    found = _by_role(change)
    for number in range(MOST + 1):
        for roles in combinations(found, number):
            for detours in product(*(found[role] for role in roles)):
                yield with_detours(change, detours)


def _by_role(change: Change) -> dict[str, list[Detour]]:
    """A node that stays may be moved; any role may have a stand-in, also one whose node is moved."""
    found: dict[str, list[Detour]] = {}
    for role in sorted(set(change.specification.nodes).intersection(change.target.nodes)):
        ways = [False, True] if kept_instance(change, role) is not None else [False]
        detours = [Detour(role, moved=True)] if True in ways else []
        detours += [Detour(role, moved, component) for component in stand_ins(change, role) for moved in ways]
        if detours:
            found[role] = detours
    return found

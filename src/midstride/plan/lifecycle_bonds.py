"""Nodes that a plan must not end, as the specification itself has the lifecycle manager that would notice.

That needs no running system, and no graph (docs/protocols/foreign.md, A lifecycle manager beside Midstride).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from midstride.errors import PlanRefused
from midstride.model.action import Remove
from midstride.model.configuration import Configuration
from midstride.model.instance_names import full_name
from midstride.model.lifecycle_management import (
    BOND_TIMEOUT,
    NODE_NAMES,
    bond_timeout,
    broken_bond,
    has_bonds,
    managed_nodes,
    why_it_stays,
)
from midstride.plan.plan import Plan


def require_unbroken_bonds(plan: Plan, has_ended: Callable[[str], bool] = lambda _: False) -> None:
    """Raises PlanRefused if ``plan`` ends a node with which a running manager, by its parameters, has a bond.

    ``has_ended``: whether the process of an instance that runs by the model has ended.
    """
    start = plan.change.start
    ending = [step.action.instance for step in plan.steps if isinstance(step.action, Remove)]
    for name in ending:
        if name not in start.instances or has_ended(name):
            continue
        reasons = [words for manager, words in _bonds(start, name) if not has_ended(manager)]
        if reasons:
            raise PlanRefused(why_it_stays(name, reasons))


def _bonds(configuration: Configuration, instance: str) -> Iterator[tuple[str, str]]:
    """The managers that have a bond with ``instance``, and what each does when it breaks, in words.

    A manager knows the first node of a role by its name. What a program names itself, or how a later instance is
    called, is known of what runs. Nodes that Midstride manages, or with its API, are in no bond.
    """
    node = configuration.instances[instance]
    own = node.component
    if own.gate is None or own.has_lifecycle or own.once or own.unnamed or node.name != node.role:
        return
    name = full_name(node.role)
    for manager in configuration.instances.values():
        values = manager.parameters
        if NODE_NAMES not in values or manager.name == instance or not has_bonds(values):
            continue
        if name in managed_nodes(full_name(manager.role), values):
            is_assumed = BOND_TIMEOUT not in values
            yield manager.name, broken_bond(name, full_name(manager.role), bond_timeout(values), is_assumed)

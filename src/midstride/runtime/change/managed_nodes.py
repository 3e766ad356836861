"""Nodes that must not end, as a lifecycle manager would take all of its nodes down: a plan that ends one is refused."""

from __future__ import annotations

import asyncio
from typing import Final

from midstride.errors import BackendError, CommandRefused, PlanRefused, StepFailed
from midstride.model.action import Remove
from midstride.model.component import ComponentSpec
from midstride.model.lifecycle_management import why_it_stays
from midstride.plan.lifecycle_bonds import require_unbroken_bonds
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.process.component_client import ComponentClient

# How long it may take a plan to find out whether a lifecycle manager would miss a node (s). What has just been started
# shows what it calls within some 3 s.
PLAN_LOOK: Final = 4.0
# The same right before the node is ended (s): the plan has waited for it.
LAST_LOOK: Final = 0.1


def reasons_to_stay(life: LifeTable, instance: str) -> list[str]:
    """The reasons why ``instance`` must not end, in words; none where no lifecycle manager is known to notice."""
    latest = life.latest(instance)
    return [] if latest is None or life.has_exited(instance) else latest.state.managed


async def require_unmanaged(plan: Plan, client: ComponentClient) -> list[str]:
    """Raises PlanRefused if ``plan`` ends an instance that a lifecycle manager would miss.

    What the specification says needs no graph. Otherwise each is asked, for PLAN_LOOK at most. What is not known then
    is in its state; returns those that have not answered at all.
    """
    require_unbroken_bonds(plan, client.life.has_exited)
    ending = [step.action.instance for step in plan.steps if isinstance(step.action, Remove)]
    answered = await asyncio.gather(
        *(look_at_managers(client, name, plan.change.instance(name).component, PLAN_LOOK) for name in ending)
    )
    for name in ending:
        if reasons := reasons_to_stay(client.life, name):
            raise PlanRefused(why_it_stays(name, reasons))
    return [name for name, has_answered in zip(ending, answered, strict=True) if not has_answered]


async def require_unmanaged_at_its_end(client: ComponentClient, instance: str, component: ComponentSpec) -> bool:
    """Raises StepFailed if a lifecycle manager would miss ``instance``, and was not seen when its end was planned.

    Returns whether what answers for it has looked once more.
    """
    answered = await look_at_managers(client, instance, component, LAST_LOOK)
    if reasons := reasons_to_stay(client.life, instance):
        raise StepFailed(why_it_stays(instance, reasons))
    return answered


async def look_at_managers(client: ComponentClient, instance: str, component: ComponentSpec, seconds: float) -> bool:
    """Have what answers for a node without Midstride's API look at the graph; others cannot be managed.

    Returns whether it has, where there is anything to ask. What it reported before counts in any case.
    """
    if component.gate is None or component.once or client.life.is_gone(instance):
        return True
    try:
        await client.peek(instance, seconds)
    except (BackendError, CommandRefused):
        return False
    return True

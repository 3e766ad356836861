"""Nodes that must not end, as a lifecycle manager would take all of its nodes down: a plan that ends one is refused."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Final

from midstride.errors import BackendError, CommandRefused, PlanRefused, StepFailed
from midstride.model.action import Remove
from midstride.model.component import ComponentSpec
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.process.component_client import ComponentClient

# How long it may take a plan to find out whether a lifecycle manager would miss a node (s). What has just been started
# shows what it calls within some 3 s.
PLAN_LOOK: Final = 4.0
# The same right before the node is ended (s): the plan has waited for it.
LAST_LOOK: Final = 0.1


def why_it_stays(life: LifeTable, instance: str) -> str | None:
    """Why ``instance`` must not end, and what to do; None where no lifecycle manager is known to notice."""
    latest = life.latest(instance)
    if latest is None or not latest.state.managed or life.has_exited(instance):
        return None
    return (
        f"{instance} cannot be replaced or removed: {'; '.join(latest.state.managed)}. Let Midstride manage its "
        "lifecycle: remove the manager, and declare `gate lifecycle preload` (`midstride import` and `midstride "
        "capture` do so with `--lifecycle midstride`)"
    )


async def require_unmanaged(plan: Plan, client: ComponentClient) -> None:
    """Raises PlanRefused if ``plan`` ends an instance that a lifecycle manager would miss.

    Each is asked, for PLAN_LOOK at most. What is not known then is in its state.
    """
    ending = [step.action.instance for step in plan.steps if isinstance(step.action, Remove)]
    await asyncio.gather(
        *(look_at_managers(client, name, plan.change.instance(name).component, PLAN_LOOK) for name in ending)
    )
    for name in ending:
        if (words := why_it_stays(client.life, name)) is not None:
            raise PlanRefused(words)


async def require_unmanaged_at_its_end(client: ComponentClient, instance: str, component: ComponentSpec) -> None:
    """Raises StepFailed if a lifecycle manager would miss ``instance``, and was not seen when its end was planned."""
    await look_at_managers(client, instance, component, LAST_LOOK)
    if (words := why_it_stays(client.life, instance)) is not None:
        raise StepFailed(words)


async def look_at_managers(client: ComponentClient, instance: str, component: ComponentSpec, seconds: float) -> None:
    """Have what answers for a node without Midstride's API look at the graph; others cannot be managed."""
    if component.gate is None or component.once or client.life.is_gone(instance):
        return
    with suppress(BackendError, CommandRefused):  # what it reported last counts
        await client.peek(instance, seconds)

"""Nodes that must not end, as a lifecycle manager would take all of its nodes down: a plan that ends one is refused."""

from __future__ import annotations

from midstride.errors import PlanRefused, StepFailed
from midstride.model.action import Remove
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.process.component_client import ComponentClient


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
    """Raises PlanRefused if ``plan`` ends an instance that a lifecycle manager would miss."""
    for step in plan.steps:
        if isinstance(step.action, Remove) and why_it_stays(client.life, step.action.instance) is not None:
            state = await client.peek(step.action.instance)  # the manager may have ended
            if state.managed and (words := why_it_stays(client.life, step.action.instance)) is not None:
                raise PlanRefused(words)


def require_unmanaged_at_its_end(life: LifeTable, instance: str) -> None:
    """Raises StepFailed if a lifecycle manager would miss ``instance``, and it was not seen when that was planned."""
    if (words := why_it_stays(life, instance)) is not None:
        raise StepFailed(words)

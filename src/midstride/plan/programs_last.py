"""Programs that end (`once`) run after all other steps, unless the user's order says otherwise.

They may need what the others offer in their best modes, such as a service that a lifecycle node has when it is active
(docs/semantics.md section 6).
"""

from __future__ import annotations

from collections.abc import Sequence

from midstride.model.action import Create, Remove
from midstride.model.specification import Order
from midstride.plan.change import Change
from midstride.plan.constraints import in_force
from midstride.plan.step import Step


def programs_last(steps: Sequence[Step], change: Change) -> tuple[Step, ...]:
    """``steps`` with those of programs that end at the end, but for roles that an ``order`` puts before another one.

    These steps change no functionality, so the others are valid without them.
    """
    moving = {role for step in steps if _is_of_program(step, change) for role in step.roles}
    if not moving:
        return tuple(steps)
    acting = {role for step in steps if step.is_structural for role in step.roles}
    orders = [each for each in in_force(change) if isinstance(each, Order)]
    while kept := {order.first for order in orders if order.first in moving and order.then in acting - moving}:
        moving -= kept
    is_last = [_is_of_program(step, change) and moving.issuperset(step.roles) for step in steps]
    first = (step for step, last in zip(steps, is_last, strict=True) if not last)
    return (*first, *(step for step, last in zip(steps, is_last, strict=True) if last))


def _is_of_program(step: Step, change: Change) -> bool:
    match step.action:
        case Create(instance):
            return instance.component.once
        case Remove(name):
            return change.component_of(name).once
    return False

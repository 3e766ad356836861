"""The losses that a plan may cause on the way, and those that nothing will measure (:mod:`midstride.verdicts`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from midstride.model.action import Create, Handover, Remove
from midstride.model.configuration import Instance
from midstride.plan.plan import Plan
from midstride.verdicts import assessment, change_facts, unmeasured
from midstride.verdicts.assessment import Assessment, Assessments

# How long the two transitions of a hand-over between lifecycle nodes without a library may take (s), where the
# specification states no other time to activate (docs/how-to/lifecycle-nodes.md).
DEACTIVATE: Final = 5.0
ACTIVATE: Final = 5.0
# How long it may take to ask the nodes for their states meanwhile (s), if the new one fails and the old one returns.
ASKING: Final = 3.0


def expected_losses(plan: Plan) -> Assessments:
    """Assess what ``plan`` lowers, what is down or silent meanwhile, and of which nodes nothing measures what
    they do.
    """
    lowered = [each.functionality for each in plan.degradations]
    lowered += [shift.functionality for shift in plan.level_shifts if shift.levels > 0]
    found = [
        *map(change_facts.will_degrade, dict.fromkeys(lowered)),
        *_silences(plan),
        *_exchanges(plan),
        *plan.besides,
    ]
    touched = {role for step in plan.steps for role in step.roles}
    others = {
        role: plan.change.target.component_of(role)
        for role in plan.change.start.instances_by_role
        if role not in touched and role in plan.change.target.nodes
    }
    return assessment.expected([*found, *(unmeasured.unmeasured_nodes(others) if plan.steps else ())])


def _silences(plan: Plan) -> Iterator[Assessment]:
    """The topics that are handed over between lifecycle nodes that nothing else holds back."""
    instances = planned_instances(plan)
    for step in plan.steps:
        for swap in step.action.swaps if isinstance(step.action, Handover) else ():
            old, new = (instances[port.instance].component.gate for port in (swap.old, swap.new))
            if old == new == "lifecycle":
                sides = (instances[port.instance].component for port in (swap.old, swap.new))
                activate_old, activate_new = (each.activate_seconds or ACTIVATE for each in sides)
                longest = DEACTIVATE + activate_new
                back = longest + ASKING + activate_old
                yield change_facts.will_be_inactive(swap.connector, swap.old.instance, swap.new.instance, longest, back)


def _exchanges(plan: Plan) -> Iterator[Assessment]:
    """The nodes of which nothing measures what they do, and that are started again."""
    instances = planned_instances(plan)
    created = {step.action.instance.name: at for at, step in enumerate(plan.steps) if isinstance(step.action, Create)}
    removed = {step.action.instance: at for at, step in enumerate(plan.steps) if isinstance(step.action, Remove)}
    for old, new in sorted(plan.change.replaced.items()):
        if new not in created or old not in removed:
            continue
        because = unmeasured_pair(instances, old, new)
        if because is not None:
            down = plan.steps[removed[old] : created[new] + 1]
            yield change_facts.will_be_exchanged(
                instances[new].role,
                because,
                side_by_side=created[new] < removed[old],
                seconds=sum(step.seconds for step in down),
            )


def unmeasured_pair(instances: Mapping[str, Instance], old: str, new: str) -> str | None:
    """The reason why nothing measures what two instances of a role do; None where something does."""
    return next(filter(None, (unmeasured.why_unmeasured(instances[name].component) for name in (old, new))), None)


def planned_instances(plan: Plan) -> dict[str, Instance]:
    """The instances that run at the start of ``plan``, and those that it creates, by name."""
    created = {
        step.action.instance.name: step.action.instance for step in plan.steps if isinstance(step.action, Create)
    }
    return {**plan.change.start.instances, **created}

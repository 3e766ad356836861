"""Strategy ``paper``: the paper's Algorithm 1 and its six-step replace, as its text says (docs/semantics.md section 6).

1. Detach all ports of the old component; before each detach, degrade the affected functionalities to their last
   mode, downstream first.
2. Remove it.
3. Create the new component, in its last modes.
4. Attach its inputs.
5. Upgrade its functionalities.
6. Attach its outputs, and upgrade the degraded functionalities of the others, to ``best``.

For several changes, first everything old is removed (1 and 2 for each), then everything new is added (3 to 6 for
each). The paper's listing does not terminate in a cycle; here the affected functionalities are computed as a closure,
and degraded in groups where they support each other.
"""

from __future__ import annotations

from collections.abc import Iterable

from midstride.errors import PlanRefused
from midstride.model.action import Action, Attach, Create, Detach, Remove
from midstride.model.best import consumers_of
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import Evaluator
from midstride.model.specification import Order
from midstride.plan.change import Change, PortAttachment
from midstride.plan.constraints import breaches, conflict, in_force, layers, refusal
from midstride.plan.disruption import Levels
from midstride.plan.plan import Plan
from midstride.plan.strategies.mode_ordering import Modes
from midstride.plan.strategies.plan_builder import PlanBuilder


def paper(change: Change) -> Plan:
    """The paper's plan. Raises PlanRefused where it does not meet the user's constraints."""
    return six_steps("paper", change, ())


def six_steps(strategy: str, change: Change, lowered_first: Iterable[FunctionalityRef]) -> Plan:
    """The paper's process, after lowering ``lowered_first`` to their last modes.

    Where the user asks for an order of roles, the whole process runs for one layer of roles at a time.
    """
    levels = Levels(change)
    constraints = in_force(change)
    roles = [change.role_of(name) for name in change.instances()]
    layered = layers(roles, constraints)
    if layered is None:
        orders = [constraint for constraint in constraints if isinstance(constraint, Order)]
        raise refusal(conflict(orders, lambda some: layers(roles, some) is not None), ())
    plan = _lower_to_last(PlanBuilder.at_start(levels), lowered_first)
    for layer in layered:
        plan = _bring(_take_away(plan, set(layer)), set(layer))
    plan = plan.raise_touched().set_parameters(change.parameters)
    if broken := breaches(plan.steps, levels, constraints):
        raise refusal([broken[0].constraint], broken)
    return Plan.of(strategy, plan.steps, levels)


def _take_away(plan: PlanBuilder, roles: set[str]) -> PlanBuilder:
    """Steps 1 and 2, for these roles."""
    change = plan.change
    leaving = {name for name in change.leaving if change.role_of(name) in roles}
    detached: dict[str, list[PortAttachment]] = {name: [] for name in change.leaving if name in leaving}
    for port, connector in change.detached:
        if change.role_of(port.instance) in roles:
            detached.setdefault(port.instance, []).append((port, connector))
    for name, attachments in detached.items():
        for port, connector in attachments:
            plan = _detach(plan, port, connector)
        if name in leaving:
            plan = plan.do(Remove(name))
    return plan


def _detach(plan: PlanBuilder, port: PortRef, connector: str) -> PlanBuilder:
    seeds = consumers_of(plan.configuration, port, connector)
    affected = _affected(plan.configuration.without_attachment(port, connector), seeds)
    return plan.touching(affected).lower_to(affected).do(Detach(port, connector))


def _affected(after: Configuration, seeds: Iterable[FunctionalityRef]) -> Modes:
    """The closure of AffectedFuncs and AffectedConns: each functionality no longer satisfied, in its last mode."""
    overlay: Modes = {}
    evaluator = Evaluator(after, overlay)
    pending = list(seeds)
    while pending:
        ref = pending.pop()
        if ref in overlay or evaluator.satisfied(ref):
            continue
        overlay[ref] = after.functionality(ref).last_mode
        pending.extend(after.downstream(ref))
    return overlay


def _lower_to_last(plan: PlanBuilder, refs: Iterable[FunctionalityRef]) -> PlanBuilder:
    configuration = plan.configuration
    modes = {
        ref: last for ref in refs if configuration.modes[ref] != (last := configuration.functionality(ref).last_mode)
    }
    return plan.touching(modes).lower_to(modes)


def _bring(plan: PlanBuilder, roles: set[str]) -> PlanBuilder:
    """Steps 3 to 6, for these roles."""
    change = plan.change
    attached: dict[str, list[PortAttachment]] = {}
    for port, connector in change.attached:
        if change.role_of(port.instance) in roles:
            attached.setdefault(port.instance, []).append((port, connector))
    for instance in change.coming:
        if instance.role in roles:
            plan = _bring_instance(plan, instance, attached.pop(instance.name, []))
    for attachments in attached.values():
        plan = _attach_possible(plan, attachments).raise_touched()
    return plan


def _bring_instance(plan: PlanBuilder, instance: Instance, attachments: list[PortAttachment]) -> PlanBuilder:
    _check_possible(plan, Create(instance))
    inputs = [pair for pair in attachments if pair[0].port in instance.component.inputs]
    outputs = [pair for pair in attachments if instance.component.has_output(pair[0].port)]
    plan = plan.create(instance).attach(*inputs)
    for ref in instance.functionality_refs():
        index = Evaluator(plan.configuration).best_satisfied_mode(ref, 0)
        if index < plan.configuration.modes[ref]:
            plan = plan.raise_to({ref: index})
    return _attach_possible(plan, outputs).raise_touched()


def _attach_possible(plan: PlanBuilder, attachments: Iterable[PortAttachment]) -> PlanBuilder:
    for port, connector in attachments:
        _check_possible(plan, Attach(port, connector))
        plan = plan.attach((port, connector))
    return plan


def _check_possible(plan: PlanBuilder, action: Action) -> None:
    """Refuse where an ``order`` lets something come before what is in its way has been removed."""
    if reasons := action.check(plan.configuration):
        because = "; ".join(str(reason) for reason in reasons)
        raise PlanRefused(f"in the order that the constraints ask for, {action.describe()} is impossible: {because}")

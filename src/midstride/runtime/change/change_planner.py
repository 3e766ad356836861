"""The plan for a request, from what runs now, with all that is to be said of it before anything is changed.

Planning does not block the event loop: the search runs in a thread, on values that do not change.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from midstride.codec.parameter import from_json
from midstride.errors import BackendError, ManagerError, PlanRefused
from midstride.model.configuration import Configuration
from midstride.model.specification import Order, Specification
from midstride.plan.change_builder import change_between, requested_change
from midstride.plan.estimate import Estimate
from midstride.plan.goals_in_progress import with_time_for_goals
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.runtime_values import Origin, Values, of_change, with_times
from midstride.plan.sensitivity import sensitivity
from midstride.plan.state_continuity import with_time_for_state
from midstride.plan.strategies.registry import planner
from midstride.plan.strategies.restore import restore
from midstride.plan.strategies.settings import set_parameters
from midstride.runtime.change.container_copies import room_for_copies
from midstride.runtime.change.lost_endpoints import answered_in_turn, lost_endpoints, messages_in_turn, with_goals
from midstride.runtime.change.managed_nodes import require_unmanaged
from midstride.runtime.change.other_nodes_losses import ending_nodes, nodes_that_will_end, would_end_others
from midstride.runtime.change.parameter_transfer import unread_parameters
from midstride.runtime.change.planned_transfers import planned_transfers
from midstride.runtime.change.stalled_first import with_stalled_first
from midstride.runtime.change.successor_names import names_after
from midstride.runtime.handover.arbiter_choice import require_arbiters
from midstride.runtime.handover.fences import hanging
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.process.reached_hosts import out_of_reach, unknown_instances
from midstride.runtime.records.journal import Journal
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.other_nodes import OtherNodesWatch
from midstride.runtime.watch.silence import SilenceMonitor
from midstride.verdicts import change_facts


@dataclass(frozen=True, slots=True)
class _Situation:
    """The system as it was when a plan was asked for, which is searched from it.

    ``values``: by role, the parameters that were set at run time; ``unknown``: those of unknown origin. ``measured``:
    how long starts have taken. ``orders`` are kept by a plan that replaces one role after another; the other strategies
    remove all first. The roles ``away`` do not run, and the plan leaves them so. ``said``: the values of those
    instances whose parameters are to be set. ``apart``: by role, the container that its last instance had left.
    ``taken``: the names of instances that may still run where nothing can be reached.
    """

    specification: Specification
    configuration: Configuration
    values: Mapping[str, Values]
    unknown: Mapping[str, Mapping[str, Origin]]
    measured: Mapping[str, Estimate]
    orders: Sequence[Order]
    away: Collection[str]
    said: Mapping[str, Values]
    apart: Mapping[str, str]
    taken: Collection[str]


@dataclass
class ChangePlanner:
    """Plans changes of a running system; ``others`` are the nodes of its processes that are not the system's."""

    system: RunningSystem
    client: ComponentClient
    monitor: SilenceMonitor
    journal: Journal
    others: OtherNodesWatch

    async def plan(self, request: PlanRequest) -> tuple[Plan, Specification]:
        """The plan for ``request`` from the current configuration, and its target. Raises PlanRefused.

        Also where nodes that are not meant would end with a process that the plan ends.
        """
        system = self.system
        values = system.values.by_role(system.configuration)
        unknown = system.values.unknown_by_role(system.configuration)
        instances, nodes = system.configuration.instances.items(), system.specification.nodes
        request = request.for_roles({name: live.role for name, live in instances if name not in nodes})
        specification = request.to or system.specification
        together = request.together(specification)
        apart = {role: name for role, name in system.apart.items() if role not in together}
        request = request.for_members(specification)
        measured = dict(self.journal.estimates)
        request, orders, remarks = with_stalled_first(request, system.configuration, self.monitor.undiscovering)
        away = [role for role in system.crashes if not system.has_instance(role)]
        away = [role for role in away if request.stays_away(role, system.specification)]
        said = await self._said([role for role, _ in request.parameters])
        taken = system.life.silent
        situation = _Situation(
            system.specification, system.configuration, values, unknown, measured, orders, away, said, apart, taken
        )
        unreachable = unknown_instances(self.others.backend, system.configuration)
        try:
            plan, target = await asyncio.to_thread(_search, request, situation)
        except PlanRefused as error:
            if not unreachable:
                raise
            raise PlanRefused("; ".join((str(error), *unreachable))) from None
        if (because := out_of_reach(self.others.backend, target)) is not None:
            raise PlanRefused(because)
        require_arbiters(plan)
        unseen = await require_unmanaged(plan, self.client)
        left = (f"{role} does not run, and this change does not start it: {system.remedy(role)}" for role in away)
        asked = ((old, system.life.latest(old)) for old in plan.change.replaced)
        unread = [
            unread_parameters(plan.change.instance(old), None if latest is None else latest.state)
            for old, latest in asked
        ]
        not_known = filter(None, unread)
        hung = hanging(system.life, map(plan.change.instance, plan.change.leaving))
        others = ending_nodes(plan, self.others.look())
        if not request.with_other_nodes and (refused := would_end_others(others)) is not None:
            raise PlanRefused(refused)
        handles = system.life.handles
        here = {name for name, instance in system.configuration.instances.items() if not instance.host}
        pids = {name: handle.pid for name, handle in handles.items() if handle.pid is not None and name in here}
        room = await asyncio.to_thread(lambda: tuple(room_for_copies(plan, pids)))
        states = system.life.latest_states
        # The endpoints that the running components with the API have besides their ports.
        endpoints = {name: self.client.endpoints(name) for name in system.configuration.instances}
        besides = (
            *lost_endpoints(plan, states, endpoints),
            *planned_transfers(plan, states),
            *names_after(plan, states),
            *nodes_that_will_end(plan, others),
            *(change_facts.management_not_seen(name, planned=True) for name in unseen),
        )
        in_turn = (*answered_in_turn(plan, states), *messages_in_turn(plan, states))
        remarks = (*remarks, *hung, *left, *unreachable, *not_known, *in_turn, *plan.remarks, *room)
        plan = with_time_for_goals(plan, with_goals(states, endpoints))
        plan = with_time_for_state(plan, {name for name, latest in states.items() if latest.state.keeps_state})
        live = system.configuration.instances_by_role
        times = with_times(plan.parameters, lambda role: system.values.set_at(next(iter(live.get(role, ())), "")))
        return replace(plan, remarks=remarks, besides=besides, parameters=times), target

    def ends_others(self, plan: Plan) -> str | None:
        """The reason why ``plan`` is refused, unless the other nodes that it ends are meant; None if there are none."""
        return would_end_others(ending_nodes(plan, self.others.look()))

    async def _said(self, roles: Iterable[str]) -> dict[str, Values]:
        """The parameters of the instances of ``roles``, by instance, as their nodes say them now.

        Raises PlanRefused for an unknown role, or one whose instance does not run or does not say them.
        """
        found: dict[str, Values] = {}
        for role in dict.fromkeys(roles):
            try:
                state = await self.client.peek(self.system.live_instance(role))
            except (BackendError, ManagerError) as error:
                raise PlanRefused(str(error)) from None
            if state.unread_parameters:
                raise PlanRefused(f"{state.instance} does not say its parameters: its parameter services do not answer")
            found[state.instance] = {name: from_json(value) for name, value in state.parameters.items()}
        return found


def _search(request: PlanRequest, now: _Situation) -> tuple[Plan, Specification]:
    specification, configuration = now.specification, now.configuration
    target, keep = request.target(specification), not request.declared_parameters
    if request.restore:
        return restore(configuration, specification, dict(request.restore), now.measured), target
    if request.parameters:
        return set_parameters(configuration, specification, request.parameters, now.said, now.measured), target
    planned = target
    if request.strategy == "minimal":
        planned = replace(target, constraints=(*target.constraints, *now.orders))
    if request.to is not None and not keep:
        configuration = _as_set(configuration, now.values)
    if request.to is None and len(request.roles()) == 1 and not request.half_done:
        change = requested_change(configuration, specification, request, planned, now.measured, now.apart, now.taken)
    else:
        renewed, same = request.renewed(planned), request.same_process
        change = change_between(
            configuration,
            specification,
            planned,
            now.measured,
            renewed,
            now.away,
            now.apart,
            same_process=same,
            taken=now.taken,
        )
    plan = planner(request.strategy, detours=request.detours)(change)
    parameters = of_change(plan.change, now.values, keep=keep, unknown=now.unknown)
    doubt = sensitivity(plan)
    return replace(
        plan, parameters=parameters, remarks=plan.remarks if doubt is None else (*plan.remarks, doubt)
    ), target


def _as_set(configuration: Configuration, values: Mapping[str, Values]) -> Configuration:
    """``configuration`` with the values that were set at run time, so that a plan sets them back in place.

    A parameter that the specification does not declare cannot be set by a plan: it keeps its value.
    """
    for role, found in values.items():
        for instance in configuration.instances_of(role):
            declared = {name: value for name, value in found.items() if name in instance.component.parameters}
            configuration = configuration.with_parameters(instance.name, declared)
    return configuration

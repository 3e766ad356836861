"""The comparison of what runs with the target, which makes a :class:`~midstride.plan.change.Change`.

Two ways to the same result: :func:`change_between` walks the whole system, :func:`change_of_roles` only the given
roles, so that its cost follows the change.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import count

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.action import contract_reasons
from midstride.model.best import best, rebalanced
from midstride.model.component import Connector, FunctionalityRef, ParameterValue, PortRef, SharedContainer, same_value
from midstride.model.configuration import Configuration, Instance, SystemContext
from midstride.model.instance_names import fresh_name
from midstride.model.name_checks import node_names
from midstride.model.rules import Violation, cap_violation, capacity_violation, violations
from midstride.model.specification import Specification
from midstride.plan.change import Change, PortAttachment
from midstride.plan.estimate import Estimate
from midstride.plan.host_moves import require_same_hosts
from midstride.plan.request import PlanRequest


def change_between(
    configuration: Configuration,
    specification: Specification,
    target: Specification,
    measured: Mapping[str, Estimate] | None = None,
    renewed: Collection[str] = (),
    away: Collection[str] = (),
    apart: Mapping[str, str] = Map(),
    *,
    same_process: bool = False,
    taken: Collection[str] = (),
) -> Change:
    """The change of the whole system to ``target``. Linear in the system.

    A role that has no live instance comes, but those ``away``; an instance of no role leaves. The roles ``renewed`` get
    a new instance even where nothing differs. ``apart``: by role that has none, the container that its last instance
    had left for a process for itself, which it gets again. ``taken``: names that no new instance gets, as what has them
    may still run, out of reach. Raises PlanRefused where either end does not meet the
    target's caps, capacities, environment or contracts.
    """
    require_same_hosts(configuration, specification, target)
    connectors, identities = _connectors(configuration, target)
    resources = configuration.context.resources.update(target.resources)
    start = configuration.with_context(SystemContext(connectors, target.environment, resources))
    way_out = "; apply first what keeps the new limit, with the limit as it is now, and then lower the limit"
    _check_limits("the running system", start, sorted(start.publishers), sorted(start.held), way_out)
    for violation in violations(start):
        raise PlanRefused(f"the running system is not valid in the target's environment: {violation}")
    raised = best(start)
    baseline = raised if start.context == configuration.context else best(configuration)
    builder = ChangeBuilder(specification, target, start, identities, renewed, apart, same_process, taken)
    for role in sorted({*target.nodes, *start.instances_by_role}.difference(away)):
        builder.compare(role)
    pending = tuple(sorted(ref for ref, index in raised.modes.items() if start.modes[ref] != index))
    lowered = tuple(sorted(ref for ref, index in baseline.modes.items() if start.modes[ref] != index))
    final = builder.final(pending)
    _check_limits("the target", final, sorted(final.publishers), sorted(final.held))
    return replace(
        builder.change(final, measured), origin=configuration, baseline=baseline, pending=pending, lowered=lowered
    )


def requested_change(
    configuration: Configuration,
    specification: Specification,
    request: PlanRequest,
    target: Specification,
    measured: Mapping[str, Estimate] | None = None,
    apart: Mapping[str, str] = Map(),
    taken: Collection[str] = (),
) -> Change:
    """The change that a request asks for; ``target`` is the specification that it leads to.

    The cost follows the change, unless the request concerns every role. ``apart`` as for :func:`change_between`. Raises
    PlanRefused.
    """
    renewed, same = request.renewed(target), request.same_process
    if request.to is not None or request.stops_everything:
        return change_between(
            configuration, specification, target, measured, renewed, apart=apart, same_process=same, taken=taken
        )
    roles = request.roles()
    return change_of_roles(
        configuration, specification, target, roles, measured, renewed, apart, same_process=same, taken=taken
    )


def change_of_roles(
    configuration: Configuration,
    specification: Specification,
    target: Specification,
    roles: Iterable[str],
    measured: Mapping[str, Estimate] | None = None,
    renewed: Collection[str] = (),
    apart: Mapping[str, str] = Map(),
    *,
    same_process: bool = False,
    taken: Collection[str] = (),
) -> Change:
    """The change where ``target`` differs from ``specification`` only in the nodes ``roles``.

    The cost follows the roles and their forward cone, not the size of the system. ``configuration`` must be in its
    best modes. ``apart`` and ``taken`` as for :func:`change_between`, which raises PlanRefused as this does.
    """
    builder = ChangeBuilder(specification, target, configuration, {}, renewed, apart, same_process, taken)
    for role in sorted(set(roles)):
        builder.compare(role)
    return builder.change(builder.final(()), measured)


class ChangeBuilder:
    """A change in the making, role by role."""

    def __init__(
        self,
        specification: Specification,
        target: Specification,
        start: Configuration,
        identities: dict[str, str],
        renewed: Collection[str],
        apart: Mapping[str, str],
        same_process: bool = False,
        taken: Collection[str] = (),
    ) -> None:
        self.specification, self.target, self.start, self.identities = specification, target, start, identities
        self.renewed, self.apart, self.same_process, self.taken = renewed, apart, same_process, taken
        self.leaving: list[str] = []
        self.coming: dict[str, Instance] = {}
        self.replaced: dict[str, str] = {}
        self.detached: list[PortAttachment] = []
        self.attached: list[PortAttachment] = []
        self.parameters: list[tuple[str, Map[str, ParameterValue]]] = []
        self.renamed: list[Instance] = []

    # -- one role --------------------------------------------------------------------------------------

    def compare(self, role: str) -> None:
        """Add what happens to one role: nothing, a change in place, a replacement, a removal or an addition."""
        running = self.start.instances_of(role)
        if role not in self.target.nodes:
            for instance in running:
                self._leave(instance)
            return
        if found := node_names(self.target, self.target.nodes[role], ("nodes", role)):
            raise PlanRefused("; ".join(str(problem) for problem in found))
        wanted = self.target.instance(role)
        candidates = [] if role in self.renewed else [each for each in running if not self._renamed_topics(each)]
        candidates = [each for each in candidates if not self._waits_behind_another(each, running)]
        kept = next((instance for instance in candidates if not _differs(instance, wanted)), None)
        if kept is not None:
            self._keep(kept, wanted)
        else:
            name = self._fresh(role, bare=not running)
            self.coming[name] = self.target.instance(role, name)
            self.attached.extend(self._wanted(role, name))
            if running:
                # After a failed roll-back there may be two: the topics are with one of them.
                old = max(running, key=lambda instance: len(self.start.attached_ports(instance.name)))
                if not (old.component.once or wanted.component.once):  # a program that ends hands nothing over
                    self.replaced[old.name] = name
        for instance in running:
            if instance is not kept:
                self._leave(instance)

    def _waits_behind_another(self, instance: Instance, running: Iterable[Instance]) -> bool:
        """Return whether another instance of the role publishes what ``instance`` is to publish, which has no output
        yet.

        So it is of one that a change has created which was left incomplete. It is not kept: a new one takes over from
        the other, in a hand-over.
        """
        wanted = self._publishes(self._wanted(instance.role, instance.name))
        published = {each.name: self._publishes(self.start.attached_ports(each.name)) for each in running}
        return not published[instance.name] and any(wanted & found for found in published.values())

    def _publishes(self, attachments: Iterable[PortAttachment]) -> set[str]:
        return {connector for port, connector in attachments if self.start.is_output(port)}

    def _renamed_topics(self, instance: Instance) -> bool:
        """Return whether the instance would get other topics, and has those that it was started with for good."""
        if instance.component.gate is None:
            return False
        want = {
            (port, self.target.connectors[key].topic)
            for port, key in self.target.attachments_of(instance.role, instance.name)
        }
        connectors = self.start.context.connectors
        return want != {(port, connectors[key].topic) for port, key in self.start.attached_ports(instance.name)}

    def _leave(self, instance: Instance) -> None:
        self.leaving.append(instance.name)
        self.detached.extend(self.start.attached_ports(instance.name))

    def _keep(self, instance: Instance, wanted: Instance) -> None:
        current = instance.parameters
        changed = {key: value for key, value in wanted.parameters.items() if not same_value(current.get(key), value)}
        if changed:
            self.parameters.append((instance.name, Map(changed)))
        container = instance.container
        if container is not None and wanted.container is not None:  # which may state other times
            container = replace(container, program=wanted.container.program)
        renamed = instance.component is not wanted.component and instance.component != wanted.component
        if renamed or container != instance.container:
            self.renamed.append(replace(instance, component=wanted.component, container=container))
        have = self.start.attached_ports(instance.name)
        want = self._wanted(instance.role, instance.name)
        self.detached.extend(pair for pair in have if pair not in want)
        self.attached.extend(pair for pair in want if pair not in have)

    def _wanted(self, role: str, instance: str) -> list[PortAttachment]:
        pairs = self.target.attachments_of(role, instance)
        return [(port, self.identities.get(connector, connector)) for port, connector in pairs]

    def _fresh(self, role: str, bare: bool) -> str:
        """The name of a new instance (docs/semantics.md section 6). Only a first instance gets the role's own."""
        used = (self.start.instances, self.coming, self.taken)
        if bare and not any(role in some for some in used):
            return role
        return fresh_name(role, *used, self.specification.nodes, self.target.nodes)

    def _choose_processes(self) -> None:
        """Say in which process of its container each new instance is.

        A replacement is beside the others for itself: it runs what its library has now, and may fail. An instance that
        replaces none joins those that stay, unless the one before it had left them. Where none stays, all the others
        are together again, in a new process. Where that is asked for, a replacement is in the process of the instance
        that it replaces. Raises PlanRefused where that would be other code, or no process of a container.
        """
        inside = self._in_their_processes() if self.same_process else {}
        containers = {
            each.container.name: each.container for each in self.coming.values() if each.container is not None
        }
        for name in containers:
            running = [each for each in self.start.instances.values() if each.container and each.container.name == name]
            stay = sorted(each.process for each in running if each.process and each.name not in self.leaving)
            taken = {each.process for each in running}
            known = (taken, self.start.instances, self.coming, self.target.nodes, self.target.containers)
            together = stay[0] if stay else name if name not in taken else fresh_name(name, *known)
            for instance in list(self.coming.values()):
                if instance.container is not None and instance.container.name == name:
                    alone = self.apart.get(instance.role) == name
                    alone |= bool(stay) and instance.name in self.replaced.values()
                    process = inside.get(instance.name, "" if alone else together)
                    self.coming[instance.name] = replace(instance, process=process)

    def _in_their_processes(self) -> dict[str, str]:
        """By replacement, the process that it is in with the instance that it replaces. Raises PlanRefused."""
        found = {}
        for before, after in self.replaced.items():
            old, new = self.start.instances[before], self.coming[after]
            if old.container is None and new.container is None:
                continue
            if not old.process:
                raise PlanRefused(f"{before} has a process for itself: nothing else can be started in that")
            if _code(old) != _code(new) or not _loaded_alike(old.container, new.container):
                raise PlanRefused(
                    f"{after} cannot start in {old.process}, the process of {before}: its class or its container is "
                    "another one"
                )
            found[after] = old.process
        if not found:
            raise PlanRefused("no node of a container is replaced, so none can stay in its process")
        return found

    # -- all roles together ----------------------------------------------------------------------------

    def final(self, pending: Iterable[FunctionalityRef]) -> Configuration:
        """The final configuration, in its best modes, given that ``pending`` could be in better modes at the start.

        Raises PlanRefused for a target that is impossible.
        """
        self._choose_processes()
        configuration = self.start
        seeds: dict[FunctionalityRef, None] = dict.fromkeys(pending)
        for port, connector in self.detached:
            _add_users(configuration, port, seeds)
            configuration = configuration.without_attachment(port, connector)
        for name in self.leaving:
            configuration = configuration.without_instance(name)
        for instance in self.coming.values():
            configuration = configuration.with_instance(instance)
            seeds.update(dict.fromkeys(instance.functionality_refs()))
        for port, connector in self.attached:
            if reasons := contract_reasons(configuration, port, configuration.context.connectors[connector]):
                raise PlanRefused(f"{port} cannot be attached to {connector}: {reasons[0]}")
            configuration = configuration.with_attachment(port, connector)
            _add_users(configuration, port, seeds)
        for name, parameters in self.parameters:
            configuration = configuration.with_parameters(name, parameters)
        for connector in dict.fromkeys(connector for _, connector in [*self.detached, *self.attached]):
            seeds.update(dict.fromkeys(configuration.consumers(connector)))
        live = (ref for ref in seeds if ref.instance in configuration.instances)
        final = configuration.with_modes(rebalanced(configuration, live))
        resources = dict.fromkeys(r for instance in self.coming.values() for r in instance.resource_usage)
        connectors = dict.fromkeys(connector for _, connector in self.attached)
        _check_limits("the target", final, connectors, resources)
        return final

    def change(self, final: Configuration, measured: Mapping[str, Estimate] | None) -> Change:
        """The change, from a start in its best modes and its original context."""
        return Change(
            specification=self.specification,
            target=self.target,
            origin=self.start,
            start=self.start,
            baseline=self.start,
            final=final,
            leaving=tuple(self.leaving),
            coming=tuple(self.coming.values()),
            replaced=Map(self.replaced),
            detached=tuple(self.detached),
            attached=tuple(self.attached),
            parameters=tuple(self.parameters),
            identities=Map(self.identities),
            renamed=tuple(self.renamed),
            measured=Map(measured or {}),
        )


def _add_users(configuration: Configuration, port: PortRef, seeds: dict[FunctionalityRef, None]) -> None:
    """Add the functionalities that use an input to the seeds; an output's consumers are found by topic."""
    if not configuration.is_output(port):
        seeds.update(dict.fromkeys(configuration.users(port)))


def _differs(instance: Instance, wanted: Instance) -> bool:
    """Return whether ``instance`` must be replaced to become ``wanted`` (docs/semantics.md section 6)."""
    if instance.component is not wanted.component and not instance.component.same_body(wanted.component):
        return True
    current = instance.parameters
    if set(current) != set(wanted.parameters) or instance.sections != wanted.sections:
        return True
    if instance.host != wanted.host or not _loaded_alike(instance.container, wanted.container):
        return True
    declared, asked = instance.component.parameters, wanted.component.parameters
    return any(
        not same_value(current[name], value)
        and not (name in declared and declared[name].changeable and name in asked and asked[name].changeable)
        for name, value in wanted.parameters.items()
    )


def _code(instance: Instance) -> tuple[str, str | None]:
    """The class and the package of a composable node."""
    return (instance.component.run or "").partition(" ")[0], instance.component.package


def _loaded_alike(one: SharedContainer | None, other: SharedContainer | None) -> bool:
    """Return whether both are in one container, whatever else that loads now."""
    if one is None or other is None:
        return one is other
    return one.name == other.name and one.program.same_process(other.program)


def _check_limits(
    end: str, configuration: Configuration, connectors: Iterable[str], resources: Iterable[str], way_out: str = ""
) -> None:
    """Refuse an end of the change that exceeds a cap or a capacity."""
    found: list[Violation | None] = [cap_violation(configuration, name) for name in connectors]
    found += [capacity_violation(configuration, name) for name in resources]
    for violation in found:
        if violation is not None:
            raise PlanRefused(f"{end} exceeds a limit: {violation}{way_out}")


def _connectors(configuration: Configuration, target: Specification) -> tuple[Map[str, Connector], dict[str, str]]:
    """The connectors that exist during the plan, and the identities of topics whose contract changes while in use."""
    running = configuration.context.connectors
    identities: dict[str, str] = {}
    throughout = running.update(target.connectors)
    for name in sorted(target.connectors):
        wanted, current = target.connectors[name], running.get(name)
        in_use = configuration.publishers_on(name) or configuration.subscribers_on(name)
        if current is None or current.same_contract(wanted) or not in_use:
            continue
        identity = next(free for number in count(2) if (free := f"{name}@{number}") not in throughout)
        identities[name] = identity
        throughout = throughout.set(name, current).set(identity, replace(wanted, name=identity))
    return throughout, identities

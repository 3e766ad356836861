"""The hosts on which a back end can start processes."""

from __future__ import annotations

from collections.abc import Container, Mapping

from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.action import Create
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification
from midstride.plan.plan import Plan
from midstride.runtime.backend_protocol import Backend, Handle


def out_of_reach(backend: Backend, specification: Specification) -> str | None:
    """The reason why nothing of a specification is started: its nodes on hosts that the back end does not reach."""
    elsewhere = {role: node.host for role, node in sorted(specification.nodes.items()) if node.host}
    if backend.reaches_hosts or not elsewhere:
        return None
    nodes = ", ".join(f"{role} on {host}" for role, host in elsewhere.items())
    return (
        f"the back end {backend.name} starts processes on the host of the manager alone, so nothing is started: {nodes}"
    )


def unreached(backend: Backend) -> dict[str, str]:
    """By host that cannot be reached now: why, and what to do."""
    return {each.host: each.problem for each in backend.host_links() if each.problem is not None}


def unknown_instances(backend: Backend, configuration: Configuration) -> list[str]:
    """Say of which instances nothing is known, since their host cannot be reached now."""
    found = []
    for host, because in sorted(unreached(backend).items()):
        names = sorted(name for name, each in configuration.instances.items() if each.host == host)
        if names:
            found.append(f"nothing is known of {', '.join(names)} now: host {host} cannot be reached: {because}")
    return found


def require_reached(
    backend: Backend,
    plan: Plan,
    configuration: Configuration,
    left: Mapping[str, Handle] = Map(),
    silent: Container[str] = (),
) -> None:
    """Raises PlanRefused where a step of ``plan`` changes an instance on a host that cannot be reached now.

    Nothing is known of that instance, so the change could be neither carried out nor rolled back. ``left``: by role, an
    instance that could not be ended on its host, and may run there: nothing takes its place before. ``silent``:
    instances whose lease is over, which may run there too, with their names.
    """
    for step in plan.steps:
        if isinstance(step.action, Create) and (name := step.action.instance.name) in silent:
            raise PlanRefused(f"{name} cannot be started now: another process of that name may run where it was before")
        if isinstance(step.action, Create) and (handle := left.get(step.action.instance.role)) is not None:
            raise PlanRefused(
                f"{step.action.instance.role} cannot be started now: {handle.instance} could not be ended, and may run "
                f"on host {handle.host}; it is ended once that can be reached"
            )
    lost = unreached(backend)
    for host, name in needed_hosts(plan, configuration).items():
        if host in lost:
            raise PlanRefused(
                f"{name} cannot be changed now: host {host} cannot be reached: {lost[host]}; if it is switched off "
                f"or destroyed, `midstride dead {host}` says so"
            )


def needed_hosts(plan: Plan, configuration: Configuration) -> dict[str, str]:
    """The hosts of what the steps of ``plan`` change, each with the role of the first instance there."""
    needed: dict[str, str] = {}
    actions = [step.action for step in plan.steps]
    created = {action.instance.name: action.instance for action in actions if isinstance(action, Create)}
    instances = {**configuration.instances, **created}
    for action in actions:
        for name in action.instances():
            if name in instances and (host := instances[name].host):
                needed.setdefault(host, instances[name].role)  # the instance may not run yet
    return needed

"""Checks of a node's restart policy: its numbers, and whether it can be carried out.

Part of :mod:`midstride.model.specification_checks`. Names without a declaration are skipped here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from midstride.model.component import ComponentSpec, PortRef
from midstride.model.component_rules import number_problems
from midstride.model.contract import format_number
from midstride.model.diagnostics import Problem, SubjectPath
from midstride.model.host_checks import placement_problems
from midstride.model.hosts import host_in_words
from midstride.model.name_checks import missing_for_constraints
from midstride.model.respawn import SHORTEST_LEASE, RespawnPolicy
from midstride.model.rules import attachment_shortfall
from midstride.model.specification import Node, Specification


def respawn_problems(specification: Specification, node: Node, path: SubjectPath) -> Iterator[Problem]:
    """The problems of the restart policy of ``node``, if it has one."""
    policy, component = node.respawn, specification.components.get(node.component)
    if policy is None:
        return
    yield from number_problems(policy.delay, "the delay of a restart", (*path, "delay_seconds"), zero=True)
    yield from number_problems(policy.max_delay, "the longest delay", (*path, "max_delay_seconds"), zero=True)
    yield from number_problems(policy.max_retries, "the number of restarts", (*path, "max_retries"), zero=True)
    yield from number_problems(policy.window, "the time in which restarts count", (*path, "window_seconds"))
    if policy.max_delay is not None and policy.max_delay < policy.delay:
        delay, longest = (format_number(seconds) for seconds in (policy.delay, policy.max_delay))
        message = f"the longest delay of {node.role}, {longest} s, is shorter than the first one, {delay} s"
        yield Problem("E026", (*path, "max_delay_seconds"), message, f"write at least {delay} s")
    if component is not None and component.run is None:
        message = f"{node.role} cannot be restarted: component {component.name} has no `run` command"
        yield Problem("E026", path, message, "remove `respawn`; what has started the node has to restart it")
    yield from _lease_problems(node, policy, component, path)
    if policy.fallback is not None and policy.max_retries is None and not policy.is_leased(node.host):
        message = f"{node.role} never falls back to {policy.fallback}: its restarts are unlimited"
        yield Problem("E026", (*path, "fallback"), message, "state how many, or omit `respawn_fallback`")
    fallback = None if policy.fallback is None else specification.components.get(policy.fallback)
    if fallback is None:
        return
    if not policy.falls_back_from(node.component, node.host):
        where = "" if policy.fallback_host is None else f" on {host_in_words(node.host)}, where it is"
        message = f"the fallback of {node.role} is {node.component}, the component that it has{where}"
        yield Problem("W035", (*path, "fallback"), message, "name another component, or another host")
        return
    if policy.fallback_host == node.host:
        message = f"the fallback of {node.role} is on {host_in_words(node.host)}, where it is"
        yield Problem("W035", (*path, "fallback_host"), message, "name another host, or omit it")
    for fault in _faults(specification, node, fallback):
        message = f"{fallback.name} cannot replace {node.role}: {fault}"
        help = "name a component that fits the node's topics and constraints"
        yield Problem("E026", (*path, "fallback"), message, help)


def _lease_problems(
    node: Node, policy: RespawnPolicy, component: ComponentSpec | None, path: SubjectPath
) -> Iterator[Problem]:
    """A lease that is too short, or that the node cannot keep."""
    yield from number_problems(policy.lease, "the lease of a node", (*path, "lease_seconds"))
    if policy.lease is not None and policy.fallback_host is None:
        message = f"{node.role} needs no lease: its fallback is on its own host"
        yield Problem("E026", (*path, "lease_seconds"), message, "name the host of the fallback, or omit the lease")
    elif policy.lease is not None and 0 < policy.lease < SHORTEST_LEASE:
        message = f"the lease of {node.role}, {format_number(policy.lease)} s, may be over while a message is only late"
        yield Problem("E026", (*path, "lease_seconds"), message, f"write at least {format_number(SHORTEST_LEASE)} s")
    if not policy.leaves(node.host):
        return
    if node.container is not None:
        message = f"the fallback of {node.role} is on another host, and its container {node.container} is not"
        yield Problem("E026", (*path, "fallback_host"), message, "omit the host, or take the node out of its container")
    if component is None or component.keeps_lease or not policy.is_leased(node.host):
        return
    why = "it has a server, which would answer besides"
    if component.gate is not None:
        why = f"component {component.name} does not use Midstride's API (`gate {component.gate}`)"
    message = (
        f"{node.role} cannot keep a lease, so nothing may take its place while {host_in_words(node.host)} "
        f"cannot be reached: {why}"
    )
    yield Problem("E026", (*path, "fallback_host"), message, "omit the host of the fallback")


def _faults(specification: Specification, node: Node, fallback: ComponentSpec) -> Iterator[str]:
    if fallback.run is None:
        yield "it has no `run` command"
    for port, topics in sorted(node.attachments.items()):
        if port not in fallback.ports():
            yield f"it has no port {port}"
            continue
        owner = fallback.find_owner(port)
        if fallback.has_output(port) and (owner is None or not owner.modes):
            continue  # reported already
        for topic in topics:
            if (connector := specification.connectors.get(topic)) is not None:
                shortfall, clauses = attachment_shortfall(fallback, PortRef(node.role, port), connector)
                if clauses:
                    yield f"{shortfall}: {', '.join(clauses)}"
    reported = missing_for_constraints(specification, node.role)
    replaced = specification.with_replaced(node.role, fallback.name)
    for missing in missing_for_constraints(replaced, node.role):
        if missing not in reported:
            yield missing
    host = None if node.respawn is None else node.respawn.fallback_host
    if host is not None:
        moved = replace(replaced.nodes[node.role], host=host)
        yield from (problem.message for problem in placement_problems(specification, moved, ()) if not node.container)

"""Lifecycle managers in launch files: each goes on with its nodes, or Midstride manages them, without it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from midstride.launch_files.findings import ImportFindings
from midstride.launch_files.launched_nodes import LaunchedNode
from midstride.launch_files.launched_parameters import LaunchedParameters
from midstride.model.lifecycle_management import AUTOSTART, BOND_TIMEOUT, Management, has_bonds, managed_nodes


@dataclass(frozen=True, slots=True)
class ManagedLifecycle:
    """The nodes of a system, and the roles that follow each other in the order of a manager that Midstride replaces."""

    nodes: list[LaunchedNode]
    orders: tuple[tuple[LaunchedNode, LaunchedNode], ...] = ()


def with_one_manager(
    nodes: Sequence[LaunchedNode],
    parameters: Mapping[str, LaunchedParameters],
    management: Management,
    findings: ImportFindings,
) -> ManagedLifecycle:
    """Return the nodes, each managed by a lifecycle manager or by Midstride. ``parameters``: by role.

    Where Midstride is asked for, it takes the place of each manager of which all nodes are here.
    """
    kept, here, orders = {node.role: node for node in nodes}, {node.role for node in nodes}, []
    by_managers: set[str] = set()
    for node in nodes:
        effective = parameters[node.role].effective
        roles = [name.strip("/") for name in managed_nodes(f"/{node.role}", effective)]
        if not roles:
            continue
        managed, away = [role for role in roles if role in here], [role for role in roles if role not in here]
        if not managed:
            continue
        takes_over = management == "midstride" and not away
        for role in managed:
            kept[role] = replace(kept[role], gate="lifecycle preload" if takes_over else "preload")
        if takes_over:
            del kept[node.role]
            orders += [(kept[one], kept[other]) for one, other in pairwise(managed) if kept[one].at == kept[other].at]
        words = "; ".join(_words(node.role, managed, away, effective, management))
        findings.add("lifecycle", words, node.span, left_out=False)
        by_managers |= set(managed)
    for node in nodes:
        if node.state and node.role not in by_managers:
            findings.add("lifecycle", _unmanaged(node), node.span, left_out=False)
    return ManagedLifecycle(list(kept.values()), tuple(orders))


def _unmanaged(node: LaunchedNode) -> str:
    """Say what becomes of a lifecycle node that no manager of the launch file manages."""
    if node.state == "active":
        return f"launch activates `{node.role}` by events; here Midstride does, and manages its lifecycle"
    what = f"the launch file leaves `{node.role}` {node.state}; here Midstride activates it at its start"
    return f"{what}: write `gate preload` where something else manages its lifecycle"


def _words(
    manager: str, managed: Sequence[str], away: Sequence[str], parameters: Mapping[str, object], asked: Management
) -> Iterator[str]:
    they = ", ".join(f"`{role}`" for role in managed)
    if asked == "midstride" and not away:
        yield f"`{manager}` is left out: Midstride manages the lifecycle of {they}, as asked for"
        if not parameters[AUTOSTART]:
            yield f"`{AUTOSTART}` is false, and here they are active from the start"
        return
    yield f"`{manager}` manages the lifecycle of {they}, and goes on with it"
    if away:
        others = ", ".join(f"`{role}`" for role in away)
        yield f"it manages {others} as well, which {'is' if len(away) == 1 else 'are'} not here"
    if has_bonds(parameters):
        unless = "" if BOND_TIMEOUT in parameters else f", unless it has none: state `{BOND_TIMEOUT} = 0.0` then"
        what = "it has a bond with each and deactivates all when one breaks, so none can be replaced while it runs"
        yield f"{what}{unless}"
    if not away:
        yield "with `--lifecycle midstride`, Midstride manages them, without it"

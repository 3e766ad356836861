"""Which hosts a back end can start processes on."""

from __future__ import annotations

from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Backend


def out_of_reach(backend: Backend, specification: Specification) -> str | None:
    """Why nothing of a specification is started: its nodes on other hosts, where the back end reaches none."""
    elsewhere = {role: node.host for role, node in sorted(specification.nodes.items()) if node.host}
    if backend.reaches_hosts or not elsewhere:
        return None
    nodes = ", ".join(f"{role} on {host}" for role, host in elsewhere.items())
    return (
        f"the back end {backend.name} starts processes on the host of the manager alone, so nothing is started: {nodes}"
    )

"""The parts of a view that differ between two configurations."""

from __future__ import annotations

from midstride.model.configuration import Configuration


def changed_parts(before: Configuration, after: Configuration) -> tuple[set[str], set[str]]:
    """The instances and the connectors whose entries may differ between two configurations.

    Values that they share are one object, so that comparing them costs next to nothing.
    """
    instances = {
        name
        for name in {*before.instances, *after.instances}
        if before.instances.get(name) is not after.instances.get(name)
    }
    connectors: set[str] = set()
    if before.context is not after.context:
        connectors |= {*before.context.connectors, *after.context.connectors}
    if before.modes is not after.modes:
        raised = {ref for ref in {*before.modes, *after.modes} if before.modes.get(ref) != after.modes.get(ref)}
        instances |= {ref.instance for ref in raised}
        live = [ref for ref in raised if ref.instance in after.instances]
        connectors |= {connector for ref in live for _, connector in after.published(ref)}
    for former, latter in ((before.publishers, after.publishers), (before.subscribers, after.subscribers)):
        if former is latter:
            continue
        for name in {*former, *latter}:
            ports, later = former.get(name), latter.get(name)
            if ports is not later:
                connectors.add(name)
                instances |= {port.instance for port in {*(ports or ())} ^ {*(later or ())}}
    return instances, connectors

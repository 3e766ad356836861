"""Whether two reports, or two entries, of a component differ in more than measured figures."""

from __future__ import annotations

from operator import attrgetter
from typing import Final

from midstride.model.configuration import SystemContext
from midstride.server.view.view_forms import ComponentView
from midstride.wire.state import ComponentState, LinkState

_NO_LINKS: Final[dict[str, LinkState]] = {}
_others = attrgetter(*(name for name in ComponentView.__struct_fields__ if name != "ports"))


def same_report(before: ComponentState | None, state: ComponentState) -> bool:
    """Whether a component reports the same as before, but for figures, times, and what :func:`same_values` compares.

    Called for every report, so it must be cheap.
    """
    if before is None or before.uuid != state.uuid:
        return False
    modes, ports = before.functionalities, before.ports
    if len(modes) != len(state.functionalities) or len(ports) != len(state.ports):
        return False
    for name, functionality in state.functionalities.items():
        earlier = modes.get(name)
        if (
            earlier is None
            or earlier.mode != functionality.mode
            or earlier.reflex != functionality.reflex
            or functionality.since < earlier.since
        ):
            return False
    for name, links in state.ports.items():
        former = ports.get(name)
        if former is None or len(former) != len(links):
            return False
        for topic, link in links.items():
            known = former.get(topic)
            if known is None or known.gate != link.gate:
                return False
    return (before.waiting, before.node, before.differences, before.undeclared) == (
        state.waiting,
        state.node,
        state.differences,
        state.undeclared,
    )


def same_values(before: ComponentState | None, state: ComponentState) -> bool:
    """Whether the parameters have the same values, and modes that last the same reasons."""
    if before is None or before.parameters != state.parameters or before.declared != state.declared:
        return False
    reasons = before.functionalities
    return all(each.because == reasons[name].because for name, each in state.functionalities.items() if name in reasons)


def rates_as_shown(shown: ComponentView, state: ComponentState, context: SystemContext) -> bool:
    """Whether the declared rates are met or not as the entry says."""
    for port in shown.ports:
        if port.declared is None or port.topic is None or port.topic not in context.connectors:
            continue
        link = state.ports.get(port.name, _NO_LINKS).get(context.connectors[port.topic].topic)
        measured = None if link is None else link.measured
        if port.met != (None if measured is None else measured.meets(port.declared)):
            return False
    return True


def same_but_figures(before: ComponentView, view: ComponentView) -> bool:
    """Whether nothing but measured figures of ports differs. Whether a declared rate is met is no figure."""
    if len(before.ports) != len(view.ports):
        return False
    for earlier, port in zip(before.ports, view.ports, strict=True):
        if earlier is not port and (earlier.name, earlier.topic, earlier.gate, earlier.declared, earlier.met) != (
            port.name,
            port.topic,
            port.gate,
            port.declared,
            port.met,
        ):
            return False
    return bool(_others(before) == _others(view))

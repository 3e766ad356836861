"""Comparisons of two reports, or two entries, of an instance: do they differ in more than measurements?"""

from __future__ import annotations

from operator import attrgetter
from typing import Final

from midstride.model.configuration import SystemContext
from midstride.runtime.records.status_forms import InstanceStatus
from midstride.wire.state import ComponentState, LinkState

_NO_LINKS: Final[dict[str, LinkState]] = {}
# What is not measured: of a report, of the entry of a port, and of the entry of an instance but for its ports.
_of_component = attrgetter("waiting", "node", "answers", "differences", "undeclared")
_of_port = attrgetter("name", "topic", "gate", "declared", "met", "kept_out")
_others = attrgetter(*(name for name in InstanceStatus.__struct_fields__ if name != "ports"))


def reports_differ_in_measurements_only(before: ComponentState | None, state: ComponentState) -> bool:
    """Return whether nothing in a report is new but measurements and times.

    What :func:`same_parameters_and_reasons` compares is left out.

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
            if known is None or known.gate != link.gate or known.kept_out != link.kept_out:
                return False
    return bool(_of_component(before) == _of_component(state))


def same_parameters_and_reasons(before: ComponentState | None, state: ComponentState) -> bool:
    """Return whether the parameters have the same values, and modes that last the same reasons."""
    if before is None or before.parameters != state.parameters or before.declared != state.declared:
        return False
    reasons = before.functionalities
    return all(each.because == reasons[name].because for name, each in state.functionalities.items() if name in reasons)


def rates_met_as_shown(shown: InstanceStatus, state: ComponentState, context: SystemContext) -> bool:
    """Return whether the declared rates are met or not as the entry says."""
    for port in shown.ports:
        if port.declared is None or port.topic is None or port.topic not in context.connectors:
            continue
        link = state.ports.get(port.name, _NO_LINKS).get(context.connectors[port.topic].topic)
        measured = None if link is None else link.measured
        if port.met != (None if measured is None else measured.meets(port.declared)):
            return False
    return True


def entries_differ_in_measurements_only(before: InstanceStatus, view: InstanceStatus) -> bool:
    """Return whether nothing but measurements of ports differs. Whether a declared rate is met is none."""
    if len(before.ports) != len(view.ports):
        return False
    for earlier, port in zip(before.ports, view.ports, strict=True):
        if earlier is not port and _of_port(earlier) != _of_port(port):
            return False
    return bool(_others(before) == _others(view))

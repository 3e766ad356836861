"""Whether two reports, or two entries, of a component differ in more than measured figures."""

from __future__ import annotations

from midstride.server.view.forms import ComponentView
from midstride.wire.state import ComponentState

# By how much (s) the time in a mode may differ from the time between two reports.
_SAME_MODE = 0.5


def same_report(before: ComponentState | None, state: ComponentState) -> bool:
    """Whether a component reports the same as before, but for counts, figures and the time that has passed.

    A functionality that is not in its best mode may be about to be restored, which reports do not say: it is not the
    same. Called for every report, so it must be cheap.
    """
    if before is None or before.uuid != state.uuid:
        return False
    if before.functionalities.keys() != state.functionalities.keys() or before.ports.keys() != state.ports.keys():
        return False
    for name, functionality in state.functionalities.items():
        earlier = before.functionalities[name]
        if (earlier.mode, earlier.because, earlier.reflex) != (
            functionality.mode,
            functionality.because,
            functionality.reflex,
        ) or functionality.since < earlier.since:
            return False
    for name, links in state.ports.items():
        former = before.ports[name]
        if former.keys() != links.keys():
            return False
        for topic, link in links.items():
            if former[topic].gate != link.gate:
                return False
    return (before.waiting, before.node, before.parameters, before.declared, before.differences, before.undeclared) == (
        state.waiting,
        state.node,
        state.parameters,
        state.declared,
        state.differences,
        state.undeclared,
    )


def same_but_figures(before: ComponentView, view: ComponentView) -> bool:
    """Whether nothing but measured figures of ports differs. Whether a declared rate is met is no figure."""
    if len(before.ports) != len(view.ports):
        return False
    for earlier, port in zip(before.ports, view.ports, strict=True):
        if (earlier.name, earlier.topic, earlier.gate, earlier.declared, earlier.met) != (
            port.name,
            port.topic,
            port.gate,
            port.declared,
            port.met,
        ):
            return False
    return all(getattr(before, name) == getattr(view, name) for name in _OTHERS)


_OTHERS = [name for name in ComponentView.__struct_fields__ if name != "ports"]

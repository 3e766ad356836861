"""The services, ROS actions and topics of a component's node that are no ports."""

from __future__ import annotations

from collections.abc import Sequence

from midstride.model.configuration import Instance
from midstride.model.graph_names import resolved
from midstride.runtime.process.registration import REPORTED
from midstride.server.view.view_forms import EndpointView
from midstride.wire.state import ComponentState, Endpoint


def endpoint_views(
    instance: Instance, state: ComponentState | None, reported: Sequence[Endpoint]
) -> list[EndpointView]:
    """What the component of ``instance`` allows; which end its node has is known where it has ``reported`` that.

    A node with others is refused when it starts, so these are all.
    """
    if not instance.component.allows:
        return []
    node = instance.role if state is None or state.node is None else state.node
    ends = {(endpoint.kind, endpoint.name): endpoint.serves for endpoint in reported}
    found = {(REPORTED[each.kind], resolved(each.name, node)) for each in instance.component.allows}
    return [EndpointView(kind=kind, name=name, serves=ends.get((kind, name))) for kind, name in sorted(found)]

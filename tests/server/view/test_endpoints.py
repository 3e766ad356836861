"""Services, ROS actions and topics that are no ports, and hosts, in the entries of the live view."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from midstride.model.component import ComponentSpec, NodeEndpoint
from midstride.model.configuration import Instance
from midstride.runtime.records.status_forms import EndpointStatus
from midstride.runtime.view import instance_status
from midstride.runtime.view.instance_status import endpoints
from midstride.wire.state import THIS_HOST, ComponentState, Endpoint
from tests.server.view.support import Viewed, viewed
from tests.wire.bare_state import bare_state

ALLOWS = (
    NodeEndpoint("topic", "/tf"),
    NodeEndpoint("service", "~/reset"),
    NodeEndpoint("service", "save"),
    NodeEndpoint("action", "/dock"),
)
INSTANCE = Instance("front/arm_2", "front/arm", replace(ComponentSpec.of("Arm"), allows=ALLOWS))


def state(node: str | None) -> ComponentState:
    return bare_state("front/arm_2", pid=7, node=node)


def test_names_are_resolved_and_the_end_is_the_one_that_the_node_reported() -> None:
    reported = [
        Endpoint(kind="service", name="/front/arm/reset", serves=True),
        Endpoint(kind="ROS action", name="/dock", serves=False),
    ]
    assert endpoints(INSTANCE, state("/front/arm"), reported) == [
        EndpointStatus(kind="ROS action", name="/dock", serves=False),
        EndpointStatus(kind="service", name="/front/arm/reset", serves=True),
        EndpointStatus(kind="service", name="/front/save", serves=None),
        EndpointStatus(kind="topic", name="/tf", serves=None),
    ]


def test_private_names_are_those_of_the_node_as_it_is_called() -> None:
    """On ROS 1 it has the name of its instance; a component that does not answer, that of its role."""
    assert endpoints(INSTANCE, state("/front/arm_2"), [])[1].name == "/front/arm_2/reset"
    assert endpoints(INSTANCE, None, [])[1].name == "/front/arm/reset"


def test_a_component_without_others_has_none() -> None:
    assert endpoints(Instance("arm", "arm", ComponentSpec.of("Arm")), None, []) == []


@pytest.mark.parametrize("elsewhere", [False, True])
def test_the_host_is_named_where_it_is_not_the_managers(
    elsewhere: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(system: Viewed) -> None:
        await asyncio.sleep(1)
        assert system.component("listener")["host"] == (THIS_HOST if elsewhere else None)

    if elsewhere:
        monkeypatch.setattr(instance_status, "THIS_HOST", "base-station")
    viewed("talker", tmp_path, body)

"""Who publishes or listens on a topic of the system without a port there: the status names these nodes."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import Unreachable
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Endpoints
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import OtherEndpoints
from tests.runtime.systems import managed


def test_a_listener_outside_is_named_where_no_port_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        asked: list[Collection[str] | None] = []

        async def endpoints(topics: Collection[str] | None = None) -> Endpoints:
            asked.append(topics)
            return Endpoints(publishers=(("/talker", "/chatter"),), subscribers=(("/rviz", "/chatter"),))

        monkeypatch.setattr(simulator, "endpoints", endpoints)
        [topic] = (await manager.status()).topics
        assert (topic.others, asked) == (None, [])  # both have ports
        assert (await manager.change(PlanRequest(remove=("listener",)))).outcome == "done"
        [topic] = (await manager.status()).topics
        assert (topic.subscribers, asked) == ([], [["/chatter"]])
        assert topic.others == OtherEndpoints(publishers=[], subscribers=["/rviz"])

        async def unreachable(topics: Collection[str] | None = None) -> Endpoints:
            raise Unreachable("the master does not answer")

        monkeypatch.setattr(simulator, "endpoints", unreachable)
        [topic] = (await manager.status()).topics
        assert topic.others is None

    managed("talker", tmp_path, body)


def test_the_graph_of_the_simulator_can_be_asked_for_single_topics(tmp_path: Path) -> None:
    async def body(_: Manager, simulator: Simulator) -> None:
        assert (await simulator.endpoints(["/chatter"])).subscribers == (("/listener", "/chatter"),)
        assert await simulator.endpoints(["/other"]) == Endpoints(nodes=(await simulator.endpoints()).nodes)

    managed("talker", tmp_path, body)

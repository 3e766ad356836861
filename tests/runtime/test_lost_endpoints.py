"""What ends with a node besides its ports, as plan and report name it: services, goals, topics that both write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.plan.request import PlanRequest
from midstride.runtime.change.lost_endpoints import lost_endpoints
from midstride.runtime.instance_life import LatestState
from midstride.runtime.manager import Manager
from midstride.verdicts import Assessments
from midstride.wire.state import ComponentState, Endpoint, UndeclaredTopic
from tests.runtime.systems import managed

GOALS = [
    Endpoint(kind="ROS action", name="/dock", serves=True),
    Endpoint(kind="ROS action", name="/pick", serves=False),
    Endpoint(kind="service", name="/reset", serves=True),
]


def test_plan_and_report_name_the_goals_of_a_component_with_the_api(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        monkeypatch.setattr(manager._client, "endpoints", lambda name: GOALS if name == "talker" else [])
        plan = await manager.plan(PlanRequest(restart=("talker",)))
        assert [each.words for each in plan.besides] == [
            "goals of others that are under way at ROS action /dock: they end with talker",
            "goals that talker has sent to ROS action /pick: they go on when it ends, and it gets no result",
        ]
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        assert isinstance(outcome.continuity, Assessments) and outcome.continuity.verdict == "not_measurable"
        assert [each.words for each in outcome.continuity.found] == [
            "goals of others that are under way at ROS action /dock: they ended with talker",
            "goals that talker has sent to ROS action /pick: they went on, and it got no result",
        ]

    managed("talker", tmp_path, body)


def test_of_a_node_without_the_api_the_graph_says_it_once_it_has_been_asked(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        plan = await manager.plan(PlanRequest(restart=("talker",)))

        def said(**seen: Any) -> list[str]:
            state = ComponentState(
                instance="talker",
                uuid="",
                pid=1,
                revision=1,
                functionalities={},
                ports={},
                parameters={},
                stopping=0.0,
                node="/talker",
                **seen,
            )
            return [each.words for each in lost_endpoints(plan, {"talker": LatestState(state, 0.0)}, {})]

        assert said() == []
        assert said(looked=False) == ["what others rely on of talker besides its ports: it had just been started"]
        found = said(
            serves=["service /save"],
            calls=["ROS action /pick"],
            undeclared=[
                UndeclaredTopic(output=output, topic=topic, type="x")
                for output, topic in ((True, "/diag"), (True, "/talker/own"), (False, "/scan"))
            ],
        )
        assert [words.partition(":")[0] for words in found] == [
            "requests and goals of others",
            "which instance writes on /diag",
            "goals that talker has sent to ROS action /pick",
        ]

    managed("talker", tmp_path, body)

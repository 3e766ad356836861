"""State travels where a role is replaced, and nowhere else (semantics.md section 7)."""

from __future__ import annotations

from dataclasses import replace as changed
from pathlib import Path

from midstride.backends.simulator import Simulator
from midstride.model.specification import Node
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.reports import Outcome
from tests.runtime.systems import last_said, managed, stateful_talkers


def test_a_topic_handed_on_to_another_role_takes_no_state_along(tmp_path: Path) -> None:
    """The topic is full, so the one that comes takes over from the one that goes: two roles, two states."""
    start = stateful_talkers(tmp_path)
    full = start.connectors.set("/chatter", changed(start.connectors["/chatter"], max_publishers=1))
    start = changed(start, connectors=full)
    target = start.without_node("talker").with_node(Node("other", "NewTalker", start.nodes["talker"].attachments))
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, str]:
        outcome = await manager.change(PlanRequest(to=target))
        return outcome, await last_said(simulator)

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome, heard = managed("talker", folder, body, simulator, start)
    assert outcome.outcome == "done", outcome.because
    assert outcome.plan is not None
    assert "handover" in [step.action for step in outcome.plan.steps]
    assert heard == "the new one's"

"""State travels where a role is replaced, and nowhere else (docs/protocols/state.md)."""

from __future__ import annotations

from dataclasses import replace as changed
from pathlib import Path

from midstride.backends.simulator import Simulator
from midstride.model.specification import Node
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.runtime.systems import last_said, managed, stateful_talkers


def test_a_restarted_node_runs_what_its_program_is_now_with_the_state_it_had(tmp_path: Path) -> None:
    start = stateful_talkers(tmp_path)
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, str, list[str]]:
        program = tmp_path / "Talker.py"
        program.write_text(program.read_text().replace('"+"', '" in new code"'))
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        return outcome, await last_said(simulator), sorted(manager.configuration.instances)

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome, heard, instances = managed("talker", folder, body, simulator, start)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert [(swap.missed, swap.duplicates) for swap in outcome.swaps] == [(0, 0)]
    assert heard == "the old one's in new code"
    assert instances == ["listener", "talker_2"]


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

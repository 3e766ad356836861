"""State travels where a role is replaced, and nowhere else (semantics.md section 7)."""

from __future__ import annotations

import asyncio
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

from midstride.backends.simulator import Simulator
from midstride.model.contract import DEFAULT_QOS
from midstride.model.specification import Node
from midstride.plan.request import Request
from midstride.runtime.manager import Manager
from tests.runtime.systems import example, managed
from tests.runtime.test_rollback import STATEFUL


def test_a_topic_handed_on_to_another_role_takes_no_state_along(tmp_path: Path) -> None:
    """The topic is full, so the one that comes takes over from the one that goes: two roles, two states."""
    start, components = example("talker"), example("talker").components
    for component, own in (("Talker", "the old one's"), ("NewTalker", "the new one's")):
        script = tmp_path / f"{component}.py"
        script.write_text(STATEFUL.format(own=own))
        components = components.set(component, changed(components[component], run=f"python3 {script}"))
    full = start.connectors.set("/chatter", changed(start.connectors["/chatter"], cap=1))
    start = changed(start, components=components, connectors=full)
    target = start.without_node("talker").with_node(Node("other", "NewTalker", start.nodes["talker"].attachments))
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> tuple[dict[str, Any], str]:
        outcome = await manager.change(Request(to=target))
        reader = simulator.network.create_reader(
            simulator.processes["listener"], "/chatter", "std_msgs/msg/String", DEFAULT_QOS, lambda: None
        )
        await asyncio.sleep(1)
        return outcome, reader.queue[-1][0].data

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome, heard = managed("talker", folder, body, simulator, start)
    assert outcome["outcome"] == "done", outcome["because"]
    assert "handover" in [step["action"] for step in outcome["plan"]["steps"]]
    assert heard == "the new one's"

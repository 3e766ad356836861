"""What is written once, on entry, and read by whoever joins later: a map, a robot's description."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.codec.specification_form import decode_specification
from midstride.model.contract import QoS
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import replace

_LATCHED = QoS(durability="transient_local")
_MAP = {"type": "std_msgs/msg/String", "qos": {"durability": "transient_local"}}
_MAPPER = {
    "run": "python3 mapper.py",
    "outputs": ["out"],
    "functionalities": {
        "map": {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": _MAP}}, "degraded": {}}}
    },
}
_SYSTEM = {
    "system": "map",
    "topics": {"/map": _MAP},
    "components": {"Mapper": _MAPPER, "Mapper2": {**_MAPPER, "run": "python3 mapper.py second"}},
    "nodes": {"mapper": {"component": "Mapper", "attachments": {"out": ["/map"]}}},
}
_PROGRAM = """
from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("mapper")
out = comp.create_output("out", String, qos=QoS(durability="transient_local"))
mapping = comp.create_functionality("map", outputs=[out])
mapping.set_normal_mode(lambda: out.write(String(data=comp.instance)), outputs=[out])
mapping.set_degraded_mode(lambda: None)
comp.start()
"""


async def late_joiner(simulator: Simulator) -> list[str]:
    party = next(iter(simulator.processes.values()))
    reader = simulator.network.create_reader(party, "/map", "std_msgs/msg/String", _LATCHED, lambda: None)
    await asyncio.sleep(1)
    said = [message.data for message, _ in reader.queue]
    reader.destroy()
    return said


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
def test_a_replacement_goes_on_with_what_it_wrote_on_entry(strategy: str, tmp_path: Path) -> None:
    (tmp_path / "mapper.py").write_text(_PROGRAM)
    simulator = Simulator()

    async def main() -> tuple[list[str], Outcome, list[str]]:
        manager = Manager(decode_specification(_SYSTEM), simulator, Workspace(tmp_path), tmp_path)
        await manager.up()
        try:
            before = await late_joiner(simulator)
            outcome = await manager.change(replace("mapper", "Mapper2", strategy))
            return before, outcome, await late_joiner(simulator)
        finally:
            await manager.close()

    before, outcome, after = simulator.run(main())
    assert before == ["mapper"]
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert after == ["mapper_2"]


def test_one_that_is_attached_again_has_its_message_on_the_topic_again(tmp_path: Path) -> None:
    """The change is taken back after the old one was detached: nobody calls its mode again."""
    (tmp_path / "mapper.py").write_text(_PROGRAM)
    simulator = Simulator()

    async def main() -> tuple[Outcome, list[str]]:
        manager = Manager(decode_specification(_SYSTEM), simulator, Workspace(tmp_path), tmp_path)
        await manager.up()
        try:
            simulator.faults.fail_next("mapper", "export_state", "refused")
            outcome = await manager.change(PlanRequest(remove=("mapper",)))
            return outcome, await late_joiner(simulator)
        finally:
            await manager.close()

    outcome, after = simulator.run(main())
    assert outcome.outcome == "rolled_back"
    assert after == ["mapper"]


_SEVERAL = """
from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("mapper")
out = comp.create_output("out", String, qos=QoS(durability="transient_local", depth=3))
mapping = comp.create_functionality("map", outputs=[out])
message = String()


def normal():
    for each in range(5):
        message.data = f"{comp.instance} {each}"  # one object, filled again
        out.write(message)


mapping.set_normal_mode(normal, outputs=[out])
mapping.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.parametrize("strategy", ["minimal", "paper"])
def test_late_joiners_have_as_many_messages_as_the_publisher_keeps_after_a_replacement(
    strategy: str, tmp_path: Path
) -> None:
    (tmp_path / "mapper.py").write_text(_SEVERAL)
    kept = {"type": "std_msgs/msg/String", "qos": {"durability": "transient_local", "depth": 3}}
    text = json.dumps(_SYSTEM).replace(json.dumps(_MAP), json.dumps(kept))
    simulator = Simulator()

    async def main() -> tuple[list[str], Outcome, list[str], Outcome, list[str]]:
        manager = Manager(decode_specification(json.loads(text)), simulator, Workspace(tmp_path), tmp_path)
        await manager.up()
        try:
            before = await late_joiner(simulator)
            outcome = await manager.change(replace("mapper", "Mapper2", strategy))
            after = await late_joiner(simulator)
            simulator.faults.fail_next("mapper_2", "export_state", "refused")
            removed = await manager.change(PlanRequest(remove=("mapper",)))
            return before, outcome, after, removed, await late_joiner(simulator)
        finally:
            await manager.close()

    before, outcome, after, removed, restored = simulator.run(main())
    assert before == ["mapper 2", "mapper 3", "mapper 4"]
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert after == ["mapper_2 2", "mapper_2 3", "mapper_2 4"]
    assert removed.outcome == "rolled_back" and restored == after

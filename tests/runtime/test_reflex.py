"""The local reflex under a manager, and after its end: a chain of four, told apart from a crash, restored by a plan."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.codec.specification_form import decode_specification
from midstride.node.control.shortfall import FLOOR
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import managed, replace

STRING = "std_msgs/msg/String"
SLACK = 0.25

# The source writes until the file `silent` exists, and hangs as soon as `hung` does; `slow` has it write every fifth,
# and `raises` raise.
# With the argument `again` it ignores them.
SOURCE = """
import sys
import time
from pathlib import Path
from midstride import Component
from std_msgs.msg import String

comp = Component("source")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])
here, calls = Path({folder!r}) / ("none" if "again" in sys.argv else ""), 0

def normal():
    global calls
    calls += 1
    while (here / "hung").exists():
        time.sleep(0.1)
    if (here / "raises").exists():
        raise RuntimeError("no camera")
    if not (here / "silent").exists() and (calls % 5 == 0 or not (here / "slow").exists()):
        out.write(String(data=str(calls)))

work.set_normal_mode(normal, rate=50, outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""

# Each stage writes at its own rate, whatever it receives, until its assumption no longer holds.
STAGE = """
from midstride import Component
from std_msgs.msg import String

comp = Component("stage")
inlet, out = comp.create_input("in", String, rate=50, tolerates=49), comp.create_output("out", String)
work = comp.create_functionality("work", inputs=[inlet], outputs=[out])
work.set_normal_mode(lambda: out.write(String(data="x")), rate=50, inputs=[inlet], outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""

CHAIN = ("a", "b", "c", "d")


def chain(folder: Path) -> dict[str, Any]:
    """``a`` writes, ``b`` to ``d`` each rely on the one before."""
    (folder / "source.py").write_text(SOURCE.format(folder=str(folder)))
    (folder / "stage.py").write_text(STAGE)
    at_50 = {"type": STRING, "rate": 50}

    def component(file: str, inputs: dict[str, Any]) -> dict[str, Any]:
        modes = {"normal": {"assumes": list(inputs), "guarantees": {"out": at_50}}, "degraded": {}}
        work = {"uses": list(inputs), "produces": ["out"], "modes": modes}
        return {"run": f"python3 {file}", "inputs": inputs, "outputs": ["out"], "functionalities": {"work": work}}

    nodes = {"a": {"component": "Source", "attachments": {"out": ["/a"]}}}
    for before, name in itertools.pairwise(CHAIN):
        nodes[name] = {"component": "Stage", "attachments": {"in": [f"/{before}"], "out": [f"/{name}"]}}
    source, stage = component("source.py", {}), component("stage.py", {"in": at_50})
    return {
        "system": "chain",
        "topics": {f"/{name}": at_50 for name in CHAIN},
        "components": {"Source": source, "OtherSource": {**source, "run": "python3 source.py again"}, "Stage": stage},
        "nodes": nodes,
    }


class Chain:
    """The chain of four, all in their normal modes."""

    def __init__(self, manager: Manager, simulator: Simulator, folder: Path) -> None:
        self.manager = manager
        self.simulator = simulator
        self.folder = folder

    def mode(self, instance: str) -> str:
        state = self.simulator.state(instance)
        assert state is not None
        return state.functionalities["work"].mode

    async def fallen_at(self, instance: str, within: float) -> float:
        """After how long it is in its degraded mode (s)."""
        began = self.simulator.clock.steady()
        while self.mode(instance) == "normal":
            assert self.simulator.clock.steady() - began < within, f"{instance} is still in its normal mode"
            await asyncio.sleep(0.002)
        return self.simulator.clock.steady() - began


def in_chain(folder: Path, body: Callable[[Chain], Awaitable[None]]) -> None:
    system = folder / "system"
    programs = folder / "programs"
    system.mkdir()
    programs.mkdir()
    specification = decode_specification(chain(programs))

    async def main(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(2.0)
        status = await manager.status()
        assert status.valid, status
        await body(Chain(manager, simulator, programs))

    managed("chain", system, main, specification=specification, directory=programs)


FAULTS = [("silent", 1.0), ("slow", 4.0), ("hung", 1.0)]


@pytest.mark.parametrize(("fault", "windows"), FAULTS)
def test_with_a_manager_the_whole_chain_falls_within_one_window(tmp_path: Path, fault: str, windows: float) -> None:
    async def body(chain: Chain) -> None:
        (chain.folder / fault).touch()
        first = await chain.fallen_at("b", 6.0)
        assert windows * FLOOR - 0.1 <= first <= windows * FLOOR + SLACK
        assert await chain.fallen_at("c", 0.05) <= 0.05
        assert await chain.fallen_at("d", 0.05) <= 0.05
        await asyncio.sleep(5.0)
        status = await chain.manager.status()
        because = {each.name: each.functionalities[0].because for each in status.instances}
        assert str(because["b"]).startswith("the assumption of mode normal broke: input in received ")
        assert str(because["c"]).endswith("b.work entered mode degraded unexpectedly")
        degraded = [event.words for event in chain.manager.log() if event.kind == "degraded"]
        assert "b.work entered mode degraded unexpectedly" in degraded
        # Its own component reports that, too, but only after 5 s.
        assert ("a.work entered mode degraded unexpectedly" in degraded) is (fault == "hung")
        # Nothing is restored as long as the promise does not hold; then a plan restores it.
        (chain.folder / fault).unlink()
        await asyncio.sleep(3.0)
        outcome = await chain.manager.change(PlanRequest(to=chain.manager.specification))
        assert (
            outcome.outcome == "done" and outcome.remaining_degradations == [] and outcome.unexpected_degradations == []
        )
        await asyncio.sleep(5.0)
        assert [chain.mode(name) for name in CHAIN] == ["normal"] * 4
        assert (await chain.manager.status()).valid

    in_chain(tmp_path, body)


def test_a_plan_that_restores_too_early_says_so(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        (chain.folder / "silent").touch()
        await chain.fallen_at("b", 3.0)
        await chain.manager.change(PlanRequest(to=chain.manager.specification))
        await chain.fallen_at("b", 3.0)
        await asyncio.sleep(3.0)
        status = await chain.manager.status()
        assert not status.valid
        assert [fault.kind for fault in status.silences] == ["not_publishing"]

    in_chain(tmp_path, body)


@pytest.mark.parametrize(("fault", "windows"), FAULTS)
def test_without_a_manager_each_component_falls_a_window_after_the_one_before(
    tmp_path: Path, fault: str, windows: float
) -> None:
    async def body(chain: Chain) -> None:
        await chain.manager.close()
        (chain.folder / fault).touch()
        assert await chain.fallen_at("b", 6.0) <= windows * FLOOR + SLACK
        assert chain.mode("c") == chain.mode("d") == "normal"
        assert FLOOR - 0.1 <= await chain.fallen_at("c", 2.0) <= FLOOR + SLACK
        assert chain.mode("d") == "normal"
        assert FLOOR - 0.1 <= await chain.fallen_at("d", 2.0) <= FLOOR + SLACK
        # The next manager finds them as they are, and restores them once the promise holds.
        (chain.folder / fault).unlink()
        await asyncio.sleep(1.0)
        workspace = Workspace(chain.folder.parent / "system")
        following = Manager(chain.manager.specification, chain.simulator, workspace, chain.folder)
        await following.up()
        await asyncio.sleep(5.0)
        assert [chain.mode(name) for name in CHAIN] == ["normal"] * 4
        await following.close()

    in_chain(tmp_path, body)


def test_without_a_manager_the_death_of_a_publisher_is_noticed(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        await chain.manager.close()
        chain.simulator.faults.kill("a")
        assert FLOOR - 0.1 <= await chain.fallen_at("b", 2.0) <= FLOOR + SLACK

    in_chain(tmp_path, body)


def test_with_a_manager_a_crash_takes_no_window(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        chain.simulator.faults.kill("a")
        assert await chain.fallen_at("b", 0.05) <= 0.05

    in_chain(tmp_path, body)


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
def test_a_replacement_is_no_breakage(tmp_path: Path, strategy: str) -> None:
    async def body(chain: Chain) -> None:
        outcome = await chain.manager.change(replace("a", "OtherSource", strategy))
        assert outcome.outcome == "done" and outcome.unexpected_degradations == []
        await asyncio.sleep(5.0)
        assert [chain.mode(name) for name in ("a_2", *CHAIN[1:])] == ["normal"] * 4

    in_chain(tmp_path, body)


@pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])
@pytest.mark.parametrize("before", [0.0, 0.8, 0.95, 2.5])
def test_a_publisher_that_falls_silent_around_its_replacement_is_replaced(
    tmp_path: Path, before: float, strategy: str
) -> None:
    """Its dependants fall before the plan begins, or during it; the next plan restores those of the latter kind."""

    async def body(chain: Chain) -> None:
        (chain.folder / "silent").touch()
        await asyncio.sleep(before)
        outcome = await chain.manager.change(replace("a", "OtherSource", strategy))
        assert outcome.outcome == "done", outcome.because
        await chain.manager.change(PlanRequest(to=chain.manager.specification))
        await asyncio.sleep(5.0)
        assert [chain.mode(name) for name in ("a_2", *CHAIN[1:])] == ["normal"] * 4
        assert (await chain.manager.status()).valid

    in_chain(tmp_path, body)


def test_the_specification_states_the_tolerance(tmp_path: Path) -> None:
    """Five missed messages at 50 Hz; the code states nothing of the kind."""
    programs = tmp_path / "programs"
    programs.mkdir()
    document = json.loads(json.dumps(chain(programs)))  # without common parts
    document["components"]["Stage"]["inputs"]["in"]["tolerates"] = 5

    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(2.0)
        chain = Chain(manager, simulator, programs)
        (programs / "silent").touch()
        assert 0.1 <= await chain.fallen_at("b", 0.3) <= 0.2

    (tmp_path / "system").mkdir()
    managed("chain", tmp_path / "system", body, specification=decode_specification(document), directory=programs)

"""A change of parameters over several nodes: all are set or none, and it is rolled back where a contract breaks."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.errors import MidstrideError, PlanRefused
from midstride.model.component import ParameterValue
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.foreign.simulated import SimulatedRos, managed

TEXT = """system vision

topic /image : std_msgs/msg/String @ 20 Hz

component Camera {
  run "python3 camera.py"
  parameters { changeable every = 1 }
  output image
  functionality film {
    produces image
    mode normal { guarantee image : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}

component Detector {
  run "python3 detector.py"
  parameters { changeable threshold = 0.5 }
  input image : std_msgs/msg/String @ 20 Hz
  functionality detect {
    uses image
    mode normal { assume image }
    mode degraded { }
  }
}

component Driver { run "driver" gate none   parameters { changeable speed = 1.0 } }

node camera   : Camera   { image -> /image }
node detector : Detector { image <- /image }
node driver   : Driver   { }
timing { watch_after 2 s }
"""
CAMERA = """
from midstride import Component
from std_msgs.msg import String

comp = Component("camera")
image = comp.create_output("image", String)
film = comp.create_functionality("film", outputs=[image])
every = comp.parameter("every", 1, on_change=lambda value: None)
count = 0

def shoot():
    global count
    count += 1
    if count % every.value == 0:
        image.write(String(data=str(count)))

film.set_normal_mode(shoot, rate=20, outputs=[image])
film.set_degraded_mode(lambda: None)
comp.start()
"""
DETECTOR = """
from midstride import Component
from std_msgs.msg import String

comp = Component("detector")
image = comp.create_input("image", String, rate=20)
detect = comp.create_functionality("detect", inputs=[image])

def check(value):
    if not 0 <= value <= 1:
        raise ValueError("it must be from 0 to 1")

threshold = comp.parameter("threshold", 0.5, on_change=check)

def look(message):
    if threshold.value == 0.125:
        raise RuntimeError("nothing is found")

detect.set_normal_mode(look, inputs=[image])
detect.set_degraded_mode(lambda: None)
comp.start()
"""


def setting(**values: dict[str, ParameterValue]) -> PlanRequest:
    return PlanRequest(parameters=tuple((role, Map(each)) for role, each in values.items()))


def scenario(
    folder: Path,
    body: Callable[[Manager, SimulatedRos], Awaitable[None]],
    text: str = TEXT,
    behaviour: dict[str, dict[str, Any]] | None = None,
) -> None:
    (folder / "camera.py").write_text(CAMERA)
    (folder / "detector.py").write_text(DETECTOR)

    async def settled(manager: Manager, simulator: SimulatedRos) -> None:
        await asyncio.sleep(5)
        await body(manager, simulator)

    managed(folder, text, settled, behaviour)


async def values(manager: Manager) -> dict[str, Any]:
    return {
        f"{report.instance}.{each.name}": each.value
        for report in await manager.parameters()
        for each in report.parameters
    }


async def until(condition: Callable[[], bool | Awaitable[bool]], seconds: float = 30.0) -> None:
    """Wait until ``condition`` holds, in virtual time."""
    for _ in range(round(seconds / 0.01)):
        found = condition()
        if found if isinstance(found, bool) else await found:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"it does not hold after {seconds:g} s")


BEFORE = {"camera.every": 1, "detector.threshold": 0.5, "driver.own": 1.5, "driver.speed": 1.0}


def words(outcome: Outcome) -> list[str]:
    return [each.words for each in outcome.parameters]


def test_it_is_planned_previewed_carried_out_and_kept(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        request = setting(detector={"threshold": 1}, driver={"speed": 3, "own": 1.5})
        plan = await manager.plan(request)
        assert [step.action.describe() for step in plan.steps] == [
            "set threshold = 1.0 on detector",
            "set speed = 3.0 on driver",
        ]
        assert [each.words for each in plan.parameters] == [
            "detector: threshold = 1.0: it is 0.5 now",
            "driver: speed = 3.0: it is 1.0 now",
        ]
        assert await values(manager) == BEFORE, "a plan changes nothing"
        outcome = await manager.change(request, by="kim")
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert words(outcome) == [
            "detector: threshold = 1.0: set; it was 0.5",
            "driver: speed = 3.0: set; it was 1.0",
        ]
        after = {**BEFORE, "detector.threshold": 1.0, "driver.speed": 3.0}
        assert await values(manager) == after
        latest = (await manager.history(1)).changes[-1]
        assert (latest.by, latest.outcome) == ("kim", "done")
        assert latest.command == "set detector.threshold = 1, driver.own = 1.5, driver.speed = 3"
        # As what any tool has set, the values travel to replacements, and the specification is what it was.
        assert (await manager.plan(PlanRequest(to=manager.specification))).steps == ()
        outcome = await manager.change(PlanRequest(restart=("detector", "driver")))
        assert (outcome.outcome, {each.fate for each in outcome.parameters}) == ("done", {"kept"})
        assert (await values(manager))["detector_2.threshold"] == 1.0
        assert simulator.of("driver").values["speed"] == 3.0
        assert (await manager.plan(setting(driver={"speed": 3.0}))).steps == ()

    scenario(tmp_path, body)


@pytest.mark.parametrize("refusing", ["detector", "driver"])
def test_of_three_nodes_one_refuses_and_all_are_back_at_the_old_values(refusing: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await manager.set_parameters("camera", {"every": 1})
        if refusing == "driver":
            simulator.nodes["driver"].rejects["speed"] = "the driver is locked"
        threshold = 2.0 if refusing == "detector" else 0.25
        begun = simulator.time.steady()
        outcome = await manager.change(
            setting(camera={"every": 2}, detector={"threshold": threshold}, driver={"speed": 3.0})
        )
        assert outcome.outcome == "rolled_back"
        reason = "it must be from 0 to 1" if refusing == "detector" else "driver refuses speed = 3.0: the driver is"
        assert reason in str(outcome.because)
        assert await values(manager) == BEFORE
        assert not any(each.set_at_run_time for report in await manager.parameters() for each in report.parameters)
        fates = {each.node: each.fate for each in outcome.parameters}
        assert fates == {**dict.fromkeys(("camera", "detector", "driver"), "set_back"), refusing: "not_set"}
        for each in outcome.parameters:
            if each.fate == "set_back":
                assert isinstance(each.seconds, float) and 0 < each.seconds < 1
                assert "it had that for " in each.words and " at most, and has " in each.words
            else:
                assert reason in each.words
        assert simulator.time.steady() - begun < 10
        assert (await manager.history(1)).changes[-1].outcome == "rolled_back"

    scenario(tmp_path, body)


def test_one_breaks_its_rate_and_all_are_rolled_back_within_the_stated_time(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        begun = simulator.time.steady()
        changing = asyncio.ensure_future(manager.change(setting(driver={"speed": 3.0}, camera={"every": 4})))

        async def every() -> int:
            return int((await values(manager))["camera.every"])

        async def is_set() -> bool:
            return changing.done() or await every() == 4

        async def is_set_back() -> bool:
            return await every() == 1

        await until(is_set)
        assert not changing.done(), changing.result()
        await until(is_set_back)
        assert simulator.time.steady() - begun < 2.5, "the specification says that it is watched for 2 s"
        outcome = await changing
        assert outcome.outcome == "rolled_back"
        assert str(outcome.because).startswith("set every = 4 on camera: camera.image does not keep the 20 Hz")
        assert "after its parameters were set" in str(outcome.because)
        assert await values(manager) == BEFORE
        assert {each.node: each.fate for each in outcome.parameters} == {"camera": "set_back", "driver": "set_back"}
        assert all(isinstance(each.seconds, float) and each.seconds < 2.5 for each in outcome.parameters)
        await asyncio.sleep(5)
        assert (await manager.status()).valid

    scenario(tmp_path, body)


@pytest.mark.parametrize("text", [TEXT, TEXT.replace("timing { watch_after 2 s }", "")], ids=["2 s", "by default"])
def test_what_degrades_afterwards_rolls_it_back(text: str, tmp_path: Path) -> None:
    async def body(manager: Manager, _: SimulatedRos) -> None:
        outcome = await manager.change(setting(driver={"speed": 3.0}, detector={"threshold": 0.125}))
        assert outcome.outcome == "rolled_back"
        assert "detector.detect entered mode degraded after parameters were set" in str(outcome.because)
        assert "nothing is found" in str(outcome.because)
        assert await values(manager) == BEFORE

    scenario(tmp_path, body, text)


def test_without_a_watch_it_is_done_at_once(tmp_path: Path) -> None:
    async def body(manager: Manager, _: SimulatedRos) -> None:
        outcome = await manager.change(setting(driver={"speed": 3.0}, camera={"every": 4}))
        assert outcome.outcome == "done" and (await values(manager))["camera.every"] == 4

    scenario(tmp_path, body, TEXT.replace("watch_after 2 s", "watch_after 0 s"))


@pytest.mark.parametrize(
    ("asked", "because"),
    [
        ({"detector": {"treshold": 0.2}}, "detector has no parameter treshold; did you mean `threshold`?"),
        ({"driver": {"speed": "fast"}}, "speed of driver is a float (1.0), and 'fast' is a string"),
        ({"drivr": {"speed": 1.0}}, "there is no node `drivr`; did you mean `driver`?"),
    ],
)
def test_what_no_node_can_accept_is_refused_before_any_is_set(
    asked: dict[str, dict[str, ParameterValue]], because: str, tmp_path: Path
) -> None:
    async def body(manager: Manager, _: SimulatedRos) -> None:
        with pytest.raises(PlanRefused) as refused:
            await manager.plan(setting(camera={"every": 2}, **asked))
        assert str(refused.value) == because
        outcome = await manager.change(setting(camera={"every": 2}, **asked))
        assert (outcome.outcome, outcome.because) == ("refused", because)
        assert await values(manager) == BEFORE

    scenario(tmp_path, body)


def test_a_node_that_does_not_say_its_parameters_or_does_not_run_is_refused(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["driver"].hung = True
        outcome = await manager.change(setting(camera={"every": 2}, driver={"speed": 3.0}))
        assert (outcome.outcome, outcome.because) == (
            "refused",
            "driver does not say its parameters: its parameter services do not answer",
        )
        simulator.die("driver")
        await asyncio.sleep(1)
        outcome = await manager.change(setting(camera={"every": 2}, driver={"speed": 3.0}))
        assert outcome.outcome == "refused" and str(outcome.because).startswith("driver is not running")
        with pytest.raises(PlanRefused, match="in a change of their own"):
            await manager.plan(PlanRequest(restart=("camera",), parameters=(("camera", Map(every=2)),)))

    scenario(tmp_path, body)


def test_a_node_that_ends_by_it_rolls_it_back_and_starts_with_the_old_value(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await manager.set_parameters("driver", {"speed": 2.0})
        changing = asyncio.ensure_future(manager.change(setting(camera={"every": 2}, driver={"speed": 3.0})))
        await until(lambda: simulator.nodes["driver"].values["speed"] == 3.0)
        await asyncio.sleep(0.1)
        simulator.die("driver")
        outcome = await changing
        assert outcome.outcome == "rolled_back" and "driver has ended after its parameters" in str(outcome.because)
        assert (await values(manager))["camera.every"] == 1
        assert (await manager.change(PlanRequest(restart=("driver",)))).outcome == "done"
        assert simulator.of("driver").values["speed"] == 2.0

    scenario(tmp_path, body)


def test_the_next_manager_rolls_back_what_was_set_and_not_watched_to_its_end(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        changing = asyncio.ensure_future(manager.change(setting(detector={"threshold": 0.25}, driver={"speed": 3.0})))
        await until(lambda: simulator.nodes["driver"].values["speed"] == 3.0)
        await asyncio.sleep(0.1)
        workspace, specification = Workspace(tmp_path / "system"), manager.specification
        await simulator.manager_killed()
        second = Manager(specification, simulator, workspace, tmp_path)
        await second.up()
        with suppress(MidstrideError, asyncio.CancelledError):
            await changing
        assert await values(second) == BEFORE
        ended, back = (await second.history(2)).changes[-2:]
        assert ended.outcome == "rolled_back" and back.command == "set detector.threshold = 0.5, driver.speed = 1.0"
        await second.close()

    scenario(tmp_path, body)


def test_a_node_that_hangs_while_it_is_set_rolls_the_others_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["driver"].forgets = True
        outcome = await manager.change(setting(detector={"threshold": 0.25}, driver={"speed": 3.0}))
        assert outcome.outcome == "rolled_back"
        assert "whether it has them now is not known" in str(outcome.because)
        assert (await values(manager))["detector.threshold"] == 0.5

    scenario(tmp_path, body)

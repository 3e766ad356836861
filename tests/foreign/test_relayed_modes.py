"""Modes as sets of parameters behind a relay, which sets them: for commands, and for its local reflex."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import NodeError
from midstride.foreign.relay import RelayComponent, RelayPlatform
from midstride.foreign.relayed_program import RelayOrder
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from tests.foreign.relayed import Program, SimulatedRelays, managed

TEXT = """system drive

topic /scan : std_msgs/msg/String @ 20 Hz
topic /cmd  : std_msgs/msg/String @ 20 Hz

component Lidar {
  run "lidar" gate relay
  output scan
  functionality sense {
    produces scan
    mode normal { guarantee scan : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}

component Driver {
  run "driver" gate relay
  parameters { speed = 1.0, gain = 2 }
  input scan : std_msgs/msg/String @ 20 Hz
  output cmd
  functionality drive {
    uses scan
    produces cmd
    mode normal {
      assume scan
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode slow {
      parameters { speed = 0, gain = 5 }
      guarantee cmd : std_msgs/msg/String @ 20 Hz
    }
    mode degraded { }
  }
}

component Listener {
  run "listener" gate relay
  input cmd : std_msgs/msg/String @ 20 Hz
  functionality listen {
    uses cmd
    mode normal { assume cmd }
    mode degraded { }
  }
}

node lidar    : Lidar    { scan -> /scan }
node driver   : Driver   { scan <- /scan   cmd -> /cmd   parameters { speed = 2.0 } }
node listener : Listener { cmd <- /cmd }
"""
NORMAL, SLOW = {"gain": 2, "speed": 2.0}, {"gain": 5, "speed": 0.0}
REMOVE = PlanRequest(remove=("lidar",))


def programs() -> dict[str, Program]:
    return {name: Program(20.0) for name in ("Lidar", "Driver", "Listener")}


async def mode(manager: Manager) -> tuple[str, str]:
    state = (await manager.peek("driver")).functionalities["drive"]
    return state.mode, state.because


async def becomes(manager: Manager, wanted: str, seconds: float = 30.0) -> str:
    """Why the driver is in that mode, once it is."""
    for _ in range(int(seconds / 0.05)):
        found, because = await mode(manager)
        if found == wanted:
            return because
        await asyncio.sleep(0.05)
    raise AssertionError(await mode(manager))


def test_a_mode_sets_its_parameters_and_passes_the_messages_on(tmp_path: Path) -> None:
    made = programs()

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        lidar = manager.specification.nodes["lidar"]
        assert made["Driver"].set == [NORMAL]
        await asyncio.sleep(1)
        assert (await manager.change(REMOVE)).outcome == "done"
        assert made["Driver"].set == [NORMAL, SLOW]
        assert type(made["Driver"].set[1]["speed"]) is float
        assert (await mode(manager))[0] == "slow"
        await asyncio.sleep(1)
        assert (await manager.change(PlanRequest(add=(lidar,)))).outcome == "done"
        assert made["Driver"].set == [NORMAL, SLOW, NORMAL]
        await asyncio.sleep(1)
        numbers = [int(words.split()[1]) for _, words in simulator.heard["listener"]]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))) and len(numbers) > 60
        assert (await manager.status()).valid

    managed(tmp_path, TEXT, made, body)


def test_a_value_that_is_refused_fails_the_step(tmp_path: Path) -> None:
    made = programs()

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        made["Driver"].rejects["speed"] = "it is locked"
        outcome = await manager.change(REMOVE)
        assert outcome.outcome == "rolled_back"
        assert "driver refuses gain = 5, speed = 0: it is locked" in str(outcome.because)
        assert (await mode(manager))[0] == "normal"
        assert made["Driver"].set == [NORMAL]
        assert (await manager.status()).valid

    managed(tmp_path, TEXT, made, body)


@pytest.mark.parametrize("refuses", [False, True])
def test_the_local_reflex_sets_them_and_falls_further_where_the_node_refuses(tmp_path: Path, refuses: bool) -> None:
    made = programs()

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        driver = made["Driver"]
        if refuses:
            driver.rejects["gain"] = "it is locked"
        made["Lidar"].hung.add("lidar")
        because = await becomes(manager, "degraded" if refuses else "slow")
        assert because.startswith("the assumption of mode normal broke: input scan received nothing on /scan")
        assert because.endswith("; driver refuses gain = 5, speed = 0: it is locked") == refuses
        assert driver.set == [NORMAL] if refuses else [NORMAL, SLOW]
        driver.rejects.clear()
        made["Lidar"].hung.clear()
        await becomes(manager, "normal", 60)
        assert driver.set[-1] == NORMAL

    managed(tmp_path, TEXT, made, body)


def test_parameters_that_are_set_need_a_platform_with_services_for_that(tmp_path: Path) -> None:
    listener = "component Tuned like Listener { parameters { changeable gain = 1 } }\n\nnode lidar"
    (tmp_path / "drive.stride").write_text(TEXT.replace("node lidar", listener), encoding="utf-8")
    components = load(tmp_path / "drive.stride").require().components
    nothing: Any = lambda *_: str  # noqa: E731
    platform, program = RelayPlatform(nothing, nothing, nothing, nothing), nothing
    faults = {"Driver": "Driver has modes that set parameters", "Tuned": "Tuned has parameters that are `changeable`"}
    for name in ("Lidar", *faults):
        component = components[name]
        topics = {port: f"/{port}" for port in component.ports()}
        order = RelayOrder(command=[], node="/n", declaration=NamedComponentForm.of(component), topics=topics)
        if name == "Lidar":
            RelayComponent(order, program, platform)
            continue
        with pytest.raises(NodeError, match=f"{faults[name]}, and a node of ROS 1 has no service for that"):
            RelayComponent(order, program, platform)

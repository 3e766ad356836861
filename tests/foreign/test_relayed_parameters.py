"""Parameters of programs behind a relay: shown, set, and taken over by what replaces the program."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.errors import CommandRefused, PlanRefused
from midstride.lang.load import load_text
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import ParameterStatus
from tests.foreign.relayed import Program, SimulatedRelays, managed

TEXT = """system robot

topic /scan : std_msgs/msg/String @ 20 Hz

component Radar {
  run "radar" gate relay
  parameters { changeable power = 1.0 }
  output scan
  functionality sense {
    produces scan
    mode normal { guarantee scan : std_msgs/msg/String @ 20 Hz }
    mode degraded { }
  }
}

node radar : Radar { scan -> /scan }
node other : Radar { }
"""
RESTART = PlanRequest(restart=("radar",))


async def looked_at(manager: Manager, node: str = "radar") -> dict[str, ParameterStatus]:
    (report,) = await manager.parameters(node)
    return {each.name: each for each in report.parameters}


def robot(tmp_path: Path, body: Callable[[Manager, Program], Awaitable[None]]) -> None:
    program = Program(20.0, own={"gain": 0.1})

    async def run(manager: Manager, simulator: SimulatedRelays) -> None:
        await body(manager, program)

    managed(tmp_path, TEXT, {"Radar": program}, run)


def test_the_parameters_of_the_program_are_shown_and_set(tmp_path: Path) -> None:
    async def body(manager: Manager, program: Program) -> None:
        own = program.values["radar"]
        assert {name: each.value for name, each in (await looked_at(manager)).items()} == {"power": 1.0, "gain": 0.1}
        own["gain"] = 0.25  # by a ROS tool
        gain = (await looked_at(manager))["gain"]
        assert (gain.value, gain.origin, gain.set_at_run_time) == (0.25, "unknown", True)
        await manager.set_parameters("radar", {"power": 2})
        assert (own["power"], type(own["power"])) == (2.0, float)
        power = (await looked_at(manager))["power"]
        assert (power.value, power.declared, bool(power.origin)) == (2.0, 1.0, False)
        with pytest.raises(CommandRefused, match=r"radar refuses gian = 1\.0: .*; it has no gian; did you mean `gain`"):
            await manager.set_parameters("radar", {"gian": 1.0})
        program.rejects["power"] = "it is too much"
        with pytest.raises(CommandRefused, match=r"radar refuses power = 9\.0, gain = 3\.0: it is too much"):
            await manager.set_parameters("radar", {"power": 9.0, "gain": 3.0})
        assert own == {"power": 2.0, "gain": 0.25}

    robot(tmp_path, body)


def test_what_was_set_travels_to_the_replacement(tmp_path: Path) -> None:
    async def body(manager: Manager, program: Program) -> None:
        await looked_at(manager)  # so it is known what it started with
        program.values["radar"]["gain"] = 0.25
        await manager.set_parameters("radar", {"power": 2.0})
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert {(each.parameter, each.fate, each.origin) for each in outcome.parameters} == {
            ("gain", "kept", "unknown"),
            ("power", "kept", "set"),
        }
        assert program.values["radar_2"] == {"power": 2.0, "gain": 0.25}
        # A second one gets them as well: what its predecessor was started with counts as set at run time.
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "done" and program.values["radar_3"] == {"power": 2.0, "gain": 0.25}

    robot(tmp_path, body)


def test_a_changeable_parameter_is_set_in_place(tmp_path: Path) -> None:
    async def body(manager: Manager, program: Program) -> None:
        target = load_text(TEXT.replace("power = 1.0", "power = 3.0")).require()
        outcome = await manager.change(PlanRequest(to=target))
        assert outcome.outcome == "done" and set(program.values) == {"radar", "other"}
        power = (await looked_at(manager))["power"]
        assert (power.value, power.set_at_run_time) == (3.0, False)

    robot(tmp_path, body)


def test_parameters_of_several_programs_are_one_change(tmp_path: Path) -> None:
    async def body(manager: Manager, program: Program) -> None:
        def setting(**values: dict[str, Any]) -> PlanRequest:
            return PlanRequest(parameters=tuple((role, Map(each)) for role, each in values.items()))

        assert (await manager.change(setting(radar={"power": 2.0}, other={"gain": 2.0}))).outcome == "done"
        program.rejects["gain"] = "it is locked"
        outcome = await manager.change(setting(radar={"power": 5.0}, other={"gain": 5.0}))
        assert outcome.outcome == "rolled_back" and "other refuses gain = 5.0: it is locked" in str(outcome.because)
        assert program.values == {"radar": {"power": 2.0, "gain": 0.1}, "other": {"power": 1.0, "gain": 2.0}}

    robot(tmp_path, body)


def test_a_program_that_does_not_answer_is_named(tmp_path: Path) -> None:
    async def body(manager: Manager, program: Program) -> None:
        program.mute.add("radar")
        (report,) = await manager.parameters("radar")
        assert "its parameter services do not answer" in str(report.unread)
        with pytest.raises(CommandRefused, match="has not said its parameters within 1 s; nothing was set"):
            await manager.set_parameters("radar", {"power": 2.0})
        with pytest.raises(PlanRefused, match="radar does not say its parameters"):
            await manager.plan(PlanRequest(parameters=(("radar", Map({"power": 2.0})),)))
        plan = await manager.plan(RESTART)
        assert any("parameters of radar were set" in each and "do not answer" in each for each in plan.remarks)
        program.mute.clear()
        await manager.set_parameters("radar", {"power": 2.0})
        assert program.values["radar"]["power"] == 2.0

    robot(tmp_path, body)

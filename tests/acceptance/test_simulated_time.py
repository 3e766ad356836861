"""`use_sim_time`, set from outside while the system runs: the status shows it, and no hand-over crosses clocks."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.runtime.manager import Manager
from midstride.runtime.reports import Status
from tests.acceptance.support import managed, swap_specification
from tests.backends.ros2_support import Bare, run
from tests.runtime.systems import replace

pytestmark = pytest.mark.ros2

ON_CLOCK = "use_sim_time is on, and nothing has arrived on /clock yet: modes with a rate are not called"


@pytest.mark.full
def test_a_source_that_waits_for_a_clock_is_shown_and_not_handed_over(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            with Bare() as bare:
                await set_simulated_time(bare, "/source", True)
                assert not (await status_when(manager, ON_CLOCK)).valid
                outcome = await manager.change(replace("source", "OtherSource"))
                assert outcome.outcome == "rolled_back"
                assert "source follows /clock (use_sim_time) and source_2 the clock of the system" in str(
                    outcome.because
                )
                await set_simulated_time(bare, "/source", False)
                assert (await status_when(manager, None)).valid
                assert (await manager.change(replace("source", "OtherSource"))).outcome == "done"

    run(scenario(), 120)


async def set_simulated_time(bare: Bare, node: str, value: bool) -> None:
    """As `ros2 param set` does."""
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    client = bare.node.create_client(SetParameters, f"{node}/set_parameters")
    on = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    request = SetParameters.Request(parameters=[Parameter(name="use_sim_time", value=on)])
    assert (await bare.ask(client, request)).results[0].successful
    bare.node.destroy_client(client)


async def status_when(manager: Manager, waiting: str | None) -> Status:
    """The status, as soon as the source reports that it waits for that."""
    while True:
        status = await manager.status()
        if {row.name: row.waiting for row in status.components}["source"] == waiting:
            return status
        await asyncio.sleep(0.02)

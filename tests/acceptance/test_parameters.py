"""On real ROS 2: a bare rclpy client sets a parameter, and the value is kept when the node is replaced."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from midstride.plan.request import PlanRequest
from tests.acceptance.support import managed
from tests.backends.ros2_support import Bare, run
from tests.runtime.systems import EXAMPLES, replace
from tests.runtime.test_parameters import source, tuned

pytestmark = [pytest.mark.ros2, pytest.mark.full]


# A parameter of the node itself, which the component knows nothing of.
ON_THE_NODE = """
@comp.on_setup
def declare(node):
    node.declare_parameter("speed", 0.5)

comp.start()
"""


async def set_by_a_client(bare: Bare, node: str, name: str, value: Any) -> tuple[bool, str]:
    """As `ros2 param set` does."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = bare.node.create_client(SetParameters, f"{node}/set_parameters")
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    result = (await bare.ask(client, request)).results[0]
    bare.node.destroy_client(client)
    return result.successful, result.reason


def test_what_a_bare_client_sets_before_and_after_a_replacement_is_kept(tmp_path: Path) -> None:
    async def scenario() -> None:
        specification = tuned(tmp_path, source(2.5).replace("comp.start()", ON_THE_NODE))
        async with managed(tmp_path / "system", specification, EXAMPLES / "talker") as (manager, _):
            with Bare() as bare:
                assert await set_by_a_client(bare, "/talker", "gain", 1.7) == (True, "")
                done, reason = await set_by_a_client(bare, "/talker", "gain", -1.0)
                assert not done and "it must be from 0 to 100" in reason
                outcome = await manager.change(replace("talker", "NewTalker"))
                assert outcome.outcome == "done", outcome.because
                assert [value.words for value in outcome.parameters] == ["talker: gain = 1.7, set at run time: kept"]
                state = await manager.peek("talker_2")
                assert (state.parameters["gain"], state.declared) == (1.7, {"gain": 2.5})

                assert await set_by_a_client(bare, NODE, "label", "left") == (True, "")
                assert await set_by_a_client(bare, NODE, "speed", 0.7) == (True, "")
                await manager.set_parameters("talker", {"gain": 1.9})
                outcome = await manager.change(PlanRequest(restart=("talker",)))
                assert outcome.outcome == "done", outcome.because
                (new,) = (name for name, live in manager.configuration.instances.items() if live.role == "talker")
                state = await manager.peek(new)
                assert state.set_values() == {"gain": 1.9, "label": "left", "speed": 0.7}
                assert state.declared["speed"] == 0.5

                # Numbers that are not finite travel like any other, and do not count as changed for ever.
                assert await set_by_a_client(bare, NODE, "speed", math.nan) == (True, "")
                assert await set_by_a_client(bare, NODE, "label", "inf") == (True, "")
                outcome = await manager.change(PlanRequest(restart=("talker",)))
                assert outcome.outcome == "done", outcome.because
                (new,) = (name for name, live in manager.configuration.instances.items() if live.role == "talker")
                state = await manager.peek(new)
                assert state.set_values() == {"gain": 1.9, "label": "inf", "speed": math.nan}
                assert state.parameters["speed"] == {"float": "nan"} and state.declared["speed"] == 0.5

    run(scenario())


def test_a_value_that_the_new_node_refuses_is_rolled_back_and_the_client_still_reads_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        specification = tuned(tmp_path, source(2.5, limit=10))
        async with managed(tmp_path / "system", specification, EXAMPLES / "talker") as (manager, _):
            with Bare() as bare:
                assert await set_by_a_client(bare, "/talker", "gain", 50.0) == (True, "")
                outcome = await manager.change(replace("talker", "NewTalker"))
                assert outcome.outcome == "rolled_back"
                assert "gain = 50.0, set at run time: " in str(outcome.because)
                assert "it must be from 0 to 10" in str(outcome.because)
                assert (await manager.peek("talker")).set_values() == {"gain": 50.0}

    run(scenario())


# The name under which the replacement's parameter services answer.
NODE = "/talker"

"""A node without Midstride's API keeps its name: one client sets its parameters across its replacements.

MIDSTRIDE_NAME_REPLACEMENTS says how many replacements the long test makes, where 50 take too long.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.model.component import Gate
from midstride.model.specification import Specification
from tests.acceptance.foreign_support import Robot, declared_talker, manager_of, robot, system_to_kill
from tests.acceptance.serving import CLIENTS, LIFECYCLE_SERVER, called
from tests.acceptance.support import ended
from tests.acceptance.test_manager_killed import kill_the_manager
from tests.acceptance.test_parameters import set_by_a_client
from tests.backends.ros2_support import Bare, run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_NAME_REPLACEMENTS", "50"))

# Plain rclpy: it says its instance, and notes each value that is set.
MAPPER = """
import os
import rclpy
from itertools import count
from pathlib import Path
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node, numbers, own = Node("mapper"), count(1), os.environ["MIDSTRIDE_INSTANCE"]
publisher = node.create_publisher(String, "chatter", 10)
node.declare_parameter("resolution", 0.1)

def check(parameters):
    with (Path(__file__).parent / "set").open("a") as file:
        file.writelines(f"{each.value} {own}\\n" for each in parameters)
    return SetParametersResult(successful=True)

node.add_on_set_parameters_callback(check)
node.create_timer(0.02, lambda: publisher.publish(String(data=f"{own} {next(numbers)}")))
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


# Where a manager is killed: as the new node has taken over or is about to, and as it is given the values.
POINTS = [
    ("answer", "before"),
    ("answer", "after"),
    ("cut_in", "after"),
    *((op, when) for op in ("cut_out", "set") for when in ("before", "after")),
    ("observe", "after"),
    ("detach", "after"),
]


# Sets one value after the other, each as soon as the last one is answered, until SIGTERM; then it writes how many.
SETTER = """
import signal
import sys
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rcl_interfaces.srv import SetParameters

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node, number, stopped = Node("setter"), 0, []
signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
client = node.create_client(SetParameters, "/mapper/set_parameters")
client.wait_for_service()
while not stopped:
    number += 1
    value = Parameter("resolution", value=float(number)).to_parameter_msg()
    answer = client.call_async(SetParameters.Request(parameters=[value]))
    rclpy.spin_until_future_complete(node, answer, timeout_sec=20)
    if not answer.done() or [each.successful for each in answer.result().results] != [True]:
        sys.exit(f"{number}: {answer.result() if answer.done() else 'no answer'}")
with open(sys.argv[1], "w") as file:
    file.write(str(number))
"""


def written(folder: Path) -> Specification:
    """The system with the mapper, in ``folder``."""
    (folder / "mapper.py").write_text(MAPPER, encoding="utf-8")
    text = "system mapping\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Plain", "python3 mapper.py", "preload")
    text += declared_talker("Other", "python3 mapper.py", "preload")
    (folder / "mapping.stride").write_text(f"{text}node mapper : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return load(folder / "mapping.stride").require()


def kept_across(folder: Path, number: int) -> None:
    specification = written(folder)

    async def scenario() -> None:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        async with robot(specification, folder) as system:
            client = system.bare.node.create_client(SetParameters, "/mapper/set_parameters")
            await system.until(client.service_is_ready)
            for count in range(number + 1):
                if count:
                    await system.replaced("Plain" if count % 2 == 0 else "Other", role="mapper")
                await system.bare.until_named("mapper")
                found = await values(system)
                assert found == ({"resolution": 0.1} if not count else {"resolution": float(count)}), count
                value = float(count + 1)
                request = SetParameters.Request(parameters=[Parameter("resolution", value=value).to_parameter_msg()])
                answer = client.call_async(request)
                await system.until(answer.done)
                assert [each.successful for each in answer.result().results] == [True]
            assert system.holes() == []
            assert not any(name.startswith("mapper_") for name in system.bare.node.get_node_names())
        # Each value was set by one of the two: by the one that answered. The next one was started with it.
        lines = [line.split() for line in (folder / "set").read_text().splitlines()]
        assert [float(value) for value, _ in lines] == [float(count + 1) for count in range(number + 1)]
        assert len({instance for _, instance in lines}) > 1

    async def values(system: Robot) -> dict[str, object]:
        (report,) = await system.manager.parameters("mapper")
        return {each.name: each.value for each in report.parameters if each.name == "resolution"}

    with ended():
        run(scenario(), 3600)


def test_one_client_sets_the_parameters_of_a_node_across_replacements(tmp_path: Path) -> None:
    kept_across(tmp_path, 3)


@pytest.mark.long
def test_one_client_sets_the_parameters_of_a_node_across_many_replacements(tmp_path: Path) -> None:
    kept_across(tmp_path, REPLACEMENTS)


@pytest.mark.long
@pytest.mark.timeout(3700)
def test_a_client_that_never_pauses_sets_one_value_after_the_other_across_many_replacements(tmp_path: Path) -> None:
    """Each is answered within 20 s, none is missing, and the last instance has the last one."""
    specification = written(tmp_path)

    async def scenario() -> None:
        async with robot(specification, tmp_path) as system:
            setter = subprocess.Popen(
                [sys.executable, "-c", SETTER, str(tmp_path / "answered")], env=without_midstride(), cwd=tmp_path
            )
            try:
                for count in range(1, REPLACEMENTS + 1):
                    await system.replaced("Plain" if count % 2 == 0 else "Other", role="mapper")
                    await system.bare.until_named("mapper")
                    assert setter.poll() is None, "a value was not answered, or refused"
            finally:
                setter.send_signal(signal.SIGTERM)
                setter.wait()
            assert setter.returncode == 0
            number = int((tmp_path / "answered").read_text())
            (report,) = await system.manager.parameters("mapper")
            assert {each.name: each.value for each in report.parameters}["resolution"] == float(number)
        lines = [line.split() for line in (tmp_path / "set").read_text().splitlines()]
        # What is set on the old one in a change is set on the new one, too, which then has it from two sides.
        assert {float(value) for value, _ in lines} == {float(value) for value in range(1, number + 1)}
        assert sum(one != other for (_, one), (_, other) in pairwise(lines)) >= REPLACEMENTS
        print(f"{number} values across {REPLACEMENTS} replacements")

    with ended():
        run(scenario(), 3600)


@pytest.mark.long
@pytest.mark.timeout(500)
def test_the_next_manager_finds_which_of_two_nodes_of_a_name_is_which(tmp_path: Path) -> None:
    """A manager is killed at the change-over, while both run; the next one addresses the node of each instance."""
    specification = system_to_kill(tmp_path, MAPPER, "/swap")

    def last_set() -> list[str]:
        return (tmp_path / "set").read_text(encoding="utf-8").splitlines()[-1].split()

    async def scenario() -> None:
        manager = manager_of(specification, tmp_path)
        await manager.up()
        with Bare("tool") as bare:
            for value, point in enumerate(POINTS, start=1):
                await manager.close()
                await asyncio.to_thread(kill_the_manager, tmp_path / "system", point[0], "1", point[1])
                # One of the two answers; which instance that is, the next manager finds.
                assert await set_by_a_client(bare, "/source", "resolution", float(value)) == (True, "")
                manager = manager_of(specification, tmp_path)
                await manager.up()
                (report,) = await manager.parameters("source")
                values = {each.name: each.value for each in report.parameters}
                assert values["resolution"] == float(value), f"killed {point}: {report}"
                await manager.set_parameters("source", {"resolution": value + 0.5})
                assert last_set() == [str(value + 0.5), report.instance], f"killed {point}"
                await bare.until_named("source")
                assert (await manager.status()).valid
        await manager.down()
        await manager.close()

    with ended():
        run(scenario(), 480)


@pytest.mark.parametrize("gate", ["lifecycle", pytest.param("lifecycle preload", marks=pytest.mark.long)])
def test_a_lifecycle_node_keeps_its_name_and_hands_its_requests_over(gate: Gate, tmp_path: Path) -> None:
    """With `gate lifecycle`, the library is in its process for its services alone."""
    (tmp_path / "server.py").write_text(LIFECYCLE_SERVER.replace("node.create_timer", DECLARES), encoding="utf-8")
    (tmp_path / "clients.py").write_text(CLIENTS, encoding="utf-8")
    text = "system cameras\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Plain", "python3 server.py", gate)
    text += declared_talker("Other", "python3 server.py", gate)
    (tmp_path / "cameras.stride").write_text(f"{text}node talker : Plain {{ out -> /chat }}\n", encoding="utf-8")

    async def scenario() -> None:
        from lifecycle_msgs.srv import GetState
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        async with robot(load(tmp_path / "cameras.stride").require(), tmp_path) as system:
            node = system.bare.node
            state = node.create_client(GetState, "/talker/get_state")
            setting = node.create_client(SetParameters, "/talker/set_parameters")
            await system.until(lambda: state.service_is_ready() and setting.service_is_ready())
            value = Parameter("resolution", value=0.5).to_parameter_msg()
            done = setting.call_async(SetParameters.Request(parameters=[value]))
            await system.until(done.done)
            async with called(tmp_path, system, service="/talker/count") as calls:
                for component in ("Other", "Plain"):
                    await system.replaced(component)
                    await system.bare.until_named("talker")
                    asked = state.call_async(GetState.Request())
                    await system.until(asked.done)
                    assert asked.result().current_state.label == "active"
                    (report,) = await system.manager.parameters("talker")
                    assert {each.name: each.value for each in report.parameters}["resolution"] == 0.5
                count = len(calls.answered)
                await system.until(lambda: len(calls.answered) > count + 40)
                assert {server for _, server in calls.handled} == {"talker", "talker_2", "talker_3"}
            if gate == "lifecycle preload":
                assert system.holes() == []
            assert not any(name.startswith("talker_") for name in node.get_node_names())
            assert (await system.manager.status()).valid

    with ended():
        run(scenario())


DECLARES = 'node.declare_parameter("resolution", 0.1)\nnode.create_timer'

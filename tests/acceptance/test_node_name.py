"""A node keeps its name on ROS 2: bare clients call it across replacements, and every request is handled once.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 200 take too long.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, Mode, NodeEndpoint
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification
from tests.acceptance.support import ATTEMPTS, ended, managed, other_source
from tests.acceptance.test_manager_killed import kill_the_manager, manage
from tests.backends.counting import COUNTING, Caller
from tests.backends.ros2_support import Bare, run
from tests.backends.test_ros2_host import Tools

pytestmark = pytest.mark.ros2

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "200"))
# Where the manager's death might leave none of the instances to answer, or both.
POINTS = [("cut_in", "1", "after"), ("answer", "1", "before"), ("answer", "1", "after"), ("detach", "1", "after")]


def specification(folder: Path) -> Specification:
    """A ``source`` with a service that notes each request; two components run the same program."""
    program = folder / "counter.py"
    program.write_text(COUNTING.replace('Component("counter")', 'Component("source")'))
    modes = (Mode("normal", (), Map({"out": Predicate("std_msgs/msg/String", 50)})), Mode("degraded"))
    components = {
        name: ComponentSpec.of(
            name,
            outputs=("out",),
            functionalities=(FunctionalitySpec("work", modes, (), ("out",)),),
            run=f"{sys.executable} {program}",
            allows=(NodeEndpoint("service", "~/count"),),
        )
        for name in ("Source", "OtherSource")
    }
    return Specification(
        "counting",
        connectors=Map({"/swap": Connector("/swap", Predicate("std_msgs/msg/String", 50))}),
        components=Map(components),
        nodes=Map({"source": Node("source", "Source", Map({"out": ("/swap",)}))}),
    )


async def called_meanwhile(bare: Bare, caller: Caller, work: Coroutine[Any, Any, None]) -> None:
    """Call without a pause until ``work`` is done."""
    task = asyncio.ensure_future(work)
    while not task.done():
        caller.step()
        await bare.spin()
    await task


async def left_running(system: Path, folder: Path) -> None:
    """Have the system run without a manager, in the new folder ``system``."""
    from midstride import backends
    from midstride.runtime.manager import Manager
    from midstride.runtime.workspace import Workspace

    system.mkdir()
    manager = Manager(specification(folder), backends.make("ros2", Workspace(system)), Workspace(system), folder)
    await manager.up()
    await manager.close()


def replaced_often(folder: Path, number: int) -> None:
    async def main() -> None:
        async with managed(folder / "system", specification(folder), folder) as (manager, _):
            with Bare() as bare:
                caller, tools = Caller(bare.node, "/source/count"), Tools(bare, "/source")
                await bare.until(caller.ready)

                async def replace_often() -> None:
                    for _ in range(number):
                        for _ in range(ATTEMPTS):  # a busy machine may give a hand-over up
                            outcome = await manager.change(other_source(manager))
                            if outcome.outcome != "rolled_back":
                                break
                        assert outcome.outcome == "done", outcome.because

                assert await tools.set(gain=2.0) == [(True, "")]
                await called_meanwhile(bare, caller, replace_often())
                assert await tools.set(gain=3.0) == [(True, "")]
                await caller.finish(bare, folder / "calls")
                (component,) = (await manager.status()).instances
                assert component.role == "source" and component.name in ("source_2", "source_3")
                assert (component.node, component.answers) == ("/source", True)
                assert (await manager.peek(component.name)).parameters == {"gain": 3.0}
        caller.handled_once(folder / "calls")
        assert set(caller.answered) == {"source", "source_2", "source_3"}
        print(f"{sum(caller.answered.values())} requests, the longest took {caller.longest * 1e3:.1f} ms")
        assert caller.longest < 2.0

    with ended():
        run(main(), 60.0 + 10.0 * number)


@pytest.mark.full
def test_a_client_calls_the_same_node_across_replacements(tmp_path: Path) -> None:
    replaced_often(tmp_path, 4)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_client_calls_the_same_node_across_very_many_replacements(tmp_path: Path) -> None:
    replaced_often(tmp_path, REPLACEMENTS)


@pytest.mark.long
def test_exactly_one_instance_answers_whenever_the_manager_is_killed(tmp_path: Path) -> None:
    system = tmp_path / "system"

    async def main() -> None:
        await left_running(system, tmp_path)
        with Bare() as bare:
            caller = Caller(bare.node, "/source/count")
            await bare.until(caller.ready)
            killed: list[tuple[tuple[str, ...], float]] = []

            async def kill_at(*point: str) -> None:
                await asyncio.to_thread(kill_the_manager, system, *point)
                killed.append((point, time.monotonic()))
                before = caller.answered.total()  # without a manager, too
                deadline = time.monotonic() + 60
                while caller.answered.total() < before + 20:
                    assert time.monotonic() < deadline, (
                        f"{point}: {caller.unanswered(tmp_path / 'calls')}; {caller.answered}"
                    )
                    await asyncio.sleep(0.01)

            for point in POINTS:
                await called_meanwhile(bare, caller, kill_at(*point))

            printed: list[str] = []

            async def change_once_more() -> None:
                for _ in range(ATTEMPTS):  # a busy machine may give a hand-over up
                    done = await asyncio.to_thread(manage, system, "swap")
                    printed.extend(line for line in done.stdout.splitlines() if not line.startswith("call "))
                    if "rolled_back" not in done.stdout:
                        break
                assert done.returncode == 0 and "done None" in done.stdout, done.stdout + done.stderr

            await called_meanwhile(bare, caller, change_once_more())
            try:
                await caller.finish(bare, tmp_path / "calls")
            except AssertionError as error:
                ago = "; ".join(f"{point} {time.monotonic() - at:.1f} s ago" for point, at in killed)
                raise AssertionError(f"{error}; killed at {ago}; the last changes: {printed}") from error
        down = await asyncio.to_thread(manage, system, "down")
        assert down.returncode == 0, down.stdout + down.stderr
        caller.handled_once(tmp_path / "calls")

    with ended():
        run(main())


# Calls the service once for each line that it reads, at once, and prints who has handled it.
CLIENT = """
import sys
import rclpy
from rcl_interfaces.srv import ListParameters

rclpy.init()
node = rclpy.create_node("held_up")
client = node.create_client(ListParameters, "/source/count")
client.wait_for_service()
print("ready", flush=True)
for line in sys.stdin:
    future = client.call_async(ListParameters.Request(prefixes=[line.strip()]))
    rclpy.spin_until_future_complete(node, future)
    print(future.result().result.names[0], flush=True)
"""


@pytest.mark.full
def test_a_request_that_reaches_the_predecessor_alone_is_passed_on(tmp_path: Path) -> None:
    """A client that is held up during the change sends before it has discovered the successor, which handles that."""
    system = tmp_path / "system"

    async def main() -> None:
        await left_running(system, tmp_path)
        program = [sys.executable, "-c", CLIENT]
        with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
            try:
                assert client.stdin is not None and client.stdout is not None
                reply = client.stdout.readline
                assert await asyncio.to_thread(reply) == "ready\n"
                for number in range(2):
                    os.kill(client.pid, signal.SIGSTOP)
                    # Both instances run afterwards, and the new one answers.
                    await asyncio.to_thread(kill_the_manager, system, "detach", "1", "after")
                    client.stdin.write(f"{number}\n")
                    client.stdin.flush()
                    os.kill(client.pid, signal.SIGCONT)
                    answer = await asyncio.wait_for(asyncio.to_thread(reply), 60)
                    assert answer == f"source_{number + 2}\n"
            finally:
                client.kill()
        down = await asyncio.to_thread(manage, system, "down")
        assert down.returncode == 0, down.stdout + down.stderr

    with ended():
        run(main())

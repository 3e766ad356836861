"""A component's process on real ROS 1: its life, its own use of rospy, and what ROS's tools show of it."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros1_support import own_master_uri, program, rig, wait_for
from tests.backends.ros2_support import LISTENER, TALKER, alive, run, until, until_async

pytestmark = pytest.mark.ros1


def test_a_second_component_of_the_same_name_says_so_and_the_first_goes_on(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            second = await asyncio.to_thread(
                subprocess.run, [sys.executable, "talker.py"], cwd=tmp_path, capture_output=True, text=True, timeout=30
            )
            assert second.returncode == 1
            assert "a node /talker is running already" in second.stderr
            assert alive(r.pid("talker"))
            assert (await r.link.observe("talker"))["pid"] == r.pid("talker")

    run(scenario())


def test_without_a_master_it_says_how_to_get_one(tmp_path: Path) -> None:
    (tmp_path / "talker.py").write_text(TALKER)
    with own_master_uri():
        found = subprocess.run([sys.executable, "talker.py"], cwd=tmp_path, capture_output=True, text=True, timeout=30)
    assert found.returncode == 1
    assert "no ROS master answers" in found.stderr and "roscore" in found.stderr


ENDING = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: out.write(String(data="hello")), rate=20, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.on_stop(lambda: out.write(String(data="goodbye")))
comp.start()
"""


async def _by_command(r: Any) -> None:
    await r.link.change("talker", "stop")


async def _by_signal(r: Any) -> None:
    r.kill("talker", signal.SIGTERM)


async def _by_rosnode(r: Any) -> None:
    await asyncio.to_thread(subprocess.run, ["rosnode", "kill", "/talker"], timeout=20, check=True, capture_output=True)


@pytest.mark.parametrize("end", [_by_command, _by_signal, _by_rosnode])
def test_it_ends_in_order_whoever_asks(tmp_path: Path, end: Callable[[Any], Any]) -> None:
    heard = tmp_path / "heard"

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", ENDING)
            with program("bystander", "/chatter", str(heard)):
                await r.attach("talker", "out", "/chatter", peers=1)
                await r.modes("talker", talk="normal")
                await asyncio.to_thread(wait_for, heard, 3)
                await end(r)
                await until(lambda: r.exits)
                assert r.exits[0].status == 0, r.exits[0].log_tail
                assert wait_for(heard, 3)[-1] == "goodbye"
            assert await r.backend._master.address_of("/talker") is None

    run(scenario())


OWN_ENDS = """
import rospy
from midstride import Component
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

comp = Component("talker")
out = comp.create_output("out", String)
speed = comp.parameter("speed", 5, lambda value: None)
talk = comp.create_functionality("talk", outputs=[out])

async def normal():
    await comp.clock.sleep(0.02)
    out.write(String(data=str(speed.value)))

talk.set_normal_mode(normal, rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)

@comp.on_setup
def setup(node):
    comp.status = node.Publisher("~status", String, queue_size=1)
    node.Subscriber("/poke", String, lambda message: None)
    node.Service("own/ask", Trigger, lambda request: TriggerResponse(True, "yes"))

comp.start()
"""


def test_its_own_ends_are_listed_and_its_parameters_are_shown(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            announced = await r.start("talker", OWN_ENDS, parameters={"speed": 7})
            assert [(endpoint["kind"], endpoint["name"]) for endpoint in announced.endpoints] == [
                ("service", "/own/ask"),
                ("topic", "/poke"),
                ("topic", "/talker/status"),
            ]
            master = r.backend._master

            async def shown() -> Any:
                return await master.ask("getParam", "/test", "/talker/speed")

            async def shows(value: int) -> bool:
                return bool(await shown() == value)

            await until_async(lambda: shows(7))
            await r.link.change("talker", "set", parameters={"speed": 8})
            await until_async(lambda: shows(8))
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")  # an async mode
            assert (await r.link.read("talker", "await_write", 5.0, port="out", topic="/chatter"))["gated"] >= 1
            await r.backend.end("talker", 5.0)
            with pytest.raises(Exception, match="not set"):
                await shown()

    run(scenario())


@pytest.mark.full
def test_the_tools_of_ros_show_what_one_expects(tmp_path: Path) -> None:
    async def tool(*command: str) -> list[str]:
        found = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=20, check=True)
        return [line.strip() for line in found.stdout.splitlines()]

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)
            await r.attach("listener", "in", "/chatter")
            await r.attach("talker", "out", "/chatter", peers=1)
            nodes = await tool("rosnode", "list")
            assert {"/talker", "/listener"} < set(nodes)
            assert [name for name in nodes if name.startswith("/midstride_manager_")]
            told = await tool("rosnode", "info", "/talker")
            assert "* /chatter [std_msgs/String]" in told
            assert "* to: /listener" in told
            about = await tool("rostopic", "info", "/chatter")
            assert about[0] == "Type: std_msgs/String"
            assert [line.split()[1] for line in about if line.startswith("*")] == ["/talker", "/listener"]
            assert "/talker/midstride/command" in await tool("rosservice", "list")
            assert await tool("rosservice", "type", "/talker/midstride/command") == ["midstride/Command"]
            await r.modes("talker", talk="normal")
            assert (await tool("rostopic", "echo", "-n1", "/chatter"))[0].startswith('data: "')
            state = "\n".join(await tool("rostopic", "echo", "-n2", "/midstride/state"))
            assert "listener" in state and "functionalities" in state

    run(scenario())


@pytest.mark.full
def test_the_clock_of_a_simulation_drives_the_modes(tmp_path: Path) -> None:
    clock = """
import sys, rospy
from rosgraph_msgs.msg import Clock
rospy.init_node("clock", disable_rostime=True)
publisher = rospy.Publisher("/clock", Clock, queue_size=10, latch=True)
for line in sys.stdin:
    publisher.publish(Clock(rospy.Time.from_sec(float(line))))
"""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.backend._master.ask("setParam", "/test", "/use_sim_time", True)
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")

            async def state() -> Any:
                return await r.link.observe("talker")

            async def gated(count: int) -> bool:
                return int((await state())["ports"]["out"]["/chatter"]["gated"]) >= count

            assert "/clock" in (await state())["waiting"]
            assert not await gated(1)
            process = subprocess.Popen([sys.executable, "-c", clock], stdin=subprocess.PIPE, text=True)
            try:
                assert process.stdin is not None

                def at(seconds: float) -> None:
                    assert process.stdin is not None
                    process.stdin.write(f"{seconds}\n")
                    process.stdin.flush()

                at(100.0)
                await until_async(lambda: gated(1))
                assert (await state())["waiting"] is None
                grid = await r.link.read("talker", "grid", port="out")
                assert (grid["epoch"], grid["period"], grid["now"]) == (100_000_000_000, 0.02, 100_000_000_000)
                await asyncio.sleep(0.2)
                assert not await gated(2)  # time stands still
                for step in range(1, 6):
                    at(100.0 + 0.02 * step + 0.001)
                    await until_async(partial(gated, 1 + step))
            finally:
                process.kill()
                process.communicate()

    run(scenario())


def test_standalone_under_the_name_of_a_launch_file(tmp_path: Path) -> None:
    heard = tmp_path / "heard"

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            r.write("talker", TALKER)
            environment = {name: value for name, value in os.environ.items() if not name.startswith("MIDSTRIDE_")}
            command = [sys.executable, "talker.py", "--standalone", "out:=/alone", "__name:=soloist"]
            with program("bystander", "/alone", str(heard)):
                process = subprocess.Popen(
                    command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
                )
                try:
                    await asyncio.to_thread(wait_for, heard, 5)
                    assert "/soloist" in (await r.backend.endpoints()).nodes
                finally:
                    process.terminate()
                told, _ = await asyncio.to_thread(process.communicate, timeout=20)
                assert "runs alone, managed by nobody" in told
                assert process.returncode == 0

    run(scenario())


@pytest.mark.full
def test_peers_call_each_other_and_namespaces_are_kept(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("front/talker", TALKER, namespace="front")
            await r.start("listener", LISTENER)
            assert {"/front/talker", "/listener"} == (await r.backend.endpoints()).nodes
            await r.link.change("listener", "meet", timeout=5.0, peer="front/talker")
            with pytest.raises(Exception, match="nobody"):
                await r.link.change("listener", "meet", timeout=0.5, peer="nobody")

    run(scenario())

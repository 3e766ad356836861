"""A component's process on real ROS 1: its life, its author's use of rospy, and what ROS's tools show of it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import CommandRefused
from midstride.model.component import StopTimes
from midstride.wire.commands import (
    AwaitWriteCommand,
    GridCommand,
    MeetCommand,
    PingCommand,
    SetParametersCommand,
    StopCommand,
)
from midstride.wire.state import ComponentState
from tests.backends.ros1_support import own_master_uri, program, rig, wait_for
from tests.backends.ros2_support import LISTENER, TALKER, Rig, alive, run, until, until_async

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
            assert (await r.client.observe("talker")).pid == r.pid("talker")

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
    await r.client.change("talker", StopCommand())


async def _by_signal(r: Any) -> None:
    r.kill("talker", signal.SIGTERM)


async def _by_rosnode(r: Any) -> None:
    await asyncio.to_thread(subprocess.run, ["rosnode", "kill", "/talker"], timeout=20, check=True, capture_output=True)


@pytest.mark.parametrize("end", [_by_command, _by_signal, _by_rosnode])
def test_a_component_ends_in_order_however_it_is_ended(tmp_path: Path, end: Callable[[Any], Any]) -> None:
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


AUTHORS_ENDPOINTS = """
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
    node.Service("mine/ask", Trigger, lambda request: TriggerResponse(True, "yes"))

comp.start()
"""


def test_a_replacement_starts_with_what_was_set_at_run_time_and_the_server_shows_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", AUTHORS_ENDPOINTS, parameters={"speed": 7}, set_parameters={"speed": 8})
            master = r.backend._master

            async def shows(value: int) -> bool:
                return bool(await master.call("getParam", "/test", "/talker/speed") == value)

            await until_async(lambda: shows(8))
            assert (await r.client.observe("talker")).declared == {"speed": 7}
            await master.call("setParam", "/test", "/talker/speed", 5)  # only shown there
            assert (await r.client.observe("talker")).set_values() == {"speed": 8}
            await r.client.change("talker", SetParametersCommand(parameters={"speed": 9}, declared={}))
            assert (await r.client.observe("talker")).set_values() == {"speed": 9}
            await until_async(lambda: shows(9))

    run(scenario())


def test_the_authors_endpoints_are_listed_and_parameters_are_shown(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            _, registration = await r.start("talker", AUTHORS_ENDPOINTS, parameters={"speed": 7})
            assert [(endpoint.kind, endpoint.name) for endpoint in registration.endpoints] == [
                ("service", "/mine/ask"),
                ("topic", "/poke"),
                ("topic", "/talker/status"),
            ]
            master = r.backend._master

            async def shown() -> Any:
                return await master.call("getParam", "/test", "/talker/speed")

            async def shows(value: int) -> bool:
                return bool(await shown() == value)

            await until_async(lambda: shows(7))
            await r.client.change("talker", SetParametersCommand(parameters={"speed": 8}))
            await until_async(lambda: shows(8))
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")  # an async mode
            assert (await r.client.read("talker", AwaitWriteCommand(port="out", topic="/chatter"))).gated >= 1
            await r.backend.end("talker", StopTimes(0.0, 5.0))
            with pytest.raises(Exception, match="not set"):
                await shown()

    run(scenario())


@pytest.mark.full
def test_the_tools_of_ros_show_what_a_user_expects(tmp_path: Path) -> None:
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
            assert {"/talker", "/listener"} <= set(nodes)
            assert not [name for name in nodes if "midstride" in name], "the manager is no node"
            shown = await tool("rosnode", "info", "/talker")
            assert "* /chatter [std_msgs/String]" in shown
            assert "* to: /listener" in shown
            about = await tool("rostopic", "info", "/chatter")
            assert about[0] == "Type: std_msgs/String"
            assert [line.split()[1] for line in about if line.startswith("*")] == ["/talker", "/listener"]
            await r.modes("talker", talk="normal")
            assert (await tool("rostopic", "echo", "-n1", "/chatter"))[0].startswith('data: "')
            state = "\n".join(await tool("rostopic", "echo", "-n2", "/midstride/state"))
            assert "listener" in state and "functionalities" in state

    run(scenario())


# Every message on every topic, as it is on the wire.
EAVESDROPPER = """
import sys, rospy
rospy.init_node("eavesdropper")
heard = open(sys.argv[1], "ab", buffering=0)
for topic in sys.argv[2:]:
    rospy.Subscriber(topic, rospy.AnyMsg, lambda message: heard.write(message._buff))
rospy.spin()
"""


def test_nothing_in_the_graph_is_secret_or_takes_commands(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            master, heard = r.backend._master, tmp_path / "heard"
            topics = ("/midstride/state", "/rosout", "/chatter")
            with program(str(heard), *topics, source=EAVESDROPPER):
                await until_async(lambda: listed(r, "/eavesdropper"))
                await r.start("talker", AUTHORS_ENDPOINTS, parameters={"speed": 7})
                await r.start("listener", LISTENER)
                await r.attach("listener", "in", "/chatter")
                await r.attach("talker", "out", "/chatter", peers=1)
                await r.modes("talker", talk="normal")
                await r.client.change("talker", SetParametersCommand(parameters={"speed": 8}))
                await until(lambda: all(word in heard.read_bytes() for word in (b'"speed":8', b"is managed by")))
            state = await master.state()
            parameters = json.dumps(await master.call("getParam", "/test", "/"), default=str)
            assert '"speed": 8' in parameters
            for secret in (r.token, r.token.removeprefix("test-")):
                assert secret.encode() not in heard.read_bytes()
                assert secret not in parameters
                assert secret not in repr(state)
            ours = {"/talker", "/listener"}
            assert {topic for topic, nodes in state.subscribers.items() if ours & set(nodes)} == {"/chatter", "/poke"}
            services = {name for name, nodes in state.services.items() if ours & set(nodes)}
            loggers = {f"{node}/{name}" for node in ours for name in ("get_loggers", "set_logger_level")}
            assert services == {"/mine/ask", *loggers}

    async def listed(r: Rig, node: str) -> bool:
        return node in (await r.backend._master.state()).subscribers.get("/chatter", ())

    run(scenario())


def test_a_component_answers_before_rospy_has_joined_ros(tmp_path: Path) -> None:
    """Joining takes a tenth of a second, and longer with a slow master."""
    slow = """
import rospy, time
join = rospy.init_node
def slow(*arguments, **options):
    time.sleep(2.0)
    join(*arguments, **options)
rospy.init_node = slow
"""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.launch("talker", slow + TALKER)
            await asyncio.wait_for(r.client.connect("talker"), 20.0)
            await r.client.read("talker", PingCommand())
            assert "/talker" not in (await r.backend.endpoints()).nodes
            await r.welcome("talker")
            assert "/talker" in (await r.backend.endpoints()).nodes

    run(scenario())


@pytest.mark.parametrize("when", ["joining", "running"])
def test_a_signal_ends_it_in_order_at_any_time(tmp_path: Path, when: str) -> None:
    """While rospy joins, too, which may take for ever: then no code of the author runs any more."""
    source = """
import rospy, sys, time
join = rospy.init_node
def slow(*arguments, **options):
    print("joining", flush=True)
    time.sleep(0.1 if sys.argv[1] == "running" else 60.0)
    join(*arguments, **options)
rospy.init_node = slow
"""
    talker = TALKER.replace("comp.start()", 'comp.on_setup(lambda node: print("running", flush=True))\ncomp.start()')

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.launch("talker", source + talker, when)
            await until(lambda: when in r.log("talker"))
            r.kill("talker", signal.SIGTERM)
            await until(lambda: r.exits)
            assert r.exits[0].status == 0, r.exits[0].log_tail
            assert ("running" in r.log("talker")) == (when == "running")
            assert "Traceback" not in r.log("talker")
            assert await r.backend._master.address_of("/talker") is None

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
            await r.backend._master.call("setParam", "/test", "/use_sim_time", True)
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")

            async def state() -> ComponentState:
                return await r.client.observe("talker")

            async def gated(count: int) -> bool:
                return (await state()).ports["out"]["/chatter"].gated >= count

            assert "/clock" in ((await state()).waiting or "")
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
                assert (await state()).waiting is None
                grid = await r.client.read("talker", GridCommand(port="out"))
                assert (grid.epoch, grid.period, grid.now) == (100_000_000_000, 0.02, 100_000_000_000)
                await asyncio.sleep(0.2)
                assert not await gated(2)  # no time passes
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
                printed, _ = await asyncio.to_thread(process.communicate, timeout=20)
                assert "runs without a manager" in printed
                assert process.returncode == 0

    run(scenario())


@pytest.mark.full
def test_peers_call_each_other_and_namespaces_are_kept(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("front/talker", TALKER, namespace="front")
            await r.start("listener", LISTENER)
            assert {"/front/talker", "/listener"} == (await r.backend.endpoints()).nodes

            def meet(peer: str, timeout: float) -> MeetCommand:
                return MeetCommand(peer=peer, address=r.client.address(peer), timeout=timeout)

            await r.client.change("listener", meet("front/talker", 5.0))
            with pytest.raises(CommandRefused, match="nobody"):
                await r.client.change("listener", meet("nobody", 0.5))

    run(scenario())

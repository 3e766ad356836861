"""The component's side on real ROS 2: its parameters, its clock, its endpoints, its end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import BackendError, CommandRefused
from midstride.wire.commands import (
    AwaitWriteCommand,
    GridCommand,
    MeetCommand,
    RecordCommand,
    RecordsCommand,
    SetParametersCommand,
    WelcomeCommand,
)
from midstride.wire.environment import ENV_CONTROL, ENV_TOKEN
from midstride.wire.replies import Records
from midstride.wire.state import ComponentState, Endpoint
from tests.backends.ros2_support import (
    LISTENER,
    TALKER,
    Bare,
    Rig,
    alive,
    publishers_are_identified,
    rig,
    run,
    until,
    until_async,
    without_midstride,
)
from tests.native import c_compiler

pytestmark = pytest.mark.ros2

TUNED = """
from midstride import Component
from std_msgs.msg import String

comp = Component("tuned")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])

def gain_changed(value):
    if value < 0:
        raise ValueError("a gain below zero turns the robot over")

gain = comp.parameter("gain", 1.5, on_change=gain_changed)
label = comp.parameter("label", "plain", on_change=lambda value: None)
work.set_normal_mode(lambda: out.write(String(data=f"{gain.value} {label.value}")), rate=20, outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""


class Tools:
    """What ROS's own tools do with a node's parameters."""

    def __init__(self, bare: Bare, node: str) -> None:
        from rcl_interfaces import srv

        self._bare = bare
        self._srv = srv
        names = ("describe", "get", "list", "set", "set_atomically", "get_types")
        services = dict(
            zip(names, ("describe_parameters", "get_parameters", "list_parameters", "set_parameters"), strict=False)
        )
        services |= {"set_atomically": "set_parameters_atomically", "get_types": "get_parameter_types"}
        types = {
            "describe": srv.DescribeParameters,
            "get": srv.GetParameters,
            "list": srv.ListParameters,
            "set": srv.SetParameters,
            "set_atomically": srv.SetParametersAtomically,
            "get_types": srv.GetParameterTypes,
        }
        self._clients = {
            name: bare.node.create_client(types[name], f"{node}/{service}") for name, service in services.items()
        }
        self._types = types

    async def _ask(self, what: str, **fields: Any) -> Any:
        return await self._bare.ask(self._clients[what], self._types[what].Request(**fields))

    async def get(self, *names: str) -> list[Any]:
        from rclpy.parameter import parameter_value_to_python

        values = (await self._ask("get", names=list(names))).values
        return [parameter_value_to_python(value) for value in values]

    async def set(self, atomically: bool = False, **values: Any) -> list[tuple[bool, str]]:
        from rclpy.parameter import Parameter

        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()
        ]
        if atomically:
            result = (await self._ask("set_atomically", parameters=parameters)).result
            return [(result.successful, result.reason)]
        results = (await self._ask("set", parameters=parameters)).results
        return [(result.successful, result.reason) for result in results]

    async def names(self, *prefixes: str, depth: int = 0) -> list[str]:
        return sorted((await self._ask("list", prefixes=list(prefixes), depth=depth)).result.names)

    async def describe(self, *names: str) -> list[Any]:
        return list((await self._ask("describe", names=list(names))).descriptors)

    async def types(self, *names: str) -> list[int]:
        return list((await self._ask("get_types", names=list(names))).types)


def test_every_ros_tool_reads_the_state_and_none_can_set_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("tuned", TUNED)
            await r.attach("tuned", "out", "/told", gate="closed")
            with Bare() as bare:
                tools = Tools(bare, "/tuned")
                assert await tools.get("midstride.mode.work", "midstride.gate.out") == ["degraded", "/told: closed"]
                await r.modes("tuned", work="normal")
                assert await tools.get("midstride.mode.work", "gain") == ["normal", 1.5]
                before = await r.client.observe("tuned")
                (text,) = await tools.get("midstride.state")
                assert json.loads(text)["revision"] == before.revision
                assert await tools.get("midstride.mode.work", "no_such") == []

                for atomically in (False, True):
                    for name, value in {"mode__work": "degraded", "gate__out": "/told: open", "state": "{}"}.items():
                        ((done, reason),) = await tools.set(atomically, **{f"midstride__{name}": value})
                        assert not done
                        assert f"midstride.{name.replace('__', '.')}" in reason
                        assert "cannot be set" in reason
                ((done, reason),) = await tools.set(True, midstride__revision=7, gain=2.0)
                assert not done
                command = {"command": "modes", "modes": {"work": "degraded"}}
                ((done, reason),) = await tools.set(True, midstride__command=json.dumps(command))
                assert not done
                assert await tools.get("midstride.command") == []
                assert await tools.get("midstride.mode.work", "gain") == ["normal", 1.5]
                after = await r.client.observe("tuned")
                assert (after.revision, after.parameters) == (before.revision, before.parameters)
                assert after.functionalities["work"].mode == "normal"
                assert after.ports["out"]["/told"].gate == "closed"

                names = await tools.names()
                assert {"gain", "label", "use_sim_time", "midstride.state", "midstride.mode.work"} <= set(names)
                assert await tools.names("midstride.mode") == ["midstride.mode.work"]
                assert "midstride.mode.work" not in await tools.names(depth=1)
                state, own = await tools.describe("midstride.state", "gain")
                assert (state.read_only, own.read_only) == (True, False)
                assert await tools.types("midstride.state", "gain") == [4, 3]

    run(scenario())


def test_the_state_is_read_while_user_code_runs(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", STUCK)
            await r.modes("talker", talk="normal")
            await until(lambda: "stuck" in r.log("talker"))
            with Bare() as bare:
                assert await Tools(bare, "/talker").get("midstride.mode.talk") == ["normal"]

    run(scenario())


async def published(r: Rig, bare: Bare, heard: Callable[[], bool]) -> None:
    """Change modes until a change is heard: the first are lost while the publisher has not found its reader."""
    for mode in ("normal", "degraded") * 5:
        await r.modes("tuned", work=mode)
        with contextlib.suppress(AssertionError):
            await bare.until(heard, 2.0)
            return
    raise AssertionError("no change was published")


def test_no_secret_is_in_the_graph(tmp_path: Path) -> None:
    """Every parameter under ``midstride.`` and every event is public, so the token is in none of them."""

    async def scenario() -> None:
        from rcl_interfaces.msg import ParameterEvent

        async with rig(tmp_path) as r:
            with Bare() as bare:
                events: list[Any] = []
                bare.node.create_subscription(ParameterEvent, "/parameter_events", events.append, 1000)
                await r.launch("tuned", TUNED)
                tools = Tools(bare, "/tuned")
                await r.client.registered("tuned")
                before = await tools.get(*(name for name in await tools.names() if name.startswith("midstride.")))
                await r.client.change("tuned", WelcomeCommand(manager="a test"))
                await r.attach("tuned", "out", "/told")
                await r.modes("tuned", work="normal")
                names = [name for name in await tools.names() if name.startswith("midstride.")]
                assert {"midstride.state", "midstride.mode.work", "midstride.gate.out"} <= {*names}
                values = await tools.get(*names)
                await published(r, bare, lambda: "normal" in str(events))
                for public in (str(names), str(before), str(values), str(events), str(await tools.describe(*names))):
                    assert r.token not in public

    run(scenario())


def test_own_parameters_are_set_by_tools_and_by_the_manager_alike(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("tuned", TUNED, parameters={"gain": 3, "label": "given"})

            async def declared() -> Any:
                return (await r.client.observe("tuned")).parameters

            with Bare() as bare:
                tools = Tools(bare, "/tuned")
                assert await tools.get("gain", "label") == [3.0, "given"]
                assert await tools.set(gain=4.0) == [(True, "")]
                assert await declared() == {"gain": 4.0, "label": "given"}
                ((done, reason),) = await tools.set(gain=-1.0)
                assert (done, reason) == (False, "gain: a gain below zero turns the robot over")
                ((done, reason),) = await tools.set(True, label="other", gain=-1.0)
                assert not done
                ((done, _),) = await tools.set(no_such=1)
                assert not done
                assert await tools.get("gain", "label") == [4.0, "given"]
                assert await declared() == {"gain": 4.0, "label": "given"}

                replied = await r.client.change("tuned", SetParametersCommand(parameters={"gain": 5}))
                assert replied.before == {"gain": 4.0}
                assert await tools.get("gain") == [5.0]
                with pytest.raises(CommandRefused, match="turns the robot over"):
                    await r.client.change("tuned", SetParametersCommand(parameters={"label": "x", "gain": -2.0}))
                assert await tools.get("gain", "label") == [5.0, "given"]

    run(scenario())


LEAVING = """
from midstride import Component
from rcl_interfaces.msg import SetParametersResult

comp = Component("leaving")
work = comp.create_functionality("work")

def leave(what):
    raise SystemExit(f"no more of {what} \\udc80")

def changing(parameters):
    if any(parameter.name == "offset" for parameter in parameters):
        leave("offset")
    return SetParametersResult(successful=True)

@comp.on_setup
def setup(node):
    node.declare_parameter("offset", 0)
    node.add_on_set_parameters_callback(changing)

gain = comp.parameter("gain", 1, on_change=lambda value: leave("gain"))
work.set_normal_mode(lambda: None, rate=20)
work.set_degraded_mode(lambda: None)
comp.start()
"""


def test_a_callback_that_would_leave_rclpys_spin_refuses_the_parameter(tmp_path: Path) -> None:
    refusals = {
        "gain": "on_change of parameter gain raised SystemExit: no more of gain \\udc80",
        "offset": "SystemExit: no more of offset \\udc80",
    }

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("leaving", LEAVING)
            with Bare() as bare:
                tools = Tools(bare, "/leaving")
                assert await tools.set(gain=2, offset=2) == [
                    (False, f"gain: {refusals['gain']}"),
                    (False, refusals["offset"]),
                ]
                for name, words in refusals.items():
                    with pytest.raises(CommandRefused, match=re.escape(words)):
                        await r.client.change("leaving", SetParametersCommand(parameters={name: 2}))
                assert await tools.get("gain", "offset") == [1, 0]
            assert (await r.client.observe("leaving")).parameters == {"gain": 1, "offset": 0} and not r.exits

    run(scenario())


def test_what_is_set_at_run_time_is_in_the_state_at_once_and_a_replacement_starts_with_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            states: list[Any] = []
            r.client.listeners.append(states.append)
            given = {"gain": 3.0, "label": "given"}
            await r.start("tuned", TUNED, parameters=given, set_parameters={"gain": 4.0})
            with Bare() as bare:
                tools = Tools(bare, "/tuned")
                assert await tools.get("gain", "label") == [4.0, "given"]
                state = await r.client.observe("tuned")
                assert (state.parameters, state.declared) == ({"gain": 4.0, "label": "given"}, {"gain": 3.0})
                assert await tools.set(label="set") == [(True, "")]
                await until(lambda: states[-1].set_values() == {"gain": 4.0, "label": "set"})
                assert states[-1].revision == state.revision, "the manager's commands are still expected at it"
                events: list[tuple[str, Any]] = []
                hear_parameters(bare, events)
                await bare.until(lambda: bare.node.count_publishers("/parameter_events") > 2)
                for value in range(100):  # the first may be lost
                    await r.client.change("tuned", SetParametersCommand(parameters={"gain": float(value)}, declared={}))
                    asked = time.monotonic()
                    await bare.until(lambda asked=asked: events or time.monotonic() > asked + 0.1)  # type: ignore[misc]
                    if events:
                        break
                assert events[-1] == ("/tuned", float(value))
                assert await tools.set(gain=3.0) == [(True, "")]
                await until(lambda: states[-1].set_values() == {"label": "set"})

    run(scenario())


def test_a_list_is_set_by_tools_as_well(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            listed = TUNED.replace('"label", "plain"', '"label", [0.5]')
            await r.start("tuned", listed, parameters={"label": [1.0]}, set_parameters={"label": [1.5, 2.5]})
            assert (await r.client.observe("tuned")).set_values() == {"label": [1.5, 2.5]}
            with Bare() as bare:
                tools = Tools(bare, "/tuned")
                assert await tools.set(label=[2.0, 3.0]) == [(True, "")]
                assert (await r.client.observe("tuned")).set_values() == {"label": [2.0, 3.0]}
                await r.client.change("tuned", SetParametersCommand(parameters={"label": [4]}, declared={}))
                assert [list(value) for value in await tools.get("label")] == [[4.0]]

    run(scenario())


ON_THE_NODE = """
@comp.on_setup
def declare(node):
    node.declare_parameter("speed", 0.5)
    node.declare_parameter("frames", ["base"])
    node.declare_parameter("inner", 1)
    node.declare_parameter("limit", float("inf"))
    node.set_parameters([Parameter("inner", value=2)])

comp.start()
"""


def test_parameters_of_the_node_itself_are_in_the_state_and_a_replacement_starts_with_them(tmp_path: Path) -> None:
    text = TUNED.replace("comp.start()", ON_THE_NODE).replace(
        "import String", "import String\nfrom rclpy.parameter import Parameter"
    )
    declared = {"gain": 1.5, "label": "plain"}

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            states: list[Any] = []
            r.client.listeners.append(states.append)
            await r.start("tuned", text, set_parameters={"speed": 0.7, "frames": [], "use_sim_time": False})
            state = await r.client.observe("tuned")
            node = {"speed": 0.7, "frames": ["base"], "inner": 2, "limit": {"float": "inf"}}
            assert (state.parameters, state.declared) == (declared | node, {"speed": 0.5})
            await r.client.change("tuned", SetParametersCommand(parameters={"frames": []}, declared={}))
            with Bare() as bare:
                tools = Tools(bare, "/tuned")
                assert await tools.get("speed", "frames", "limit") == [0.7, [], float("inf")]
                assert await tools.set(inner=3, use_sim_time=True) == [(True, ""), (True, "")]
                changed = {"speed": 0.7, "frames": [], "inner": 3, "use_sim_time": True}
                await until(lambda: states[-1].set_values() == changed)
                assert states[-1].declared == {"speed": 0.5, "frames": ["base"], "inner": 1, "use_sim_time": False}
                replied = await r.client.change("tuned", SetParametersCommand(parameters={"speed": 0.9}))
                assert replied.before == {"speed": 0.7}
                assert "speed" not in (await r.client.observe("tuned")).set_values(), "the file says so"

    run(scenario())


def hear_parameters(bare: Bare, events: list[tuple[str, Any]]) -> None:
    """Append the node and the value of each change of a `gain` that is published."""
    from rcl_interfaces.msg import ParameterEvent

    def on_parameters(event: Any) -> None:
        for parameter in event.changed_parameters:
            if parameter.name == "gain":
                events.append((event.node, parameter.value.double_value))

    bare.node.create_subscription(ParameterEvent, "/parameter_events", on_parameters, 100)


def test_changes_are_published_on_parameter_events(tmp_path: Path) -> None:
    async def scenario() -> None:
        from rcl_interfaces.msg import ParameterEvent

        async with rig(tmp_path) as r:
            with Bare() as bare:
                heard: dict[str, list[Any]] = {}

                def on_parameters(event: Any) -> None:
                    for parameter in event.changed_parameters:
                        heard.setdefault(f"{event.node} {parameter.name}", []).append(parameter.value.string_value)

                bare.node.create_subscription(ParameterEvent, "/parameter_events", on_parameters, 100)
                starting = asyncio.ensure_future(r.start("tuned", TUNED))
                await bare.until(starting.done)
                await bare.until(lambda: bare.node.count_publishers("/parameter_events") > 2)
                await published(r, bare, lambda: "normal" in heard.get("/tuned midstride.mode.work", []))
                assert json.loads(heard["/tuned midstride.state"][-1])["instance"] == "tuned"

    run(scenario())


STOPPING = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: out.write(String(data="going")), rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.on_stop(lambda: out.write(String(data="stopped")))
comp.start()
print("after start")
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_in_order_and_the_last_words_are_heard(tmp_path: Path, number: signal.Signals) -> None:
    async def scenario() -> None:
        from std_msgs.msg import String

        async with rig(tmp_path) as r:
            with Bare() as bare:
                heard: list[str] = []
                bare.node.create_subscription(String, "/said", lambda message: heard.append(message.data), 10)
                starting = asyncio.ensure_future(r.start("talker", STOPPING))
                await bare.until(starting.done)
                await r.attach("talker", "out", "/said", peers=1)
                await r.modes("talker", talk="normal")
                await bare.until(lambda: len(heard) > 5)
                r.kill("talker", number)
                await bare.until(lambda: heard[-1] == "stopped" and r.exits)
                assert r.exits[0].status == 0
                assert "after start" in r.log("talker")

    run(scenario())


STUCK = TALKER.replace(
    "    global count\n", "    print('stuck', flush=True)\n    while True: __import__('time').sleep(60)\n"
)


@pytest.mark.full
def test_user_code_that_never_returns_does_not_keep_the_process(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", STUCK)
            await r.attach("talker", "out", "/chatter")
            await r.modes("talker", talk="normal")
            await until(lambda: "stuck" in r.log("talker"))
            r.kill("talker", signal.SIGTERM)
            await until(lambda: r.exits, 30.0)
            assert "has not returned" in r.log("talker")
            assert r.exits[0].status == 0

    run(scenario())


@pytest.mark.full
def test_the_second_signal_ends_it_at_once(tmp_path: Path) -> None:
    source = STOPPING.replace(
        'comp.on_stop(lambda: out.write(String(data="stopped")))',
        "comp.on_stop(lambda: (print('stopping', flush=True), __import__('time').sleep(60)), timeout=50)",
    )

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", source)
            r.kill("talker", signal.SIGINT)
            await until(lambda: "stopping" in r.log("talker"))
            r.kill("talker", signal.SIGINT)
            await until(lambda: r.exits)  # sooner than the 50 s that stopping may take
            assert r.exits[0].status == -signal.SIGINT

    run(scenario())


@pytest.mark.full
def test_a_component_that_shuts_ros_down_says_so_and_ends(tmp_path: Path) -> None:
    source = TALKER.replace("    global count\n", "    __import__('rclpy').shutdown()\n    global count\n")

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", source)
            with contextlib.suppress(BackendError):  # whether the answer still gets out is chance
                await r.modes("talker", talk="normal")
            await until(lambda: r.exits, 30.0)
            assert r.exits[0].status == 1
            assert "rclpy was shut down from within the component" in r.exits[0].log_tail

    run(scenario())


@pytest.mark.full
@pytest.mark.parametrize(
    "started_by",
    ["hand", "hand, discovered late", "a manager of another system", "a manager of this system"],
)
def test_a_second_component_of_the_same_name_says_so_and_ends(tmp_path: Path, started_by: str) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            if started_by == "hand, discovered late":  # after it has joined
                blind = "import midstride.backends.ros2.component.node_threads as nodes\nnodes.LOOK_BEFORE = -1.0\n"
                r.write("talker", blind + TALKER)
            from midstride.backends.ros2 import middleware

            await asyncio.sleep(
                middleware.of_this_process().name_delay
            )  # of two that join together, either may give way
            environment, words = without_midstride(), "a node /talker is running already"
            if started_by == "a manager of another system":
                environment |= {ENV_TOKEN: "the token of that system", ENV_CONTROL: str(tmp_path / "another")}
            if started_by == "a manager of this system":
                environment |= {ENV_TOKEN: r.token, ENV_CONTROL: str(tmp_path / "components")}
                words = "a component talker is running already"
            second = await asyncio.to_thread(
                subprocess.run,
                [sys.executable, "talker.py"],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                timeout=30,
                check=False,
            )
            assert second.returncode == 1
            assert words in second.stderr
            assert alive(r.pid("talker"))
            assert (await r.client.observe("talker")).pid == r.pid("talker")

    run(scenario())


@pytest.mark.full
def test_the_clock_of_a_simulation_drives_the_modes(tmp_path: Path) -> None:
    async def scenario() -> None:
        from rosgraph_msgs.msg import Clock

        async with rig(tmp_path) as r:
            with Bare() as bare:
                clock = bare.node.create_publisher(Clock, "/clock", 10)
                starting = asyncio.ensure_future(r.start("talker", TALKER, parameters={"use_sim_time": True}))
                await bare.until(starting.done)
                await r.attach("talker", "out", "/chatter", gate="closed")
                await r.modes("talker", talk="normal")
                await bare.until(lambda: clock.get_subscription_count() > 0)

                async def state() -> ComponentState:
                    return await r.client.observe("talker")

                async def gated() -> int:
                    return (await r.link("talker", "out", "/chatter")).gated

                assert "/clock" in ((await state()).waiting or "")
                assert await gated() == 0

                def at(seconds: float) -> None:
                    message = Clock()
                    message.clock.sec, message.clock.nanosec = int(seconds), round(seconds % 1 * 1e9)
                    clock.publish(message)

                async def send_until(seconds: float, reached: Callable[[], Awaitable[bool]]) -> None:
                    """Send the time until the component has it: the subscription to `/clock` is best effort, and may be
                    matched later on its side than on ours."""
                    while not await reached():
                        at(seconds)
                        await asyncio.sleep(0.02)

                async def wrote(count: int) -> bool:
                    return await gated() >= count

                await send_until(100.0, lambda: wrote(1))
                assert (await state()).waiting is None
                grid = await r.client.read("talker", GridCommand(port="out"))
                assert (grid.epoch, grid.period, grid.now) == (100_000_000_000, 0.02, 100_000_000_000)
                await asyncio.sleep(0.2)
                assert await gated() == 1  # time stands still
                for step in range(1, 6):
                    await send_until(100.0 + 0.02 * step + 0.001, lambda step=step: wrote(1 + step))  # type: ignore[misc]

                async def back() -> bool:
                    return (await r.client.read("talker", GridCommand(port="out"))).now == 50_000_000_000

                await send_until(50.0, back)  # the recording starts again
                await send_until(50.021, lambda: wrote(7))

    run(scenario())


SET_BACK = r"""
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
    long failed = syscall(SYS_clock_gettime, clock, now);
    if (clock == CLOCK_REALTIME && access(getenv("SET_BACK"), F_OK) == 0)
        now->tv_sec -= 1000;
    return failed;
}
"""

WAITING = """
pause = comp.create_functionality("pause")

async def waiting():
    print("it waits", flush=True)
    await comp.clock.sleep(3)
    print("it has waited", flush=True)

pause.set_normal_mode(waiting, rate=0.001)
pause.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.full
def test_a_system_clock_that_is_set_back_silences_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing writes on /clock, rcl does not notice, and waits until the clock is where it was."""
    compiler = c_compiler()
    source, library, set_back = tmp_path / "clock.c", tmp_path / "clock.so", tmp_path / "set back"
    source.write_text(SET_BACK, encoding="utf-8")
    subprocess.run([*compiler, "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("SET_BACK", str(set_back))

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER.replace("comp.start()\n", WAITING))
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")

            async def gated() -> int:
                return (await r.link("talker", "out", "/chatter")).gated

            await until_async(lambda: greater(gated, 10))
            await r.modes("talker", pause="normal")
            await until(lambda: "it waits" in r.log("talker"))
            set_back.touch()
            before = await gated()
            await until_async(lambda: greater(gated, before + 100), 30.0)
            await until(lambda: "it has waited" in r.log("talker"), 30.0)

    async def greater(count: Callable[[], Awaitable[int]], than: int) -> bool:
        return await count() > than

    run(scenario())


OWN_ENDS = """
from midstride import Component
from std_msgs.msg import String
from rcl_interfaces.srv import ListParameters

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: out.write(String(data="x")), rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)

def broken(message):
    raise RuntimeError("a callback of the author's own")

@comp.on_setup
def setup(node):
    comp.publisher = node.create_publisher(String, "~/status", 10)
    node.create_subscription(String, "/poke", broken, 10)
    node.create_service(ListParameters, "own/list", lambda request, response: response)
    comp.client = node.create_client(ListParameters, "/elsewhere/list")

comp.start()
"""


def test_endpoints_that_are_no_ports_are_listed(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            _, registration = await r.start("talker", OWN_ENDS)
            assert [(endpoint.kind, endpoint.name, endpoint.serves) for endpoint in registration.endpoints] == [
                ("service", "/elsewhere/list", False),
                ("service", "/own/list", True),
                ("topic", "/poke", None),
                ("topic", "/talker/status", None),
            ]

    run(scenario())


def test_the_ros_actions_of_this_process_are_listed_and_none_of_another_with_a_node_of_that_name() -> None:
    """No package with a ROS action's type is part of the test environment, so each end has its status topic alone."""
    from rclpy.node import Node
    from std_msgs.msg import String

    from midstride.backends.ros2 import middleware
    from midstride.backends.ros2.component.node_parameters import endpoints

    async def scenario() -> None:
        with Bare("acting") as bare, Bare("acting") as other:
            control = Node("_acting_control", context=bare.context, use_global_arguments=False)
            control.create_publisher(String, "/acting/dock/_action/status", 1)
            control.create_subscription(String, "/go/_action/status", lambda message: None, 1)
            other.node.create_publisher(String, "/acting/undock/_action/status", 1)
            await bare.until(lambda: bare.node.count_publishers("/acting/undock/_action/status"))
            assert endpoints(bare.node, "/_acting_control", set(), middleware.of_this_process()) == [
                Endpoint(kind="ROS action", name="/acting/dock", serves=True),
                Endpoint(kind="ROS action", name="/go", serves=False),
            ]
            unknown = endpoints(bare.node, "/_acting_control", set(), middleware.of_identifier("rmw_zenoh_cpp"))
            assert unknown == [], "where processes are unknown, those of two nodes of a name are not told apart"
            control.destroy_node()

    run(scenario())


@pytest.mark.parametrize("raised", ['RuntimeError("', 'SystemExit("', 'RuntimeError("\\udc80'])
def test_what_the_authors_own_callbacks_raise_does_not_take_the_component_down(tmp_path: Path, raised: str) -> None:
    async def scenario() -> None:
        from std_msgs.msg import String

        async with rig(tmp_path) as r:
            await r.start("talker", OWN_ENDS.replace('RuntimeError("', raised))
            await r.attach("talker", "out", "/chatter", gate="closed")
            await r.modes("talker", talk="normal")
            with Bare() as bare:
                poke = bare.node.create_publisher(String, "/poke", 10)
                await bare.until(lambda: poke.get_subscription_count() > 0)
                while "a callback of the author's own" not in r.log("talker"):
                    poke.publish(String(data="now"))
                    await asyncio.sleep(0.05)

            async def gated() -> int:
                return (await r.link("talker", "out", "/chatter")).gated

            before = await gated()
            while await gated() == before:
                await asyncio.sleep(0.01)

    run(scenario())


@pytest.mark.full
def test_a_component_whose_data_thread_ends_says_so_and_ends(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.launch("talker", TALKER.replace("    global count\n", "    raise KeyboardInterrupt\n"))
            await r.welcome("talker")
            with contextlib.suppress(BackendError):  # whether the answer still gets out is chance
                await r.modes("talker", talk="normal")
            await until(lambda: r.exits, 30.0)
            assert r.exits[0].status == 1
            assert "the thread of the author's callbacks has ended" in r.exits[0].log_tail
            assert "KeyboardInterrupt" in r.log("talker")

    run(scenario())


@pytest.mark.fast_dds
@pytest.mark.full
def test_an_input_records_what_the_middleware_tells(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)
            await r.attach("listener", "in", "/chatter")
            await r.attach("talker", "out", "/chatter", peers=1)
            await r.client.change("listener", RecordCommand(inputs=["in"], on=True))
            await r.modes("talker", talk="normal")
            begun = time.time_ns()

            async def recorded() -> Records:
                return await r.client.read("listener", RecordsCommand(input="in"))

            while len((await recorded()).rows) < 20:
                await asyncio.sleep(0.02)
            records = await recorded()
            identity = publishers_are_identified()
            assert records.publisher_identity is identity
            numbers = [row.number or 0 for row in records.rows]
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            assert numbers[0] == 1
            sources = [row.source or 0 for row in records.rows]
            assert sources == sorted(sources)
            assert abs(sources[0] - begun) < 5_000_000_000
            publishers = {row.publisher for row in records.rows}
            assert len(publishers) == 1
            assert (None in publishers) is not identity

    run(scenario())


ASYNCHRONOUS = """
from midstride import Component
from std_msgs.msg import String
from rcl_interfaces.srv import ListParameters

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])

@comp.on_setup
def setup(node):
    comp.client = node.create_client(ListParameters, "/other/list_parameters")

async def normal():
    while not comp.client.service_is_ready():  # a request sent before that gets no answer
        await comp.clock.sleep(0.05)
    answer = await comp.client.call_async(ListParameters.Request())
    out.write(String(data=str(len(answer.result.names))))

talk.set_normal_mode(normal, rate=5, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.full
def test_an_async_mode_awaits_a_service(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", ASYNCHRONOUS)
            await r.start("other", TALKER)
            await r.attach("talker", "out", "/counted", gate="closed")
            await r.modes("talker", talk="normal")
            written = await r.client.read("talker", AwaitWriteCommand(timeout=30.0, port="out", topic="/counted"))
            assert written.gated >= 1
            await r.modes("talker", talk="degraded")

    run(scenario())


QOS = """
from midstride import Component
from midstride.model.contract import QoS
from std_msgs.msg import String

comp = Component("talker")
first = comp.create_output("first", String, qos=QoS(
    reliability="best_effort", durability="transient_local", deadline=0.5, liveliness="manual_by_topic", lease=2.0,
    depth=3))
second = comp.create_output("second", String)
talk = comp.create_functionality("talk", outputs=[first, second])
talk.set_normal_mode(lambda: None, rate=1, outputs=[first, second])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


def test_endpoints_get_the_qos_that_is_declared(tmp_path: Path) -> None:
    async def scenario() -> None:
        from rclpy.duration import Duration
        from rclpy.qos import DurabilityPolicy, LivelinessPolicy, ReliabilityPolicy

        async with rig(tmp_path) as r:
            await r.start("talker", QOS)
            await r.attach("talker", "first", "/first")
            await r.attach("talker", "second", "/second")
            with Bare() as bare:
                await bare.until(lambda: all(bare.node.get_publishers_info_by_topic(t) for t in ("/first", "/second")))
                (first,) = bare.node.get_publishers_info_by_topic("/first")
                (second,) = bare.node.get_publishers_info_by_topic("/second")
                assert first.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                assert first.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                assert first.qos_profile.deadline == Duration(nanoseconds=500_000_000)
                assert first.qos_profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
                assert first.qos_profile.liveliness_lease_duration == Duration(seconds=2)
                assert second.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                assert second.qos_profile.durability == DurabilityPolicy.VOLATILE

    run(scenario())


@pytest.mark.full
def test_attaching_waits_for_compatible_peers_alone(tmp_path: Path) -> None:
    async def scenario() -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            with Bare() as bare:
                demanding = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                bare.node.create_subscription(String, "/chatter", lambda message: None, demanding)

                with pytest.raises(CommandRefused, match="0 of 1"):
                    await r.attach("talker", "out", "/chatter", peers=1, timeout=1.0)
                bare.node.create_subscription(String, "/chatter", lambda message: None, 10)
                await r.attach("talker", "out", "/chatter", peers=1, timeout=1.0)

    run(scenario())


@pytest.mark.full
def test_acknowledgement_is_unknown_where_a_reader_has_frozen(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)
            await r.attach("listener", "in", "/chatter")
            await r.attach("talker", "out", "/chatter", peers=1)
            await r.modes("talker", talk="normal")

            async def has_written(count: int) -> bool:
                return (await r.link("talker", "out", "/chatter")).count >= count

            await until_async(lambda: has_written(1))
            r.kill("listener", signal.SIGSTOP)
            before = (await r.link("talker", "out", "/chatter")).count
            await until_async(lambda: has_written(before + 5))
            detaching = asyncio.ensure_future(r.detach("talker", "out", "/chatter", timeout=1.0))
            await r.client.peek("talker")
            assert not detaching.done(), "everything stopped until the acknowledgement was given up"
            assert (await detaching).acknowledged is None
            r.kill("listener", signal.SIGCONT)

    run(scenario())


def test_the_process_of_a_component_imports_nothing_of_the_manager_and_no_ros_actions() -> None:
    """Imports delay each start: on jazzy, ``rclpy.action`` alone brings in 84 modules of NumPy."""
    code = """
import sys, midstride
midstride.Component
import midstride.backends.ros2.component.host
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    modules = done.stdout.split()
    packages = {name.split(".")[1] for name in modules if name.startswith("midstride.")}
    assert "rclpy.node" in modules
    assert "rclpy.action" not in modules
    assert "backends" in packages
    assert not packages & {"capture", "cli", "lang", "plan", "runtime", "server", "verdicts", "verify"}


def test_standalone(tmp_path: Path) -> None:
    async def scenario() -> None:
        from std_msgs.msg import String

        (tmp_path / "talker.py").write_text(TALKER)
        command = [sys.executable, "talker.py", "--standalone", "out:=/alone", "--ros-args", "-r", "__node:=soloist"]
        with (
            Bare() as bare,
            subprocess.Popen(
                command,
                cwd=tmp_path,
                env=without_midstride(),
                stderr=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                text=True,
            ) as process,
        ):
            heard: list[str] = []
            bare.node.create_subscription(String, "/alone", lambda message: heard.append(message.data), 10)
            try:
                await bare.until(lambda: len(heard) > 5 and "soloist" in bare.node.get_node_names())
            finally:
                process.terminate()
            _, words = process.communicate(timeout=20)
            assert "runs without a manager" in words
            assert process.returncode == 0

    run(scenario())


@pytest.mark.full
def test_peers_call_each_other(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.start("listener", LISTENER)

            async def meet(peer: str) -> None:
                command = MeetCommand(peer=peer, address=r.client.address(peer), timeout=0.5)
                await r.client.change("talker", command)

            await meet("listener")
            with pytest.raises(CommandRefused, match="nobody"):
                await meet("nobody")

    run(scenario())

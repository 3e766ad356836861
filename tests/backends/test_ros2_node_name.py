"""The instances of a role share its node's name on ROS 2, and one of them answers."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2 import names
from midstride.errors import StartFailed
from midstride.node.request_admission import RequestAdmission
from midstride.wire.commands import AnswerCommand
from midstride.wire.environment import ENV_CONTROL
from tests.backends.counting import COUNTING, Caller
from tests.backends.ros2_support import Bare, Rig, rig, run, until_async, without_midstride
from tests.backends.test_ros2_host import Tools

pytestmark = pytest.mark.ros2


async def answers(r: Rig, new: str, old: str | None) -> None:
    """Have ``new`` answer instead of ``old``, which has exited if None."""
    command = AnswerCommand(peer=old or "", address=None if old is None else r.client.address(old))
    await r.client.change(new, command)


async def start_both(r: Rig) -> None:
    await r.start("counter", COUNTING, node="counter")
    await r.start("counter_2", COUNTING, node="counter", standby=True)


@pytest.mark.full
def test_the_clients_of_a_node_reach_its_replacement(tmp_path: Path) -> None:
    """Parameters, the state that is shown as parameters, and the author's own service; the graph shows both nodes."""

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("counter", COUNTING, node="counter")
            with Bare() as bare:
                tools, caller = Tools(bare, "/counter"), Caller(bare.node, "/counter/count", clients=1)

                async def instance() -> Any:
                    (state,) = await tools.get("midstride.state")
                    return json.loads(state)["instance"]

                assert await tools.set(gain=2.0) == [(True, "")]
                assert await instance() == "counter"
                await r.start("counter_2", COUNTING, node="counter", standby=True)
                await bare.until_named("counter", 2)
                assert "counter_2" not in bare.node.get_node_names()
                assert await tools.set(gain=3.0) == [(True, "")]
                parameters = {name: (await r.client.observe(name)).parameters for name in ("counter", "counter_2")}
                assert parameters == {"counter": {"gain": 3.0}, "counter_2": {"gain": 1.0}}

                await answers(r, "counter_2", "counter")
                states = {name: await r.client.observe(name) for name in ("counter", "counter_2")}
                assert {name: state.answers for name, state in states.items()} == {"counter": False, "counter_2": True}
                assert {state.node for state in states.values()} == {"/counter"}
                assert await instance() == "counter_2"
                assert await tools.set(gain=4.0) == [(True, "")]
                parameters = {name: (await r.client.observe(name)).parameters for name in ("counter", "counter_2")}
                assert parameters == {"counter": {"gain": 3.0}, "counter_2": {"gain": 4.0}}

                await bare.until(caller.ready)
                caller.step()
                await bare.until(caller.finished)
                assert caller.answered == {"counter_2": 1}

                # The manager knows them by their instances.
                await until_async(lambda: r.shows_node("/counter"))
                await until_async(lambda: r.shows_node("/counter_2"))
                await r.attach("counter_2", "out", "/counted")
                await until_async(lambda: r.shows_writer("/counter_2", "/counted"))
                r.kill("counter")
                await until_async(lambda: not_shown(r, "/counter"))
                assert await r.shows_node("/counter_2")

    run(scenario())


async def not_shown(r: Rig, node: str) -> bool:
    return node not in (await r.backend.endpoints()).nodes


@pytest.mark.full
def test_each_request_is_handled_once_while_the_instances_change(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await start_both(r)
            with Bare() as bare:
                caller = Caller(bare.node, "/counter/count")
                await bare.until(lambda: caller.ready() and bare.node.count_services("/counter/count") == 2)

                async def change() -> None:
                    for _ in range(20):
                        for new, old in (("counter_2", "counter"), ("counter", "counter_2")):
                            before = caller.answered.total()
                            while caller.answered.total() < before + 20:
                                await asyncio.sleep(0.001)
                            await answers(r, new, old)

                changing = asyncio.ensure_future(change())
                while not changing.done():
                    caller.step()
                    await bare.spin()
                await changing
                await bare.until(caller.finished)
            assert caller.answered["counter"] > 100 and caller.answered["counter_2"] > 100
            caller.handled_once(tmp_path / "calls")

    run(scenario())


@pytest.mark.full
@pytest.mark.parametrize("foreign", ["a node", "an instance of another system"])
def test_a_foreign_node_of_the_roles_name_is_found_although_an_instance_has_it(tmp_path: Path, foreign: str) -> None:
    async def scenario() -> None:
        (tmp_path / "ours").mkdir()
        (tmp_path / "theirs").mkdir()
        async with rig(tmp_path / "ours") as r, rig(tmp_path / "theirs") as other:
            if foreign == "a node":
                from midstride.backends.ros2 import middleware

                await r.start("counter", COUNTING, node="counter")
                await asyncio.sleep(
                    middleware.of_this_process().name_delay
                )  # of two that join together, either may give way
                with Bare("counter"):
                    told = middleware.of_this_process().fast_dds
                    await refused_soon(r, f"it is process {os.getpid()} " if told else "whose it is, is not known: ")
            else:
                await other.start("counter_3", COUNTING, node="counter")
                await until_async(lambda: r.shows_node("/counter_3"))
                whose = f"it is counter_3 of the Midstride system theirs ({tmp_path / 'theirs'}), process "
                await refused_soon(r, whose)

    run(scenario())


@pytest.mark.full
@pytest.mark.long
@pytest.mark.parametrize("whose", ["the system's", "another's"])
def test_a_component_that_has_just_started_stays_beside_a_node_of_its_name_that_the_system_has_started(
    tmp_path: Path, whose: str
) -> None:
    """As its replacement without the API, whose program names its node itself; any other node has it end."""

    async def scenario() -> None:
        from midstride.backends.ros2 import middleware
        from midstride.backends.ros2.component.node_threads import LEAVING

        async with rig(tmp_path) as r:
            system = names.system_tag(r.token if whose == "the system's" else "the token of that system")
            await r.start("counter", COUNTING, node="counter")
            with Bare("counter", ["--ros-args", "--enclave", names.enclave_of(system, "counter_2")]):
                deadline = time.monotonic() + middleware.of_this_process().name_delay + 2 * LEAVING
                while not r.exits and time.monotonic() < deadline:
                    await asyncio.sleep(0.05)
            if whose == "the system's":
                assert not r.exits
            else:
                assert "a node /counter is running already" in r.exits[0].log_tail

    run(scenario())


async def refused_soon(r: Rig, whose: str) -> None:
    """A replacement is not started once the foreign node is in the graph; the message says ``whose`` it is."""
    await until_async(lambda: r.backend._foreign("/counter", names.system_tag(r.token)))
    with pytest.raises(StartFailed, match=re.escape(f"counter_2: a node /counter is running already: {whose}")):
        await r.launch("counter_2", COUNTING, node="counter", standby=True)


@pytest.mark.full
def test_a_component_started_by_hand_is_replaced_under_its_name(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            r.write("counter", COUNTING)
            environment = without_midstride() | {ENV_CONTROL: str(r.backend.transport.folder)}
            with subprocess.Popen([sys.executable, "counter.py"], cwd=tmp_path, env=environment) as process:
                try:
                    await r.welcome("counter")
                    await until_async(lambda: r.shows_node("/counter"))
                    await r.start("counter_2", COUNTING, node="counter", standby=True)
                    await answers(r, "counter_2", "counter")
                    assert [(await r.client.observe(name)).answers for name in ("counter", "counter_2")] == [
                        False,
                        True,
                    ]
                finally:
                    process.terminate()
                    process.wait(20)

    run(scenario())


def test_requests_to_a_ros_action_are_handled_by_one_server_each() -> None:
    """No package with a ROS action's type is part of the test environment, so the servers and requests are planted."""
    from midstride.backends.ros2.component.action_endpoints import guard_action

    class Server:
        def __init__(self, *, is_open: bool) -> None:
            self.handled: list[str] = []
            self.admission = RequestAdmission(time.monotonic_ns, is_open=is_open)
            self._result_futures: dict[bytes, Any] = {}
            self._handle = SimpleNamespace(process_cancel_request=None, send_cancel_response=lambda *_: None)
            guard_action(self, self.admission, lambda work: asyncio.run(work()))

        async def execute(self, taken: dict[str, Any]) -> None:
            self.handled += taken

        async def _execute_cancel_request(self, entry: Any) -> None:
            self.handled.append("cancel")
            self._handle.send_cancel_response(None, SimpleNamespace(return_code=0))

    def request(goal: int, number: int, *, cancels: bool = False) -> tuple[Any, Any]:
        goal_id = SimpleNamespace(uuid=[goal] * 16)
        stamp = SimpleNamespace(sec=0, nanosec=0)
        body = {"goal_info": SimpleNamespace(goal_id=goal_id, stamp=stamp)} if cancels else {"goal_id": goal_id}
        return SimpleNamespace(sequence_number=number), SimpleNamespace(**body)

    old, new = Server(is_open=True), Server(is_open=False)
    both: list[dict[str, Any]] = [{"goal": request(1, 1)}, {"cancel": request(1, 1, cancels=True), "expired": []}]
    for taken in both:
        asyncio.run(old.execute(taken))
        asyncio.run(new.execute(taken))
    assert (old.handled, new.handled) == (["goal", "cancel", "expired"], ["expired"])
    asyncio.run(new.execute({"goal": request(2, 2)}))
    new.admission.open(old.admission.close())
    asyncio.run(old.execute({"goal": request(2, 2), "result": request(1, 1)}))
    asyncio.run(new.execute({"result": request(1, 1)}))
    assert (old.handled, new.handled) == (["goal", "cancel", "expired"], ["expired", "goal", "result"])


def test_a_node_with_ros_actions_leaves_the_graph_when_it_is_destroyed() -> None:
    """Its replacement would take it for a foreign node of its name, and end."""
    actions = pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    from rclpy.action import ActionClient, ActionServer

    from midstride.backends.ros2.component.admitting_node import AdmittingNode

    with Bare() as bare:
        admission = RequestAdmission(time.monotonic_ns)
        node = AdmittingNode("with_actions", admission, context=bare.node.context)
        kept = ActionServer(node, actions.Fibonacci, "~/count", print), ActionClient(node, actions.Fibonacci, "/other")
        assert "with_actions" in bare.node.get_node_names()
        node.destroy_node()
        assert "with_actions" not in bare.node.get_node_names()
        del kept


def test_a_service_that_is_destroyed_handles_no_request_that_is_passed_on() -> None:
    from std_srvs.srv import Empty

    from midstride.backends.ros2.component.admitting_node import AdmittingNode

    with Bare() as bare:
        admission = RequestAdmission(time.monotonic_ns)
        node = AdmittingNode("with_services", admission, context=bare.node.context)
        own = set(admission.passed_handlers)
        first = node.create_service(Empty, "/save", print)
        assert admission.passed_handlers.keys() - own == {"/save"}
        second = node.create_service(Empty, "/save", print)
        node.destroy_service(first)  # the later one handles them
        assert admission.passed_handlers.keys() - own == {"/save"}
        assert node.destroy_service(second) and not node.destroy_service(second)
        assert admission.passed_handlers.keys() == own
        node.destroy_node()
        assert not admission.passed_handlers

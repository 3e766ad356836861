"""On ROS 2, what an outside recorder hears beside what the plan, the report and the status say: a false word fails.

The situations are those of field reports: a lifecycle node whose activation is slow, one that is stopped, nodes without
ports that are started again or whose new program is broken, a lifecycle manager that takes all nodes down, a program
that has to be killed.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign.record import ForeignRecord
from midstride.lang.load import load
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.verdicts import Assessment, Assessments
from tests.acceptance.foreign_support import manager_of
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

PERIOD = 0.05

TALK = """
import os, sys
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

if open("broken").read():
    raise SystemExit("broken build")
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Node("talk")
node.create_service(Trigger, "/save", lambda request, response: response)
publisher = node.create_publisher(String, "/said", 10)
node.create_timer(0.05, lambda: publisher.publish(String(data=node.get_name())))
import signal
if "stubborn" in sys.argv:
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
rclpy.spin(node)
"""

LIFE = """
import sys, time
import rclpy
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String


class Life(LifecycleNode):
    def __init__(self):
        super().__init__("life")

    def on_configure(self, state):
        self.out = self.create_lifecycle_publisher(String, "/said", 10)
        self.create_timer(0.05, lambda: self.out.is_activated and self.out.publish(String(data=self.get_name())))
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        time.sleep(float(sys.argv[1]))
        return super().on_activate(state)


rclpy.init()
try:
    rclpy.spin(Life())
except BaseException:
    pass
"""

WITHOUT_PORTS = """system robot
component Driver {{ run "python3 talk.py {word}" stop sigterm 0.5 s sigkill 0.5 s gate {gate} }}
node driver : Driver
"""

LIFECYCLE = """system robot
topic /said : std_msgs/msg/String
component Life {
  run "python3 life.py 0" gate lifecycle
  output out as /said
  functionality f { produces out mode normal { guarantee out : std_msgs/msg/String } mode degraded { } }
}
component Slow like Life { run "python3 life.py 4" activate 1 s gate lifecycle }
node life : Life { out -> /said }
"""


MANAGE = """
import rclpy
from lifecycle_msgs.srv import ChangeState, GetState

rclpy.init()
node = rclpy.create_node("manager")
names = "life_a", "life_b"
change = {name: node.create_client(ChangeState, f"/{name}/change_state") for name in names}
state = {name: node.create_client(GetState, f"/{name}/get_state") for name in names}


def ask(client, request, patience=2.0):
    if not client.wait_for_service(patience):
        return None
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=patience)
    return future.result()


def transition(name, number):
    request = ChangeState.Request()
    request.transition.id = number
    return ask(change[name], request)


try:
    for name in names:
        for number in 1, 3:
            while transition(name, number) is None:
                pass
    while all((answer := ask(state[name], GetState.Request())) and answer.current_state.id == 3 for name in names):
        rclpy.spin_once(node, timeout_sec=0.5)
    for name in names:
        transition(name, 4)
    rclpy.spin(node)
except BaseException:
    pass
"""

MANAGED = """system robot
component Life { run "python3 life.py 0" gate preload }
component Manager { run "python3 manage.py" gate none }
node life_a : Life
node life_b : Life
node manager : Manager
"""


class OutsideRecorder:
    """When which node was heard on ``/said``."""

    def __init__(self, bare: Bare) -> None:
        from std_msgs.msg import String

        self.bare = bare
        self.heard: list[tuple[float, str]] = []
        bare.node.create_subscription(String, "/said", self._hear, 1000)

    def _hear(self, message: Any) -> None:
        self.heard.append((time.monotonic(), message.data))

    async def hears(self, messages: int = 10) -> None:
        count = len(self.heard)
        await self.bare.until(lambda: len(self.heard) >= count + messages, 60)

    async def meanwhile(self, work: Any) -> tuple[Any, float]:
        """The result of ``work``, and the longest silence from before it until now (s)."""
        begun = len(self.heard) - 1
        task = asyncio.ensure_future(work)
        await self.bare.until(task.done, 90)
        return task.result(), self.silence(begun)

    def silence(self, begun: int) -> float:
        times = [at for at, _ in self.heard[begun:]] + [time.monotonic()]
        return max(after - before for before, after in itertools.pairwise(times))


@asynccontextmanager
async def robot(folder: Path, text: str) -> AsyncIterator[tuple[Manager, OutsideRecorder]]:
    (folder / "talk.py").write_text(TALK, encoding="utf-8")
    (folder / "life.py").write_text(LIFE, encoding="utf-8")
    (folder / "manage.py").write_text(MANAGE, encoding="utf-8")
    (folder / "broken").write_text("", encoding="utf-8")
    (folder / "robot.stride").write_text(text, encoding="utf-8")
    (folder / "system").mkdir()
    manager = manager_of(load(folder / "robot.stride").require(), folder)
    with Bare("recorder") as bare:
        recorder = OutsideRecorder(bare)
        try:
            await manager.up()
            await recorder.hears()
            yield manager, recorder
        finally:
            await manager.down()
            await manager.close()


def said(outcome: Outcome) -> Assessments:
    assert outcome.continuity is not None
    return outcome.continuity


def lost(found: Assessments, subject: str) -> Assessment:
    (only,) = (each for each in found.found if each.subject == subject and each.verdict == "lost")
    return only


def test_a_failed_activation_loses_as_much_as_the_recorder_hears_and_a_stopped_node_is_no_health(
    tmp_path: Path,
) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, LIFECYCLE) as (manager, recorder):
            outcome, silence = await recorder.meanwhile(manager.change(PlanRequest(restart=("life",))))
            assert outcome.outcome == "done"
            quick = lost(said(outcome), "/said").seconds
            assert quick is not None and quick < 1.0 and silence < quick + 3 * PERIOD
            await recorder.hears()
            outcome, silence = await recorder.meanwhile(manager.change(PlanRequest(replace=(("life", "Slow"),))))
            assert outcome.outcome == "rolled_back"
            slow = lost(said(outcome), "/said").seconds
            assert silence > 1.0 and slow == pytest.approx(silence, abs=0.5)
            assert (await manager.history(1)).changes[-1].continuity == said(outcome)
            (instance,) = (await manager.status()).instances
            assert instance.pid is not None
            os.kill(instance.pid, signal.SIGSTOP)
            try:
                await recorder.bare.until(lambda: recorder.heard[-1][0] < time.monotonic() - 1.0, 10)
                condition = (await manager.status()).condition
                assert condition.state == "degraded" and "is stopped (SIGSTOP)" in condition.headline
                # It is killed when it is replaced: it could be continued at any time, and would write beside the other.
                task = asyncio.ensure_future(manager.change(PlanRequest(restart=("life",))))
                await recorder.bare.until(task.done, 60)
                assert (task.result().outcome, [each.how for each in task.result().fenced]) == ("done", ["killed"])
                await recorder.hears()
            finally:
                with suppress(ProcessLookupError):
                    os.kill(instance.pid, signal.SIGCONT)

    with ended():
        run(scenario())


@pytest.mark.parametrize("gate", ["preload", "none"])
def test_a_node_without_ports_is_never_down_unless_the_report_says_so(tmp_path: Path, gate: str) -> None:
    restart = PlanRequest(restart=("driver",))

    async def scenario() -> None:
        async with robot(tmp_path, WITHOUT_PORTS.format(gate=gate, word="")) as (manager, recorder):
            await recorder.bare.until(lambda: has_looked(manager), 20)  # at the graph, which it does now and then
            plan = PlanPreview.of(await manager.plan(restart)).continuity
            assert plan and plan.verdict == "not_measurable"
            assert "no ports are stated" in plan.headline and "so both write there" in plan.headline
            assert "service /save ends with driver" in plan.headline
            outcome, silence = await recorder.meanwhile(manager.change(restart))
            assert outcome.outcome == "done", outcome.because
            found = said(outcome)
            assert found.verdict == "not_measurable", found
            assert silence < 0.5, "the new one is up before the old one ends"
            writers = {name for _, name in recorder.heard}
            assert writers == {"driver", "driver_2"} and "so both could write there" in found.headline
            assert "service /save ended with driver" in found.headline
            (tmp_path / "broken").write_text("broken", encoding="utf-8")
            await recorder.hears()
            outcome, silence = await recorder.meanwhile(manager.change(restart))
            assert outcome.outcome == "rolled_back" and "broken build" in str(outcome.because)
            assert silence < 0.5 and list(manager.configuration.instances) == ["driver_2"]
            condition = (await manager.status()).condition
            assert condition.state == "up" and condition.unknown == ["what driver does (no ports are stated)"]
            (instance,) = (await manager.status()).instances
            assert instance.pid is not None
            os.kill(instance.pid, signal.SIGKILL)
            await recorder.bare.until(lambda: not manager.configuration.instances, 20)
            assert (await manager.status()).condition.state == "down"

    with ended():
        run(scenario())


def has_looked(manager: Manager) -> bool:
    latest = manager.system.life.latest("driver")
    return latest is not None and latest.state.serves == ["service /save"] and bool(latest.state.undeclared)


def test_a_program_that_has_to_be_killed_is_named(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, WITHOUT_PORTS.format(gate="preload", word="stubborn")) as (manager, recorder):
            outcome, _ = await recorder.meanwhile(manager.change(PlanRequest(restart=("driver",))))
            assert outcome.outcome == "done"
            assert [each.instance for each in outcome.killed] == ["driver"]
            assert "was killed (SIGKILL): what it does at its end is lost" in said(outcome).headline

    with ended():
        run(scenario())


def test_nodes_of_a_lifecycle_manager_are_not_lost_and_taken_down_they_are_no_health(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(tmp_path, MANAGED) as (manager, recorder):
            await recorder.bare.until(lambda: {"life_a", "life_b"} <= {name for _, name in recorder.heard}, 30)
            await recorder.bare.until(lambda: all(map(seen_active(tmp_path), ("life_a", "life_b"))), 20)
            # The manager asks for states all the time, by the name of the old node, which has to stay.
            outcome, silence = await recorder.meanwhile(manager.change(PlanRequest(restart=("life_a",))))
            assert outcome.outcome == "refused" and silence < 0.5
            assert "lifecycle manager /manager may ask /life_a/get_state at any time" in str(outcome.because)
            (life,) = (each for each in (await manager.status()).instances if each.name == "life_a")
            assert life.pid is not None
            os.kill(life.pid, signal.SIGKILL)
            await recorder.bare.until(lambda: recorder.heard[-1][0] < time.monotonic() - 1.0, 30)
            taken_down = "lifecycle node /life_b is inactive, and was active before"
            deadline = time.monotonic() + 20
            while taken_down not in (condition := (await manager.status()).condition).faults:
                assert time.monotonic() < deadline, condition
                await recorder.bare.spin()
            assert condition.state == "degraded"

    with ended():
        run(scenario())


def seen_active(folder: Path) -> Callable[[str], bool]:
    """Whether the agent of a node has seen it active, by its record."""

    def seen(name: str) -> bool:
        return any(
            record.was_active
            for path in folder.rglob(f"{name}.json")
            if (record := ForeignRecord.read(path.parent, name)) is not None
        )

    return seen


@pytest.mark.parametrize("gate", ["preload", "relay", "lifecycle preload"])
def test_a_hand_over_that_is_said_to_be_kept_is_heard_without_a_pause(tmp_path: Path, gate: str) -> None:
    program = "life.py 0" if gate == "lifecycle preload" else "talk.py x"
    text = f"""system robot
topic /said : std_msgs/msg/String @ 18 Hz
component Talk {{
  run "python3 {program}" gate {gate}
  output out as /said
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 18 Hz }}
    mode degraded {{ }}
  }}
}}
node talk : Talk {{ out -> /said }}
"""

    async def scenario() -> None:
        async with robot(tmp_path, text) as (manager, recorder):
            outcome, silence = await recorder.meanwhile(manager.change(PlanRequest(restart=("talk",))))
            assert outcome.outcome == "done", outcome.because
            found = said(outcome)
            assert [each for each in found.found if each.verdict == "lost"] == [] and silence < 0.4, found

    with ended():
        run(scenario())

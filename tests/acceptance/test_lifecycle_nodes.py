"""Lifecycle nodes in plain rclpy: created, degraded, upgraded, replaced; one refuses a transition, one hangs in one."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from pathlib import Path

import pytest

from midstride import backends
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

PROGRAM = """
import os, sys, time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String

FAULT = sys.argv[1]


class Node(LifecycleNode):
    def __init__(self):
        super().__init__("node")
        self.instance = os.environ["MIDSTRIDE_INSTANCE"]  # the name stays
        self.declare_parameter("word", "hello")
        self.declare_parameter("volume", 1.5)

    def note(self, what, result=TransitionCallbackReturn.SUCCESS):
        word, volume = (self.get_parameter(name).value for name in ("word", "volume"))
        with open("events", "a") as file:
            file.write(f"{self.instance} {what} {word} {volume}\\n")
        if FAULT == f"hang:{what}":
            time.sleep(600)
        return TransitionCallbackReturn.FAILURE if what == FAULT else result

    def on_configure(self, state):
        if self.get_name().startswith("talker"):
            self.out = self.create_lifecycle_publisher(String, "chatter", 10)
            self.count = 0
            self.create_timer(0.02, self.talk)
        else:
            self.create_subscription(String, "chatter", lambda message: None, 10)
        return self.note("configure")

    def talk(self):
        if self.out.is_activated:
            self.count += 1
            self.out.publish(String(data=f"{self.instance} {self.count}"))

    def on_activate(self, state):
        super().on_activate(state)
        return self.note("activate")

    def on_deactivate(self, state):
        super().on_deactivate(state)
        return self.note("deactivate")

    def on_cleanup(self, state):
        return self.note("cleanup")

    def on_shutdown(self, state):
        return self.note("shutdown")


rclpy.init()
try:
    rclpy.spin(Node())
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

TEXT = """system chat

topic /chat : std_msgs/msg/String @ 50 Hz { publishers <= 1 }

component Talker {
  run "python3 node.py none" gate lifecycle
  parameters { word = "hi" }
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

component Other    like Talker { run "python3 ./node.py none" gate lifecycle }
component Refusing like Talker { run "python3 node.py configure" gate lifecycle }
component Hanging  like Talker { run "python3 node.py hang:activate" gate lifecycle }

component Listener {
  run "python3 node.py none" gate lifecycle
  input in : std_msgs/msg/String @ 50 Hz as chatter
  functionality listen {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}

node talker   : Talker   { out -> /chat }
node listener : Listener { in <- /chat }
"""


def manager_of(folder: Path, text: str) -> Manager:
    (folder / "node.py").write_text(PROGRAM, encoding="utf-8")
    (folder / "chat.stride").write_text(text, encoding="utf-8")
    (folder / "system").mkdir()
    workspace = Workspace(folder / "system")
    return Manager(load(folder / "chat.stride").require(), backends.make("ros2", workspace), workspace, folder)


def test_their_transitions_are_the_steps_of_a_change(tmp_path: Path) -> None:
    manager = manager_of(tmp_path, TEXT)
    heard: list[str] = []

    def events() -> list[str]:
        """Those since the last call."""
        path = tmp_path / "events"
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("", encoding="utf-8")
        return lines

    async def scenario() -> None:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter
        from std_msgs.msg import String

        await manager.up()
        assert sorted(events()) == [
            "listener activate hello 1.5",
            "listener configure hello 1.5",
            "talker activate hi 1.5",
            "talker configure hi 1.5",
        ]
        with Bare("recorder") as bare:
            bare.node.create_subscription(String, "/chat", lambda message: heard.append(message.data.split()[0]), 1000)

            async def changed(component: str, writer: str, strategy: str = "minimal") -> Outcome:
                outcome = await manager.change(PlanRequest(replace=(("talker", component),), strategy=strategy))
                count = len(heard)
                await bare.until(lambda: len(heard) > count + 20 and {*heard[-20:]} == {writer}, 60)
                status = await manager.status()
                assert status.valid, str(status)
                return outcome

            await bare.until(lambda: len(heard) > 20, 60)
            client = bare.node.create_client(SetParameters, "/talker/set_parameters")
            await bare.until(client.service_is_ready, 60)
            values = Parameter("word", value="bye"), Parameter("volume", value=2.5)
            setting = client.call_async(
                SetParameters.Request(parameters=[value.to_parameter_msg() for value in values])
            )
            await bare.until(setting.done, 60)
            assert all(each.successful for each in setting.result().results)

            refused = await changed("Refusing", "talker")
            assert refused.outcome == "rolled_back"
            assert "talker_2 has answered `configure` with a failure; it is unconfigured" in str(refused.because)
            assert events() == ["talker_2 configure bye 2.5", "talker_2 shutdown bye 2.5"]

            hung = await changed("Hanging", "talker")
            assert hung.outcome == "rolled_back", hung.because
            assert "talker_2 has not answered `activate` within 5 s; it was inactive before" in str(hung.because)
            assert [each.split()[:2] for each in events()] == [
                ["talker_2", "configure"],
                ["talker", "deactivate"],
                ["talker_2", "activate"],
                ["talker", "activate"],
            ]

            assert (await changed("Other", "talker_2")).outcome == "done"
            assert events() == [
                "talker_2 configure bye 2.5",
                "talker deactivate bye 2.5",
                "talker_2 activate bye 2.5",
                "talker cleanup bye 2.5",
                "talker shutdown bye 2.5",
            ]

            assert (await changed("Talker", "talker_3", "paper")).outcome == "done"
            found = [each.split()[:2] for each in events()]
            assert [what for name, what in found if name == "listener"] == ["deactivate", "activate"]
        await manager.down()
        await manager.close()

    with ended():
        run(scenario())


def test_with_the_library_no_message_is_missed(tmp_path: Path) -> None:
    manager = manager_of(tmp_path, TEXT.replace("gate lifecycle", "gate lifecycle preload"))
    heard: list[tuple[str, int]] = []

    async def scenario() -> None:
        from std_msgs.msg import String

        await manager.up()
        with Bare("recorder") as bare:

            def hear(message: String) -> None:
                name, number = message.data.split()
                heard.append((name, int(number)))

            bare.node.create_subscription(String, "/chat", hear, 1000)
            await bare.until(lambda: len(heard) > 20, 60)
            change = asyncio.ensure_future(manager.change(PlanRequest(replace=(("talker", "Other"),))))
            await bare.until(change.done, 90)
            assert (change.result().outcome, change.result().because) == ("done", None)
            count = len(heard)
            await bare.until(lambda: len(heard) > count + 20, 60)
        assert (await manager.status()).valid
        await manager.down()
        await manager.close()

    with ended():
        run(scenario())
    assert [(old, new) for (old, _), (new, _) in pairwise(heard) if old != new] == [("talker", "talker_2")]
    assert all(number == last + 1 for (before, last), (writer, number) in pairwise(heard) if before == writer)

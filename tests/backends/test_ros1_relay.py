"""Unmodified nodes of ROS 1 behind relays, in rospy and roscpp: they replace each other and a component."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from midstride.backends.ros1 import create_backend
from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CallTimeout
from midstride.foreign.relayed_program import RelayOrder
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.backends.ros1_support import own_master_uri, program, wait_for
from tests.backends.ros2_support import run, until, until_async

pytestmark = [pytest.mark.ros1, pytest.mark.full]

TALKER = """
import rospy
from std_msgs.msg import String

rospy.init_node("talker")
out = rospy.Publisher("chatter", String, queue_size=100)
count, rate = 0, rospy.Rate(50)
while not rospy.is_shutdown():
    count += 1
    out.publish(f"{rospy.get_name()} {count} {rospy.get_param('~say/word')}")
    rate.sleep()
"""
OURS = """
from midstride import Component
from std_msgs.msg import String

comp = Component("ours")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    count += 1
    out.write(String(data=f"/{comp.instance} {count} ours"))

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
TEXT = """system chat

topic /chat : std_msgs/msg/String @ 50 Hz

component Talker {
  run "python3 talker.py" gate relay
  parameters { say.word = "hello" }
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

component Other like Talker { run "python3 ./talker.py" gate relay }

component Ours {
  run "python3 ours.py"
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }
    mode degraded { }
  }
}

node talker : Talker { out -> /chat }
"""


def system(folder: Path, text: str, body: Callable[[Manager], Awaitable[None]]) -> None:
    """Bring the system of ``text`` up with a master of its own, run ``body``, and end it."""
    (folder / "talker.py").write_text(TALKER, encoding="utf-8")
    (folder / "ours.py").write_text(OURS, encoding="utf-8")
    (folder / "chat.stride").write_text(text, encoding="utf-8")
    (folder / "system").mkdir()

    async def scenario() -> None:
        backend = create_backend(folder / "components", logs=folder / "logs")
        workspace = Workspace(folder / "system")
        manager = Manager(load(folder / "chat.stride").require(), backend, workspace, folder)
        await manager.up()
        try:
            await body(manager)
        finally:
            await manager.down()
            await manager.close()

    with own_master_uri():
        run(scenario())


def test_rospy_talkers_replace_each_other_and_a_component(tmp_path: Path) -> None:
    heard = tmp_path / "heard"

    async def body(manager: Manager) -> None:
        with program("recorder", "/chat", str(heard)):
            await asyncio.to_thread(wait_for, heard, 50)
            for component in ("Other", "Ours", "Talker"):
                outcome = await manager.change(PlanRequest(replace=(("talker", component),)))
                assert (outcome.outcome, outcome.because) == ("done", None)
                lines = len(heard.read_text().splitlines())
                await asyncio.to_thread(wait_for, heard, lines + 20)
        status = await manager.status()
        assert status.valid, status

    system(tmp_path, TEXT, body)
    found = [(words[0], int(words[1])) for words in map(str.split, heard.read_text().splitlines())]
    writers = [old for (old, _), (new, _) in pairwise(found) if old != new] + [found[-1][0]]
    assert writers == ["/talker", "/talker_2", "/talker_3", "/talker_2"], writers
    assert {words for line in heard.read_text().splitlines() for words in line.split()[2:]} == {"hello", "ours"}
    # One that has the topic writes all of its messages, and after the change none.
    gaps = [(one, two) for one, two in pairwise(found) if one[0] == two[0] and two[1] != one[1] + 1]
    assert not gaps


def test_a_master_that_is_frozen_does_not_stop_the_relay_for_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from midstride.backends.ros1 import relay_program

    path = tmp_path / "chat.stride"
    path.write_text(TEXT, encoding="utf-8")
    declaration = NamedComponentForm.of(load(path).require().components["Talker"])
    order = RelayOrder(command=["talker"], node="/talker", declaration=declaration, topics={}, real={})
    host: Any = SimpleNamespace(node_name="/talker_relay")
    with socket.create_server(("127.0.0.1", 0)) as frozen:
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{frozen.getsockname()[1]}")
        with pytest.raises(CallTimeout, match="did not answer getSystemState within"):
            relay_program.endpoints(host, order)


THROTTLES = """
topic /slow : std_msgs/msg/String @ 8 Hz

component Throttle {
  run "/usr/lib/topic_tools/throttle messages source 10 out" gate relay
  input  in : std_msgs/msg/String @ 50 Hz as source
  output out
  functionality thin {
    uses in
    produces out
    mode normal {
      assume in
      guarantee out : std_msgs/msg/String @ 8 Hz
    }
    mode degraded { }
  }
}

component Faster like Throttle {
  run "/usr/lib/topic_tools/throttle messages source 20 out" gate relay
}

component Relay like Throttle {
  run "/usr/lib/topic_tools/relay source out" gate relay
}

component Mux like Throttle {
  run "/usr/lib/topic_tools/mux out source" gate relay
}

node throttle : Throttle {
  in <- /chat
  out -> /slow
}
"""


@pytest.mark.skipif(not Path("/usr/lib/topic_tools/throttle").exists(), reason="needs Debian's topic-tools")
def test_nodes_of_topic_tools_replace_each_other_and_are_killed_with_their_relay(tmp_path: Path) -> None:
    """Nodes in roscpp, of any type, that advertise when they have received their first message."""
    heard = tmp_path / "heard"

    async def body(manager: Manager) -> None:
        with program("recorder", "/slow", str(heard)):
            await asyncio.to_thread(wait_for, heard, 10)
            for component in ("Faster", "Relay", "Mux", "Throttle"):
                outcome = await manager.change(PlanRequest(replace=(("throttle", component),)))
                assert (outcome.outcome, outcome.because) == ("done", None)
                lines = len(heard.read_text().splitlines())
                await asyncio.to_thread(wait_for, heard, lines + 10)
            state = await manager.peek("throttle_3")
            measured = state.ports["out"]["/slow"].measured
            assert measured is not None and (measured.rate or 0.0) > 0
            (program_,) = psutil.Process(state.pid).children()
            assert program_.name() == "throttle"
            program_.kill()  # the relay ends as well, and the manager knows at once
            await until(lambda: "throttle_3" not in manager.configuration.instances)
            assert not psutil.pid_exists(state.pid)

    system(tmp_path, TEXT + THROTTLES, body)
    counts = [int(line.split()[1]) for line in heard.read_text().splitlines()]
    assert counts == sorted(counts), counts  # at each moment, one of them is heard
    assert max(new - old for old, new in pairwise(counts)) < 50, counts


@pytest.mark.skipif(not Path("/usr/lib/topic_tools/throttle").exists(), reason="needs Debian's topic-tools")
def test_a_node_that_hangs_has_its_dependants_degraded(tmp_path: Path) -> None:
    async def body(manager: Manager) -> None:
        async def mode() -> str:
            return (await manager.peek("throttle")).functionalities["thin"].mode

        async def receives() -> bool:  # what never came is not missed
            return (await manager.peek("throttle")).ports["in"]["/chat"].count > 0

        await until_async(receives, 60)
        await until_async(lambda: is_normal(mode), 60)
        (talker,) = psutil.Process((await manager.peek("talker")).pid).children()
        talker.suspend()
        try:
            await until_async(lambda: is_not_normal(mode), 60)
        finally:
            talker.resume()
        await until_async(lambda: is_normal(mode), 60)

    async def is_normal(mode: Callable[[], Awaitable[str]]) -> bool:
        return await mode() == "normal"

    async def is_not_normal(mode: Callable[[], Awaitable[str]]) -> bool:
        return await mode() == "degraded"

    system(tmp_path, TEXT + THROTTLES, body)

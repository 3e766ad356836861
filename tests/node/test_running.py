"""What a component's code sees while it runs, script by script in the simulator."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from midstride.backends.common import KeptParameters
from midstride.backends.simulator.host import SimulatedHost
from midstride.errors import Unreachable
from midstride.model.component import StopTimes
from midstride.node.control.component_agent import Agent
from midstride.node.control.component_reflex import Reflex
from midstride.runtime.process.launcher import STOP_GRACE
from tests.planting import plant

from .author import Bench, simulate

HEAD = """
from midstride import Component, any_of, approximate
from std_msgs.msg import String
from sensor_msgs.msg import Image

comp = Component("node")
"""

TALKER = (
    HEAD
    + """
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    count += 1
    out.write(String(data=str(count)))

talk.set_normal_mode(normal, rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
)


def test_the_first_call_comes_on_entry_and_the_rest_on_the_grid(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
f.set_normal_mode(lambda: print("normal", comp.clock.now()), rate=4)
f.set_mode("slower", lambda: print("slower", comp.clock.now()), rate=2)
f.set_degraded_mode(lambda: print("degraded", f.mode))
comp.start()
print("ended")
""",
        )
        assert bench.log("node") == ["degraded degraded"]
        await bench.send("node", "modes", modes={"f": "normal"}, because="to see it run")
        await bench.sleep(0.6)
        await bench.mode("node", "f", "slower")
        await bench.sleep(0.6)
        await bench.mode("node", "f", "degraded")
        await bench.sleep(2.0)
        lines = [line.split() for line in bench.log("node")]
        names = [line[0] for line in lines]
        assert names == ["degraded", *["normal"] * 3, *["slower"] * 2, "degraded"]
        normal = [int(line[1]) for line in lines if line[0] == "normal"]
        assert [time - normal[0] for time in normal] == [0, 250_000_000, 500_000_000]
        slower = [int(line[1]) for line in lines if line[0] == "slower"]
        assert slower[1] - slower[0] == 500_000_000

    simulate(tmp_path, main)


def test_messages_call_what_is_mapped_to_their_input(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("left", TALKER)
        await bench.start("right", TALKER)
        await bench.start(
            "node",
            HEAD
            + """
left, right = comp.create_input("left", String), comp.create_input("right", String)
each = comp.create_functionality("each", inputs=[left, right])
each.set_normal_mode(
    {left: lambda m: print("left", m.data), right: lambda m: print("right", m.data)}, inputs=[left, right]
)
each.set_degraded_mode(lambda: None)
both = comp.create_functionality("both", inputs=[left, right])
both.set_normal_mode(lambda m: print("both", m.data, left.latest.data), inputs=[any_of(left, right)])
both.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.attach("node", "left", "/left")
        await bench.attach("node", "right", "/right")
        state = (await bench.lab.read("node", "observe"))["functionalities"]["each"]
        assert state["because"] == "it has been in this mode since it started"
        for side in ("left", "right"):
            await bench.attach(side, "out", f"/{side}")
        await bench.mode("node", "each", "normal")
        await bench.mode("left", "talk", "normal")
        await bench.sleep(0.01)
        await bench.mode("right", "talk", "normal")
        await bench.sleep(0.01)
        assert bench.log("node") == ["left 1", "right 1"]
        await bench.mode("node", "both", "normal")
        await bench.sleep(0.1)
        assert bench.log("node")[2:] == ["left 2", "both 2 2", "right 2", "both 2 2"]
        await bench.mode("node", "each", "degraded")
        await bench.sleep(0.1)
        assert bench.log("node")[6:] == ["both 3 3", "both 3 3"]

    simulate(tmp_path, main)


STAMPED = (
    HEAD
    + """
out = comp.create_output("out", Image)
look = comp.create_functionality("look", outputs=[out])
offset = comp.parameter("offset", 0)
count = 0

def normal():
    global count
    count += 1
    image = Image(width=count)
    stamp = count * 100_000_000 + offset.value * 1_000_000
    image.header.stamp.sec, image.header.stamp.nanosec = divmod(stamp, 10**9)
    out.write(image)

look.set_normal_mode(normal, rate=10, outputs=[out])
look.set_degraded_mode(lambda: None)
comp.start()
"""
)


def test_synchronised_messages_lie_within_the_slop(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("left", STAMPED)
        await bench.start("right", STAMPED, offset=30)
        await bench.start("apart", STAMPED, offset=49)
        await bench.start(
            "node",
            HEAD
            + """
left, right = comp.create_input("left", Image), comp.create_input("right", Image)
stereo = comp.create_functionality("stereo", inputs=[left, right])
stereo.set_normal_mode(
    lambda left, right: print(left.width, right.width), inputs=[left, right], sync=approximate(0.04)
)
stereo.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        for side, topic in (("left", "/left"), ("right", "/right"), ("apart", "/right")):
            await bench.attach(side, "out", topic)
        await bench.attach("node", "left", "/left")
        await bench.attach("node", "right", "/right")
        await bench.mode("node", "stereo", "normal")
        await bench.mode("left", "look", "normal")
        await bench.sleep(0.15)
        await bench.mode("right", "look", "normal")
        await bench.sleep(0.25)
        # The left one began earlier: its second and third image wait for the right one's.
        assert bench.log("node") == ["1 1", "2 2", "3 3"]
        await bench.mode("right", "look", "degraded")
        await bench.mode("apart", "look", "normal")
        await bench.sleep(0.45)
        # 49 ms later than the left one's of that number, and 51 ms from the next: never within 40.
        assert bench.log("node") == ["1 1", "2 2", "3 3"]

    simulate(tmp_path, main)


def test_latest_and_age_are_of_the_time_since_the_attach(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("talker", TALKER)
        await bench.start(
            "node",
            HEAD
            + """
in_ = comp.create_input("in", String)
f = comp.create_functionality("f", inputs=[in_])
f.set_normal_mode(lambda: None, rate=1, inputs=[in_])
f.set_degraded_mode(lambda: print(in_.attached, in_.latest and in_.latest.data, in_.age), rate=1)
comp.start()
""",
        )
        await bench.mode("talker", "talk", "normal")
        await bench.attach("talker", "out", "/chatter")
        await bench.attach("node", "in", "/chatter")
        await bench.sleep(1.0)
        await bench.mode("talker", "talk", "degraded")
        await bench.sleep(1.0)
        await bench.send("node", "detach", port="in", topic="/chatter")
        await bench.sleep(1.0)
        first, attached, silent, *detached = bench.log("node")
        assert first == "False None None" and detached == ["False None None"]
        ages = [float(line.split()[2]) for line in (attached, silent)]
        assert attached.startswith("True ") and ages[0] < 0.1 and 0.8 < ages[1] < 1.0

    simulate(tmp_path, main)


def test_messages_that_come_during_an_async_call_wait_for_its_end(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("talker", TALKER)
        await bench.start(
            "node",
            HEAD
            + """
in_ = comp.create_input("in", String, qos=3)
f = comp.create_functionality("f", inputs=[in_])

async def on_message(message):
    print("begin", message.data)
    await comp.clock.sleep(0.25 if message.data == "1" else 0)
    print("end", message.data)

f.set_normal_mode(on_message, inputs=[in_])
f.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.attach("node", "in", "/chatter")
        await bench.attach("talker", "out", "/chatter")
        await bench.mode("node", "f", "normal")
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(0.36)
        assert bench.log("node") == [f"{what} {n}" for n in (1, 2, 3, 4) for what in ("begin", "end")]

    simulate(tmp_path, main)


def test_an_async_function_that_raises_degrades_when_it_raises(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")

async def normal():
    await comp.clock.sleep(0.5)
    raise LookupError("no map")

f.set_normal_mode(normal, rate=10)
f.set_degraded_mode(lambda: print("degraded"))
comp.start()
""",
        )
        await bench.mode("node", "f", "normal")
        await bench.sleep(0.4)
        assert bench.state("node").functionalities["f"].mode == "normal"
        await bench.sleep(0.2)
        state = bench.state("node").functionalities["f"]
        assert state.mode == "degraded" and "LookupError: no map" in state.because
        assert "in normal" in state.because, "the author's line is missing from the traceback"
        assert "functionality_runner.py" not in state.because, "our own lines are in the traceback"
        assert bench.log("node").count("degraded") == 2

    simulate(tmp_path, main)


@pytest.mark.parametrize(
    ("raised", "because"),
    [
        (r'ValueError("bad frame: " + bytes([0x80]).decode("ascii", "surrogateescape"))', r"bad frame: \udc80"),
        (r'ValueError("bad image " + 10_000_000 * "x")', r"characters are left out here"),
    ],
    ids=["what UTF-8 cannot express", "very long"],
)
def test_a_component_stays_reachable_whatever_the_text_that_it_raises(
    tmp_path: Path, raised: str, because: str
) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + f"""
f = comp.create_functionality("f")

def normal():
    raise {raised}

f.set_normal_mode(normal, rate=10)
f.set_degraded_mode(lambda: None)
comp.on_export_state(normal)
comp.start()
""",
        )
        await bench.mode("node", "f", "normal")
        await bench.sleep(0.3)
        state = (await bench.lab.read("node", "observe"))["functionalities"]["f"]
        assert state["mode"] == "degraded" and because in state["because"] and len(state["because"]) < 10_000
        assert state["because"].startswith("mode normal raised: ValueError: bad ")
        assert state["because"].splitlines()[-1].startswith("    raise ValueError"), "the author's line is missing"
        refused = await bench.refusal("node", "export_state", timeout=1.0)
        assert because in refused and len(refused) < 10_000

    simulate(tmp_path, main)


def test_sys_exit_in_a_callback_is_an_error_of_the_callback(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
import sys
f = comp.create_functionality("f")
f.set_normal_mode(lambda: sys.exit(4), rate=10)
f.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.mode("node", "f", "normal")
        await bench.sleep(0.3)
        state = bench.state("node").functionalities["f"]
        assert state.mode == "degraded" and "SystemExit: 4" in state.because and not bench.exits()

    simulate(tmp_path, main)


def test_sys_exit_in_on_change_refuses_the_value_and_in_on_stop_is_logged(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
import sys
label = comp.parameter("label", "plain", on_change=lambda value: print(value))
speed = comp.parameter("speed", 1, on_change=lambda value: sys.exit("no way") if value > 3 else None)
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: None)

@comp.on_stop
async def stop():
    sys.exit("no rest")

comp.start()
""",
        )
        refused = await bench.refusal("node", "set", parameters={"label": "other", "speed": 4})
        assert refused == "on_change of parameter speed raised SystemExit: no way"
        assert (bench.state("node").parameters["speed"], bench.log("node")) == (1, ["other", "plain"])
        await bench.send("node", "set", parameters={"speed": 3}, declared={})
        assert bench.state("node").set_values() == {"speed": 3} and not bench.exits()
        await bench.send("node", "stop")
        await bench.sleep(0.5)
        assert "on_stop raised: SystemExit: no rest" in bench.exits()[0].log_tail

    simulate(tmp_path, main)


@pytest.mark.parametrize(
    ("works", "words"),
    [
        ((Reflex, "_look"), "node ends, since the watch over its inputs has failed: RuntimeError: error not set"),
        ((Agent, "_report"), "node ends, since the reports of its state have failed: RuntimeError: error not set"),
    ],
    ids=["reflex", "reports"],
)
def test_a_component_that_does_not_watch_or_report_any_more_ends_in_order(
    works: tuple[type, str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would only seem to be well."""

    async def main(bench: Bench) -> None:
        await bench.start("node", TALKER.replace("comp.start", "comp.on_stop(lambda: print('stopped'))\ncomp.start"))
        monkeypatch.setattr(*works, Mock(side_effect=RuntimeError("error not set")))
        await bench.sleep(2.0)
        [event] = bench.exits()
        assert words in event.log_tail and "stopped" in event.log_tail.split()

    simulate(tmp_path, main)


@pytest.mark.parametrize("limit", [2.0, 6.0])
def test_a_call_under_way_takes_nothing_of_the_time_of_on_stop(limit: float, tmp_path: Path) -> None:
    """It has as long as `on_stop`, which has its time after it: a manager waits for both before it kills."""
    source = f"""
async def work():
    await comp.clock.sleep({limit} - 0.1)
    print("worked")

f = comp.create_functionality("f")
f.set_normal_mode(work, rate=0.1)
f.set_degraded_mode(lambda: None)

async def stop():
    await comp.clock.sleep({limit} - 0.1)
    print("stopped")

comp.on_stop(stop, timeout={limit})
comp.start()
"""

    async def main(bench: Bench) -> None:
        await bench.start("node", HEAD + source)
        await bench.mode("node", "f", "normal")
        log, begun = bench.simulator.processes["node"].log, bench.simulator.clock.steady()
        await bench.simulator.end("node", StopTimes(0.0, max(STOP_GRACE, bench.state("node").stopping)))
        assert log.tail().split() == ["worked", "stopped"]
        assert bench.simulator.clock.steady() - begun < 2 * (limit - 0.1) + 0.1, "neither waits for more than the call"

    simulate(tmp_path, main)


def test_a_group_changes_at_one_moment_or_not_at_all(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
a = comp.create_functionality("a")

async def slow():
    await comp.clock.sleep(1.0)
    print("slow is done")

a.set_normal_mode(slow, rate=0.5)
a.set_degraded_mode(lambda: print("a degraded"))
b = comp.create_functionality("b")
b.set_normal_mode(lambda: print("b"), rate=5)
b.set_degraded_mode(lambda: print("b degraded"))
comp.start()
""",
        )
        await bench.send("node", "modes", modes={"a": "normal", "b": "normal"}, timeout=1.0)
        await bench.sleep(0.3)
        assert bench.log("node") == ["a degraded", "b degraded", "b", "b"]
        await bench.send("node", "modes", modes={"a": "degraded", "b": "degraded"}, timeout=5.0)
        await bench.sleep(3.0)
        # While the change waits for the one, the other starts no further call.
        assert bench.log("node")[4:] == ["slow is done", "a degraded", "b degraded"]

    simulate(tmp_path, main)


def test_a_change_to_the_mode_it_is_in_calls_nothing_and_keeps_the_grid(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
f.set_normal_mode(lambda: print(round(comp.clock.now() / 1e6) % 250), rate=4)
f.set_degraded_mode(lambda: print("degraded"))
comp.start()
""",
        )
        await bench.mode("node", "f", "degraded")
        await bench.mode("node", "f", "normal")
        await bench.sleep(0.1)
        await bench.send("node", "modes", modes={"f": "normal"}, because="once more")
        await bench.sleep(0.5)
        first, *calls = bench.log("node")
        assert first == "degraded" and len(calls) == 3 and len(set(calls)) == 1, calls
        functionality = (await bench.send("node", "observe"))["functionalities"]["f"]
        assert functionality["because"] == "the manager requested it" and functionality["since"] > 0.5

    simulate(tmp_path, main)


@pytest.mark.parametrize(
    ("failing", "why"),
    [
        ("normal", "f is in mode degraded: mode normal raised: ValueError: no more"),
        ("last", "f is in mode degraded: its last mode, degraded, raised, so it is no longer called: ValueError"),
    ],
)
def test_a_change_that_expects_the_state_before_a_failure_is_refused_with_that_failure(
    failing: str, why: str, tmp_path: Path
) -> None:
    """And not with two revisions, which explain nothing. One that knows of the failure is carried out."""

    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
calls = 0

def fail():
    global calls
    calls += 1
    if calls == 2:
        raise ValueError("no more")

NORMAL
comp.start()
""".replace(
                "NORMAL",
                "f.set_normal_mode(fail, rate=1)\nf.set_degraded_mode(lambda: None)"
                if failing == "normal"
                else "f.set_normal_mode(lambda: None, rate=1)\nf.set_degraded_mode(fail, rate=1)",
            ),
        )
        if failing == "normal":
            await bench.send("node", "modes", modes={"f": "normal"})
        expected = bench.state("node").revision
        await bench.sleep(1.5)
        arguments: dict[str, Any] = {"parameters": {}}
        reply = await bench.lab.send("node", "set", arguments, id="x", revision=expected)
        assert reply.refused is not None and reply.refused.startswith(why), reply
        reply = await bench.lab.send("node", "set", arguments, id="y", revision=reply.revision)
        assert reply.refused is None
        reply = await bench.lab.send("node", "set", arguments, id="z", revision=reply.revision + 1)
        assert reply.refused is not None and "is at revision" in reply.refused

    simulate(tmp_path, main)


def test_a_change_is_refused_where_a_functionality_degrades_while_it_waits(tmp_path: Path) -> None:
    """The manager chose the modes for the state that it knew."""

    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
a = comp.create_functionality("a")

async def slow():
    await comp.clock.sleep(1.0)

a.set_normal_mode(slow, rate=0.1)
a.set_degraded_mode(lambda: print("a degraded"))
b = comp.create_functionality("b")
calls = 0

def failing():
    global calls
    calls += 1
    if calls == 3:
        raise RuntimeError("no more")

b.set_normal_mode(failing, rate=4)
b.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.send("node", "modes", modes={"a": "normal", "b": "normal"})
        await bench.sleep(0.1)
        refused = await bench.refusal("node", "modes", modes={"a": "degraded"}, timeout=5.0)
        assert "has degraded by itself meanwhile: observe the component again" in refused
        state = await bench.send("node", "observe")
        assert {name: entry["mode"] for name, entry in state["functionalities"].items()} == {
            "a": "normal",
            "b": "degraded",
        }
        assert bench.log("node").count("a degraded") == 1
        await bench.mode("node", "a", "degraded")

    simulate(tmp_path, main)


def test_the_state_shows_what_was_set_at_run_time(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
speed = comp.parameter("speed", 1.5, on_change=lambda value: print("speed", value))
frame = comp.parameter("frame", "map")
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: None)

@comp.on_stop
def stop():
    try:
        speed.change(9)
    except Exception as error:
        print(error)

comp.start()
""",
            speed=2,
        )
        assert bench.state("node").declared == {}
        await bench.send("node", "set", parameters={"speed": 3}, declared={})
        assert (bench.state("node").declared, bench.state("node").set_values()) == ({"speed": 2.0}, {"speed": 3.0})
        await bench.send("node", "set", parameters={"frame": "map"}, declared={})  # the value that it has
        await bench.send("node", "set", parameters={"speed": 4})
        assert (bench.state("node").declared, bench.state("node").set_values()) == ({}, {})
        await bench.send("node", "set", parameters={"speed": 5}, declared={"speed": 1})
        assert bench.state("node").declared == {"speed": 1.0}
        refused = await bench.refusal("node", "set", parameters={"speed": 6}, declared={"speed": "fast"})
        assert "takes a value like 1.5" in refused and bench.state("node").set_values() == {"speed": 5.0}
        assert "shows the state" in await bench.refusal("node", "set", parameters={"midstride.mode.f": "normal"})
        await bench.send("node", "stop")
        await bench.sleep(0.5)
        assert "parameter speed cannot be set any more: the component is ending" in bench.exits()[0].log_tail

    simulate(tmp_path, main)


def test_a_component_that_is_ending_changes_nothing_any_more(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        slow = "async def rest():\n    await comp.clock.sleep(2)\n\ncomp.on_stop(rest)\ncomp.start"
        await bench.start("node", TALKER.replace("comp.start", slow))
        await bench.send("node", "welcome", manager="me")
        stopping = asyncio.ensure_future(bench.send("node", "stop"))
        await bench.sleep(0.5)
        assert await bench.refusal("node", "modes", modes={"talk": "normal"}) == "the component is ending"
        await stopping

    simulate(tmp_path, main)


def test_a_value_that_is_no_json_is_not_among_those_that_were_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `ros2 param set /node gain .nan` on a parameter that the author's code has declared on the ROS node itself."""
    gain = SimpleNamespace(name="gain", value=None, declared=2.0)
    plant(monkeypatch, KeptParameters, "held", lambda self: {"gain": gain})
    source = """
comp.parameter("speed", 1.5, on_change=print)
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: None)
comp.start()
"""

    async def main(bench: Bench) -> None:
        await bench.start("node", HEAD + source)
        await bench.send("node", "set", parameters={"speed": 3.0}, declared={})
        assert bench.state("node").set_values() == {"speed": 3.0}
        gain.value = 2.5
        await bench.send("node", "set", parameters={"speed": 4.0}, declared={})
        assert bench.state("node").set_values() == {"speed": 4.0, "gain": 2.5}

    simulate(tmp_path, main)


def test_set_up_comes_first_and_start_values_are_there(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
speed = comp.parameter("speed", 1.5, on_change=lambda value: print("speed", value))
frame = comp.parameter("frame", "map")
print("declared", speed.value)
comp.on_setup(lambda node: print("set up", node, speed.value, comp.instance))
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: print("degraded"))
comp.on_stop(lambda: print("last word"))
comp.start()
print("after start")
""",
            speed=2,
        )
        assert bench.log("node") == ["declared 2.0", "set up None 2.0 node", "degraded"]
        await bench.send("node", "set", parameters={"speed": 3})
        refused = await bench.refusal("node", "set", parameters={"speed": 4, "frame": "odom"})
        assert "frame keeps the value that the component was started with" in refused
        assert bench.state("node").parameters == {"speed": 3.0, "frame": "map"}
        await bench.send("node", "stop")
        await bench.sleep(0.5)
        (exited,) = bench.exits()
        assert exited.status == 0
        assert [line for line in exited.log_tail.splitlines() if line[0] != "["][-5:] == [
            "speed 3.0",
            "speed 4.0",
            "speed 3.0",
            "last word",
            "after start",
        ]

    simulate(tmp_path, main)


def test_a_set_up_that_raises_ends_the_process_with_its_traceback(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: None)

@comp.on_setup
def connect(node):
    raise ConnectionError("no such device")

comp.start()
""",
        )
        (exited,) = bench.exits()
        assert exited.status == 1 and "ConnectionError: no such device" in exited.log_tail

    simulate(tmp_path, main)


def test_a_failed_set_up_does_not_wait_for_the_requests_that_wait_for_it(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        begun = bench.lab.clock.steady()
        await bench.start(
            "node",
            HEAD
            + """
import time

f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)
f.set_degraded_mode(lambda: None)

@comp.on_setup
def connect(node):
    time.sleep(1)
    raise ConnectionError("no such device")

comp.start()
""",
        )
        assert (await bench.lab.send("node", "ping", {})).ok
        with pytest.raises(Unreachable, match="node is gone"):
            await bench.lab.send("node", "observe", {})
        assert (await bench.lab.exited("node")).status == 1
        assert bench.lab.clock.steady() - begun < 1.2

    simulate(tmp_path, main)


def test_declaring_after_start_and_starting_twice_are_refused(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)

def degraded():
    for late in (
        lambda: comp.create_input("late", String),
        lambda: f.set_mode("late", degraded),
        lambda: comp.parameter("late", 1),
        comp.start,
    ):
        try:
            late()
        except Exception as error:
            print(error)

f.set_degraded_mode(degraded)
comp.start()
""",
        )
        lines = bench.log("node")
        assert len(lines) == 4 and all("declare everything before start()" in line for line in lines), lines

    simulate(tmp_path, main)


def test_started_by_hand_it_belongs_to_the_first_manager_that_welcomes_it(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("node", TALKER, token="")
        assert "waits for a manager" in bench.simulator.log("node")
        mistaken = await bench.lab.send(
            "node", "welcome", {"manager": "you"}, id="mistaken", token="yours", revision=99
        )
        assert mistaken.refused is not None
        await bench.send("node", "welcome", token="mine", manager="me")
        await bench.send("node", "modes", token="mine", modes={"talk": "normal"})
        assert "token" in await bench.refusal("node", "welcome", token="yours", manager="you")
        await bench.send("node", "attach", token="mine", port="out", topic="/chatter")
        await bench.send("node", "release", token="mine")
        assert "token" in await bench.refusal("node", "modes", token="mine", modes={"talk": "normal"})
        view = (await bench.send("node", "observe", token="yours"))["functionalities"]["talk"]
        assert (view["mode"], view["because"]) == ("degraded", "released: it no longer has a manager")
        assert (await bench.simulator.endpoints()).publishers == ()
        bench.lab.registrations.clear()
        await bench.lab.channel("node", "of a third system")
        await bench.sleep(0.3)
        assert "node" in bench.lab.registrations, "it does not register any more"
        await bench.send("node", "welcome", token="yours", manager="you")
        assert "for components started by hand" in await refusal_of_one_started_by_its_manager(bench)

    simulate(tmp_path, main)


async def refusal_of_one_started_by_its_manager(bench: Bench) -> str:
    await bench.start("own", TALKER)
    await bench.send("own", "welcome", manager="me")
    return await bench.refusal("own", "release")


def test_a_changing_command_needs_an_id(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("node", TALKER)
        reply = await bench.lab.send("node", "welcome", {"manager": "me"}, id="", revision=0)
        assert reply.refused is not None and "must have an id" in reply.refused

    simulate(tmp_path, main)


def test_standalone_attaches_and_runs_the_best_modes(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("talker", TALKER, "--verbose", "--standalone", "out:=/chatter", "more", token="")
        await bench.start(
            "node",
            HEAD
            + """
import sys
in_, other = comp.create_input("in", String), comp.create_input("other", String)
f = comp.create_functionality("f", inputs=[in_, other])
f.set_normal_mode({in_: lambda m: print("both", m.data)}, inputs=[in_, other])
f.set_mode("one", lambda m: print("heard", m.data), inputs=[any_of(in_, other)])
f.set_degraded_mode(lambda: print("arguments", sys.argv[1:]))
comp.start()
""",
            "--standalone",
            "in:=/chatter",
            token="",
        )
        await bench.sleep(0.2)
        assert bench.log("node")[0] == "arguments ['--standalone', 'in:=/chatter']"
        assert bench.log("node")[1].startswith("heard ")
        assert "runs without a manager: talk in mode normal" in bench.simulator.log("talker")
        assert bench.simulator.transport.present() == {}, "it listens for a manager all the same"
        assert await bench.lab.unreachable("talker")

    simulate(tmp_path, main)


@pytest.mark.parametrize("arguments", [(), ("out=/chatter",)])
def test_standalone_without_topics_says_that_nothing_is_published(arguments: tuple[str, ...], tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("talker", TALKER, "--standalone", *arguments, token="")
        log = bench.simulator.log("talker")
        assert "talker is attached to no topic: it neither publishes nor receives anything" in log
        assert "Name the topics of its ports: --standalone out:=/out" in log
        await bench.start("other", TALKER, "--standalone", "out:=/chatter", token="")
        assert "attached to no topic" not in bench.simulator.log("other")

    simulate(tmp_path, main)


def test_standalone_with_a_port_that_is_not_there(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("talker", TALKER, "--standalone", "put:=/chatter", token="")
        (exited,) = bench.exits()
        assert exited.status == 1 and "there is no port put; the ports of node are: out" in exited.log_tail

    simulate(tmp_path, main)


def test_the_clock_fills_stamps(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
f = comp.create_functionality("f")
f.set_normal_mode(lambda: None, rate=1)

def degraded():
    stamp = comp.clock.stamp(Image().header.stamp)
    print(stamp.sec * 10**9 + stamp.nanosec == comp.clock.now(), comp.clock.seconds() == comp.clock.now() / 1e9)

f.set_degraded_mode(degraded)
comp.start()
""",
        )
        assert bench.log("node") == ["True True"]

    simulate(tmp_path, main)


def test_an_attach_that_is_delayed_by_user_code_leaves_no_endpoint(tmp_path: Path) -> None:
    """There is nothing to match with, and by then user code is busy: the endpoint goes once it returns."""

    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
import time

out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: time.sleep(3), rate=0.25)
talk.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.send("node", "welcome", manager="me")
        await bench.mode("node", "talk", "normal")
        await bench.sleep(3.5)
        refused = await bench.refusal("node", "attach", port="out", topic="/alone", peers=3, timeout=1.0)
        assert "only 0 of 3 endpoints on /alone" in refused
        await bench.sleep(3.5)
        assert (await bench.simulator.endpoints()).publishers == ()
        await bench.attach("node", "out", "/alone")

    simulate(tmp_path, main)


def test_an_input_is_not_attached_where_the_platform_refuses_the_subscription(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create, refusing = SimulatedHost.create_subscription, [True]

    def failing(self: SimulatedHost, *args: Any, **named: Any) -> Any:
        if refusing.pop():
            raise RuntimeError("no more subscriptions")
        return create(self, *args, **named)

    plant(monkeypatch, SimulatedHost, "create_subscription", failing)

    async def main(bench: Bench) -> None:
        await bench.start(
            "node",
            HEAD
            + """
in_ = comp.create_input("in", String)
f = comp.create_functionality("f", inputs=[in_])
f.set_normal_mode(lambda message: None, inputs=[in_])
f.set_degraded_mode(lambda: None)
comp.start()
""",
        )
        await bench.send("node", "welcome", manager="me")
        assert "no more subscriptions" in await bench.refusal("node", "attach", port="in", topic="/chatter")
        assert bench.state("node").ports["in"] == {}
        refusing.append(False)
        await bench.attach("node", "in", "/chatter")

    simulate(tmp_path, main)


def test_a_mode_that_the_platform_cannot_run_is_a_failure_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = SimulatedHost.create_timer

    def failing(self: SimulatedHost, period: float, epoch: int | None, callback: Callable[[int, int], None]) -> Any:
        if period < 0.2:
            raise RuntimeError("no more timers")
        return create(self, period, epoch, callback)

    plant(monkeypatch, SimulatedHost, "create_timer", failing)

    async def main(bench: Bench) -> None:
        await bench.start("node", TALKER)
        await bench.send("node", "welcome", manager="me")
        await bench.mode("node", "talk", "normal")
        await bench.sleep(0.1)
        view = (await bench.send("node", "observe"))["functionalities"]["talk"]
        assert view["mode"] == "degraded" and view["because"].startswith("mode normal raised: RuntimeError: no more")
        await bench.mode("node", "talk", "degraded")

    simulate(tmp_path, main)

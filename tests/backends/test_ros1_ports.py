"""Ports on real ROS 1: what is on the wire, what arrives, and that nothing is lost where a port goes or comes back."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from midstride.backends.ros1 import connection_headers
from midstride.errors import CommandRefused
from midstride.model.contract import QoS
from midstride.wire.commands import GridCommand, RecordsCommand
from midstride.wire.replies import Receipt
from tests.backends.ros1_support import pack_string, program, read_block, rig, subscribe, wait_for
from tests.backends.ros2_support import LISTENER, TALKER, Rig, run, until_async

pytestmark = pytest.mark.ros1


async def one_reader(r: Rig) -> None:
    """Wait until the talker counts its reader: it sends its header before it writes to a connection."""

    async def counted() -> bool:
        return (await r.client.read("talker", GridCommand(port="out", topic="/chatter"))).readers == 1

    await until_async(counted)


def test_a_subscriber_that_requests_nothing_gets_what_rospy_would_send(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter")
            header, reader, writer = await subscribe(r, "/talker", "/chatter", "string data")
            await one_reader(r)
            await r.modes("talker", talk="normal")
            assert header["callerid"] == "/talker" and header["type"] == "std_msgs/String"
            assert not [name for name in header if "midstride" in name]
            for number in range(1, 20):
                assert await read_block(reader) == pack_string(str(number))
            writer.close()

    run(scenario())


def test_a_subscriber_that_requests_them_gets_numbers_and_times_beside_the_message(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/chatter")
            header, reader, writer = await subscribe(
                r, "/talker", "/chatter", connection_headers.request("string data", QoS())
            )
            await one_reader(r)
            begun = time.time_ns()
            await r.modes("talker", talk="normal")
            publisher = connection_headers.publisher_of(header)
            assert publisher and connection_headers.is_compatible(header)
            for number in range(1, 20):
                block = await read_block(reader)
                message = pack_string(str(number))
                assert block.startswith(message)
                trailer = block[len(message) :]
                assert int.from_bytes(trailer[:8], "little") == number
                assert begun <= int.from_bytes(trailer[8:16], "little") <= time.time_ns()
            writer.close()
            # Off and on the topic again: another publisher, counting from 1.
            await r.detach("talker", "out", "/chatter")
            await r.attach("talker", "out", "/chatter")
            header, reader, writer = await subscribe(
                r, "/talker", "/chatter", connection_headers.request("string data", QoS())
            )
            assert connection_headers.publisher_of(header) not in (None, publisher)
            writer.close()

    run(scenario())


def test_an_earlier_subscriber_hears_the_first_message_even_if_it_is_not_waited_for(tmp_path: Path) -> None:
    """The master lists it: an attach waits for all subscribers there, Midstride's or not."""
    heard = tmp_path / "heard"

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            with program("stranger", "/chatter", str(heard)):

                async def subscribed() -> bool:
                    return "/chatter" in (await r.backend._master.state()).subscribers

                await until_async(subscribed)
                await r.attach("talker", "out", "/chatter")
                await r.modes("talker", talk="normal")
                assert (await asyncio.to_thread(wait_for, heard, 3))[:3] == ["1", "2", "3"]

    run(scenario())


FAST = """
from midstride import Component
from std_msgs.msg import String

comp = Component("fast")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = 0

def normal():
    global count
    for _ in range(20):
        count += 1
        out.write(String(data=str(count)))

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""

SLOW = """
import sys, time, rospy
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
heard = open(sys.argv[3], "a", buffering=1)

def take(message):
    heard.write(message.data + chr(10))
    time.sleep(float(sys.argv[4]))

rospy.Subscriber(sys.argv[2], String, take)
rospy.spin()
"""


def test_a_bare_subscriber_that_is_slow_reads_to_the_end_what_was_written_before_a_detach(tmp_path: Path) -> None:
    """rospy's own publisher forgets what it has queued when it is unregistered."""
    heard = tmp_path / "heard"

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("fast", FAST)
            with program("slow", "/fast", str(heard), "0.002", source=SLOW):
                await r.attach("fast", "out", "/fast", peers=1)
                await r.modes("fast", talk="normal")
                await asyncio.to_thread(wait_for, heard, 50)
                await r.modes("fast", talk="degraded")
                written = (await r.link("fast", "out", "/fast")).count
                assert (await r.detach("fast", "out", "/fast")).acknowledged is True
                assert await asyncio.to_thread(wait_for, heard, written) == [str(n) for n in range(1, written + 1)]

    run(scenario())


@pytest.mark.full
def test_a_port_that_comes_back_is_heard_again_by_a_subscriber_inside_a_callback(tmp_path: Path) -> None:
    """rospy's subscriber believes it is still connected, and overlooks the publisher that has come back."""
    heard = tmp_path / "heard"

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            with program("dreamer", "/chatter", str(heard), "1.5", source=SLOW):
                await r.attach("talker", "out", "/chatter", peers=1)
                await r.modes("talker", talk="normal")
                await asyncio.to_thread(wait_for, heard, 1)  # from now on it is inside its callback
                await r.detach("talker", "out", "/chatter")
                assert "/chatter" not in (await r.client.observe("talker")).ports["out"]
                said = len(heard.read_text().splitlines())
                await r.attach("talker", "out", "/chatter", peers=1)
                later = await asyncio.to_thread(wait_for, heard, said + 3, 15.0)
                assert int(later[-1]) > int(later[0])

    run(scenario())


PAIR = """
from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("pair")
qos = QoS(durability="transient_local", depth=1)
left, right = comp.create_output("left", String, qos=qos), comp.create_output("right", String, qos=qos)
talk = comp.create_functionality("talk", outputs=[left, right])

def normal():
    left.write(String(data="left"))
    right.write(String(data="right"))
    right.write(String(data="right again"))

talk.set_normal_mode(normal, outputs=[left, right])
talk.set_degraded_mode(lambda: None)
comp.start()
"""

EARS = """
from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("ears")
late = comp.create_input("late", String, qos=QoS(durability="transient_local", depth=10))
now = comp.create_input("now", String)
listen = comp.create_functionality("listen", inputs=[late, now])
listen.set_normal_mode({late: lambda message: None, now: lambda message: None}, inputs=[late, now])
listen.set_degraded_mode(lambda: None)
comp.start()
"""


def test_ports_that_share_a_topic_are_distinguished_and_late_joiners_get_what_they_request(tmp_path: Path) -> None:
    async def rows(r: Rig, port: str) -> list[Receipt]:
        return (await r.client.read("ears", RecordsCommand(input=port))).rows

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("pair", PAIR)
            await r.start("ears", EARS)
            for port in ("left", "right"):
                await r.attach("pair", port, "/pair")
            await r.modes("pair", talk="normal")
            for port in ("now", "late"):  # the second one shares the connection of the first
                await r.attach("ears", port, "/pair", peers=1)
            await until_async(lambda: rows(r, "late"))
            assert await rows(r, "now") == [], "it has not requested earlier messages"
            await r.modes("pair", talk="degraded")
            await r.modes("pair", talk="normal")

            async def all_came() -> bool:
                return len(await rows(r, "now")) == 3

            await until_async(all_came)
            publishers = [row.publisher for row in await rows(r, "now")]
            assert publishers[0] != publishers[1] == publishers[2]
            assert [row.number for row in await rows(r, "now")] == [2, 3, 4]
            # Taking one of them off the topic does not concern the other.
            await r.detach("pair", "left", "/pair")
            await r.detach("ears", "late", "/pair")
            await r.modes("pair", talk="degraded")
            await r.modes("pair", talk="normal")

            async def two_more() -> bool:
                return len(await rows(r, "now")) == 5

            await until_async(two_more)
            seen = await r.backend.endpoints()
            assert (seen.publishers, seen.subscribers) == ((("/pair", "/pair"),), (("/ears", "/pair"),))

    run(scenario())


LARGE = """
from midstride import Component
from std_msgs.msg import String

comp = Component("large")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: out.write(String(data="x" * 1_000_000)), rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.full
def test_a_frozen_subscriber_does_not_delay_the_publisher(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("large", LARGE)
            await r.start("listener", LISTENER)
            await r.start("sleeper", LISTENER)
            for name in ("listener", "sleeper"):
                await r.attach(name, "in", "/large")
            await r.attach("large", "out", "/large", peers=2)
            r.kill("sleeper", signal.SIGSTOP)
            await r.modes("large", talk="normal")

            async def received() -> int:
                return (await r.link("listener", "in", "/large")).count

            await until_async(received)
            before = await received()

            async def more() -> bool:
                return await received() > before + 30

            await until_async(more)  # a publisher that waits for the frozen one writes 5 at most
            answer = await asyncio.wait_for(r.detach("large", "out", "/large"), 20.0)
            assert answer.acknowledged is None, "what the frozen one will read is unknown"
            r.kill("sleeper", signal.SIGCONT)
            await r.client.observe("sleeper")

    run(scenario())


@contextlib.asynccontextmanager
async def frozen(pid: int) -> AsyncIterator[None]:
    import os

    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def test_a_frozen_master_delays_no_component(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("talker", TALKER)
            await r.attach("talker", "out", "/a", gate="closed")
            await r.modes("talker", talk="normal")
            async with frozen(await r.backend._master.process()):
                before = (await r.link("talker", "out", "/a")).gated
                with pytest.raises(CommandRefused, match="0 of 0"):
                    await r.attach("talker", "out", "/b", timeout=1.0)
                after = (await r.link("talker", "out", "/a")).gated
                assert after - before > 10  # of 50
            await r.attach("talker", "out", "/b")
            assert ("/talker", "/b") in (await r.backend.endpoints()).publishers

    run(scenario())


def test_numbers_of_a_bare_publisher_are_those_of_its_headers(tmp_path: Path) -> None:
    source = """
import sys, rospy
from sensor_msgs.msg import Range
rospy.init_node(sys.argv[1])
publisher = rospy.Publisher(sys.argv[2], Range, queue_size=10)
rate = rospy.Rate(50)
while not rospy.is_shutdown():
    message = Range()
    message.header.stamp = rospy.Time.now()
    publisher.publish(message)
    rate.sleep()
"""
    listener = LISTENER.replace("std_msgs.msg import String", "sensor_msgs.msg import Range as String")

    async def scenario() -> None:
        async with rig(tmp_path) as r:
            await r.start("listener", listener)
            with program("sensor", "/range", source=source):
                await r.attach("listener", "in", "/range", peers=1)

                async def rows() -> list[Receipt]:
                    found = (await r.client.read("listener", RecordsCommand(input="in"))).rows
                    return found if len(found) > 10 else []

                await until_async(rows)
                seen = await rows()
                assert {(row.source, row.publisher) for row in seen} == {(None, "/sensor")}
                numbers = [row.number for row in seen]
                assert numbers[0] is not None and numbers == list(range(numbers[0], numbers[0] + len(numbers)))

    run(scenario())

"""Services of nodes without Midstride's API across replacements: every request is handled once, by bare clients' count.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 200 take too long.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import Robot, declared_talker, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "200"))

# Plain rclpy: it talks, and notes each request that it handles.
SERVER = """
import time
import rclpy
from pathlib import Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

rclpy.init()
node = Node("talker")
name, number = node.get_name(), 0
publisher = node.create_publisher(String, "chatter", 10)
calls = (Path(__file__).parent / "calls").open("a", buffering=1)

def talk():
    global number
    number += 1
    publisher.publish(String(data=f"{name} {number}"))

def count(request, response):
    calls.write(f"{request.prefixes[0]} {name}\\n")
    if request.depth:
        time.sleep(request.depth / 1000)
    response.result.names = [name]
    return response

node.create_timer(0.02, talk)
node.create_service(ListParameters, "count", count)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""

# Bare clients, each with one request at a time, until SIGTERM. It writes each: its name, its latency (s), who answered.
CLIENTS = """
import signal
import sys
import time
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rcl_interfaces.srv import ListParameters

rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Node("callers")
number, period, takes = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
# A client's queue has the responses to all clients of the service: of ten, some fall out where this process is late.
deep = QoSProfile(depth=400)
clients = [node.create_client(ListParameters, "count", qos_profile=deep) for _ in range(number)]
for client in clients:
    client.wait_for_service()
stopped, sent, waiting = [], 0, {}
signal.signal(signal.SIGTERM, lambda *_: stopped.append(time.monotonic()))
due = [time.monotonic() + index * period / number for index in range(number)]
print("ready", flush=True)
while not stopped or (waiting and time.monotonic() < stopped[0] + 8):
    now = time.monotonic()
    for index, client in enumerate(clients):
        if index in waiting:
            future, since, name = waiting[index]
            if future.done():
                print(name, now - since, future.result().result.names[0], flush=True)
                del waiting[index]
        elif not stopped and now >= due[index]:
            due[index], sent = max(due[index] + period, now), sent + 1
            name = f"{index}_{sent}"
            waiting[index] = client.call_async(ListParameters.Request(prefixes=[name], depth=takes)), now, name
    rclpy.spin_once(node, timeout_sec=0.002)
for _, since, name in waiting.values():
    print(name, time.monotonic() - since, "-", flush=True)
"""


class Calls:
    """What the clients have written, and what the servers have."""

    def __init__(self, folder: Path) -> None:
        self._handled, self._answered = folder / "calls", folder / "answered"

    @property
    def answered(self) -> list[tuple[str, float, str]]:
        """Name, latency (s) and server of each request that has been answered, or was given up (`-`)."""
        whole = self._answered.read_text().rpartition("\n")[0]  # the last line may be under way
        words = (line.split() for line in whole.splitlines()[1:])
        return [(name, float(latency), server) for name, latency, server in words]

    @property
    def handled(self) -> list[tuple[str, str]]:
        whole = self._handled.read_text().rpartition("\n")[0]
        return [(words[0], words[1]) for words in map(str.split, whole.splitlines())]

    def are_handled_once(self) -> None:
        """Each request was handled by one server, the one that answered it, once; and a client's in their order."""
        answered = {name: server for name, _, server in self.answered}
        unanswered = [(name, dict(self.handled).get(name)) for name, server in answered.items() if server == "-"]
        assert not unanswered, f"not answered: {unanswered}"
        twice = [(name, count) for name, count in Counter(name for name, _ in self.handled).items() if count > 1]
        assert not twice, f"handled twice: {twice}"
        assert dict(self.handled) == answered
        by_client: dict[str, list[int]] = {}
        for name, _ in self.handled:
            client, number = name.split("_")
            by_client.setdefault(client, []).append(int(number))
        assert all(numbers == sorted(numbers) for numbers in by_client.values())


def written(folder: Path) -> Path:
    """A system with a talker that serves, and the clients, in ``folder``."""
    (folder / "server.py").write_text(SERVER)
    (folder / "clients.py").write_text(CLIENTS)
    text = "system serving\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Plain", "python3 server.py", "preload")
    text += declared_talker("Other", "python3 server.py", "preload")
    path = folder / "serving.stride"
    path.write_text(f"{text}node talker : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return path


@asynccontextmanager
async def called(
    folder: Path, system: Robot, clients: int = 20, period: float = 0.1, takes: int = 0
) -> AsyncIterator[Calls]:
    """Meanwhile, bare clients call; each request takes ``takes`` ms. At the end, all that were sent are judged."""
    with (folder / "answered").open("w") as output:
        command = [sys.executable, str(folder / "clients.py"), str(clients), str(period), str(takes)]
        process = subprocess.Popen(command, stdout=output, env=without_midstride())
        try:
            calls = Calls(folder)
            await system.until(lambda: "ready" in (folder / "answered").read_text())
            await system.until(lambda: len(calls.answered) > clients)
            yield calls
            process.send_signal(signal.SIGTERM)
            await system.until(lambda: process.poll() is not None)
        finally:
            process.kill()
            process.wait()
    calls.are_handled_once()


def replaced_often(folder: Path, number: int) -> None:
    """Replace the server under 20 clients; print what that costs them."""

    async def scenario() -> None:
        async with robot(load(written(folder)).require(), folder) as system:
            async with called(folder, system) as calls:
                for count in range(number):
                    await system.replaced("Plain" if count % 2 else "Other")
                count = len(calls.answered)
                await system.until(lambda: len(calls.answered) > count + 40)
            assert len(system.changes()) == number
            assert system.holes() == []
            found = sorted(latency for _, latency, _ in calls.answered)
            p50, p99 = (found[int(len(found) * part)] for part in (0.5, 0.99))
            print(f"{len(found)} requests, p50 {p50 * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, {found[-1] * 1e3:.1f} ms")

    with ended():
        run(scenario(), 3600)


def test_every_request_is_handled_once_across_replacements(tmp_path: Path) -> None:
    replaced_often(tmp_path, 2)


@pytest.mark.long
def test_every_request_is_handled_once_across_many_replacements(tmp_path: Path) -> None:
    replaced_often(tmp_path, REPLACEMENTS)

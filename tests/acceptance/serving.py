"""Servers in plain rclpy, in C on rcl and with the API, bare clients that call them, and what both have counted."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final, NamedTuple

from tests.acceptance.foreign_support import Robot, declared_talker
from tests.backends.ros2_support import without_midstride
from tests.native import SERVER as SERVER_IN_C
from tests.native import compiled

# Plain rclpy: it talks, and notes each request that it handles.
SERVER = """
import os
import time
import rclpy
from pathlib import Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

rclpy.init()
node = Node("talker")
name, number = os.environ["MIDSTRIDE_INSTANCE"], 0
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

# With the API: the same, as a port. It does not note requests of the name `-`, and fails at those of depth 77.
OURS: Final = """
import time
from pathlib import Path

from midstride import Component
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

comp = Component("Ours")
calls = (Path(__file__).parent / "calls").open("a", buffering=1)
number = 0

def normal():
    global number
    number += 1
    out.write(String(data=f"{comp.instance} {number}"))

def answer(request, response):
    if request.prefixes[0] != "-":
        calls.write(f"{request.prefixes[0]} {comp.instance}\\n")
    if request.depth == 77:
        raise ValueError("77 is too deep")
    if request.depth:
        time.sleep(request.depth / 1000)
    response.result.names = [comp.instance]

def refuse(request, response):
    response.result.names = ["refused"]

out = comp.create_output("out", String)
count = comp.create_server("count", ListParameters, answer, within=0.5)
map = comp.create_server("map", ListParameters, answer, refusal=refuse)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
for name, port in (("counting", count), ("mapping", map)):
    functionality = comp.create_functionality(name, outputs=[port])
    functionality.set_normal_mode(lambda: None, outputs=[port])
    functionality.set_degraded_mode(lambda: None, name="off")
comp.start()
"""
# The same with one server.
COUNTING_OURS: Final = OURS.replace(
    'map = comp.create_server("map", ListParameters, answer, refusal=refuse)\n', ""
).replace(', ("mapping", map)', ",")
OUR_SYSTEM: Final = """system serving
contract Listing = rcl_interfaces/srv/ListParameters
topic /chat : std_msgs/msg/String @ 50 Hz
service /count : rcl_interfaces/srv/ListParameters responds within 0.5 s
service /map : Listing
component Ours {
  run "python3 ours.py"
  output out
  server count
  server map
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }  mode degraded { } }
  functionality counting {
    produces count
    mode normal { guarantee count : rcl_interfaces/srv/ListParameters responds within 0.5 s }
    mode off { }
  }
  functionality mapping { produces map  mode normal { guarantee map : Listing }  mode off { } }
}
component OurOther like Ours { run "python3 ours.py" }
node talker : Ours { out -> /chat  count -> /count  map -> /map }
"""
# The same as a lifecycle node, whose service is one below its name.
LIFECYCLE_SERVER = (
    SERVER.replace("from rclpy.node import Node", "from rclpy.lifecycle import LifecycleNode as Node")
    .replace("create_publisher(", "create_lifecycle_publisher(")
    .replace("    global number\n", "    global number\n    if not publisher.is_activated:\n        return\n")
    .replace('"count"', '"~/count"')
)

# Bare clients, each with one request at a time, until SIGTERM. It writes each: its name, its latency (s), who answered,
# and when it was sent (monotonic, s). The last arguments: after how long a request is given up (s), and the service.
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
patience, service = float(sys.argv[4]), sys.argv[5]
# A client's queue has the responses to all clients of the service: of ten, some fall out where this process is late.
deep = QoSProfile(depth=400)
clients = [node.create_client(ListParameters, service, qos_profile=deep) for _ in range(number)]
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
                print(name, now - since, future.result().result.names[0], since, flush=True)
                del waiting[index]
            elif now - since > patience:
                print(name, now - since, "-", since, flush=True)
                del waiting[index]
        elif not stopped and now >= due[index]:
            due[index], sent = max(due[index] + period, now), sent + 1
            name = f"{index}_{sent}"
            waiting[index] = client.call_async(ListParameters.Request(prefixes=[name], depth=takes)), now, name
    rclpy.spin_once(node, timeout_sec=0.002)
for _, since, name in waiting.values():
    print(name, time.monotonic() - since, "-", since, flush=True)
"""


class Answered(NamedTuple):
    """A request that has been answered, or was given up (``server`` is `-`); ``at``: sent at (monotonic, s)."""

    name: str
    latency: float
    server: str
    at: float


class Calls:
    """What the clients have written, and what the servers have."""

    def __init__(self, folder: Path) -> None:
        self._handled, self._answered = folder / "calls", folder / "answered"

    @property
    def answered(self) -> list[Answered]:
        """What has become of each request, in the order in which that was known."""
        whole = self._answered.read_text().rpartition("\n")[0]  # the last line may be under way
        words = (line.split() for line in whole.splitlines()[1:])
        return [Answered(name, float(latency), server, float(at)) for name, latency, server, at in words]

    @property
    def handled(self) -> list[tuple[str, str]]:
        whole = self._handled.read_text().rpartition("\n")[0]
        return [(words[0], words[1]) for words in map(str.split, whole.splitlines())]

    @property
    def unanswered(self) -> list[Answered]:
        return [each for each in self.answered if each.server == "-"]

    @property
    def handled_twice(self) -> list[str]:
        return [name for name, count in Counter(name for name, _ in self.handled).items() if count > 1]

    @property
    def out_of_order(self) -> list[str]:
        """The requests that were handled after a later one of the same client."""
        latest: dict[str, int] = {}
        found = []
        for name, _ in self.handled:
            client, number = name.split("_")
            if int(number) < latest.get(client, 0):
                found.append(name)
            latest[client] = max(int(number), latest.get(client, 0))
        return found

    def are_handled_once(self) -> None:
        """Each request was handled by one server, the one that answered it, once; and a client's in their order."""
        handled = dict(self.handled)
        unanswered = [(each.name, handled.get(each.name)) for each in self.unanswered]
        assert not unanswered, f"not answered: {unanswered}"
        assert not self.handled_twice, f"handled twice: {self.handled_twice}"
        assert handled == {each.name: each.server for each in self.answered}
        assert not self.out_of_order, f"out of order: {self.out_of_order}"


PLAIN: Final = "python3 server.py"


def written(folder: Path) -> Path:
    """A system with a talker that serves, and the clients, in ``folder``.

    It is a `Plain`, and can become `Other`, both in plain rclpy, and `Id` and `Info`, in C on rcl: they take requests
    by the one and by the other of its functions.
    """
    (folder / "server.py").write_text(SERVER)
    (folder / "clients.py").write_text(CLIENTS)
    compiled(folder, SERVER_IN_C, "c_server")
    text = "system serving\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Plain", "Other"):
        text += declared_talker(name, PLAIN, "preload")
    for name in ("Id", "Info"):
        text += declared_talker(name, f"./c_server 20000000 {name.lower()}", "preload")
    path = folder / "serving.stride"
    path.write_text(f"{text}node talker : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return path


def written_with_the_api(folder: Path, more: str = "") -> Path:
    """A system with a talker that serves with the API, and the clients, in ``folder``; ``more``: of the specification.

    It is an `Ours`, and can become an `OurOther`.
    """
    (folder / "ours.py").write_text(OURS)
    (folder / "clients.py").write_text(CLIENTS)
    path = folder / "ours.stride"
    path.write_text(OUR_SYSTEM + more, encoding="utf-8")
    return path


Until = Callable[[Callable[[], bool]], Awaitable[None]]


@asynccontextmanager
async def calling(
    folder: Path,
    until: Until,
    clients: int = 20,
    period: float = 0.1,
    takes: int = 0,
    patience: float = math.inf,
    service: str = "count",
) -> AsyncIterator[Calls]:
    """Meanwhile, bare clients call ``service``; a request takes ``takes`` ms, and is given up after ``patience`` (s).

    ``until`` waits for what is to come true. At the end, all that was sent has been answered, or was given up.
    """
    with (folder / "answered").open("w") as output:
        given = map(str, (clients, period, takes, patience, service))
        command = [sys.executable, str(folder / "clients.py"), *given]
        process = subprocess.Popen(command, stdout=output, env=without_midstride())
        try:
            calls = Calls(folder)
            await until(lambda: "ready" in (folder / "answered").read_text())
            await until(lambda: len(calls.answered) > clients)
            yield calls
            process.send_signal(signal.SIGTERM)
            await until(lambda: process.poll() is not None)
        finally:
            process.kill()
            process.wait()


@asynccontextmanager
async def called(
    folder: Path, system: Robot, clients: int = 20, period: float = 0.1, takes: int = 0, service: str = "count"
) -> AsyncIterator[Calls]:
    """As :func:`calling`; at the end, all that were sent are judged."""
    async with calling(folder, system.until, clients, period, takes, service=service) as calls:
        yield calls
    calls.are_handled_once()

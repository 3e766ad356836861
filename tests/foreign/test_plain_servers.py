"""Two plain rclpy servers of one service behind the library, without a manager: who answers when which of them dies.

The steps of the manager are taken here.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign.page import Page
from tests.backends.ros2_support import Bare, run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Handles each request for as many milliseconds as it says, and answers with the instance and the name of the request.
SERVER = """
import sys, time
import rclpy
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters

rclpy.init()
node = Node("server", start_parameter_services=False)

def count(request, response):
    time.sleep(request.depth / 1000)
    response.result.names = [sys.argv[1], *request.prefixes]
    return response

def own(request, response):
    response.result.names = [sys.argv[1]]
    return response

node.create_service(ListParameters, "/count", count)
node.create_service(ListParameters, f"/{sys.argv[1]}/own", own)
rclpy.spin(node)
"""


class Servers:
    """The old one and the new one, and clients that call them."""

    def __init__(self, folder: Path, library: Path, bare: Bare) -> None:
        self.page = Page(folder / "page", library)
        self.bare = bare
        self._library, self._program = library, folder / "server.py"
        self._program.write_text(SERVER)
        self.processes: dict[int, subprocess.Popen[bytes]] = {}
        self._clients: dict[str, Any] = {}
        self.names: dict[int, str] = {}

    async def start(self, name: str, of: int | None = None) -> int:
        """Start one; its index. It is known to the clients on return."""
        page = self.page
        index = page.allocate(name)
        self.names[index] = name
        page.have_requests(index, of)
        given = {
            "LD_PRELOAD": str(self._library),
            "MIDSTRIDE_GATE_PAGE": str(page.path),
            "MIDSTRIDE_GATE_NODE": str(index),
        }
        command = [sys.executable, str(self._program), name]
        self.processes[index] = subprocess.Popen(command, env={**without_midstride(), **given})
        await self.bare.until(lambda: "/count" in page.servers(index))
        answer = await self.bare.ask(self.client(f"/{name}/own"), self.request("", 0))
        assert answer.result.names == [name], "a service that the other one does not have is answered at once"
        number = len([each for each in self.processes.values() if each.poll() is None])
        await self.bare.until(lambda: self.bare.node.count_services("/count") >= number)
        return index

    def client(self, service: str = "/count", key: str = "") -> Any:
        from rcl_interfaces.srv import ListParameters
        from rclpy.qos import QoSProfile

        if service + key not in self._clients:  # its own queue of responses is deep enough for a burst
            make = self.bare.node.create_client
            self._clients[service + key] = make(ListParameters, service, qos_profile=QoSProfile(depth=200))
        return self._clients[service + key]

    @staticmethod
    def request(name: str, takes: int) -> Any:
        from rcl_interfaces.srv import ListParameters

        return ListParameters.Request(prefixes=[name], depth=takes)

    def call(self, name: str, takes: int = 0, key: str = "") -> Any:
        return self.client(key=key).call_async(self.request(name, takes))

    async def answered(self, future: Any) -> str:
        """Which server has answered."""
        await self.bare.until(future.done, 20)
        return str(future.result().result.names[0])

    async def answers(self, name: str) -> None:
        """The server of that name answers ten requests."""
        for number in range(10):
            assert await self.answered(self.call(f"{name} {number}")) == name

    def claimed(self, index: int) -> int:
        return int(self.page.servers(index)["/count"].passed)

    async def claims(self, index: int, count: int) -> None:
        """The server has claimed so many requests in all, before the end of the wait."""
        await self.bare.until(lambda: self.claimed(index) == count)

    def held(self, index: int) -> int:
        return int(self.page.servers(index)["/count"].gated)

    def send(self, index: int, number: int) -> None:
        os.kill(self.processes[index].pid, number)
        if number == signal.SIGKILL:
            self.processes[index].wait()

    def close(self) -> None:
        for process in self.processes.values():
            process.kill()
            process.wait()


def note(order: list[str], name: str, _: Any) -> None:
    order.append(name)


def has_both(order: list[str]) -> bool:
    return len(order) == 2


@pytest.fixture
def servers(tmp_path: Path, gate_library: Path) -> Iterator[Servers]:
    with Bare() as bare:
        made = Servers(tmp_path, gate_library, bare)
        try:
            yield made
        finally:
            made.close()


def test_one_answers_and_the_other_one_goes_on_when_it_dies(servers: Servers) -> None:
    async def scenario() -> None:
        page = servers.page
        old = await servers.start("old")
        await servers.answers("old")
        new = await servers.start("new", old)
        await servers.answers("old")
        assert (servers.claimed(old), servers.claimed(new)) == (20, 0)
        page.give_requests(new, 2.0)
        page.ring(new)
        await servers.answers("new")
        assert (servers.claimed(old), servers.claimed(new)) == (20, 10)
        page.give_requests(old, 2.0)  # a roll-back
        await servers.answers("old")
        page.give_requests(new, 2.0)
        await servers.answers("new")
        # The new one dies with what it has taken; the old one answers what it has not.
        servers.send(new, signal.SIGSTOP)
        waiting = servers.call("not taken")
        await servers.bare.until(lambda: servers.held(old) == 1)
        servers.send(new, signal.SIGKILL)
        assert await servers.answered(waiting) == "old"
        await servers.answers("old")
        page.free(new)
        third = await servers.start("third", old)
        # The old one dies before it has been succeeded: the manager gives the third one the requests.
        servers.send(old, signal.SIGSTOP)
        waiting = servers.call("held")
        await servers.bare.until(lambda: servers.held(third) == 1)
        servers.send(old, signal.SIGKILL)
        page.give_requests(third, 2.0)
        page.ring(third)
        assert await servers.answered(waiting) == "third"
        await servers.answers("third")

    run(scenario())


def test_the_new_one_begins_when_the_old_one_has_answered_or_its_time_is_over(servers: Servers) -> None:
    async def scenario() -> None:
        page = servers.page
        old = await servers.start("old")
        new = await servers.start("new", old)
        for patience, first in ((10.0, "slow"), (0.0, "next")):
            begun = servers.claimed(old)
            order: list[str] = []
            calls = {"slow": servers.call("slow", 1500)}
            await servers.claims(old, begun + 1)
            calls["next"] = servers.call("next", 300, key="another client")  # so long that the order shows
            await servers.bare.until(lambda: servers.held(new) == 1)
            for name, future in calls.items():
                future.add_done_callback(partial(note, order, name))
            page.give_requests(new, patience)
            page.ring(new)
            assert await servers.answered(calls["next"]) == "new"
            assert await servers.answered(calls["slow"]) == "old"
            await servers.bare.until(partial(has_both, order))  # noted once the executor gets to it
            assert order[0] == first
            await servers.answers("new")
            page.give_requests(old, 2.0)
            await servers.answers("old")

    run(scenario())


def test_what_the_new_one_has_not_received_is_answered_by_the_old_one(servers: Servers) -> None:
    """As of a client that does not know the new server yet: the new one, which is stopped, has seen nothing of it."""

    async def scenario() -> None:
        page = servers.page
        old = await servers.start("old")
        new = await servers.start("new", old)
        page.give_requests(new, 2.0)
        await servers.answers("new")
        servers.send(new, signal.SIGSTOP)
        begun = time.monotonic()
        assert await servers.answered(servers.call("left over", key="a client that is not known")) == "old"
        print(f"after {time.monotonic() - begun:.3f} s")
        servers.send(new, signal.SIGCONT)
        await servers.answers("new")
        assert servers.held(new) == 0

    run(scenario())


def test_a_burst_does_not_overflow_the_queue_of_a_busy_server(servers: Servers) -> None:
    async def scenario() -> None:
        old = await servers.start("old")
        busy = servers.call("busy", 500)
        await servers.bare.until(lambda: servers.claimed(old) == 1)
        calls = [servers.call(f"{number}", key="burst") for number in range(100)]
        assert await servers.answered(busy) == "old"
        for call in calls:
            assert await servers.answered(call) == "old"

    run(scenario())

"""Services on the simulator, which handle admitted requests as rclpy's do, and a client that calls without end.

Every server of a service receives every request, each after its own latency.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import random
from collections import Counter
from collections.abc import Callable
from typing import Any

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.host import SimulatedHost
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.node.component_host import Host
from midstride.node.request_admission import PassableRequest

# Appended to a counter's program: a service that notes each request in the state, and returns all that it has noted.
SERVICE = """
count["asked"] = []

@comp.on_setup
def set_up(node):
    def ask(request):
        count["asked"].append(request)
        return list(count["asked"])
    node.create_service("ask", ask)
"""
# The same, in an async function that takes so long (s).
SLOW_SERVICE = """
count["asked"] = []

@comp.on_setup
def set_up(node):
    async def ask(request):
        await comp.clock.sleep({seconds})
        count["asked"].append(request)
        return list(count["asked"])
    node.create_service("ask", ask)
"""


class PlantedNode:
    """What `on_setup` gets: services run on the component's thread, between two calls of its modes."""

    def __init__(self, host: SimulatedHost, process: SimulatedProcess) -> None:
        self.instance = host.instance
        self._host, self._process = host, process
        self._services: dict[str, Callable[[str], Any]] = {}

    def create_service(self, name: str, serve: Callable[[str], Any]) -> None:
        self._services[name] = serve

        def passed(request: str, data: bytes, respond: Callable[[bytes | None], object]) -> None:
            def reply(instance: str, value: Any) -> None:
                respond(json.dumps([instance, value]).encode())

            self._process.enqueue(self._handling(name, data.decode(), reply))

        self._host.admission.passed_handlers[name] = passed

    def receive(self, name: str, request: str, reply: Callable[[str, Any], None]) -> None:
        """Take a request that has arrived: of a process that lives and has this service."""
        if self._process.dead or name not in self._services:
            return
        admission, handle = self._host.admission, self._handling(name, request, reply)

        def respond(data: bytes) -> None:
            if not self._process.dead:
                reply(*json.loads(data))

        def take() -> None:
            passable = PassableRequest(name, request.encode, respond)
            if admission.admit(request, lambda: self._process.enqueue(handle), passable):
                handle()

        self._process.enqueue(take)

    def _handling(self, name: str, request: str, reply: Callable[[str, Any], None]) -> Callable[[], None]:
        """What handles ``request`` on the component's thread, and sends the reply."""
        admission, serve = self._host.admission, self._services[name]

        def handle() -> None:
            result = serve(request)
            if not inspect.isawaitable(result):
                admission.finished(request)
                reply(self._host.instance, result)
                return

            async def finish() -> None:
                value = await result
                admission.finished(request)
                reply(self._host.instance, value)

            self._host.run_coroutine(finish(), lambda: None)

        return handle


class ServingSimulator(Simulator):
    """Its components get a node to create services on."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.nodes: dict[SimulatedProcess, PlantedNode] = {}

    def _host(self, process: SimulatedProcess, name: str) -> Host:
        host = super()._host(process, name)
        assert isinstance(host, SimulatedHost)
        self.nodes[process] = PlantedNode(host, process)
        host.ros_node = self.nodes[process]  # type: ignore[assignment]
        return host


class Caller:
    """Calls ``ask`` every ``interval`` seconds from now on, until :meth:`stop`.

    ``knows`` says of which instances it has discovered the server by now.
    """

    def __init__(
        self,
        simulator: ServingSimulator,
        interval: float = 0.001,
        seed: int = 0,
        name: str = "request",
        knows: Callable[[str], bool] = lambda instance: True,
    ) -> None:
        self._knows = knows
        self.sent: list[str] = []
        self.answers: dict[str, list[tuple[str, Any]]] = {}
        self._simulator, self._interval, self._random, self._name = simulator, interval, random.Random(seed), name
        self._task = asyncio.ensure_future(self._call())

    async def _call(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            request = f"{self._name} {len(self.sent)}"
            self.sent.append(request)
            for process, node in list(self._simulator.nodes.items()):
                if not process.dead and self._knows(node.instance):
                    latency = self._random.uniform(0.0003, 0.002)
                    loop.call_later(latency, node.receive, "ask", request, self._reply(request))
            await asyncio.sleep(self._interval)

    def _reply(self, request: str) -> Callable[[str, Any], None]:
        def reply(instance: str, value: Any) -> None:
            self.answers.setdefault(request, []).append((instance, value))

        return reply

    @property
    def answered_by(self) -> Counter[str]:
        return Counter(instance for answers in self.answers.values() for instance, _ in answers)

    async def stop(self) -> list[str]:
        """The requests in the state in the end, once all have been answered."""
        self._task.cancel()
        for _ in range(1000):
            if len(self.answers) == len(self.sent):
                break
            await asyncio.sleep(0.01)
        unanswered = [request for request in self.sent if request not in self.answers]
        assert not unanswered, f"{len(unanswered)} of {len(self.sent)}: {unanswered[:5]}"
        assert {len(answers) for answers in self.answers.values()} == {1}, "a request was handled more than once"
        states = [value for answers in self.answers.values() for _, value in answers]
        longest: list[str] = max(states, key=len)
        return longest

"""What tests of the author's API share: the message class, and scripts run in the simulator."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.messages import message_class
from midstride.runtime.backend_protocol import Exited, Launch
from midstride.wire.frames import Reply
from midstride.wire.state import ComponentState
from tests.conformance.lab import TOKEN, Lab

String: type = message_class("std_msgs/msg/String")
Image: type = message_class("sensor_msgs/msg/Image")


class Bench:
    """A simulator with a laboratory: start scripts, command them."""

    def __init__(self, folder: Path, simulator: Simulator, lab: Lab) -> None:
        self.simulator = simulator
        self.lab = lab
        self._folder = folder
        self._ids = 0

    async def start(self, name: str, source: str, *arguments: str, token: str = TOKEN, **parameters: object) -> None:
        """Write ``source`` to a file and start it; it is up to the caller to welcome it."""
        (self._folder / f"{name}.py").write_text(textwrap.dedent(source), encoding="utf-8")
        command = (sys.executable, f"{name}.py", *arguments)
        await self.simulator.start(Launch(name, "", command, token, self._folder, parameters))
        await self.sleep(0.2)

    async def sleep(self, seconds: float) -> None:
        await self.simulator.clock.sleep(seconds)

    def state(self, instance: str) -> ComponentState:
        """What the component last published of its state."""
        state = self.simulator.state(instance)
        assert state is not None, f"{instance} has published nothing"
        return state

    async def send(self, instance: str, op: str, token: str = TOKEN, **arguments: Any) -> dict[str, Any]:
        """Carry out a command at whatever revision the component is; it must not be refused."""
        reply = await self._reply(instance, op, token, arguments)
        assert reply.refused is None, reply.refused
        result: dict[str, Any] = msgspec.json.decode(reply.result)
        return result

    async def refusal(self, instance: str, op: str, token: str = TOKEN, **arguments: Any) -> str:
        """The words with which a command is refused, which it must be."""
        reply = await self._reply(instance, op, token, arguments)
        assert reply.refused is not None, f"`{op}` was not refused"
        return reply.refused

    async def _reply(self, instance: str, op: str, token: str, arguments: dict[str, Any]) -> Reply:
        self._ids += 1
        revision = self.state(instance).revision
        return await self.lab.send(instance, op, arguments, id=str(self._ids), revision=revision, token=token)

    async def attach(self, instance: str, port: str, topic: str) -> None:
        await self.send(instance, "attach", port=port, topic=topic)

    async def mode(self, instance: str, functionality: str, mode: str) -> None:
        await self.send(instance, "modes", modes={functionality: mode})

    def log(self, instance: str) -> list[str]:
        """The lines the component has printed itself, without what its logger said."""
        return [line for line in self.simulator.log(instance).splitlines() if line and not line.startswith("[")]

    def exits(self) -> list[Exited]:
        return list(self.lab.exits.values())


def simulate(folder: Path, main: Callable[[Bench], Awaitable[None]], **options: Any) -> None:
    """Run ``main`` with a bench in virtual time."""
    simulator = Simulator(**options)

    async def opened() -> None:
        async with Lab(simulator, folder) as lab:
            await main(Bench(folder, simulator, lab))

    simulator.run(opened())

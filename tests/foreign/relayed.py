"""Relays in virtual time, under a manager: their programs are simulated, everything else is real.

Run as a program, it is the process of a relay; its argument is the file of its order.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, TypeVar

from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.own_names import StartName
from midstride.backends.simulator import Simulator
from midstride.backends.simulator.virtual_clock import SimulatedTimer
from midstride.foreign.foreign_state import OfferedState
from midstride.foreign.graph_check import GraphEndpoint, NamedServer, Served
from midstride.foreign.relay import RelayComponent, RelayPlatform
from midstride.foreign.relayed_program import RelayOrder
from midstride.foreign.services import NoAnswer
from midstride.lang.load import load
from midstride.model.contract import QoS
from midstride.model.instance_names import full_name
from midstride.node.component_host import Host
from midstride.node.process_context import ProcessContext, find
from midstride.runtime.backend_protocol import Handle, Launch
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace

T = TypeVar("T")


@dataclass
class Text:
    """What programs publish and receive."""

    __msgtype__: ClassVar[str] = "std_msgs/msg/String"
    data: str = ""


class Read(Text):
    """What is read of a message where its fields are checked: nothing else has the field ``number``."""

    def __init__(self, message: Text) -> None:
        super().__init__(message.data)
        self.number = int(message.data.split()[1])


@dataclass
class Program:
    """How the nodes of a component behave: they publish at ``rate`` (Hz).

    ``hung``: the instances that write nothing now; all do so after ``most`` messages. ``type``: of the subscriptions.
    ``set``: what was set at once of their parameters, in order; ``rejects``: by parameter, why it cannot be. ``own``:
    the parameters that they declare besides those that they are started with; ``values``: by instance, what it has now.
    ``mute``: the instances that do not answer for their parameters, or their state. ``offers``: the services by which
    they offer their state, which is how many messages they have written; ``refuses``: why they do not import it.
    ``takes``: how long they take to export it, and to import it (s).
    """

    rate: float = 50.0
    hung: set[str] = field(default_factory=set)
    mute: set[str] = field(default_factory=set)
    most: float = math.inf
    type: str = "std_msgs/msg/String"
    set: list[dict[str, Any]] = field(default_factory=list)
    rejects: dict[str, str] = field(default_factory=dict)
    own: dict[str, Any] = field(default_factory=dict)
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    offers: tuple[tuple[str, str], ...] = ()
    refuses: str | None = None
    takes: float = 0.0


@dataclass
class ProgramParameters:
    """The parameter services of the node of ``instance``."""

    program: Program
    instance: str

    async def _answers(self, timeout: float) -> None:
        if self.instance in self.program.mute:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")

    async def parameters(self, timeout: float) -> dict[str, Any]:
        await self._answers(timeout)
        return dict(self.program.values[self.instance])

    def offers_parameters(self) -> bool:
        return True

    async def set_parameters(self, values: Mapping[str, Any], timeout: float) -> str | None:
        await self._answers(timeout)
        program, own = self.program, self.program.values[self.instance]
        if refused := [program.rejects[name] for name in values if name in program.rejects]:
            return refused[0]
        if undeclared := [name for name in values if name not in own]:
            return f"parameter {undeclared[0]} is not declared"
        own |= values
        program.set.append(dict(values))
        return None


class ProgramState:
    """What the node of ``instance`` has counted, and the services for it."""

    def __init__(self, program: Program, instance: str) -> None:
        self.program, self.instance = program, instance
        self.count = 0

    async def _answers(self, timeout: float) -> None:
        if self.instance in self.program.mute:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        await asyncio.sleep(self.program.takes)

    async def export_state(self, timeout: float) -> bytes | str:
        await self._answers(timeout)
        return str(self.count).encode()

    async def import_state(self, state: bytes, timeout: float) -> str | None:
        await self._answers(timeout)
        if self.program.refuses is None:
            self.count = int(state)
        return self.program.refuses


class SimulatedRelays(Simulator):
    """A simulator with relays. ``programs``: by component. ``heard``: by instance, when (ns) and what it received.

    ``written``: by instance, when its program has published each of its messages (ns).
    ``exits``: by instance, to be called when its program has exited.
    """

    name = "ros2"
    current: ClassVar[SimulatedRelays]

    def __init__(self, folder: Path, programs: dict[str, Program]) -> None:
        super().__init__()
        SimulatedRelays.current = self
        self.programs = programs
        self.heard: dict[str, list[tuple[int, str]]] = {}
        self.written: dict[str, list[int]] = {}
        self.exits: dict[str, Callable[[], None]] = {}
        transport: Any = self.control
        self._foreign = ForeignNodes(folder, transport, lambda _: None)

    async def start(self, launch: Launch) -> Handle:
        component, node = launch.foreign, full_name(launch.instance, launch.namespace)
        assert component is not None and component.gate == "relay"
        order = self._foreign.prepare_relay(launch, component, StartName(node), ["program"], {})
        command = ("python3", "-m", "tests.foreign.relayed", str(order))
        return await super().start(replace(launch, arguments=command, foreign=None))


def joined(context: ProcessContext) -> Host:
    assert context.factory is not None
    return context.factory(context.instance or "", context.namespace)


class SimulatedRelay(RelayComponent):
    """Has the publishers of its program as well."""

    def __init__(self, order: RelayOrder) -> None:
        lab, program = SimulatedRelays.current, SimulatedRelays.current.programs[order.declaration.name]
        self.instance = find().instance or ""
        running: Any = SimpleNamespace(status=lambda: None, watch=partial(lab.exits.__setitem__, self.instance))
        graph, parameters = partial(self._endpoints, program), ProgramParameters(program, self.instance)
        program.values[self.instance] = {**program.own, **order.stated, **order.taken_over}
        self.program_state = state = ProgramState(program, self.instance)
        offered = (NamedServer("service", f"{order.node}/{name}", type_) for name, type_ in program.offers)
        served = Served(servers=frozenset(offered))
        platform = RelayPlatform(
            joined,
            lambda _: Text,
            lambda _: Read,
            lambda *_: graph(),
            parameters=lambda *_: parameters,
            state=lambda *_: OfferedState(self.instance, lambda: order.node, state, lambda: served),
        )
        super().__init__(order, running, platform)
        heard = lab.heard.setdefault(self.instance, [])
        for port in self.parts.inputs.values():
            port.listeners = (lambda message, _: heard.append((lab.time.ros_now(), message.data)),)

    def _endpoints(self, program: Program) -> list[GraphEndpoint]:
        return [GraphEndpoint(False, self.order.topics[port], program.type, QoS()) for port in self.parts.inputs]

    def _set_up(self, node: object) -> None:
        host, program = self.host, SimulatedRelays.current.programs[self.component.name]
        assert host is not None
        for relay in self.relays.values():
            self._publish(host, relay.topic, relay.qos, program)
        super()._set_up(node)

    def _publish(self, host: Host, topic: str, qos: QoS, program: Program) -> None:
        lab, publisher, state = SimulatedRelays.current, host.create_publisher(topic, Text, qos), self.program_state
        times = lab.written[self.instance] = []

        def write(first: int, last: int) -> None:
            if self.instance not in program.hung and state.count < program.most:
                state.count += 1
                times.append(lab.time.ros_now())
                publisher.publish(Text(f"{self.instance} {state.count}"))

        def begin() -> None:
            """It goes on while its relay is frozen, or hangs."""
            SimulatedTimer(lab.time, lambda call: call(), round(1e9 / program.rate), None, write)

        lab.time.loop.call_later(2 * lab.network.discovery, begin)


def managed(
    folder: Path,
    text: str,
    programs: dict[str, Program],
    body: Callable[[Manager, SimulatedRelays], Awaitable[T]],
) -> T:
    """Bring the system of ``text`` up in virtual time, and run ``body``."""
    simulator = SimulatedRelays(folder / "gates", programs)
    (folder / "system").mkdir()
    path = folder / "system.stride"
    path.write_text(text, encoding="utf-8")

    async def main() -> T:
        manager = Manager(load(path).require(), simulator, Workspace(folder / "system"), folder)
        await manager.up()
        try:
            return await body(manager, simulator)
        finally:
            await manager.close()

    return simulator.run(main())


if __name__ == "__main__":
    from tests.foreign.relayed import SimulatedRelay as Relay  # that of the module, not of this program

    Relay(RelayOrder.read(Path(sys.argv[1]))).run()

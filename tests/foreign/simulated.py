"""Lifecycle nodes in virtual time, under a manager: their services are simulated, their agents are the real ones."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.simulator import Simulator
from midstride.backends.simulator.control import SimulatedControl
from midstride.foreign.foreign_state import EXPORT_STATE, IMPORT_STATE
from midstride.foreign.graph_check import NamedServer, Served
from midstride.foreign.lifecycle_transitions import ACTIVE, FINALIZED, INACTIVE, UNCONFIGURED
from midstride.foreign.preloading import StartedPrograms
from midstride.foreign.services import NoAnswer
from midstride.lang.load import load
from midstride.model.component import StopTimes
from midstride.model.hosts import OWN_HOST
from midstride.model.instance_names import full_name
from midstride.runtime.backend_protocol import Exited, Handle, Launch, RemainingProcess
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from midstride.wire.pipe import MEMORY
from midstride.wire.transport import Connection, Serve, StopListening

T = TypeVar("T")

_AFTER = {
    "configure": INACTIVE,
    "activate": ACTIVE,
    "deactivate": INACTIVE,
    "cleanup": UNCONFIGURED,
    "shutdown": FINALIZED,
}


@dataclass
class SimulatedNode:
    """A node that takes 20 ms for each transition. ``events`` is that of all nodes of a system.

    ``refuses`` and ``hangs`` have transitions; ``rejects``: by parameter, why it cannot be set. ``ends_on``: the signal
    on which its process ends; on None of them, it has to be killed. ``slow``: how long a transition takes besides (s);
    it may have `export` and `import`, and `state`, for how long it takes to say that, too.
    ``lacks``: the parameters that it does not declare; ``forgets``: it has set what it was asked to, and hangs then.
    ``kept``: its state, None where it offers none; ``no_export`` and ``no_import``: why it refuses, if so.
    ``hangs`` may have `export` and `import`, too.
    """

    instance: str
    events: list[str]
    values: dict[str, Any] = field(default_factory=dict)
    refuses: set[str] = field(default_factory=set)
    hangs: set[str] = field(default_factory=set)
    rejects: dict[str, str] = field(default_factory=dict)
    state: str = UNCONFIGURED
    hung: bool = False
    slow: dict[str, float] = field(default_factory=dict)
    ends_on: str | None = "SIGINT"
    lacks: set[str] = field(default_factory=set)
    forgets: bool = False
    kept: bytes | None = None
    no_export: str | None = None
    no_import: str | None = None
    closed: bool = False

    def close(self) -> None:
        self.closed = True

    async def _answers(self, timeout: float) -> None:
        if self.hung:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        await asyncio.sleep(0.001)

    async def lifecycle_state(self, timeout: float) -> str:
        if (seconds := self.slow.get("state", 0.0)) > timeout:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        await asyncio.sleep(seconds)
        await self._answers(timeout)
        return self.state

    async def transition(self, name: str, state: str, timeout: float) -> bool:
        self.hung |= name in self.hangs
        await self._answers(timeout)
        if (seconds := self.slow.get(name, 0.0)) > timeout:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        await asyncio.sleep(0.02 + seconds)
        if name in self.refuses:
            return False
        self.state = _AFTER[name]
        self.events.append(f"{self.instance} {name}")
        return True

    async def parameters(self, timeout: float) -> dict[str, Any]:
        await self._answers(timeout)
        return dict(self.values)

    def offers_parameters(self) -> bool:
        return True

    async def set_parameters(self, values: Mapping[str, Any], timeout: float) -> str | None:
        await self._answers(timeout)
        if refused := [self.rejects[name] for name in values if name in self.rejects]:
            return refused[0]
        if undeclared := [name for name in values if name not in self.values]:
            return f"parameter {undeclared[0]} is not declared"
        self.values |= values
        if self.forgets:
            self.hung = True
            await self._answers(timeout)
        self.events.append(f"{self.instance} set {' '.join(f'{name}={value}' for name, value in values.items())}")
        return None

    def settings_in(self, request: bytes) -> Mapping[str, Any]:
        """Nothing notes its requests."""
        return {}

    async def export_state(self, timeout: float) -> bytes | str:
        await self._unless_hung("export", timeout)
        self.events.append(f"{self.instance} exported")
        return self.no_export or self.kept or b""

    async def import_state(self, state: bytes, timeout: float) -> str | None:
        await self._unless_hung("import", timeout)
        if self.no_import is None:
            self.kept = state
            self.events.append(f"{self.instance} imported {state.decode()}")
        return self.no_import

    async def _unless_hung(self, what: str, timeout: float) -> None:
        if what in self.hangs:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        if (seconds := self.slow.get(what, 0.0)) > timeout:
            await asyncio.sleep(timeout)
            raise NoAnswer(f"{self.instance} has not answered within {timeout:g} s")
        await asyncio.sleep(seconds)
        await self._answers(timeout)

    def served(self) -> Served:
        """What the graph shows of its services."""
        offers = () if self.kept is None else (EXPORT_STATE, IMPORT_STATE)
        names = (NamedServer("service", f"/{self.instance}/{name}", type_) for name, type_ in offers)
        return Served(servers=frozenset(names))


class _Process:
    """A process of the manager's host that is never frozen."""

    runs = True
    host, on = OWN_HOST, MEMORY

    async def wait_while_frozen(self) -> None:
        pass


class _Transport:
    """The simulator's, for agents in the manager's process."""

    def __init__(self, control: SimulatedControl) -> None:
        self._control = control
        self.address, self.present, self.cut_lock = control.address, control.present, control.cut_lock

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        process: Any = _Process()
        return await self._control.listen(instance, serve, process)

    async def connect(self, address: str) -> Connection:
        return await self._control.connect(address)


class SimulatedRos(Simulator):
    """A simulator with nodes that do not use Midstride's API, without the library inside.

    ``behaviour``: by component, what its nodes have of the fields of :class:`SimulatedNode`.
    """

    name = "ros2"

    def __init__(self, folder: Path, behaviour: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        super().__init__()
        self.nodes: dict[str, SimulatedNode] = {}
        self.events: list[str] = []
        self._behaviour = behaviour or {}
        self._folder = folder
        self._foreign = self._agents()

    def _agents(self) -> ForeignNodes:
        def services(node: str) -> SimulatedNode | None:
            return self.nodes.get(node.strip("/"))

        def served(node: str, _: frozenset[str] | None, mark: bytes | None) -> Served:
            found = services(node)
            return Served() if found is None else found.served()

        shows = any("kept" in fields for fields in self._behaviour.values())
        return ForeignNodes(self._folder, _Transport(self.control), services, served=served if shows else None)

    async def start(self, launch: Launch) -> Handle:
        if launch.foreign is None:
            return await super().start(launch)
        behaviour = self._behaviour.get(launch.foreign.name, {})
        node = self.nodes[launch.instance] = SimulatedNode(launch.instance, self.events, **behaviour)
        values = {"own": 1.5, **node.values, **launch.parameters, **launch.set_parameters}
        node.values = {name: value for name, value in values.items() if name not in node.lacks}
        handle = Handle(launch.instance, None, self.time.steady())
        try:
            name = full_name(launch.instance, launch.namespace)
            without_library = {"CC": "none", "XDG_CACHE_HOME": str(self._folder)}
            started = StartedPrograms((), without_library)
            _, record = await self._foreign.prepare(launch, launch.foreign, name, started)
            await self._foreign.started(record, handle)
        except BaseException:
            self._gone(launch.instance)
            raise
        return handle

    async def adopt(self, handle: Handle) -> bool:
        if handle.instance not in self.nodes:
            return await super().adopt(handle)
        await self._foreign.adopt(handle.instance)
        return True

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        if instance not in self.nodes:
            return await super().end(instance, stop)
        if stop.longest:
            await self._foreign.finish(instance)
        if (node := self.nodes.get(instance)) is None:  # another manager's command has ended it meanwhile
            return []
        ended = False
        for name, patience in (("SIGINT", stop.sigterm), ("SIGTERM", stop.sigkill)):
            if patience and not ended:
                ended = node.ends_on == name
                await asyncio.sleep(0.01 if ended else patience)
        self._gone(instance)
        self.events.append(f"{instance} {'ended' if ended else 'killed'}")
        return [] if ended or not stop.longest else [RemainingProcess(0, "python3", stop.longest)]

    def unwritten(self) -> str | None:
        return self._foreign.unwritten()

    def _gone(self, instance: str) -> None:
        self.nodes.pop(instance, None)
        self._foreign.gone(instance)

    def die(self, instance: str) -> None:
        self._gone(instance)
        self.events.append(f"{instance} died")
        self._on_exit(Exited(instance, 1, "an error of its own"))

    async def manager_killed(self) -> None:
        """The agents are those of the next manager from now on."""
        await self._foreign.close()
        self._foreign = self._agents()

    def of(self, role: str) -> SimulatedNode:
        """The only node of that role."""
        (found,) = (node for name, node in self.nodes.items() if name.startswith(role))
        return found

    def active(self) -> list[str]:
        return sorted(name for name, node in self.nodes.items() if node.state == ACTIVE)


def managed(
    folder: Path,
    text: str,
    body: Callable[[Manager, SimulatedRos], Awaitable[T]],
    behaviour: Mapping[str, Mapping[str, Any]] | None = None,
    simulator: SimulatedRos | None = None,
) -> T:
    """Bring the system of ``text`` up in virtual time, and run ``body``; the events are those since."""
    simulator = simulator or SimulatedRos(folder / "gates", behaviour)
    (folder / "system").mkdir()
    path = folder / "system.stride"
    path.write_text(text, encoding="utf-8")

    async def main() -> T:
        manager = Manager(load(path).require(), simulator, Workspace(folder / "system"), folder)
        await manager.up()
        simulator.events.clear()
        try:
            return await body(manager, simulator)
        finally:
            await manager.close()

    return simulator.run(main())

"""Stand-ins for the programs of a system: the real node code, around functions that only write what they guarantee.

Their functions do not block, so they need no threads (:mod:`.threadless`).
"""

from __future__ import annotations

import contextlib
import json
import math
import zlib
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import cache
from types import ModuleType
from typing import Any, Final

from immutables import Map

from midstride.backends.simulator.cooperative_thread import ThreadYield
from midstride.backends.simulator.simulated_program import ProcessOutput, SimulatedProgram
from midstride.codec.component_form import encode_component
from midstride.model.component import ComponentSpec
from midstride.model.contract import ConnectorKind, connector_kind
from midstride.model.specification import Specification
from midstride.node.author.client_ports import ClientPort
from midstride.node.author.ports import Output
from midstride.node.author.server_ports import ServerPort
from midstride.node.request_admission import RequestAdmission
from midstride.runtime.backend_protocol import Launch
from midstride.simulation.puppet import Puppet
from midstride.simulation.threadless import ThreadlessProcess
from midstride.wire.state import ComponentState

# Which of the goals that a client sends it has cancelled: each so many. And after how many of its calls it asks for the
# results of successive goals: at once, before the goal has ended, and later, perhaps of the instance that comes next.
CANCELLED: Final = 4
FETCHED: Final = (0, 12, 30)
# How long a goal takes (s): longer than a replaced instance keeps running for other reasons.
GOAL: Final = 2.2
_NOTHING: Final = contextlib.nullcontext()
# What the types of services and ROS actions consist of.
_PARTS: Final[dict[ConnectorKind, tuple[str, ...]]] = {
    "service": ("Request", "Response"),
    "action": ("Goal", "Result", "Feedback"),
}
_PROGRAM: Final = ("python3", "-m", __name__)
# What the stand-ins are, by the last word of their command.
_described: Final[dict[str, tuple[ComponentSpec, dict[str, Any]]]] = {}


def with_stand_ins(specification: Specification, stateless: Collection[str] = ()) -> Specification:
    """``specification`` with a stand-in as the program of each component that has one.

    ``stateless``: the components that have no state to move, as drivers of devices often. What changes require is taken
    for met: what is published outside the system is not simulated. Servers that use no API of ours are stood in for by
    ones that do.
    """
    components = {
        name: _stand_in(component, name not in stateless) for name, component in specification.components.items()
    }
    return replace(specification, components=Map(components), requirements=())


def _stand_in(component: ComponentSpec, keeps_state: bool) -> ComponentSpec:
    if component.run is None:
        return component
    plain = _with_the_api(component)
    described = {
        "component": encode_component(replace(plain, run=None)),
        "keeps_state": keeps_state,
        "stateless": not keeps_state,
        "goals": GOAL,
        "later": {"cancel": CANCELLED, "fetch": FETCHED},
    }
    word = f"{component.name}-{zlib.crc32(json.dumps(described).encode()):08x}"
    _described[word] = component, described
    return replace(plain, run=" ".join([*_PROGRAM, word]))


def _with_the_api(component: ComponentSpec) -> ComponentSpec:
    """The ``component`` as a program with Midstride's API has it, which has no gate and sets parameters in its code.

    Without its conditions: the messages of stand-ins have no values that could meet them.
    """
    functionalities = {
        each.name: replace(each, modes=tuple(replace(mode, parameters=Map()) for mode in each.modes))
        for each in component
    }
    return replace(
        component,
        functionalities=Map(functionalities),
        gate="none" if component.once else None,
        topics=Map(),
        package=None,
        container=None,
        stop=None,
        activate_seconds=None,
        lazy=frozenset(),
        conditions=frozenset(),
    )


@cache
def _type(name: str) -> type:
    """A class of that type whose messages have a text, or any other field: stand-ins read and write nothing else."""
    parts = _PARTS.get(connector_kind(name))
    if parts is None:
        return _message_type(name)
    attributes = {"__msgtype__": name, **{part: _message_type(f"{name}_{part}") for part in parts}}
    return type(name.rpartition("/")[2], (), attributes)


def _message_type(name: str) -> type:
    def copied(message: Any, _: object) -> Any:
        copy = type(message)()
        copy.data = message.data
        return copy

    # A constraint may be on any field.
    attributes = {
        "__msgtype__": name,
        "data": "",
        "__deepcopy__": copied,
        "__getattr__": lambda message, field: message,
    }
    return type(name.rpartition("/")[2], (), attributes)


class _Program(SimulatedProgram):
    """Runs the puppet of a command without an interpreter's global state, which it does not touch."""

    def __init__(self, launch: Launch, log: ProcessOutput, imported: Callable[[str], object]) -> None:
        self.arguments = ()
        self.modules: dict[str, ModuleType] = {}
        self._log, self._imported = log, imported
        self.key = launch.arguments[-1]
        self.component, described = _described[self.key]
        # The behaviour of each mode, which faults change while it runs.
        self.modes: dict[str, dict[str, Any]] = {
            f"{name}.{mode}": {}
            for name, functionality in described["component"].get("functionalities", {}).items()
            for mode in functionality["modes"]
        }
        self._description = {**described, "modes": self.modes}
        self.outputs: tuple[Output, ...] = ()
        self.clients: tuple[ClientPort, ...] = ()

    def run(self) -> None:
        if self.component.once:  # it is done
            return
        puppet = Puppet(self._description, _type, self._imported)
        # Servers have no messages: which of them answers is another question.
        self.outputs = tuple(port for port in puppet.outputs.values() if not isinstance(port, ServerPort))
        self.clients = puppet.clients
        puppet.start()

    def interpreter_state(self) -> contextlib.AbstractContextManager[None]:  # type: ignore[override]
        return _NOTHING


class StandIn(ThreadlessProcess):
    """The process of a stand-in. ``on_state`` is called when it has published its state.

    ``on_import`` is called with the instance whose state it has imported.
    """

    on_state: Callable[[StandIn], None]
    on_import: Callable[[StandIn, str], None]
    # Decides which requests it answers, once its component has a host.
    admission: RequestAdmission | None = None
    # Since when it has reported that it answers (steady s); None while it does not. And when it has ended.
    answers_since: float | None = None
    exited_at: float = math.inf
    _published: ComponentState | None = None

    @property
    def state(self) -> ComponentState | None:
        return self._published

    @state.setter
    def state(self, state: ComponentState | None) -> None:
        self._published = state
        if state is None or not state.answers:
            self.answers_since = None
        elif self.answers_since is None:
            self.answers_since = self.clock.steady()
        if state is not None:
            self.on_state(self)

    @property
    def component(self) -> ComponentSpec:
        return self._stand_in.component

    @property
    def key(self) -> str:
        """Identifies what it declares: two components of one name may differ."""
        return self._stand_in.key

    @property
    def modes(self) -> dict[str, dict[str, Any]]:
        """The behaviour of each mode (:mod:`midstride.simulation.puppet`)."""
        return self._stand_in.modes

    def open_outputs(self) -> set[tuple[str, str]]:
        """The outputs, with the topics on which whatever they write is published: no gate or cut decides about it."""
        return {
            (output.name, link.topic)
            for output in self._stand_in.outputs
            for link in output.links
            if link.open and not link.is_silenced
        }

    @property
    def answers(self) -> bool:
        """True while it runs, and answers requests."""
        return not self.dead and self.admission is not None and self.admission.is_open

    @property
    def clients(self) -> tuple[ClientPort, ...]:
        return self._stand_in.clients

    def has_goal(self, goal: str) -> bool:
        """Return whether it says that it answers what is asked about ``goal``."""
        return self.admission is not None and self.admission.goals.has(goal)

    @property
    def replaced(self) -> bool:
        """True once it has left the results of its goals to another instance."""
        return self.admission is not None and self.admission.goals.handed_over

    def lost_servers(self) -> set[str]:
        """Return the clients of it that have seen their server, or a response, and have no server in the graph now."""
        seen = [port for port in self._stand_in.clients if port.attached and port.count]
        return {port.name for port in seen if not any(link.endpoint.matched() for link in port.links)}

    def bound_of(self, name: str) -> float | None:
        """Within what its client of the service or ROS action ``name`` must have a response (s); None where none is."""
        found = (port.within for port in self._stand_in.clients if port.link(name) is not None)
        return next(found, None)

    def outputs_on(self, topic: str) -> list[str]:
        """The names of the outputs that are attached to ``topic``."""
        return [output.name for output in self._stand_in.outputs if output.link(topic) is not None]

    def _run_thread(self, work: Callable[[], object] | None) -> ThreadYield:
        return self._thread.resume(work)  # its program does not touch the interpreter's state

    def _new_program(self, launch: Launch) -> SimulatedProgram:
        self.role = launch.node
        self._stand_in = _Program(launch, self.log, lambda exporter: self.on_import(self, exporter))
        return self._stand_in

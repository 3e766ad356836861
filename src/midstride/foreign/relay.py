"""`gate relay`: a component that runs an unmodified program, and passes on the messages that this publishes.

For programs that no library can be preloaded into. The program's outputs are remapped to private topics, where the
relay takes each message as bytes, and writes it on the real topic if its own gate is open. So the program cannot
publish there, whatever it does, and to the manager the relay is a component as any other: with the agent, the gates,
the counters, the agreed cuts and the local reflex of :mod:`midstride.node`. Inputs are not in its path: the program
subscribes to the real topic, and the relay as well, to count what comes and to notice when it stays away.

The relay is the parent of the program. If the program ends, it ends; if it ends, the program does.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NoReturn

import msgspec

from midstride.codec.component import NamedComponentForm
from midstride.errors import BackendError, MidstrideError, NodeError
from midstride.foreign.graph_check import GraphEndpoint, differences, lacking
from midstride.foreign.reflex import inputs_of
from midstride.model.component import ComponentSpec, FunctionalitySpec, Mode
from midstride.model.contract import Predicate, QoS
from midstride.node.agent import Agent
from midstride.node.contracts import Guarantee
from midstride.node.declaration import DeclaredParts
from midstride.node.functionality import Functionality
from midstride.node.host import Host
from midstride.node.message_times import MessageTimes
from midstride.node.modes import DeclaredMode
from midstride.node.ports import Input, InputLink, Output
from midstride.node.process_context import ProcessContext, find
from midstride.node.program import ProgramFiles
from midstride.wire.state import WireValue

# How long the program may take to create the publishers and subscriptions that are declared (s).
ENDPOINTS_TIMEOUT: Final = 20.0
_LOOK: Final = 0.05
# For how long a reliable output with a rate may wait in a relay without loss (s), and of how many messages at most.
QUEUE: Final = 2.0
DEEPEST: Final = 1000
# How long it may take to end unasked, and once it is asked to (s).
_ENDS: Final = 0.5
_GRACE: Final = 2.0
_LIBC: Final = ctypes.CDLL(None)
_PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True)
class RelayPlatform:
    """What a relay needs of its platform.

    ``host``: joins as the relay of an instance. ``type_of``: the class of a port of a message type, whose messages stay
    serialised. ``graph``: what the graph shows of the program's node. ``advertises_late``: a program may create a
    publisher only when it has something to publish, so none is waited for.
    """

    host: Callable[[ProcessContext], Host]
    type_of: Callable[[str], type]
    graph: Callable[[Host, RelayOrder], Sequence[GraphEndpoint]]
    advertises_late: bool = False


class RelayOrder(WireValue, frozen=True, kw_only=True):
    """What a relay runs: ``command``, whose node has the full name ``node``.

    ``topics``: by port, the full name of the topic that the program uses, which for an output is private.
    ``environment``: the variables that are others for the program than for the relay; None: it has none.
    """

    command: list[str]
    node: str
    declaration: NamedComponentForm
    topics: dict[str, str]
    environment: dict[str, str | None] = {}

    def write(self, path: Path) -> None:
        """Raises BackendError."""
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            path.write_bytes(msgspec.json.encode(self))
        except OSError as error:
            raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None

    @classmethod
    def read(cls, path: Path) -> RelayOrder:
        """Raises BackendError."""
        try:
            return msgspec.json.decode(path.read_bytes(), type=cls)
        except (OSError, msgspec.DecodeError) as error:
            raise BackendError(f"{path} cannot be read: {error}") from None


def order_file(folder: Path, instance: str) -> Path:
    """The file of the order for the relay of ``instance``."""
    return folder / "relays" / f"{instance.strip('/').replace('/', '.')}.json"


def differing(program: Mapping[str, str], relay: Mapping[str, str]) -> dict[str, str | None]:
    """The variables that are others in the environment of a program than in that of its relay."""
    return {name: program.get(name) for name in {*program, *relay} if program.get(name) != relay.get(name)}


def private_topics(component: ComponentSpec, instance: str) -> dict[str, str]:
    """Where the program publishes instead, by output: hidden from ROS 2's tools by the first character."""
    return {port: f"/_midstride/relay/{instance.strip('/')}/{port}" for port in component.outputs}


def patient(qos: QoS, rate: float | None) -> QoS:
    """The same with a queue that is deep enough for a relay that is not given a core for a while, where it is reliable.

    Such a queue fills at once and is emptied at once, where that of the program would have done so message by message.
    """
    depth = qos.effective().depth or 1
    wanted = min(max(depth, math.ceil((rate or 0.0) * QUEUE)), DEEPEST)
    return replace(qos, depth=max(depth, wanted)) if qos.is_reliable and qos.history != "keep_all" else qos


class RelayedProgram:
    """The program, from its start to its end."""

    def __init__(self, order: RelayOrder) -> None:
        """Start it, on the main thread and before there are others. Raises NodeError."""
        environment = {name: value for name, value in os.environ.items() if name not in order.environment}
        environment |= {name: value for name, value in order.environment.items() if value is not None}
        self.words = " ".join(order.command)
        parent = os.getpid()

        def end_with_relay() -> None:
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        try:
            self._process = subprocess.Popen(order.command, env=environment, preexec_fn=end_with_relay)
        except OSError as error:
            raise NodeError(f"cannot start `{self.words}`: {error.strerror or error}") from None
        self.pid = self._process.pid

    def status(self) -> int | None:
        """What it has exited with, 128 and the number for a signal, as in a shell; None while it runs."""
        status = self._process.poll()
        return status if status is None or status >= 0 else 128 - status

    def watch(self, ended: Callable[[], None]) -> None:
        """Have ``ended`` called, in a thread, when it has exited."""

        def wait() -> None:
            self._process.wait()
            ended()

        threading.Thread(target=wait, daemon=True).start()

    def end(self) -> int:
        """End it, in bounded time; the status for the relay to exit with: that of a program that has exited."""
        status = self.status()
        # A signal to the relay's group has reached it already.
        for ask, patience in ((None, _ENDS), (self._process.terminate, _GRACE), (self._process.kill, None)):
            if ask is not None:
                ask()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)
                break
        return status or 0


@dataclass(eq=False)
class Relay:
    """Passes on the messages of one output: from ``source``, the private topic, to ``output``."""

    source: Input
    output: Output
    topic: str
    qos: QoS
    rated: bool
    passed: Any = None

    def subscribe(self, host: Host) -> None:
        """On the data thread."""
        link = InputLink(self.source, self.topic, MessageTimes(host.now))
        receive = self.source.receiver(link, host)
        link.endpoint = host.create_subscription(self.topic, self.source.type, self.qos, receive)
        self.source.links = (link,)

    def write(self, message: Any) -> None:
        self.passed = message
        self.output.write(message)

    def write_last(self) -> None:
        """What was published once, before the mode was entered, as a map that is latched."""
        if not self.rated and self.source.latest is not None and self.source.latest is not self.passed:
            self.write(self.source.latest)

    @property
    def matched(self) -> bool:
        return any(link.endpoint.matched() > 0 for link in self.source.links)


class RelayedFunctionality(Functionality):
    """One whose ``modes`` are those of the specification."""

    def __init__(
        self, name: str, inputs: tuple[Input, ...], outputs: tuple[Output, ...], modes: tuple[DeclaredMode, ...]
    ) -> None:
        super().__init__(name, inputs, outputs, 1.0, lambda _: None)
        self._modes = modes

    def chain(self) -> tuple[DeclaredMode, ...]:
        return self._modes


class RelayComponent:
    """The component of ``order``."""

    def __init__(self, order: RelayOrder, program: RelayedProgram, platform: RelayPlatform) -> None:
        self.order, self.program = order, program
        self.component = component = order.declaration.declared()
        self._platform = platform
        self._type_of = type_of = platform.type_of
        self.host: Host | None = None
        self.parts = DeclaredParts()
        self.relays: dict[str, Relay] = {}
        for name in component.input_order:
            assumed = component.inputs[name]
            # What is in a message is not known here, so its fields are not checked.
            required = Predicate(assumed.type, assumed.rate, assumed.qos)
            self.parts.inputs[name] = Input(name, type_of(assumed.type), required, component.tolerates.get(name))
        for name in component.outputs:
            self.relays[name] = self._relay(name)
            self.parts.outputs[name] = self.relays[name].output
        for functionality in component:
            self.parts.functionalities[functionality.name] = self._functionality(functionality)
        self.parts.callbacks.setup = self._set_up

    def _relay(self, name: str) -> Relay:
        endpoint, owner = self.component.output_endpoint(name), self.component.owner(name)
        if endpoint is None:
            raise NodeError(f"output {name} of {self.component.name} has no type: no mode guarantees anything for it")
        rate = self.component.stated_rate(name, {owner.name: owner.modes[0].name})
        type_, qos = self._type_of(endpoint[0]), endpoint[1]
        deeper = patient(qos, rate)
        # Late joiners get as many messages of a transient-local output as are declared.
        output = Output(name, type_, qos if qos.is_transient_local else deeper)
        output.relayed = True
        source = Input(name, type_, Predicate(endpoint[0], None, deeper))
        return Relay(source, output, self.order.topics[name], deeper, rate is not None)

    def _functionality(self, functionality: FunctionalitySpec) -> Functionality:
        inputs = tuple(self.parts.inputs[name] for name in functionality.inputs)
        outputs = tuple(self.parts.outputs[name] for name in functionality.outputs)
        modes = tuple(self._mode(functionality, mode) for mode in functionality.modes)
        return RelayedFunctionality(functionality.name, inputs, outputs, modes)

    def _mode(self, functionality: FunctionalitySpec, mode: Mode) -> DeclaredMode:
        relays = [self.relays[name] for name in functionality.outputs]
        if mode is functionality.modes[-1]:
            return DeclaredMode(mode.name, "none", lambda: None, None, (), (), {})
        assumptions = tuple(
            tuple(self.parts.inputs[name] for name in inputs_of(self.component, functionality, assumption))
            for assumption in mode.assumptions
        )
        guarantees = {
            relay.output: Guarantee(guarantee.rate, ())
            for relay in relays
            if isinstance(guarantee := mode.guarantee(relay.output.name), Predicate)
        }

        def enter() -> None:
            for relay in relays:
                relay.write_last()

        handlers = tuple((relay.source, relay.write) for relay in relays)
        driven: Any = "message" if relays else "none"
        outputs = tuple(relay.output for relay in relays)
        return DeclaredMode(mode.name, driven, enter, None, assumptions, outputs, guarantees, handlers)

    def _set_up(self, _: object) -> None:
        """Before it registers: the program has the endpoints that are declared. Raises NodeError."""
        assert self.host is not None
        for relay in self.relays.values():
            relay.subscribe(self.host)
        deadline = time.monotonic() + ENDPOINTS_TIMEOUT
        while missing := self._missing():
            self._require_running()
            if time.monotonic() >= deadline:
                break
            time.sleep(_LOOK)
        self._require_running()
        found = self._platform.graph(self.host, self.order)
        there = {(endpoint.output, endpoint.topic) for endpoint in found}
        absent = [port for port in missing if (self.component.has_output(port), self.order.topics[port]) not in there]
        faults = lacking(self.component, self.order.topics, self.order.node, found, absent)
        faults += differences(self.component, self.order.topics, self.order.node, found)
        if faults or missing:
            raise NodeError("; ".join(faults) or f"the messages of {', '.join(missing)} cannot be received")

    def _require_running(self) -> None:
        if (status := self.program.status()) is not None:
            raise NodeError(f"`{self.program.words}` has exited with status {status}")

    def _missing(self) -> list[str]:
        """The ports for which the program has no endpoint."""
        assert self.host is not None
        late = self._platform.advertises_late
        missing = [] if late else [name for name, relay in self.relays.items() if not relay.matched]
        if missing or not self.component.input_order:
            return missing
        received = {endpoint.topic for endpoint in self._platform.graph(self.host, self.order) if not endpoint.output}
        return [name for name in self.component.input_order if self.order.topics[name] not in received]

    def run(self) -> None:
        """Until it is stopped, or the program has exited. As :meth:`midstride.node.component.Component.start`."""
        context = find()
        self.host = host = self._platform.host(context)
        files = ProgramFiles({}, context.started)
        agent = Agent(self.parts, self.component, host, context.token, os.getpid(), None, files, context.diagnostics)
        self.program.watch(agent.stop)
        host.run(agent.main)


def run_relay(platform: RelayPlatform) -> NoReturn:
    """The whole life of a relay's process. Its argument is the file of the order."""
    order = RelayOrder.read(Path(sys.argv[1]))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # until the component runs
    program, status = None, 1
    try:
        program = RelayedProgram(order)
        RelayComponent(order, program, platform).run()
        status = 0
    except MidstrideError as error:
        print(f"the relay of {order.node} ends: {error}", file=sys.stderr, flush=True)
    except SystemExit:
        pass
    ended = 0 if program is None else program.end()
    if ended not in (0, 128 + signal.SIGTERM):  # else it has been asked to
        print(f"`{' '.join(order.command)}` has exited with status {ended}", file=sys.stderr, flush=True)
    sys.exit(ended or status)

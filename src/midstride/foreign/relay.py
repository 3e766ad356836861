"""`gate relay`: a component that runs an unmodified program, and passes on the messages that this publishes.

For programs that no library can be preloaded into. The program's outputs are remapped to private topics, where the
relay takes each message as bytes, and writes it on the real topic if its own gate is open. So the program cannot
publish there, whatever it does, and to the manager the relay is a component as any other: with the agent, the gates,
the counters, the agreed cuts and the local reflex of :mod:`midstride.node`. Inputs are not in its path: the program
subscribes to the real topic, and the relay as well, to count what comes and to notice when it stays away. Servers are
relayed as outputs are (:mod:`.relayed_servers`).

The relay is the parent of the program. If the program ends, it ends; if it ends, the program does.
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn

import msgspec

from midstride.errors import MidstrideError, NodeError
from midstride.foreign.foreign_state import OfferedState
from midstride.foreign.gated_reflex import inputs_of
from midstride.foreign.graph_check import GraphEndpoint, Served
from midstride.foreign.lifecycle_transitions import ACTIVE
from midstride.foreign.relay_agent import RelayAgent
from midstride.foreign.relay_endpoints import ProgramEndpoints
from midstride.foreign.relayed_actions import RelayedActionServer
from midstride.foreign.relayed_lifecycle import RelayedLifecycle, followed
from midstride.foreign.relayed_parameters import RelayedNode, RelayedParameters, RelayedRecord
from midstride.foreign.relayed_program import KILLED, RelayedProgram, RelayOrder
from midstride.foreign.relayed_servers import RelayedServer
from midstride.foreign.relayed_state import RelayedState
from midstride.foreign.services import NodeServices, ParameterAccess
from midstride.model.component import ROS_PARAMETERS, FunctionalitySpec, Mode
from midstride.model.contract import Predicate, QoS
from midstride.node.author.declaration import DeclaredParts
from midstride.node.author.declared_contracts import Guarantee
from midstride.node.author.functionality import Functionality
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.modes import DeclaredMode
from midstride.node.author.ports import Input, InputLink, Output
from midstride.node.component_host import Host, MessageInfo
from midstride.node.loaded_program import ProgramFiles
from midstride.node.process_context import ProcessContext, find
from midstride.wire import replies
from midstride.wire.commands import SetParametersCommand

# For how long a reliable output with a rate may wait in a relay without loss (s), and of how many messages at most.
QUEUE: Final = 2.0
DEEPEST: Final = 1000


@dataclass(frozen=True)
class RelayPlatform:
    """The functions that a relay needs of its platform.

    ``host``: joins as the relay of an instance. ``type_of``: the class of a port of a message type, whose messages stay
    serialised. ``graph``: what the graph shows of the program's node; None if it shows no such node. It may raise
    BackendError where the graph cannot be read in time.
    ``decoder``: reads such messages of a type, of which only some are, and only where the contract constrains fields.
    ``advertises_late``: a program may create a publisher only when it has something to publish, so none is waited for.
    ``service_type``: the class of a service or ROS action; None where no services can be ports.
    ``parameters``: reads and sets those of the program's node; called on the data thread. None where there are no such
    services.
    ``state``: that of the program's node, where it offers any. None where there are no such services.
    ``nodes``: the full names of the nodes in an enclave; None where the platform has no enclaves.
    ``served``: what the graph shows of a node that others may rely on, and ``services``: what it can be asked, and
    whether its lifecycle state can be changed; called on the data thread. None where nodes have no lifecycle.
    """

    host: Callable[[ProcessContext], Host]
    type_of: Callable[[str], type]
    decoder: Callable[[str], Callable[[Any], Any]]
    graph: Callable[[Host, RelayOrder], Sequence[GraphEndpoint] | None]
    advertises_late: bool = False
    service_type: Callable[[str], type] | None = None
    parameters: Callable[[Host, RelayOrder], ParameterAccess] | None = None
    state: Callable[[Host, RelayOrder], OfferedState] | None = None
    nodes: Callable[[Host, str], Sequence[str]] | None = None
    served: Callable[[Host, str], Served] | None = None
    services: Callable[[Host, str, bool], NodeServices] | None = None


def patient(qos: QoS, rate: float | None) -> QoS:
    """Return ``qos``, if reliable with a queue that is deep enough for a relay that is not given a core for a while.

    Such a queue fills at once and is emptied at once, where that of the program would have done so message by message.
    """
    depth = qos.effective().depth or 1
    wanted = min(max(depth, math.ceil((rate or 0.0) * QUEUE)), DEEPEST)
    return replace(qos, depth=max(depth, wanted)) if qos.is_reliable and qos.history != "keep_all" else qos


@dataclass(eq=False)
class Relay:
    """Passes on the messages of one output: from ``source``, the private topic, to ``output``."""

    source: Input
    output: Output
    topic: str
    qos: QoS
    rated: bool
    read_info: Callable[[Any], MessageInfo] | None = field(default=None, init=False)
    # What was published before (ns, by the host's `message_now`) was with a state that the program has no more.
    stale_before: int = field(default=0, init=False)
    # Of an output without a rate, the newest messages that have not been passed on: as many as late joiners shall have.
    waiting: deque[Any] = field(init=False)

    def __post_init__(self) -> None:
        self.waiting = deque(maxlen=0 if self.rated else self.output.kept.maxlen)

    def subscribe(self, host: Host) -> None:
        """On the data thread."""
        self.read_info = host.read_info
        link = InputLink(self.source, self.topic, MessageTimes(host.now))
        receive = self.source.receiver(link, host)

        def received(message: Any, info: Any) -> None:
            if not self._is_stale(info):
                self.waiting.append(message)
            receive(message, info)

        link.endpoint = host.create_subscription(self.topic, self.source.type, self.qos, received)
        self.source.links = (link,)

    def write(self, message: Any) -> None:
        if self.stale_before:
            # the message that its functionality is called with
            if self._is_stale(self.output.owner.info):
                return
            self.stale_before = 0
        self._pass_on(message)

    def _pass_on(self, message: Any) -> None:
        if any(each is message for each in self.waiting):
            while self.waiting.popleft() is not message:  # an earlier one is not written after it
                pass
        self.output.write(message)

    def _is_stale(self, info: Any) -> bool:
        """Return whether the message with this ``info`` was published with another state."""
        if not self.stale_before or info is None or self.read_info is None:
            return False
        published = self.read_info(info).source
        return published is not None and published < self.stale_before

    def forget_kept(self) -> None:
        """Have later subscribers get nothing of what has been published so far. On the data thread."""
        self.waiting.clear()
        for kept in (self.output.kept, *(link.kept for link in self.output.links)):
            kept.clear()

    def write_waiting(self) -> None:
        """Write what was published once before the mode was entered, as a map that is latched."""
        for message in tuple(self.waiting):
            self._pass_on(message)

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
    """The component of ``order``, which is written into the file ``path`` once its program's node is known."""

    def __init__(
        self, order: RelayOrder, program: RelayedProgram, platform: RelayPlatform, path: Path | None = None
    ) -> None:
        self.order, self.program, self._path = order, program, path
        self.component = component = order.declaration.declared()
        self._platform = platform
        self._type_of = type_of = platform.type_of
        self._fault: str | None = None  # why the relay must end
        self.host: Host | None = None
        self._agent: RelayAgent | None = None
        self._lifecycle: RelayedLifecycle | None = None
        self.parts = DeclaredParts()
        self.relays: dict[str, Relay] = {}
        self.servers: dict[str, RelayedServer | RelayedActionServer] = {}
        for name in component.input_order:
            assumed = component.inputs[name]
            received = Input(name, type_of(assumed.type), assumed, component.tolerates.get(name))
            received.decode = self._platform.decoder(assumed.type)
            self.parts.inputs[name] = received
        for name in component.outputs:
            if component.is_service(name):
                self.servers[name] = self._server(name)
                self.parts.outputs[name] = self.servers[name].port
            else:
                self.relays[name] = self._relay(name)
                self.parts.outputs[name] = self.relays[name].output
        for functionality in component:
            self.parts.functionalities[functionality.name] = self._functionality(functionality)
        self.parts.callbacks.setup = self._set_up
        of_modes = any(functionality.mode_parameters() for functionality in component)
        if platform.parameters is not None:
            self.parts.callbacks.set_parameters = self._set_parameters
            self.parts.callbacks.before_modes = self._before_modes if of_modes else None
        elif of_modes or any(parameter.changeable for parameter in component.parameters.values()):
            what = "modes that set parameters" if of_modes else "parameters that are `changeable`"
            raise NodeError(f"{component.name} has {what}, and a node of ROS 1 has no service for that")

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
        output.fields.decode = self._platform.decoder(endpoint[0])
        source = Input(name, type_, Predicate(endpoint[0], None, deeper))
        return Relay(source, output, self.order.topics[name], deeper, rate is not None)

    def _server(self, name: str) -> RelayedServer | RelayedActionServer:
        if self._platform.service_type is None:
            raise NodeError(f"{self.component.name} has the server {name}, and only ROS 2 has services as ports")
        endpoint, best = self.component.output_endpoint(name), self.component.owner(name).modes[0].guarantee(name)
        assert endpoint is not None  # a server without a type is an output
        within = best.within if isinstance(best, Predicate) else None
        kind = RelayedActionServer if self.component.kind_of(name) == "action" else RelayedServer
        return kind(name, self._platform.service_type(endpoint[0]), self.order.topics[name], within)

    def _functionality(self, functionality: FunctionalitySpec) -> Functionality:
        inputs = tuple(self.parts.inputs[name] for name in functionality.inputs)
        outputs = tuple(self.parts.outputs[name] for name in functionality.outputs)
        modes = tuple(self._mode(functionality, mode) for mode in functionality.modes)
        return RelayedFunctionality(functionality.name, inputs, outputs, modes)

    def _mode(self, functionality: FunctionalitySpec, mode: Mode) -> DeclaredMode:
        relays = [self.relays[name] for name in functionality.outputs if name in self.relays]
        if mode is functionality.modes[-1]:
            return DeclaredMode(mode.name, "none", lambda: None, None, (), (), {})
        assumptions = tuple(
            tuple(self.parts.inputs[name] for name in inputs_of(self.component, functionality, assumption))
            for assumption in mode.assumptions
        )
        guarantees = {
            relay.output: Guarantee(guarantee.rate, guarantee.fields)
            for relay in relays
            if isinstance(guarantee := mode.guarantee(relay.output.name), Predicate)
        }

        def enter() -> None:
            for relay in relays:
                relay.write_waiting()

        handlers = tuple((relay.source, relay.write) for relay in relays)
        driven: Any = "message" if relays else "none"
        serving = (name for name in functionality.outputs if name in self.servers and mode.guarantees.get(name))
        outputs = (*(relay.output for relay in relays), *(self.servers[name].port for name in serving))
        return DeclaredMode(mode.name, driven, enter, None, assumptions, outputs, guarantees, handlers)

    def _set_up(self, _: object) -> None:
        """Before it registers: the program has the endpoints that are declared. Raises NodeError, BackendError."""
        assert self.host is not None
        if self.order.enclave:
            self.order = msgspec.structs.replace(self.order, node=self._program_endpoints().own_node())
            if self._path is not None:
                self.order.write(self._path)
        for relay in self.relays.values():
            relay.subscribe(self.host)
        for server in self.servers.values():
            server.connect(self.host)
        self._follow(self.host)
        if self._platform.parameters is not None:
            assert self._agent is not None
            services = self._platform.parameters(self.host, self.order)
            self._agent.parameters = self._parameters_of(self.host, services)
        self._program_endpoints().wait()
        self._keep_state(self.host)

    def _keep_state(self, host: Host) -> None:
        """Have the state of the program's node moved at cuts, where it offers any."""
        if self._platform.state is None:
            return
        state = RelayedState(self._platform.state(host, self.order), tuple(self.relays.values()), host)
        state.look()
        assert self._agent is not None
        self._agent.program_state = self.parts.callbacks.outside_state = state

    def _follow(self, host: Host) -> None:
        """Take a lifecycle node that another program manages to the state of the one that it replaces.

        Nothing else would: its manager knows the old one, by its name. Raises NodeError.
        """
        order, platform = self.order, self._platform
        if not order.predecessor or platform.services is None or self._lifecycle is None:
            return
        endpoints, lifecycle = self._program_endpoints(), self._lifecycle
        old = platform.services(host, order.predecessor, False)
        new = platform.services(host, order.node, True)
        try:
            state = asyncio.run(
                followed(
                    host.instance,
                    self.component,
                    old,
                    new,
                    lambda: endpoints.becomes(lambda: lifecycle.served().has_lifecycle),
                )
            )
        finally:
            old.close()
            new.close()
        lifecycle.was_active = state == ACTIVE

    def _lifecycle_of(self, host: Host) -> RelayedLifecycle | None:
        platform = self._platform
        served, services = platform.served, platform.services
        if served is None or services is None:
            return None

        async def connect(node: str) -> NodeServices:
            return await host.on_data(lambda: services(host, node, False))

        return RelayedLifecycle(lambda: self.order.node, lambda: served(host, self.order.node), connect)

    def _parameters_of(self, host: Host, services: ParameterAccess) -> RelayedParameters:
        order, component = self.order, self.component
        modes = {functionality.name: functionality.modes[-1].name for functionality in component}
        record = RelayedRecord(host.instance, order.node, order.stated, order.taken_over, modes)
        return RelayedParameters(RelayedNode(component, record), services)

    async def _before_modes(self, modes: Mapping[str, str]) -> None:
        """Set what these modes, by functionality, state. Raises CommandRefused with the node's reason."""
        assert self._agent is not None and self._agent.parameters is not None
        await self._agent.parameters.enter_modes(modes)

    async def _set_parameters(self, command: SetParametersCommand) -> replies.PreviousParameters:
        """Set parameters of the program's node, whose time is that of the relay. Raises CommandRefused."""
        host, agent = self.host, self._agent
        assert host is not None and agent is not None and agent.parameters is not None
        modes = {name: each.mode for name, each in agent.state().functionalities.items()}
        before = await agent.parameters.set(command, modes)
        if own := {name: value for name, value in command.parameters.items() if name in ROS_PARAMETERS}:
            await host.on_data(lambda: host.parameters.set(own))
        return before

    def _program_endpoints(self) -> ProgramEndpoints:
        host, platform, served = self.host, self._platform, self._platform.served
        assert host is not None
        passed: dict[str, Relay | RelayedServer | RelayedActionServer] = {**self.relays, **self.servers}
        return ProgramEndpoints(
            self.order,
            self.component,
            self.program,
            lambda: platform.graph(host, self.order),
            {name: lambda relay=relay: relay.matched for name, relay in passed.items()},  # type: ignore[misc]
            platform.advertises_late,
            (lambda: ()) if platform.nodes is None else partial(platform.nodes, host, self.order.enclave),
            Served if served is None else lambda: served(host, self.order.node),
        )

    def run(self) -> None:
        """Until it is stopped, or the program has exited. As :meth:`midstride.Component.start`.

        Raises NodeError if the program publishes past the relay.
        """
        context = find()
        self.host = host = self._platform.host(context)
        files = ProgramFiles({}, context.started)
        self._lifecycle = lifecycle = self._lifecycle_of(host)
        self._agent = agent = RelayAgent(
            self.parts,
            self.component,
            host,
            context.token,
            os.getpid(),
            None,
            files,
            context.diagnostics,
            lifecycle=lifecycle,
            patience=self.component.stop_times.patience,
            servers=tuple(self.servers.values()),
        )
        self.program.watch(agent.program_exited)

        def went_past(fault: str) -> None:
            self._fault = fault
            print(f"the relay of {self.order.node} ends: {fault}", file=sys.stderr, flush=True)
            agent.stop()

        self._program_endpoints().watch(went_past)
        host.run(agent.main)
        if self._fault is not None:
            raise NodeError(self._fault)


def run_relay(platform: RelayPlatform) -> NoReturn:
    """The whole life of a relay's process. Its argument is the file of the order."""
    order = RelayOrder.read(Path(sys.argv[1]))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # until the component runs
    program, status = None, 1
    try:
        program = RelayedProgram(order)
        RelayComponent(order, program, platform, Path(sys.argv[1])).run()
        status = 0
    except MidstrideError as error:
        print(f"the relay of {order.node} ends: {error}", file=sys.stderr, flush=True)
    except SystemExit:
        pass
    ended = 0 if program is None else program.end()
    if ended and ended != KILLED:
        print(f"`{' '.join(order.command)}` has exited with status {ended}", file=sys.stderr, flush=True)
    sys.exit(ended or status)

"""The agent of a node that has none inside it: in the manager's process, it answers the commands of the control plane.

So the executor, the hand-over and the reconciler need not know what kind of node they talk to. What it changes is in
shared memory and in a file, so if the manager ends the node goes on, and the next manager's agent continues
(docs/semantics.md section 7).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final

from midstride.codec.component import NamedComponentForm
from midstride.errors import CommandRefused, MidstrideError
from midstride.foreign.cuts import PUBLISHING, ForeignCuts
from midstride.foreign.gates import Gates
from midstride.foreign.graph_check import NodeGraph, differences, lacking, shown
from midstride.foreign.lifecycle_cuts import LifecycleCuts, LifecyclePeers
from midstride.foreign.lifecycle_node import LifecycleNode
from midstride.foreign.node import TICK, ForeignNode, without_ports
from midstride.foreign.parameters import ForeignParameters
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reflex import broken_assumptions
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.node.baton import BatonStep
from midstride.node.rate_watch import RateWatch
from midstride.wire import commands, frames
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import Command
from midstride.wire.frames import Reply, Request
from midstride.wire.program import Program
from midstride.wire.state import GateState, WireValue
from midstride.wire.transport import Transport

HEARTBEAT: Final = 0.5
# How often it asks a lifecycle node for its state and its parameters (s).
LOOK: Final = 1.0
# How long the graph may take to show a new node's endpoints (s), and how often it is compared later (s).
GRAPH_TIMEOUT: Final = 5.0
GRAPH_LOOK: Final = 2.0
# How often it looks whether a baton has moved (s).
WATCH: Final = 0.05
# How long a node may take to create the publishers and subscriptions that are declared (s).
ENDPOINTS_TIMEOUT: Final = 20.0
# A best-effort message right after the match is often lost, one a moment later is not (s).
SETTLE: Final = 0.05
# An output with a rate hangs if it has been silent for so many periods, and at least so long (s).
HANGS_PERIODS: Final = 10
HANGS: Final = 1.0
_REMEMBERED: Final = 1000

Handler = Callable[[Any], Awaitable[WireValue]]


class ForeignAgent:
    """Answers for the node of ``record``, whose file is in ``folder``. ``gates`` is None for `gate none`."""

    def __init__(
        self,
        record: ForeignRecord,
        folder: Path,
        gates: Gates | None,
        services: NodeServices | None = None,
        peers: LifecyclePeers | None = None,
        graph: NodeGraph | None = None,
    ) -> None:
        self.node = ForeignNode(record, folder, gates)
        self._cuts: ForeignCuts | LifecycleCuts = ForeignCuts(self.node)
        self._services = services
        self.lifecycle: LifecycleNode | None = None
        self._parameters: ForeignParameters | None = None
        if services is not None:
            self._parameters = ForeignParameters(self.node, services)
        if services is not None and self.node.component.has_lifecycle:
            self.lifecycle = LifecycleNode(self.node, services)
            if gates is None:
                self._cuts = LifecycleCuts(self.lifecycle, peers or LifecyclePeers())
        self._graph = graph
        self._failed: str | None = None  # why it has not been configured, or is not what is declared
        self._replies: dict[str, asyncio.Task[Reply]] = {}
        self._lock = asyncio.Lock()
        self._registered = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._reported: dict[str, GateState | None] = {}
        greeting = frames.Greeting(
            protocol=frames.PROTOCOL,
            instance=record.instance,
            uuid=record.uuid,
            pid=record.pid,
            start_token=record.token,
        )
        self._server = CommandServer(greeting, self._serve)
        self._handlers: dict[type[Command[Any]], Handler] = {
            commands.AttachCommand: self._attach,
            commands.DetachCommand: self._detach,
            commands.GateCommand: self._gate,
            commands.AwaitMatchCommand: self._await_match,
            commands.AwaitRateCommand: self._await_rate,
            commands.AwaitWriteCommand: self._await_write,
            commands.GridCommand: self._cuts.grid,
            commands.CutOutCommand: self._cuts.cut_out,
            commands.CutInCommand: self._cuts.cut_in,
            commands.CancelCutCommand: self._cuts.cancel_cut,
            commands.AwaitCutCommand: self._await_cut,
            commands.AwaitIdleCommand: self._await_idle,
            commands.FenceCommand: self._fence,
            commands.HoldCommand: self._hold,
            commands.ModesCommand: self._modes,
        }
        if isinstance(self._cuts, ForeignCuts):
            self._handlers[commands.SeatCommand] = self._cuts.seat

    async def open(self, transport: Transport) -> None:
        """Listen for the manager, and register as soon as the node has the endpoints that are declared.

        A hand-over that an earlier manager has not finished is withdrawn, unless the new node has written already.
        """
        if self.node.gates is not None:
            for baton in {self.node.gates.baton(port) for port in self.node.component.outputs} - {0}:
                self.node.gates.step(baton, BatonStep.WITHDRAW)
        await self._server.open(transport)
        loop = asyncio.get_running_loop()
        self._tasks = [
            loop.create_task(each)
            for each in (
                self._register(),
                self._heartbeat(),
                self._watch_lifecycle(),
                self._watch_graph(),
                self._watch_inputs(),
            )
        ]

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.close(0.0)
        if self._services is not None:
            self._services.close()

    async def _register(self) -> None:
        missing: list[str] = []
        if self.lifecycle is not None:
            try:
                await (self.lifecycle.configure() if not self.node.record.welcomed else self.lifecycle.look())
            except CommandRefused as error:
                self._failed = str(error)
        if self._parameters is not None and self.lifecycle is not None:
            await self._parameters.read()
        if self.node.gates is not None and self._failed is None:
            await self.node.comes_true(lambda: not self.node.require_gates().missing(), ENDPOINTS_TIMEOUT)
            missing = self.node.gates.missing()
            missing = await self._compare(missing)
        self._registered.set()
        self._report()
        declaration = NamedComponentForm.of(without_ports(self.node.component, missing))
        self._server.register(frames.Registration(declaration=declaration, endpoints=[]))

    async def _compare(self, missing: list[str]) -> list[str]:
        """Compare what the graph shows with what is declared; the ports that it then lacks without a reason given.

        What the graph does not show in time is not judged. A node that has been accepted keeps running.
        """
        component, topics, node = self.node.component, self.node.record.topics, self.node.record.node
        if (graph := self._graph) is None or self.node.record.welcomed:
            return missing
        if not missing:
            await self.node.comes_true(lambda: shown(component, topics, graph()), GRAPH_TIMEOUT, every=WATCH)
        found = graph()
        faults = lacking(component, topics, node, found, missing) + differences(component, topics, node, found)
        self._failed = "; ".join(faults) or None
        return []

    async def _watch_graph(self) -> None:
        """Look now and then whether the node still has what is declared: it may create endpoints at any time."""
        await self._registered.wait()
        while self._graph is not None:
            await asyncio.sleep(GRAPH_LOOK)
            record = self.node.record
            found = differences(self.node.component, record.topics, record.node, self._graph())
            if found != self.node.differences:
                self.node.differences = found
                self._report()

    async def _heartbeat(self) -> None:
        """Report twice a second, and soon after a baton has moved, which the nodes do without a command."""
        await self._registered.wait()
        while True:
            await self.node.comes_true(lambda: self.node.gate_states() != self._reported, HEARTBEAT, every=WATCH)
            self._report()

    async def _watch_lifecycle(self) -> None:
        """Look now and then which lifecycle state and which parameters the node has: others may change them."""
        await self._registered.wait()
        while self.lifecycle is not None and self._parameters is not None and self._failed is None:
            await asyncio.sleep(LOOK)
            async with self._lock:
                left = await self.lifecycle.look()
                if self.lifecycle.lifecycle.responsive:
                    await self._parameters.read()
                if left:
                    self.node.change_record(revision=self.node.record.revision + 1)
                    self._report()

    async def _watch_inputs(self) -> None:
        """Degrade what relies on a publisher that has fallen silent; the manager restores it once that is back."""
        await self._registered.wait()
        while self.node.gates is not None:
            await asyncio.sleep(HEARTBEAT)
            async with self._lock:
                for name, (mode, because) in broken_assumptions(self.node).items():
                    try:
                        await self._modes(commands.ModesCommand(modes={name: mode}, because=because))
                    except CommandRefused as error:  # its gates are closed without its help
                        last = self.node.component.functionalities[name].modes[-1].name
                        self.node.enter_modes({name: last}, f"{because}; {error}")
                    fallen = {**self.node.record.fallen, name: because}
                    self.node.change_record(fallen=fallen, revision=self.node.record.revision + 1)
                    self._report()

    # -- requests --------------------------------------------------------------------------------------

    async def _serve(self, request: Request, token: str) -> Reply:
        try:
            command = frames.decode_command(request)
            if token != self.node.record.token:
                raise CommandRefused("the token is not that of the system that the component belongs to")
        except CommandRefused as error:
            return self._reply(request, error)
        if not isinstance(command, commands.PingCommand):
            await self._registered.wait()
        if command.kind != "changing":
            return await self._carry_out(request, command)
        if (answer := self._replies.get(request.id)) is None:
            answer = self._replies[request.id] = asyncio.get_running_loop().create_task(self._change(request, command))
            if len(self._replies) > _REMEMBERED:
                del self._replies[next(iter(self._replies))]
        return await asyncio.shield(answer)

    async def _change(self, request: Request, command: Command[Any]) -> Reply:
        async with self._lock:
            if request.revision != self.node.record.revision:
                words = f"the component is at revision {self.node.record.revision}, and the request expects "
                return self._reply(request, CommandRefused(f"{words}{request.revision}: observe it again, then retry"))
            return await self._carry_out(request, command)

    async def _carry_out(self, request: Request, command: Command[Any]) -> Reply:
        try:
            result = await self._result(command)
            if command.kind == "changing":
                self.node.change_record(revision=self.node.record.revision + 1)
                self._report()
                if isinstance(command, commands.WelcomeCommand):
                    result = self.node.state()
        except MidstrideError as error:
            return self._reply(request, error)
        return Reply(id=request.id, revision=self.node.record.revision, result=frames.encode_value(result))

    def _reply(self, request: Request, refused: MidstrideError) -> Reply:
        return Reply(id=request.id, revision=self.node.record.revision, refused=str(refused))

    async def _result(self, command: Command[Any]) -> WireValue:
        handler = self._handlers.get(type(command))
        if handler is not None:
            return await handler(command)
        match command:
            case commands.ObserveCommand():
                if self._parameters is not None and self.lifecycle is not None and self.lifecycle.lifecycle.responsive:
                    await self._parameters.read()
                return self.node.state()
            case commands.SetParametersCommand() if self._parameters is not None and self.lifecycle is not None:
                return await self._parameters.set(command)
            case commands.WelcomeCommand():
                if self._failed is not None:
                    raise CommandRefused(self._failed)
                self.node.change_record(welcomed=True)
            case commands.PingCommand() | commands.MeetCommand() | commands.AnswerCommand():
                pass
            case commands.ProgramCommand():
                return Program(files=[], started=self.node.record.started)
            case commands.ExportStateCommand():
                return commands.ExportedState(state=None)
            case commands.PrepareStateCommand() | commands.OfferStateCommand():
                return commands.StateOffer(exports="nothing")
            case commands.YieldCommand():
                return commands.Yielded(handled=[])
            case commands.DiscoverCommand():
                return commands.Discovered(found=None)
            case _:
                raise CommandRefused(
                    f"{self.node.record.instance} does not use Midstride's API, and `{command.name}` needs it"
                )
        return commands.Done()

    def _report(self) -> None:
        self._reported = self.node.gate_states()
        self._server.report(frames.StateChanged(state=self.node.state()))

    # -- modes and gates -------------------------------------------------------------------------------

    async def _modes(self, command: commands.ModesCommand) -> commands.PreviousModes:
        before = {name: mode for name, mode in self.node.record.modes.items() if name in command.modes}
        self.node.require_modes(command.modes)
        if self._parameters is not None:
            await self._parameters.enter_modes(command.modes)
        if self.lifecycle is not None:
            await self.lifecycle.enter_modes(command.modes, command.because)
        else:
            self.node.enter_modes(command.modes, command.because)
        return commands.PreviousModes(before=before)

    async def _hold(self, command: commands.HoldCommand) -> commands.Done:
        """Its code makes its calls at any time, and its modes change without them."""
        return commands.Done()

    async def _attach(self, command: commands.AttachCommand) -> commands.Attached:
        port, topic, record = command.port, command.topic, self.node.record
        if port not in record.topics:
            raise CommandRefused(f"there is no port {port}; the ports are: {', '.join(record.topics)}")
        if port in record.links:
            raise CommandRefused(f"{port} is already attached to {record.topics[port]}")
        if record.topics[port] != topic:
            words = f"{port} was started on topic {record.topics[port]}, and cannot be attached to {topic}"
            raise CommandRefused(f"{words}: the names of a node without Midstride's API are fixed at its start")
        if self.node.gates is None:
            if self.lifecycle is not None:
                await self.lifecycle.set_links({port: command.gate})
                return commands.Attached(matched=0)
            if command.gate == "closed":
                raise CommandRefused(
                    f"{record.instance} has no gate (`gate none`), so {topic} cannot be handed over to it; "
                    "use `--strategy paper`, or `gate preload`"
                )
            self.node.change_record(links={**record.links, port: "open"})
            return commands.Attached(matched=0)
        matched = await self.node.matched(port, command.peers, command.timeout)
        if matched < command.peers:
            raise CommandRefused(
                f"only {matched} of {command.peers} endpoints on {topic} were found within {command.timeout:g} s; "
                "the others are missing, or have another type or incompatible QoS"
            )
        matched = await self.node.matched(port, command.everyone, command.patience)
        if command.peers or command.everyone:
            await asyncio.sleep(SETTLE)
        self.node.change_record(links={**self.node.record.links, port: command.gate})
        if self.node.component.has_output(port):
            self.node.adjust(port)
        else:
            self.node.gates.set_gate(port, True)
        return commands.Attached(matched=matched)

    async def _detach(self, command: commands.DetachCommand) -> commands.Detached:
        port = command.port
        self.node.require_attached(port, command.topic)
        if self.lifecycle is not None and self.node.gates is None:
            await self.lifecycle.set_links({port: None})
            return commands.Detached(acknowledged=None, last=None)
        self.node.change_record(links={name: gate for name, gate in self.node.record.links.items() if name != port})
        if self.node.gates is None:
            return commands.Detached(acknowledged=None, last=None)
        self.node.gates.set_gate(port, False)
        if self.node.component.has_output(port) and (baton := self.node.gates.baton(port)):
            await self.node.comes_true(
                lambda: not self.node.require_gates().has_it(port) or not self.node.writers(baton), PUBLISHING
            )
            word = self.node.gates.page.word(baton)
            if word.predecessor == self.node.gates.index + 1:  # it has been handed over, for good
                self.node.gates.page.step(baton, BatonStep.SETTLE, word.holder - 1)
        return commands.Detached(acknowledged=None, last=self.node.gates.entry(port).passed)

    async def _gate(self, command: commands.GateCommand) -> commands.Done:
        self.node.require_attached(command.port, command.topic)
        if self.lifecycle is not None and self.node.gates is None:
            await self.lifecycle.set_links({command.port: command.gate})
            return commands.Done()
        self.node.require_gates()
        self.node.change_record(links={**self.node.record.links, command.port: command.gate})
        self.node.adjust(command.port)
        return commands.Done()

    # -- waiting ---------------------------------------------------------------------------------------

    async def _await_match(self, command: commands.AwaitMatchCommand) -> commands.Attached:
        self.node.require_attached(command.port, command.topic)
        if self.node.gates is None:  # with how many is not known, and delays nothing
            return commands.Attached(matched=command.peers)
        return commands.Attached(matched=await self.node.matched(command.port, command.peers, command.timeout))

    async def _await_write(self, command: commands.AwaitWriteCommand) -> commands.GatedWrites:
        """With a rate, what was written before does not count: it may hang by now."""
        entry, rated = self.node.require_gates().entry(command.port), self.node.require_gates().rate(command.port)
        begun = int(entry.gated) if rated else 0
        await self.node.comes_true(lambda: entry.gated > begun, command.timeout)
        if rated and entry.gated > begun:
            await self.node.comes_true(lambda: entry.gated - begun >= command.calls, command.patience)
        return commands.GatedWrites(gated=entry.gated - begun, wrong_type=None)

    async def _await_rate(self, command: commands.AwaitRateCommand) -> commands.RateVerdict:
        if self.lifecycle is not None and self.node.gates is None:
            # What can be known of it: that it does not leave its lifecycle state.
            left = await self.node.comes_true(self.lifecycle.left, command.timeout, every=WATCH)
            return commands.RateVerdict(reached=left == (command.until == "broken"), rate=0.0, pause=0.0)
        entry, deadline = self.node.require_gates().entry(command.port), time.monotonic() + command.timeout
        begun = entry.passed + entry.gated
        watch = RateWatch(command.rate, command.window, time.monotonic_ns())
        while True:
            watch.see(entry.passed + entry.gated - begun, time.monotonic_ns())
            reached = watch.kept if command.until == "met" else watch.broken
            if reached or time.monotonic() >= deadline:
                return commands.RateVerdict(reached=reached, rate=round(watch.rate, 3), pause=round(watch.pause, 3))
            await asyncio.sleep(TICK)

    async def _await_idle(self, command: commands.AwaitIdleCommand) -> commands.Idle:
        """It hangs if an output with a rate has been silent for long, whether its gate is open or not.

        A lifecycle node without a gate hangs if it does not say its state.
        """
        if self.lifecycle is not None and self.node.gates is None:
            try:
                await self.lifecycle.lifecycle.look(command.timeout)
            except NoAnswer as error:
                return commands.Idle(busy=str(error))
            return commands.Idle(busy=None)
        for port in self.node.record.links:
            rate = (
                self.node.component.stated_rate(port, self.node.record.modes)
                if self.node.component.has_output(port)
                else None
            )
            age = self.node.gates.age(port) if self.node.gates is not None else None
            if rate and age is not None and age > max(HANGS, HANGS_PERIODS / rate):
                return commands.Idle(busy=f"it has written nothing on {self.node.record.topics[port]} for {age:.1f} s")
        return commands.Idle(busy=None)

    async def _await_cut(self, command: commands.AwaitCutCommand) -> commands.CutResult:
        result = await self._cuts.await_cut(command)
        self._report()  # the manager compares what is reported with its model as soon as the change ends
        return result

    async def _fence(self, command: commands.FenceCommand) -> commands.FencedOutputs:
        gates = self.node.require_gates()
        for port, topic in command.attachments:
            self.node.require_attached(port, topic)
        batons = {baton for port, _ in command.attachments if (baton := gates.baton(port))}
        for baton in batons:
            gates.step(baton, BatonStep.LIFT if command.lift else BatonStep.FENCE)
        for port, _ in command.attachments:
            if not gates.baton(port):
                gates.set_gate(port, command.lift)
        if not command.lift:
            free = await self.node.comes_true(lambda: not any(map(self.node.writers, batons)), command.timeout)
            if not free:
                for baton in batons:
                    gates.step(baton, BatonStep.LIFT)
                raise CommandRefused("a message is being published, and that does not end")
        self._report()
        last = {f"{port} {topic}": int(gates.entry(port).passed) for port, topic in command.attachments}
        return commands.FencedOutputs(last=last)

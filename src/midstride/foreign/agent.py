"""The agent of a node that has none inside it: in the manager's process, it answers the commands of the control plane.

So the executor, the hand-over and the reconciler need not know what kind of node they talk to. What it changes is in
shared memory and in a file, so if the manager ends the node goes on, and the next manager's agent continues
(docs/semantics.md section 7).
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any, Final

from immutables import Map
from msgspec.structs import replace

from midstride.codec.component import NamedComponentForm
from midstride.errors import CommandRefused, MidstrideError
from midstride.foreign.gates import Gates
from midstride.foreign.page import BatonStep
from midstride.foreign.record import ForeignRecord
from midstride.model.component import ComponentSpec
from midstride.node.message_times import window_of
from midstride.node.rate_watch import RateWatch
from midstride.wire import commands, frames
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import Command
from midstride.wire.frames import Reply, Request
from midstride.wire.program import Program
from midstride.wire.state import (
    NOT_WELCOMED,
    ComponentState,
    FunctionalityState,
    GateState,
    LinkState,
    Measured,
    WireValue,
)
from midstride.wire.transport import Transport

HEARTBEAT: Final = 0.5
TICK: Final = 0.005
# The shortest interval between two counts from which a rate is computed (s).
SAMPLE: Final = 0.2
# How long a node may take to create the publishers and subscriptions that are declared (s).
ENDPOINTS_TIMEOUT: Final = 20.0
# A best-effort message right after the match is often lost, one a moment later is not (s).
SETTLE: Final = 0.05
# How long the helper thread of a node may take to look, once it is asked to (s).
LOOK: Final = 0.3
# How long a call that is publishing may take to return (s).
PUBLISHING: Final = 0.3
# An output with a rate hangs if it has been silent for so many periods, and at least so long (s).
HANGS_PERIODS: Final = 10
HANGS: Final = 1.0
_REMEMBERED: Final = 1000

Handler = Callable[[Any], Awaitable[WireValue]]


@dataclass
class _Cut:
    """One cut, of the old side or the new one. ``before``: by port, how many messages had passed."""

    swaps: list[commands.CutSwap]
    baton: int
    before: dict[str, int]
    other: int | None = None  # the index of the old side; None on that side
    own: dict[str, int] = field(default_factory=dict)  # by port, its baton before


class ForeignAgent:
    """Answers for the node of ``record``, whose file is in ``folder``. ``gates`` is None for `gate none`."""

    def __init__(self, record: ForeignRecord, folder: Path, gates: Gates | None) -> None:
        self.record = record
        self._folder = folder
        self._gates = gates
        self._component: ComponentSpec = record.declaration.declared()
        self._since = dict.fromkeys(record.modes, time.monotonic())
        self._because = dict.fromkeys(record.modes, "started")
        self._counts: dict[str, deque[tuple[float, int]]] = {}
        self._cuts: dict[str, _Cut] = {}
        self._replies: dict[str, asyncio.Task[Reply]] = {}
        self._lock = asyncio.Lock()
        self._registered = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
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
            commands.GridCommand: self._grid,
            commands.CutOutCommand: self._cut_out,
            commands.CutInCommand: self._cut_in,
            commands.CancelCutCommand: self._cancel_cut,
            commands.AwaitCutCommand: self._await_cut,
            commands.AwaitIdleCommand: self._await_idle,
            commands.FenceCommand: self._fence,
            commands.ModesCommand: self._modes,
        }

    async def open(self, transport: Transport) -> None:
        """Listen for the manager, and register as soon as the node has the endpoints that are declared.

        A hand-over that an earlier manager has not finished is withdrawn, unless the new node has written already.
        """
        if self._gates is not None:
            for baton in {self._gates.baton(port) for port in self._component.outputs} - {0}:
                self._gates.step(baton, BatonStep.WITHDRAW)
        await self._server.open(transport)
        loop = asyncio.get_running_loop()
        self._tasks = [loop.create_task(self._register()), loop.create_task(self._heartbeat())]

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._server.close(0.0)

    async def _register(self) -> None:
        missing: list[str] = []
        if self._gates is not None:
            await self._comes_true(lambda: not self._gates_of().missing(), ENDPOINTS_TIMEOUT)
            missing = self._gates.missing()
        self._registered.set()
        self._report()
        declaration = NamedComponentForm.of(_without(self._component, missing))
        self._server.register(frames.Registration(declaration=declaration, endpoints=[]))

    async def _heartbeat(self) -> None:
        while True:
            await asyncio.sleep(HEARTBEAT)
            if self._registered.is_set():
                self._report()

    async def _comes_true(self, condition: Callable[[], bool], timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline:
                return False
            await asyncio.sleep(TICK)
        return True

    # -- requests --------------------------------------------------------------------------------------

    async def _serve(self, request: Request, token: str) -> Reply:
        try:
            command = frames.decode_command(request)
            if token != self.record.token:
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
            if request.revision != self.record.revision:
                words = f"the component is at revision {self.record.revision}, and the request expects "
                return self._reply(request, CommandRefused(f"{words}{request.revision}: observe it again, then retry"))
            return await self._carry_out(request, command)

    async def _carry_out(self, request: Request, command: Command[Any]) -> Reply:
        try:
            result = await self._result(command)
            if command.kind == "changing":
                self._change_record(revision=self.record.revision + 1)
                self._report()
                if isinstance(command, commands.WelcomeCommand):
                    result = self.state()
        except MidstrideError as error:
            return self._reply(request, error)
        return Reply(id=request.id, revision=self.record.revision, result=frames.encode_value(result))

    def _reply(self, request: Request, refused: MidstrideError) -> Reply:
        return Reply(id=request.id, revision=self.record.revision, refused=str(refused))

    async def _result(self, command: Command[Any]) -> WireValue:
        handler = self._handlers.get(type(command))
        if handler is not None:
            return await handler(command)
        match command:
            case commands.ObserveCommand():
                return self.state()
            case commands.WelcomeCommand():
                self._change_record(welcomed=True)
            case commands.PingCommand() | commands.MeetCommand() | commands.AnswerCommand():
                pass
            case commands.ProgramCommand():
                return Program(files=[], started=self.record.started)
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
                    f"{self.record.instance} does not use Midstride's API, and `{command.name}` needs it"
                )
        return commands.Done()

    def _change_record(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)
        self.record.write(self._folder)

    # -- state -----------------------------------------------------------------------------------------

    def state(self) -> ComponentState:
        record, now = self.record, time.monotonic()
        functionalities = {
            name: FunctionalityState(mode=mode, since=now - self._since[name], because=self._because[name])
            for name, mode in record.modes.items()
        }
        return ComponentState(
            instance=record.instance,
            uuid=record.uuid,
            pid=record.pid,
            revision=record.revision,
            functionalities=functionalities,
            ports={port: {record.topics[port]: self._link(port)} for port in record.links},
            parameters={},
            stopping=0.0,
            waiting=None if record.welcomed else NOT_WELCOMED,
            node=record.node,
            imported=1,
        )

    def _link(self, port: str) -> LinkState:
        output, gates = self._component.has_output(port), self._gates
        if gates is None:
            return LinkState(gate="open" if output else None, count=0)
        entry = gates.entry(port)
        gate: GateState | None = None
        if output:
            gate = "open" if self.record.links[port] == "open" and gates.has_it(port) else "closed"
        return LinkState(
            gate=gate,
            count=entry.passed,
            gated=entry.gated,
            measured=self._measured(port),
            fenced=output and gates.fenced(port),
        )

    def _measured(self, port: str) -> Measured:
        """From the counts at each report, so less exact than a component's own figures; there is no jitter."""
        gates, now = self._gates_of(), time.monotonic()
        entry, window = gates.entry(port), window_of(self._component.stated_rate(port, self.record.modes))
        seen, total = self._counts.setdefault(port, deque()), int(entry.passed + entry.gated)
        if not seen or now - seen[-1][0] >= SAMPLE:
            seen.append((now, total))
        while len(seen) > 2 and seen[1][0] <= now - window:
            seen.popleft()
        covered, age = now - seen[0][0], gates.age(port)
        rate = None if age is None or covered < SAMPLE else (total - seen[0][1]) / covered
        return Measured(window=window, covered=min(window, covered), rate=rate, age=age)

    def _report(self) -> None:
        self._server.report(frames.StateChanged(state=self.state()))

    # -- modes and gates -------------------------------------------------------------------------------

    def _gates_of(self) -> Gates:
        if self._gates is None:
            raise CommandRefused(f"{self.record.instance} has no gate (`gate none`), so it cannot be held back")
        return self._gates

    def _adjust(self, port: str) -> None:
        """Open or close the gate of an output, as its attachment and the mode of its functionality say."""
        if self._gates is None or not self._component.has_output(port):
            return
        owner = self._component.owner(port)
        works = self.record.modes[owner.name] != owner.modes[-1].name
        self._gates.set_gate(port, works and self.record.links.get(port) == "open")

    async def _modes(self, command: commands.ModesCommand) -> commands.PreviousModes:
        for name, mode in command.modes.items():
            found = self._component.functionalities.get(name)
            if found is None or mode not in [each.name for each in found.modes]:
                raise CommandRefused(f"{self.record.instance} has no functionality {name} with a mode {mode!r}")
        before = {name: self.record.modes[name] for name in command.modes}
        self._change_record(modes={**self.record.modes, **command.modes})
        for name in command.modes:
            self._since[name], self._because[name] = time.monotonic(), command.because
            for port in self._component.functionalities[name].outputs:
                self._adjust(port)
        return commands.PreviousModes(before=before)

    def _attached(self, port: str, topic: str) -> None:
        if port not in self.record.links or self.record.topics[port] != topic:
            raise CommandRefused(f"{port} is not attached to {topic}")

    async def _attach(self, command: commands.AttachCommand) -> commands.Attached:
        port, topic, record = command.port, command.topic, self.record
        if port not in record.topics:
            raise CommandRefused(f"there is no port {port}; the ports are: {', '.join(record.topics)}")
        if port in record.links:
            raise CommandRefused(f"{port} is already attached to {record.topics[port]}")
        if record.topics[port] != topic:
            words = f"{port} was started on topic {record.topics[port]}, and cannot be attached to {topic}"
            raise CommandRefused(f"{words}: the names of a node without Midstride's API are fixed at its start")
        if self._gates is None:
            if command.gate == "closed":
                raise CommandRefused(
                    f"{record.instance} has no gate (`gate none`), so {topic} cannot be handed over to it; "
                    "use `--strategy paper`, or `gate preload`"
                )
            self._change_record(links={**record.links, port: "open"})
            return commands.Attached(matched=0)
        matched = await self._match(port, command.peers, command.timeout)
        if matched < command.peers:
            raise CommandRefused(
                f"only {matched} of {command.peers} endpoints on {topic} were found within {command.timeout:g} s; "
                "the others are missing, or have another type or incompatible QoS"
            )
        matched = await self._match(port, command.everyone, command.patience)
        if command.peers or command.everyone:
            await asyncio.sleep(SETTLE)
        self._change_record(links={**self.record.links, port: command.gate})
        if self._component.has_output(port):
            self._adjust(port)
        else:
            self._gates.set_gate(port, True)
        return commands.Attached(matched=matched)

    async def _match(self, port: str, wanted: int, patience: float) -> int:
        """With how many endpoints a port is matched, once that is ``wanted`` or after ``patience`` (s)."""
        gates = self._gates_of()
        looked = gates.node.beat
        gates.page.ring(gates.index)
        await self._comes_true(lambda: gates.node.beat != looked, LOOK)
        await self._comes_true(lambda: gates.entry(port).matched >= wanted, patience)
        return int(gates.entry(port).matched)

    async def _detach(self, command: commands.DetachCommand) -> commands.Detached:
        port = command.port
        self._attached(port, command.topic)
        self._change_record(links={name: gate for name, gate in self.record.links.items() if name != port})
        if self._gates is None:
            return commands.Detached(acknowledged=None, last=None)
        self._gates.set_gate(port, False)
        if self._component.has_output(port) and (baton := self._gates.baton(port)):
            await self._comes_true(lambda: not self._gates_of().has_it(port) or not self._writers(baton), PUBLISHING)
            word = self._gates.page.word(baton)
            if word.predecessor == self._gates.index + 1:  # it has been handed over, for good
                self._gates.page.step(baton, BatonStep.SETTLE, word.holder - 1)
        return commands.Detached(acknowledged=None, last=self._gates.entry(port).passed)

    def _writers(self, baton: int) -> int:
        return self._gates_of().page.word(baton).writers

    async def _gate(self, command: commands.GateCommand) -> commands.Done:
        self._attached(command.port, command.topic)
        self._gates_of()
        self._change_record(links={**self.record.links, command.port: command.gate})
        self._adjust(command.port)
        return commands.Done()

    # -- waiting ---------------------------------------------------------------------------------------

    async def _await_match(self, command: commands.AwaitMatchCommand) -> commands.Attached:
        self._attached(command.port, command.topic)
        return commands.Attached(matched=await self._match(command.port, command.peers, command.timeout))

    async def _await_write(self, command: commands.AwaitWriteCommand) -> commands.GatedWrites:
        """With a rate, what was written before does not count: it may hang by now."""
        entry, rated = self._gates_of().entry(command.port), self._gates_of().rate(command.port)
        begun = int(entry.gated) if rated else 0
        await self._comes_true(lambda: entry.gated > begun, command.timeout)
        if rated and entry.gated > begun:
            await self._comes_true(lambda: entry.gated - begun >= command.calls, command.patience)
        return commands.GatedWrites(gated=entry.gated - begun, wrong_type=None)

    async def _await_rate(self, command: commands.AwaitRateCommand) -> commands.RateVerdict:
        entry, deadline = self._gates_of().entry(command.port), time.monotonic() + command.timeout
        begun = entry.passed + entry.gated
        watch = RateWatch(command.rate, command.window, time.monotonic_ns())
        while True:
            watch.see(entry.passed + entry.gated - begun, time.monotonic_ns())
            reached = watch.kept if command.until == "met" else watch.broken
            if reached or time.monotonic() >= deadline:
                return commands.RateVerdict(reached=reached, rate=round(watch.rate, 3), pause=round(watch.pause, 3))
            await asyncio.sleep(TICK)

    async def _await_idle(self, command: commands.AwaitIdleCommand) -> commands.Idle:
        """It hangs if an output with a rate has been silent for long, whether its gate is open or not."""
        for port in self.record.links:
            rate = self._component.stated_rate(port, self.record.modes) if self._component.has_output(port) else None
            age = self._gates.age(port) if self._gates is not None else None
            if rate and age is not None and age > max(HANGS, HANGS_PERIODS / rate):
                return commands.Idle(busy=f"it has written nothing on {self.record.topics[port]} for {age:.1f} s")
        return commands.Idle(busy=None)

    # -- hand-over -------------------------------------------------------------------------------------

    async def _grid(self, command: commands.GridCommand) -> commands.Grid:
        rate = None if command.port is None else self._component.stated_rate(command.port, self.record.modes)
        now, readers = time.time_ns(), None
        if command.port is not None and command.topic is not None and self._gates is not None:
            readers = await self._match(command.port, 0, 0.0)
        if not rate:
            return commands.Grid(trigger="none", now=now, readers=readers)
        return commands.Grid(trigger="rate", now=now, epoch=now, period=1 / rate, readers=readers)

    async def _cut_out(self, command: commands.CutOutCommand) -> commands.Done:
        """The old side: from now on, one baton decides for the outputs of the cut."""
        gates, ports = self._gates_of(), [swap.port for swap in command.swaps]
        if not ports or command.state is not None:
            raise CommandRefused(f"{self.record.instance} does not use Midstride's API: it has no state to move")
        own = {port: gates.baton(port) for port in self._component.outputs}
        baton = gates.share(ports)
        self._cuts[command.cut] = _Cut(command.swaps, baton, {}, own=own)
        return commands.Done()

    async def _cut_in(self, command: commands.CutInCommand) -> commands.Done:
        """The new side: be named as the successor of the old one."""
        gates, ports = self._gates_of(), [swap.port for swap in command.swaps]
        old = gates.page.index_of(command.peer)
        if old is None:
            raise CommandRefused(f"{command.peer} has no gate of the kind that {self.record.instance} has")
        topics = {swap.topic for swap in command.swaps}
        holders = {
            int(entry.baton) for entry in gates.page.layout.nodes[old].ports if entry.topic.decode() in topics
        } - {0}
        if len(holders) != 1:
            raise CommandRefused(f"{command.peer} is not ready to hand over")
        baton = holders.pop()
        own = {port: gates.baton(port) for port in self._component.outputs}
        before = {port: int(gates.entry(port).passed) for port in ports}
        gates.share(ports, baton)
        cut = self._cuts[command.cut] = _Cut(command.swaps, baton, before, old, own)
        self._change_record(links={**self.record.links, **dict.fromkeys(ports, "open")})
        for port in ports:
            self._adjust(port)
        gates.page.step(baton, BatonStep.NAME_SUCCESSOR, old, gates.index, at_once=gates.timed(ports))
        gates.page.ring(gates.index)
        word = gates.page.word(baton)
        if gates.index + 1 not in (word.successor, word.holder):
            await self._withdraw(cut)
            del self._cuts[command.cut]
            raise CommandRefused(f"{command.peer} does not hold the baton of its outputs")
        return commands.Done()

    async def _await_cut(self, command: commands.AwaitCutCommand) -> commands.CutResult:
        """Both sides: until the new one has written, or that is withdrawn, or the old one is fenced."""
        cut, gates = self._cuts.get(command.cut), self._gates_of()
        if cut is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        new = cut.other is not None
        old = cut.other + 1 if cut.other is not None else gates.index + 1
        ports = [swap.port for swap in cut.swaps]

        def taken() -> bool:
            return gates.page.word(cut.baton).holder != old

        def over() -> bool:
            word = gates.page.word(cut.baton)
            return word.holder == old and not word.successor

        def done() -> bool:
            return taken() and (not new or any(gates.entry(port).passed > cut.before[port] for port in ports))

        await self._comes_true(lambda: done() or over(), command.timeout)
        if not done():
            return commands.CutResult(outcome="waiting")
        writes = {f"{swap.port} {swap.topic}": self._last_write(swap.port, cut) for swap in cut.swaps}
        if new:
            return commands.CutResult(outcome="done", first=writes)
        return commands.CutResult(outcome="done", last=writes)

    def _last_write(self, port: str, cut: _Cut) -> commands.LastWrite | None:
        entry = self._gates_of().entry(port)
        if entry.passed <= cut.before.get(port, -1):
            return None
        return commands.LastWrite(number=entry.passed, source=time.time_ns() - time.monotonic_ns() + entry.last)

    async def _cancel_cut(self, command: commands.CancelCutCommand) -> commands.Done:
        cut = self._cuts.pop(command.cut, None)
        if cut is not None and cut.other is not None:
            await self._withdraw(cut)
        elif cut is not None:
            gates = self._gates_of()
            gates.step(cut.baton, BatonStep.WITHDRAW)
            self._restore(cut)
        return commands.Done()

    async def _withdraw(self, cut: _Cut) -> None:
        """The new side: close its gates, and give the baton back to the old side."""
        gates = self._gates_of()
        assert cut.other is not None
        ports = [swap.port for swap in cut.swaps]
        self._change_record(links={**self.record.links, **dict.fromkeys(ports, "closed")})
        for port in ports:
            self._adjust(port)
        gates.page.step(cut.baton, BatonStep.WITHDRAW, cut.other)
        if gates.page.word(cut.baton).holder == gates.index + 1:
            gates.step(cut.baton, BatonStep.FENCE)
            if not await self._comes_true(lambda: not self._writers(cut.baton), PUBLISHING):
                raise CommandRefused(f"{self.record.instance} is publishing, and that does not end")
            gates.page.step(cut.baton, BatonStep.GIVE, cut.other)
        self._restore(cut)

    def _restore(self, cut: _Cut) -> None:
        for port, baton in cut.own.items():
            self._gates_of().entry(port).baton = baton

    async def _fence(self, command: commands.FenceCommand) -> commands.FencedOutputs:
        gates = self._gates_of()
        for port, topic in command.attachments:
            self._attached(port, topic)
        batons = {baton for port, _ in command.attachments if (baton := gates.baton(port))}
        for baton in batons:
            gates.step(baton, BatonStep.LIFT if command.lift else BatonStep.FENCE)
        for port, _ in command.attachments:
            if not gates.baton(port):
                gates.set_gate(port, command.lift)
        if not command.lift:
            free = await self._comes_true(lambda: not any(map(self._writers, batons)), command.timeout)
            if not free:
                for baton in batons:
                    gates.step(baton, BatonStep.LIFT)
                raise CommandRefused("a message is being published, and that does not end")
        self._report()
        last = {f"{port} {topic}": int(gates.entry(port).passed) for port, topic in command.attachments}
        return commands.FencedOutputs(last=last)


def _without(component: ComponentSpec, missing: list[str]) -> ComponentSpec:
    """``component`` as a node is that lacks the endpoints of these ports."""
    if not missing:
        return component
    kept = {
        name: replaced(
            found,
            inputs=tuple(port for port in found.inputs if port not in missing),
            outputs=tuple(port for port in found.outputs if port not in missing),
            modes=tuple(
                replaced(
                    mode,
                    assumptions=(),
                    guarantees=Map({port: g for port, g in mode.guarantees.items() if port not in missing}),
                )
                for mode in found.modes
            ),
        )
        for name, found in component.functionalities.items()
    }
    return replaced(
        component,
        inputs=Map({name: p for name, p in component.inputs.items() if name not in missing}),
        input_order=tuple(name for name in component.input_order if name not in missing),
        outputs=tuple(name for name in component.outputs if name not in missing),
        functionalities=Map(kept),
    )

"""What the commands of the control plane mean for a node without an agent inside it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from midstride.errors import CommandRefused
from midstride.foreign.cuts import PUBLISHING, ForeignCuts
from midstride.foreign.foreign_parameters import ForeignParameters
from midstride.foreign.lifecycle_cuts import LifecycleCuts
from midstride.foreign.lifecycle_node import LifecycleNode
from midstride.foreign.node import TICK, ForeignNode
from midstride.foreign.services import NoAnswer
from midstride.node.control.attachments import SETTLE, not_matched
from midstride.node.control.rate_watch import RateWatch
from midstride.node.handover.baton import BatonStep
from midstride.wire import commands, replies
from midstride.wire.command_server import CommandHandler
from midstride.wire.commands import Command
from midstride.wire.program import Program
from midstride.wire.state import WireValue

# How often an agent looks whether a baton has moved, or a lifecycle node has left its state (s).
WATCH: Final = 0.05
# An output with a rate hangs if it has been silent for so many periods, and at least so long (s).
HANGS_PERIODS: Final = 10
HANGS: Final = 1.0


class ForeignCommands:
    """Those of ``node``. ``parameters`` and ``lifecycle``: where it has any. ``report`` reports its state."""

    def __init__(
        self,
        node: ForeignNode,
        cuts: ForeignCuts | LifecycleCuts,
        parameters: ForeignParameters | None,
        lifecycle: LifecycleNode | None,
        report: Callable[[], None],
    ) -> None:
        self._node, self._cuts = node, cuts
        self._parameters, self._lifecycle = parameters, lifecycle
        self._report = report
        self._handlers: dict[type[Command[Any]], CommandHandler] = {
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
            commands.ModesCommand: self.modes,
        }
        if isinstance(self._cuts, ForeignCuts):
            self._handlers[commands.SeatCommand] = self._cuts.seat

    async def carry_out(self, command: Command[Any]) -> WireValue:
        """Carry out any command but `welcome`. Raises CommandRefused."""
        handler = self._handlers.get(type(command))
        if handler is not None:
            return await handler(command)
        match command:
            case commands.ObserveCommand():
                if self._parameters is not None and (node := self._lifecycle) is not None and node.lifecycle.responsive:
                    await self._parameters.read()
                return self._node.state()
            case commands.SetParametersCommand() if self._parameters is not None and self._lifecycle is not None:
                return await self._parameters.set(command)
            case commands.PingCommand() | commands.MeetCommand() | commands.AnswerCommand() | commands.HoldCommand():
                pass  # to hold: its code makes its calls at any time, and its modes change without them
            case commands.ProgramCommand():
                return Program(files=[], started=self._node.record.started)
            case commands.ExportStateCommand():
                return replies.ExportedState(state=None)
            case commands.PrepareStateCommand() | commands.OfferStateCommand():
                return replies.StateOffer(exports="nothing")
            case commands.YieldCommand():
                return replies.Yielded(handled=[])
            case commands.DiscoverCommand():
                return replies.Discovered(found=None)
            case _:
                raise CommandRefused(
                    f"{self._node.record.instance} does not use Midstride's API, and `{command.name}` needs it"
                )
        return replies.Done()

    # -- modes and gates -------------------------------------------------------------------------------

    async def modes(self, command: commands.ModesCommand) -> replies.PreviousModes:
        before = {name: mode for name, mode in self._node.record.modes.items() if name in command.modes}
        self._node.require_modes(command.modes)
        if self._parameters is not None:
            await self._parameters.enter_modes(command.modes)
        if self._lifecycle is not None:
            try:
                await self._lifecycle.enter_modes(command.modes, command.because)
            except CommandRefused:
                if self._parameters is not None and self._lifecycle.lifecycle.responsive:
                    with suppress(CommandRefused):  # why it is in neither mode is said already
                        await self._parameters.enter_modes(before)
                raise
        else:
            self._node.enter_modes(command.modes, command.because)
        return replies.PreviousModes(before=before)

    async def _attach(self, command: commands.AttachCommand) -> replies.Attached:
        port, topic, record = command.port, command.topic, self._node.record
        if port not in record.topics:
            raise CommandRefused(f"there is no port {port}; the ports are: {', '.join(record.topics)}")
        if port in record.links:
            raise CommandRefused(f"{port} is already attached to {record.topics[port]}")
        if record.topics[port] != topic:
            words = f"{port} was started on topic {record.topics[port]}, and cannot be attached to {topic}"
            raise CommandRefused(f"{words}: the names of a node without Midstride's API are fixed at its start")
        if self._node.gates is None:
            if self._lifecycle is not None:
                await self._lifecycle.set_links({port: command.gate})
                return replies.Attached(matched=0)
            if command.gate == "closed":
                raise CommandRefused(
                    f"{record.instance} has no gate (`gate none`), so {topic} cannot be handed over to it; "
                    "use `--strategy paper`, or `gate preload`"
                )
            self._node.change_record(links={**record.links, port: "open"})
            return replies.Attached(matched=0)
        matched = await self._node.matched(port, command.peers, command.timeout)
        if matched < command.peers:
            raise not_matched(matched, command)
        matched = await self._node.matched(port, command.everyone, command.patience)
        if command.peers or command.everyone:
            await asyncio.sleep(SETTLE)
        self._node.change_record(links={**self._node.record.links, port: command.gate})
        if self._node.component.has_output(port):
            self._node.adjust(port)
        else:
            self._node.gates.set_gate(port, True)
        return replies.Attached(matched=matched)

    async def _detach(self, command: commands.DetachCommand) -> replies.Detached:
        port = command.port
        self._node.require_attached(port, command.topic)
        if self._lifecycle is not None and self._node.gates is None:
            await self._lifecycle.set_links({port: None})
            return replies.Detached(acknowledged=None, last=None)
        self._node.change_record(links={name: gate for name, gate in self._node.record.links.items() if name != port})
        if self._node.gates is None:
            return replies.Detached(acknowledged=None, last=None)
        self._node.gates.set_gate(port, False)
        if self._node.component.has_output(port) and (baton := self._node.gates.baton(port)):
            await self._node.comes_true(
                lambda: not self._node.require_gates().has_it(port) or not self._node.writers(baton), PUBLISHING
            )
            word = self._node.gates.page.word(baton)
            if word.predecessor == self._node.gates.index + 1:  # it has been handed over, for good
                self._node.gates.page.step(baton, BatonStep.SETTLE, word.holder - 1)
        return replies.Detached(acknowledged=None, last=self._node.gates.entry(port).passed)

    async def _gate(self, command: commands.GateCommand) -> replies.Done:
        self._node.require_attached(command.port, command.topic)
        if self._lifecycle is not None and self._node.gates is None:
            await self._lifecycle.set_links({command.port: command.gate})
            return replies.Done()
        self._node.require_gates()
        self._node.change_record(links={**self._node.record.links, command.port: command.gate})
        self._node.adjust(command.port)
        return replies.Done()

    # -- waiting ---------------------------------------------------------------------------------------

    async def _await_match(self, command: commands.AwaitMatchCommand) -> replies.Attached:
        self._node.require_attached(command.port, command.topic)
        if self._node.gates is None:  # with how many is not known, and delays nothing
            return replies.Attached(matched=command.peers)
        return replies.Attached(matched=await self._node.matched(command.port, command.peers, command.timeout))

    async def _await_write(self, command: commands.AwaitWriteCommand) -> replies.GatedWrites:
        """With a rate, what was written before does not count: it may hang by now."""
        entry, rated = self._node.require_gates().entry(command.port), self._node.require_gates().rate(command.port)
        begun = int(entry.gated) if rated else 0
        await self._node.comes_true(lambda: entry.gated > begun, command.timeout)
        if rated and entry.gated > begun:
            await self._node.comes_true(lambda: entry.gated - begun >= command.calls, command.patience)
        return replies.GatedWrites(gated=entry.gated - begun, wrong_type=None)

    async def _await_rate(self, command: commands.AwaitRateCommand) -> replies.RateVerdict:
        if self._lifecycle is not None and self._node.gates is None:
            # What can be known of it: that it does not leave its lifecycle state.
            left = await self._node.comes_true(self._lifecycle.left, command.timeout, every=WATCH)
            return replies.RateVerdict(reached=left == (command.until == "broken"), rate=0.0, pause=0.0)
        entry, deadline = self._node.require_gates().entry(command.port), time.monotonic() + command.timeout
        if command.known_clock and self._node.record.simulated_time:
            return replies.RateVerdict(reached=command.until == "met", rate=command.rate, pause=0.0)
        begun = entry.passed + entry.gated
        watch = RateWatch(command.rate, command.window, time.monotonic_ns())
        while True:
            watch.see(entry.passed + entry.gated - begun, time.monotonic_ns())
            reached = watch.kept if command.until == "met" else watch.broken
            if reached or time.monotonic() >= deadline:
                return replies.RateVerdict(reached=reached, rate=round(watch.rate, 3), pause=round(watch.pause, 3))
            await asyncio.sleep(TICK)

    async def _await_idle(self, command: commands.AwaitIdleCommand) -> replies.Idle:
        """It hangs if an output with a rate has been silent for long, whether its gate is open or not.

        In simulated time, nothing is judged while `/clock` stands still, or it is not known how it moves.
        A lifecycle node without a gate hangs if it does not say its state.
        """
        if self._lifecycle is not None and self._node.gates is None:
            try:
                await self._lifecycle.lifecycle.look(command.timeout)
            except NoAnswer as error:
                return replies.Idle(busy=str(error))
            return replies.Idle(busy=None)
        for port in self._node.record.links:
            rate = (
                self._node.component.stated_rate(port, self._node.record.modes)
                if self._node.component.has_output(port)
                else None
            )
            age = self._node.gates.age(port) if self._node.gates is not None else None
            due = None if age is None else self._node.due(age)
            if rate and due is not None and due > max(HANGS, HANGS_PERIODS / rate):
                return replies.Idle(busy=f"it has written nothing on {self._node.record.topics[port]} for {age:.1f} s")
        return replies.Idle(busy=None)

    async def _await_cut(self, command: commands.AwaitCutCommand) -> replies.CutResult:
        result = await self._cuts.await_cut(command)
        self._report()  # the manager compares what is reported with its model as soon as the change ends
        return result

    async def _fence(self, command: commands.FenceCommand) -> replies.FencedOutputs:
        gates = self._node.require_gates()
        for port, topic in command.attachments:
            self._node.require_attached(port, topic)
        batons = {baton for port, _ in command.attachments if (baton := gates.baton(port))}
        for baton in batons:
            gates.step(baton, BatonStep.LIFT if command.lift else BatonStep.FENCE)
        for port, _ in command.attachments:
            if not gates.baton(port):
                gates.set_gate(port, command.lift)
        if not command.lift:
            free = await self._node.comes_true(lambda: not any(map(self._node.writers, batons)), command.timeout)
            if not free:
                for baton in batons:
                    gates.step(baton, BatonStep.LIFT)
                raise CommandRefused("a message is being published, and that does not end")
        self._report()
        last = {f"{port} {topic}": int(gates.entry(port).passed) for port, topic in command.attachments}
        return replies.FencedOutputs(last=last)

"""Carries out the commands of the control plane for a node without an agent inside it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from midstride.errors import CommandRefused
from midstride.foreign.foreign_parameters import ForeignParameters
from midstride.foreign.foreign_state import ForeignState, StatePeers
from midstride.foreign.lifecycle_node import LifecycleNode
from midstride.foreign.node import ForeignNode
from midstride.foreign.ungated_outputs import UngatedOutputs
from midstride.wire import commands, replies
from midstride.wire.commands import Command
from midstride.wire.program import Program
from midstride.wire.state import WireValue


class ForeignCommands:
    """The commands of ``node``. ``parameters``, ``lifecycle`` and ``state``: where it has any.

    ``peers``: what is known of the state of others; ``report`` reports the node's.
    """

    def __init__(
        self,
        node: ForeignNode,
        outputs: UngatedOutputs,
        parameters: ForeignParameters | None,
        lifecycle: LifecycleNode | None,
        state: ForeignState | None,
        peers: StatePeers,
        report: Callable[[], None],
    ) -> None:
        self._node, self._outputs = node, outputs
        self._parameters, self._lifecycle = parameters, lifecycle
        self._state, self._peers = state, peers
        self._report = report

    async def carry_out(self, command: Command[Any]) -> WireValue:
        """Carry out any command but `welcome`. Raises CommandRefused."""
        if (port := getattr(command, "port", None)) is not None and self._is_service(port):
            self._check(command)
            return self._of_service(command)
        if (handler := getattr(self._outputs, command.name, None)) is not None:
            self._check(command)
            reply: WireValue = await handler(command)
            if isinstance(command, commands.AwaitCutCommand | commands.FenceCommand):
                self._report()  # the manager compares what is reported with its model as soon as the change ends
            return reply
        match command:
            case commands.ModesCommand():
                return await self.modes(command)
            case commands.ObserveCommand():
                node = self._lifecycle
                answers = self._node.record.welcomed if node is None else node.lifecycle.responsive
                if self._parameters is not None and answers:
                    await self._parameters.read()
                return self._node.state()
            case commands.SetParametersCommand() if self._parameters is not None:
                return await self._parameters.set(command)
            case commands.AnswerCommand():
                return replies.Answers()
            case commands.PingCommand() | commands.MeetCommand() | commands.HoldCommand() | commands.MuteCommand():
                pass  # its code makes its calls at any time, and its modes change without them
            case commands.ProgramCommand():
                return Program(files=[], started=self._node.record.started)
            case commands.ExportStateCommand(timeout=timeout):
                own = self._peers.exporting(self._node.record.instance)
                return replies.ExportedState(state=None) if own is None else await own.exported(timeout)
            case commands.ImportStateCommand(state=state, timeout=timeout) if self._state is not None:
                await self._state.import_once(state, timeout, command.exporter)
            case commands.PrepareStateCommand(peer=peer):
                return await self._prepare_state(peer)
            case commands.OfferStateCommand():  # to a component, which would fetch it
                return replies.StateOffer(exports="nothing")
            case commands.YieldCommand(instance=instance):
                shared = None if self._node.requests is None else self._node.requests.share_requests(instance)
                return replies.Yielded(handled=[], place=shared)
            case commands.DiscoverCommand():
                return replies.Discovered(found=None)
            case _:
                raise CommandRefused(
                    f"{self._node.record.instance} does not use Midstride's API, and `{command.name}` needs it"
                )
        return replies.Done()

    async def _prepare_state(self, peer: str) -> replies.StateOffer:
        """Return what state moves here from ``peer``, beside it. Raises CommandRefused where it cannot be imported."""
        if self._state is None or self._peers.exporting(peer) is None:
            return replies.StateOffer(exports="nothing")
        if self._node.gates is None and self._lifecycle is None:
            words = f"{self._node.record.instance} has `gate {self._node.component.gate}`, so nothing holds it back"
            raise CommandRefused(f"{words} while state moves; `--strategy paper` moves it")
        await self._state.require_import()
        return replies.StateOffer(exports="whole")

    def _is_service(self, port: str) -> bool:
        return port in self._node.record.topics and self._node.component.is_service(port)

    def _of_service(self, command: Command[Any]) -> WireValue:
        """Carry out a command about a server or a client, which come and go with the process. Raises CommandRefused."""
        node = self._node
        match command:
            case commands.AttachCommand(port=port, topic=name):
                if command.gate == "closed" and node.requests is None:
                    kind = f"`gate {node.component.gate}`"
                    raise CommandRefused(
                        f"{node.record.instance} answers {name} at once ({kind}): nothing holds it back"
                    )
                node.set_links({port: command.gate})
                return replies.Attached(matched=0)
            case commands.DetachCommand(port=port):
                node.set_links({port: None})
                return replies.Detached(acknowledged=None, last=None)
            case commands.GateCommand(port=port):
                node.set_links({port: command.gate})
                return replies.Done()
        raise CommandRefused(
            f"{node.record.instance} has no messages to count on a service or ROS action (`{command.name}`)"
        )

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

    def _check(self, command: Command[Any]) -> None:
        """Raises CommandRefused where an attachment that it concerns cannot be made, or does not exist."""
        match command:
            case commands.AttachCommand():
                self._check_port(command.port, command.topic)
            case (
                commands.DetachCommand()
                | commands.GateCommand()
                | commands.AwaitMatchCommand()
                | commands.AwaitReadersCommand()
            ):
                self._node.require_attached(command.port, command.topic)
            case commands.FenceCommand():
                for port, topic in command.attachments:
                    self._node.require_attached(port, topic)

    def _check_port(self, port: str, topic: str) -> None:
        record = self._node.record
        if port not in record.topics:
            raise CommandRefused(f"there is no port {port}; the ports are: {', '.join(record.topics)}")
        if port in record.links:
            raise CommandRefused(f"{port} is already attached to {record.topics[port]}")
        if record.topics[port] != topic:
            words = f"{port} was started on topic {record.topics[port]}, and cannot be attached to {topic}"
            raise CommandRefused(f"{words}: the names of a node without Midstride's API are fixed at its start")

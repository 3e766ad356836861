"""The commands of wire/commands.py, carried out on a component. Control thread.

Every handler checks before it changes something, and undoes what it did where it fails half-way: a refused command has
changed nothing.
"""

from __future__ import annotations

import bisect
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

from midstride.codec.parameter import from_json, json_value
from midstride.errors import CommandRefused
from midstride.model.component import ROS_PARAMETERS, same_value
from midstride.node.author.declaration import DeclaredParts
from midstride.node.author.server_ports import ActionServerPort, ServerPort
from midstride.node.component_host import HeldParameter, Host
from midstride.node.control.attachments import Attachments
from midstride.node.control.component_end import ComponentEnd
from midstride.node.control.component_reflex import Reflex
from midstride.node.control.discovery import discover
from midstride.node.control.fence_commands import Fencing
from midstride.node.control.lease_commands import Leasing
from midstride.node.control.mode_commands import ModeCommands, Revision
from midstride.node.control.state_hooks import StateHooks
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.data.mode_switch import DataExecutor
from midstride.node.handover.handover_commands import HandoverCommands
from midstride.wire import commands, replies
from midstride.wire.command_server import CommandHandler
from midstride.wire.commands import Command
from midstride.wire.state import THIS_HOST, ComponentState, WireValue

T = TypeVar("T")


@dataclass
class CommandHandlers:
    """``degraded`` is called on either thread when a functionality degrades by itself, ``changed`` after a cut, and
    when a condition has changed.

    ``token`` returns the token for connections to peers.
    """

    parts: DeclaredParts
    host: Host
    revision: Revision
    degraded: Callable[[FunctionalityRunner], None]
    changed: Callable[[], None]
    token: Callable[[], str]
    # For how long its goals go on once a successor takes new ones (s).
    patience: float

    def __post_init__(self) -> None:
        self._runners: list[FunctionalityRunner] = []
        self._under_way = 0
        before = self.parts.callbacks.before_modes
        self.reflex = Reflex(self.host, self._runners, lambda: self._under_way > 0, self.degraded, self.changed, before)
        self._data = DataExecutor(self.host, self._busy_words)
        self._attachments = Attachments(self.parts, self.host, self._data)
        self._hooks = StateHooks(self.parts.callbacks, self._data)
        self._handovers = HandoverCommands(
            self._attachments, self.host, self._data, self.changed, self.token, self._hooks, self._runners
        )
        self._modes = ModeCommands(self.host, self._data, self._runners, self.revision, before)
        self.end = ComponentEnd(
            self.parts,
            self.host,
            self._runners,
            self._data,
            self._modes,
            self._attachments,
            self._handovers,
            self._parameters,
            self.patience,
        )
        self._fencing = Fencing(self._attachments, self.host, self._data, self._runners, self.changed)
        self._leasing = Leasing(self._attachments, self.host, self._data, self.changed)
        self._handlers: dict[type[Command[Any]], CommandHandler] = {
            commands.AttachCommand: self._attachments.attach,
            commands.DetachCommand: self._detach,
            commands.GateCommand: self._attachments.gate,
            commands.AwaitMatchCommand: self._attachments.await_match,
            commands.AwaitRateCommand: self._attachments.await_rate,
            commands.AwaitReadersCommand: self._attachments.await_readers,
            commands.CountWritesCommand: self._attachments.count_writes,
            commands.AwaitWriteCommand: self._attachments.await_write,
            commands.GridCommand: self._handovers.grid,
            commands.MeetCommand: self._handovers.meet,
            commands.MuteCommand: self._handovers.mute,
            commands.CutOutCommand: self._handovers.cut_out,
            commands.CutInCommand: self._handovers.cut_in,
            commands.CancelCutCommand: self._handovers.cancel_cut,
            commands.AwaitCutCommand: self._handovers.await_cut,
            commands.ResolveCutsCommand: self._handovers.resolve_cuts,
            commands.CutTakenCommand: self._handovers.taken,
            commands.CutClaimCommand: self._handovers.claim,
            commands.ConfirmCutCommand: self._handovers.confirm_cut,
            commands.DiscoverCommand: partial(discover, self.host),
            commands.AwaitIdleCommand: self._fencing.await_idle,
            commands.FenceCommand: self._fencing.fence,
            commands.KeepLeaseCommand: self._leasing.keep,
            commands.AnswerCommand: self._handovers.answer,
            commands.YieldCommand: self._handovers.answering.stop,
            commands.JoinRequestsCommand: self._handovers.answering.join,
            commands.MissingRequestsCommand: self._handovers.answering.missing,
            commands.ServeCommand: self._handovers.answering.serve,
            commands.CancelledGoalsCommand: self._handovers.answering.cancelled_goals,
            commands.KeepResultsCommand: self._handovers.answering.keep_results,
            commands.PrepareStateCommand: self._handovers.prepare_state,
            commands.OfferStateCommand: self._handovers.offer_state,
            commands.FetchStateCommand: self._handovers.fetch_state,
            commands.ImportingCommand: self._handovers.importing,
            commands.HoldCommand: self._modes.hold,
            commands.SetParametersCommand: self._set_parameters,
            commands.ExportStateCommand: self._export_state,
            commands.ImportStateCommand: self._import_state,
            commands.RecordCommand: self._record,
            commands.RecordsCommand: self._records,
        }

    async def carry_out(self, command: Command[Any], expected: int | None) -> WireValue:
        """Carry out one command. Raises CommandRefused, and then nothing has changed."""
        self._under_way += 1
        try:
            if isinstance(command, commands.ModesCommand):
                return await self._modes.switch(command, expected)
            return await self._handlers[type(command)](command)
        finally:
            self._under_way -= 1

    # -- start and end -----------------------------------------------------------------------------

    def set_up(self) -> None:
        """On the data thread, first of all: parameters and the author's set-up. If this raises, the start fails."""
        for parameter in self.parts.parameters.values():
            value = self.host.parameters.declare(parameter.name, parameter.value, parameter.change)
            # The platform has another one, of a launch file for example.
            if not same_value(parameter.fitted(value), parameter.value):
                parameter.begin_with(value)
        if self.parts.callbacks.setup is not None:
            self.parts.callbacks.setup(self.host.ros_node)

    def begin(self) -> None:
        """On the data thread: start every functionality in its last mode."""
        self._fencing.data_thread = threading.get_ident()
        for functionality in self.parts.functionalities.values():
            runner = FunctionalityRunner(functionality, self.host, self.degraded)
            functionality.start(runner.current_mode)
            for port in functionality.outputs:
                port.owner = runner
                if isinstance(port, ServerPort):
                    port.call = runner.answer
                if isinstance(port, ActionServerPort):
                    port.failed, port.entered = runner.request_failed, partial(getattr, runner, "entered")
            self._runners.append(runner)
        for runner in self._runners:
            runner.start_calls()

    async def release(self, timeout: float) -> None:
        """Go back to degraded and unattached. Raises CommandRefused where user code does not return in time."""
        modes = {runner.name: runner.chain[runner.last].name for runner in self._runners}
        because = "released: it no longer has a manager"
        await self._modes.switch(commands.ModesCommand(modes=modes, timeout=timeout, because=because), None)
        await self._attachments.close_all(timeout)
        self._handovers.give_back()
        self._handovers.disconnect()

    async def _detach(self, command: commands.DetachCommand) -> replies.Detached:
        detached = await self._attachments.detach(command)
        self._handovers.give_back()
        return detached

    # -- state -------------------------------------------------------------------------------------

    def state(
        self, instance: str, uuid: str, pid: int, waiting: str | None, imported: int, ending: bool
    ) -> ComponentState:
        """The component's state, read without waiting for the data thread."""
        # At one moment: the data thread may set one.
        parameters = [_Seen(each.name, each.value, each.declared) for each in self._parameters().values()]
        return ComponentState(
            instance=instance,
            uuid=uuid,
            pid=pid,
            revision=self.revision.value,
            functionalities={runner.name: runner.state() for runner in self._runners},
            ports={name: port.states() for name, port in self.parts.ports.items()},
            parameters={each.name: json_value(each.value) for each in parameters if _is_shown(each)},
            stopping=self.end.seconds(),
            waiting=waiting,
            simulated_time=self.host.simulated_time,
            node=self.host.node_name,
            answers=self.host.admission.is_open,
            imported=imported,
            clock_speed=self.host.clock_history.speed(self.host.steady()) if self.host.simulated_time else 1.0,
            declared={each.name: json_value(each.declared) for each in parameters if _is_shown(each) and each.is_set},
            keeps_state=self._hooks.exports(to_changes=False) != "nothing",
            unfinished=self.end.unfinished,
            goals=self.host.admission.goals.counts,
            host=THIS_HOST,
            ending=ending,
        )

    def _parameters(self) -> dict[str, HeldParameter]:
        """The parameters of the component, and those that are declared on the ROS node itself."""
        return {**self.host.parameters.held(), **self.parts.parameters}

    def _busy_words(self) -> str:
        busy = [(runner.name, seconds) for runner in self._runners if (seconds := runner.state().busy) is not None]
        return f" (busy: {', '.join(f'{name} for {seconds:.1f} s' for name, seconds in busy)})" if busy else ""

    # -- parameters and state ----------------------------------------------------------------------

    async def _set_parameters(self, command: commands.SetParametersCommand) -> replies.PreviousParameters:
        if self.parts.callbacks.set_parameters is not None:
            return await self.parts.callbacks.set_parameters(command)
        declared = self._parameters()
        for name in command.parameters:
            if name.startswith("midstride."):
                raise CommandRefused(f"{name} shows the state of the component and cannot be set")
            if name not in declared:
                raise CommandRefused(
                    f"there is no parameter {name}; the parameters are: {', '.join(declared) or 'none'}"
                )
        values = {name: from_json(value) for name, value in command.parameters.items()}
        started_with = values if command.declared is None else command.declared
        fitted = {
            name: declared[name].fitted(from_json(value)) for name, value in started_with.items() if name in declared
        }

        def set_all() -> replies.PreviousParameters:
            parameters = [declared[name] for name in command.parameters]
            before = {each.name: json_value(each.value) for each in parameters}
            set_before = {
                each.name: json_value(each.declared) for each in parameters if not same_value(each.value, each.declared)
            }
            self.host.parameters.set(values)
            for name, value in fitted.items():
                declared[name].declared = value
            return replies.PreviousParameters(before=before, declared=set_before)

        return await self._data.run(set_all, command.timeout)

    async def _export_state(self, command: commands.ExportStateCommand) -> replies.ExportedState:
        return await self._hooks.exported(command.timeout)

    async def _import_state(self, command: commands.ImportStateCommand) -> replies.Done:
        await self._hooks.import_(command.state, command.timeout, exporter=command.exporter)
        return replies.Done()

    async def _record(self, command: commands.RecordCommand) -> replies.RecordingSwitched:
        ports = [self._attachments.input(name) for name in command.inputs]

        def switch() -> None:
            for port in ports:
                port.record(command.on)

        await self._data.run(switch, command.timeout)
        return replies.RecordingSwitched(now=self.host.steady())

    async def _records(self, command: commands.RecordsCommand) -> replies.Records:
        port = self._attachments.input(command.input)
        receipts = await self._data.run(lambda: list(port.receipts), command.timeout)
        rows = []
        for received, native in receipts:
            info = self.host.read_info(native)
            rows.append(replies.Receipt(received, info.source, info.number, info.distinct_writer))
        identity = bool(rows) and all(row.publisher is not None for row in rows)
        moments = None
        if self.host.simulated_time:
            known = self.host.clock_history.moments()
            begin = bisect.bisect_left([steady for steady, _ in known], rows[0].received if rows else 0)
            moments = known[max(0, begin - 1) :]
        return replies.Records(
            rows=rows,
            publisher_identity=identity,
            now=self.host.steady(),
            moments=moments,
            ros_sources=self.host.publishes_ros_time,
        )


class _Seen(NamedTuple):
    """A parameter at one moment. ``value`` is None where it has none that can be written as JSON."""

    name: str
    value: Any
    declared: Any

    @property
    def is_set(self) -> bool:
        return not same_value(self.value, self.declared)


def _is_shown(parameter: _Seen) -> bool:
    """Return whether a parameter is in the component's state.

    Of those that every node has, only what was set at run time is.
    """
    if parameter.value is None:
        return False
    return parameter.name not in ROS_PARAMETERS or parameter.is_set

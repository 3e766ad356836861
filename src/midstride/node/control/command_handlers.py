"""The commands of wire/commands.py, carried out on a component. Control thread.

Every handler checks before it changes something, and undoes what it did where it fails half-way: a refused command has
changed nothing.
"""

from __future__ import annotations

import asyncio
import bisect
import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

from midstride.codec.parameter import from_json, json_value
from midstride.errors import BackendError, CommandRefused
from midstride.model.component import CANCELLING, ROS_PARAMETERS, same_value
from midstride.model.wording import LOST_AT_END
from midstride.node.author.declaration import DeclaredParts
from midstride.node.author.server_ports import ActionServerPort, ServerPort
from midstride.node.component_host import HeldParameter, Host
from midstride.node.control.attachments import Attachments
from midstride.node.control.component_reflex import Reflex
from midstride.node.control.discovery import discover
from midstride.node.control.fence_commands import Fencing
from midstride.node.control.state_hooks import StateHooks
from midstride.node.data.functionality_runner import CAUGHT, FunctionalityRunner, format_error
from midstride.node.data.mode_switch import DataExecutor, Hold, ModeSwitch, within
from midstride.node.handover.handover_commands import HandoverCommands
from midstride.node.legible import legible
from midstride.wire import commands, replies
from midstride.wire.command_server import CommandHandler
from midstride.wire.commands import Command
from midstride.wire.state import THIS_HOST, ComponentState, WireValue

T = TypeVar("T")

# How long ending takes besides the author's `on_stop` (s): destroying endpoints and leaving the platform.
SHUTDOWN_SECONDS: Final = 1.0
# How long a request to a service that is being handled may take, once its instance is to end (s). For so long, at most,
# it also stays for clients that have not discovered its successor.
REQUESTS_SECONDS: Final = 10.0
# Such a client is waited for where a request has been answered within so long (s): one that calls once a second may be
# one. The middleware does not say whom a client has discovered; ROS's own finds a new server within 3 s.
CALLED_WITHIN: Final = 1.5
# How long a server stays in ROS after its last response (s): a client whose middleware learns that the server has left
# before it has read the response drops it, and the middleware does not say when a response has arrived.
RESPONSE_SECONDS: Final = 0.5


class Revision:
    """Counts the changes of a component. Both threads count up, so it has a lock; reading needs none.

    ``failure``: the last change that user code made by raising, as its number and in words.
    """

    def __init__(self) -> None:
        self.value = 0
        self.failure = (0, "")
        self._lock = threading.Lock()

    def bump(self, failure: str = "") -> None:
        with self._lock:
            if failure:
                self.failure = (self.value + 1, failure)
            self.value += 1


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
        self._hold: Hold | None = None
        # In which way the author's `on_stop` has failed, and what it has left of its goals.
        self.unfinished: str | None = None
        self._expiry: asyncio.Task[None] | None = None  # of the hold
        before = self.parts.callbacks.before_modes
        self.reflex = Reflex(self.host, self._runners, lambda: self._under_way > 0, self.degraded, self.changed, before)
        self._data = DataExecutor(self.host, self._busy_words)
        self._attachments = Attachments(self.parts, self.host, self._data)
        self._hooks = StateHooks(self.parts.callbacks, self._data)
        self._handovers = HandoverCommands(
            self._attachments, self.host, self._data, self.changed, self.token, self._hooks, self._runners
        )
        self._fencing = Fencing(self._attachments, self.host, self._data, self._runners, self.changed)
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
            commands.DiscoverCommand: partial(discover, self.host),
            commands.AwaitIdleCommand: self._fencing.await_idle,
            commands.FenceCommand: self._fencing.fence,
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
            commands.HoldCommand: self._hold_calls,
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
                return await self._modes(command, expected)
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
        await self._modes(commands.ModesCommand(modes=modes, timeout=timeout, because=because), None)
        await self._attachments.close_all(timeout)
        self._handovers.give_back()
        self._handovers.disconnect()

    async def end(self) -> None:
        """Finish requests, stop calls, run the author's `on_stop`, destroy endpoints; each in bounded time."""
        deadline = self.host.steady() + int(REQUESTS_SECONDS * 1e9)
        await self._finish_requests(deadline)
        await self._finish_goals()
        self._handovers.close_cuts()
        self._take_hold()  # no call is begun any more
        timeout = self.parts.callbacks.stop_timeout
        try:
            await self._data.run(self._stop_calls, timeout)
            await self._idle(timeout)
        except CommandRefused as error:
            self.host.logger.error(f"{self.host.instance} ends, but {error}")
        if self.parts.callbacks.stop is not None:
            try:
                if not await self._data.drive(self.parts.callbacks.stop, timeout):
                    self._left_unfinished(f"on_stop did not return within {timeout:.3g} s: {LOST_AT_END}")
            except CAUGHT as error:
                words = legible(f"on_stop raised {type(error).__name__}: {error}").partition("\n")[0]
                self._left_unfinished(f"{words}: {LOST_AT_END}")
                self.host.logger.error(f"on_stop raised: {format_error(error)}")
        with contextlib.suppress(CommandRefused, BackendError):
            await self._attachments.close_all(0.5)
        deadline = max(deadline, self.host.steady() + int(RESPONSE_SECONDS * 1e9))
        while self.host.admission.answered_within(RESPONSE_SECONDS) and self.host.steady() < deadline:
            await self.host.sleep(0.01)
        self._handovers.close()

    async def _finish_requests(self, deadline: int) -> None:
        """Answer the requests to services that are being handled, and begin with no other. ``deadline``: steady ns.

        What only this instance has received of those held now, its successor handles first. A client that has called
        lately may not have discovered that successor: without this instance, which passes its requests on, its next one
        would reach no server.
        """
        admission, answering = self.host.admission, self._handovers.answering
        admission.pause()
        held = set(answering.undecided())
        while admission.busy or held.intersection(answering.undecided()) or self._may_pass_on:
            if self.host.steady() >= deadline:
                if admission.busy:
                    words = f"a request to a service of it was not answered within {REQUESTS_SECONDS:g} s"
                elif held.intersection(answering.undecided()):
                    words = f"after {REQUESTS_SECONDS:g} s, its successor has not said which of the requests held here "
                    words += "it has received"
                else:
                    words = f"after {REQUESTS_SECONDS:g} s, a client still sends its requests to it alone"
                self.host.logger.error(f"{self.host.instance} ends, but {words}")
                return
            await self.host.sleep(0.01)

    @property
    def _may_pass_on(self) -> bool:
        """True where another instance answers instead, and a client that called lately may not have discovered it."""
        return self._handovers.answering.may_pass_on and self.host.admission.answered_within(CALLED_WITHIN)

    async def _finish_goals(self) -> None:
        """Where a successor takes new goals, go on with its own until they have ended; then leave their results to it.

        What has not ended after the patience is cancelled.
        """
        goals, answering = self.host.admission.goals, self._handovers.answering
        if not answering.has_successor:
            return
        patience, begun = self.patience, self.host.steady()
        if not await self._goals_end(patience):
            seconds = (self.host.steady() - begun) / 1e9
            words = f"{_goals(goals.in_progress)} had not ended after {seconds:.0f} s (`patience`)"
            goals.cancel()
            if not await self._goals_end(CANCELLING):
                words += f", and {_goals(goals.in_progress)} {CANCELLING:g} s after cancelling was asked for"
            else:
                words += ", and cancelling was asked for"
            self._left_unfinished(words)
        if (lost := await answering.hand_over_results()) is not None:
            self._left_unfinished(lost)
        if goals.counts is not None:
            await self.host.sleep(RESPONSE_SECONDS)

    async def _goals_end(self, seconds: float) -> bool:
        """Wait until no goal is in progress, for ``seconds`` at most; whether that is so."""
        deadline = self.host.steady() + int(seconds * 1e9)
        while in_progress := self.host.admission.goals.in_progress:
            if self.host.steady() >= deadline:
                return False
            await self.host.sleep(0.01)
        return not in_progress

    def _left_unfinished(self, words: str) -> None:
        self.host.logger.error(f"{self.host.instance} ends, but {words}")
        self.unfinished = words if self.unfinished is None else f"{self.unfinished}; {words}"

    @property
    def _goes_on_with_goals(self) -> bool:
        return self.host.admission.goals.has_any and self._handovers.answering.has_successor

    def _stop_calls(self) -> None:
        for parameter in self._parameters().values():
            parameter.closed = "the component is ending"
        for runner in self._runners:
            runner.stop_calls()

    async def _idle(self, timeout: float) -> None:
        """Wait until no async call runs. Raises CommandRefused after ``timeout``."""
        deadline = self.host.steady() + int(timeout * 1e9)
        while any(runner.asynchronous for runner in self._runners):
            if self.host.steady() >= deadline:
                raise CommandRefused(f"user code did not return within {timeout:.3g} s{self._busy_words()}")
            await self.host.sleep(0.01)

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
            stopping=self._stopping_seconds(),
            waiting=waiting,
            simulated_time=self.host.simulated_time,
            node=self.host.node_name,
            answers=self.host.admission.is_open,
            imported=imported,
            clock_speed=self.host.clock_history.speed(self.host.steady()) if self.host.simulated_time else 1.0,
            declared={each.name: json_value(each.declared) for each in parameters if _is_shown(each) and each.is_set},
            keeps_state=self._hooks.exports(to_changes=False) != "nothing",
            unfinished=self.unfinished,
            goals=self.host.admission.goals.counts,
            host=THIS_HOST,
            ending=ending,
        )

    def _stopping_seconds(self) -> float:
        """How long :meth:`end` takes where user code keeps to its times.

        That of a request that is being handled, or may have to be passed on, of the call under way, and of `on_stop`.
        """
        callbacks = self.parts.callbacks
        waits = self.host.admission.busy or self._may_pass_on or self._handovers.answering.undecided()
        requests = REQUESTS_SECONDS if waits else 0.0
        requests += self.patience + 2 * CANCELLING + RESPONSE_SECONDS if self._goes_on_with_goals else 0.0
        requests += RESPONSE_SECONDS if requests or self.host.admission.answered_within(RESPONSE_SECONDS) else 0.0
        return requests + callbacks.stop_timeout * (1 if callbacks.stop is None else 2) + SHUTDOWN_SECONDS

    def _parameters(self) -> dict[str, HeldParameter]:
        """The parameters of the component, and those that are declared on the ROS node itself."""
        return {**self.host.parameters.held(), **self.parts.parameters}

    def _busy_words(self) -> str:
        busy = [(runner.name, seconds) for runner in self._runners if (seconds := runner.state().busy) is not None]
        return f" (busy: {', '.join(f'{name} for {seconds:.1f} s' for name, seconds in busy)})" if busy else ""

    # -- modes -------------------------------------------------------------------------------------

    async def _modes(self, command: commands.ModesCommand, expected: int | None) -> replies.PreviousModes:
        indices = {name: self._mode_index(name, mode) for name, mode in command.modes.items()}
        before = self.parts.callbacks.before_modes
        if before is None:
            return await self._switch_modes(command, indices, expected)
        current = {runner.name: runner.current_mode() for runner in self._runners if runner.name in indices}
        await before(command.modes)
        try:
            return await self._switch_modes(command, indices, expected)
        except CommandRefused:
            with contextlib.suppress(CommandRefused):
                await before(current)
            raise

    async def _switch_modes(
        self, command: commands.ModesCommand, indices: Mapping[str, int], expected: int | None
    ) -> replies.PreviousModes:
        targets = {runner: indices[runner.name] for runner in self._runners if runner.name in indices}
        ended = asyncio.Event()
        on_ended = partial(asyncio.get_running_loop().call_soon_threadsafe, ended.set)

        def guard() -> str | None:
            if expected is not None and expected != self.revision.value:
                return "a functionality has degraded by itself meanwhile: observe the component again, then retry"
            return None

        switch = ModeSwitch(targets, command.because, guard, on_ended, hold=self._take_hold())
        attempt = asyncio.ensure_future(self.host.on_data(switch.attempt))
        attempt.add_done_callback(self._log_failure)
        if await within(self.host, ended.wait(), command.timeout) is None and switch.decision.make():
            self.host.on_data(switch.release)
            raise CommandRefused(
                f"the change of {', '.join(indices)} was withdrawn: "
                f"user code did not return within {command.timeout:.3g} s{self._busy_words()}"
            )
        await ended.wait()
        if switch.refused is not None:
            raise CommandRefused(switch.refused)
        return replies.PreviousModes(before=switch.before, at=None if switch.hold is None else switch.at)

    async def _hold_calls(self, command: commands.HoldCommand) -> replies.Done:
        names = {runner.name: runner for runner in self._runners}
        if unknown := [name for name in command.functionalities if name not in names]:
            raise CommandRefused(f"there is no functionality {unknown[0]}; the functionalities are: {', '.join(names)}")
        if (earlier := self._take_hold()) is not None:
            self.host.on_data(earlier.release)
        if not command.seconds:
            return replies.Done()
        held = asyncio.Event()
        on_held = partial(asyncio.get_running_loop().call_soon_threadsafe, held.set)
        hold = Hold([names[name] for name in command.functionalities], on_held)
        self.host.on_data(hold.attempt)
        if await within(self.host, held.wait(), command.timeout) is None:
            self.host.on_data(hold.release)
            raise CommandRefused(f"user code did not return within {command.timeout:.3g} s{self._busy_words()}")
        self._hold = hold
        self._expiry = asyncio.ensure_future(self._expire(command.seconds))
        return replies.Done()

    async def _expire(self, seconds: float) -> None:
        """Whoever asked for the hold may be gone."""
        await self.host.sleep(seconds)
        self._expiry = None
        if (hold := self._take_hold()) is not None:
            self.host.on_data(hold.release)

    def _take_hold(self) -> Hold | None:
        """The hold in force, if any, which the caller ends."""
        hold, self._hold = self._hold, None
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None
        return hold

    def _log_failure(self, work: asyncio.Future[Any]) -> None:
        if not work.cancelled() and (error := work.exception()) is not None:
            self.host.logger.error(f"changing modes failed: {type(error).__name__}: {error}")

    def _mode_index(self, functionality: str, mode: object) -> int:
        runner = next((runner for runner in self._runners if runner.name == functionality), None)
        if runner is None:
            listed = ", ".join(runner.name for runner in self._runners)
            raise CommandRefused(f"there is no functionality {functionality}; the functionalities are: {listed}")
        names = [declared.name for declared in runner.chain]
        if mode not in names:
            raise CommandRefused(f"{functionality} has no mode {mode!r}; its modes are: {', '.join(names)}")
        return names.index(str(mode))

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
            rows.append(replies.Receipt(received, info.source, info.number, info.publisher))
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


def _goals(number: int) -> str:
    return f"{number} goal{'s' * (number != 1)}"


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

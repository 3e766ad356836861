"""What each command of wire/commands.py does to a component. Control side.

Every handler checks before it changes; where one fails half-way it puts back what it did, so that
a refused command has changed nothing.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import contextlib
from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, TypeVar

from midstride.errors import BackendError, CommandRefused
from midstride.node.arguments import Arguments
from midstride.node.attachments import Attachments
from midstride.node.functionality_runner import CAUGHT, FunctionalityRunner, told_by
from midstride.node.handover_commands import HandoverCommands
from midstride.node.host import Host
from midstride.node.mode_switch import DataExecutor, ModeSwitch, within

if TYPE_CHECKING:
    from midstride.node.agent import Revision
    from midstride.node.component import Component

T = TypeVar("T")
Handler = Callable[[Arguments], Awaitable[dict[str, Any]]]

# How long user code may take over what is no mode change, where the command does not say (s).
PATIENCE: Final = 2.0
# How long the end takes beside the author's own part in it (s): its endpoints and the platform are left in order.
LEAVING: Final = 1.0


class CommandHandlers:
    """``degraded`` is called on the data side when a functionality degrades by itself."""

    def __init__(
        self,
        component: Component,
        host: Host,
        revision: Revision,
        degraded: Callable[[FunctionalityRunner], None],
        changed: Callable[[], None],
    ) -> None:
        self._component = component
        self._host = host
        self._revision = revision
        self._degraded = degraded
        self._runners: list[FunctionalityRunner] = []
        self._data = DataExecutor(host, self._busy_words)
        self._attachments = Attachments(component.inputs, component.outputs, host, self._data)
        self._handovers = HandoverCommands(self._attachments, host, self._data, changed)
        self._handlers: dict[str, Handler] = {
            "attach": self._attachments.attach,
            "detach": self._attachments.detach,
            "gate": self._attachments.gate,
            "await_write": self._attachments.await_write,
            "grid": self._handovers.grid,
            "meet": self._handovers.meet,
            "cut_out": self._handovers.cut_out,
            "cut_in": self._handovers.cut_in,
            "cancel_cut": self._handovers.cancel_cut,
            "await_cut": self._handovers.await_cut,
            "taken": self._handovers.taken,
            "set": self._set,
            "export_state": self._export_state,
            "import_state": self._import_state,
            "record": self._record,
            "records": self._records,
            "ping": self._ping,
        }

    async def carry_out(self, op: str, values: Mapping[str, Any], expected: int | None) -> dict[str, Any]:
        """Carry out one command. Raises CommandRefused, and then nothing has changed."""
        arguments = Arguments(op, values)
        if op == "modes":
            return await self._modes(arguments, expected)
        return await self._handlers[op](arguments)

    def belongs_to(self, token: str) -> None:
        """The system's token, by which peers know each other."""
        self._handovers.token = token

    # -- beginning and end -------------------------------------------------------------------------

    def set_up(self) -> None:
        """Data side, first of all: parameters and whatever else the author wants. What it raises ends the start."""
        for parameter in self._component.parameters.values():
            value = self._host.parameter(parameter.name, parameter.value, parameter.change)
            parameter.begin_with(value)
        if self._component.hooks.setup is not None:
            self._component.hooks.setup(self._host.ros_node)

    def begin(self) -> None:
        """Data side: every functionality into its last mode."""
        for functionality in self._component.functionalities.values():
            runner = FunctionalityRunner(functionality, self._host, self._degraded)
            functionality.runner = runner
            for port in functionality.outputs:
                port.owner = runner
            self._runners.append(runner)
        for runner in self._runners:
            runner.begin()

    async def release(self, arguments: Arguments) -> None:
        """Degraded and unattached, as at first. Raises CommandRefused where user code does not return in time."""
        modes = {runner.name: runner.chain[runner.last].name for runner in self._runners}
        timeout = arguments.seconds("timeout", PATIENCE)
        because = "released: nobody manages it any more"
        await self._modes(Arguments("release", {"modes": modes, "timeout": timeout, "because": because}), None)
        await self._attachments.close_all(timeout)

    async def end(self) -> None:
        """No call any more, the author's last word, then the endpoints; each in bounded time, whatever fails."""
        self._handovers.close()
        timeout = self._component.hooks.stop_timeout
        try:
            await self._data.run(self._leave_all, timeout)
            await self._idle(timeout)
        except CommandRefused as error:
            self._host.logger.error(f"{self._host.instance} ends although {error}")
        if self._component.hooks.stop is not None:
            try:
                if not await self._data.drive(self._component.hooks.stop, timeout):
                    self._host.logger.error(f"on_stop did not return within {timeout:g} s")
            except CAUGHT as error:
                self._host.logger.error(f"on_stop raised: {told_by(error)}")
        with contextlib.suppress(CommandRefused, BackendError):
            await self._attachments.close_all(0.5)

    def _leave_all(self) -> None:
        for runner in self._runners:
            runner.leave()

    async def _idle(self, timeout: float) -> None:
        """Until no async call runs. Raises CommandRefused after ``timeout``."""
        deadline = self._host.steady() + int(timeout * 1e9)
        while any(runner.asynchronous for runner in self._runners):
            if self._host.steady() >= deadline:
                raise CommandRefused(f"user code did not return within {timeout:g} s{self._busy_words()}")
            await self._host.sleep(0.01)

    # -- state -------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """The part of State that is the data side's doing, read without waiting for it."""
        now = self._host.steady()
        functionalities = {}
        for runner in self._runners:
            busy = runner.busy
            functionalities[runner.name] = {
                "mode": runner.mode.name,
                "since": (now - runner.since) / 1e9,
                "because": runner.because,
                "busy": None if busy is None else (now - busy) / 1e9,
            }
        ports: dict[str, dict[str, Any]] = {}
        for output in self._component.outputs.values():
            ports[output.name] = {
                link.topic: {"gate": link.gate, "count": link.count, "gated": link.gated} for link in output.links
            }
        for port in self._component.inputs.values():
            ports[port.name] = {link.topic: {"gate": None, "count": link.count, "gated": 0} for link in port.links}
        parameters = {parameter.name: parameter.value for parameter in self._component.parameters.values()}
        stopping = self._component.hooks.stop_timeout + LEAVING
        return {"functionalities": functionalities, "ports": ports, "parameters": parameters, "stopping": stopping}

    def _busy_words(self) -> str:
        now = self._host.steady()
        since = [(runner.name, busy) for runner in self._runners if (busy := runner.busy) is not None]
        told = ", ".join(f"{name} for {(now - busy) / 1e9:.1f} s" for name, busy in since)
        return f" (busy: {told})" if told else ""

    # -- modes -------------------------------------------------------------------------------------

    async def _modes(self, arguments: Arguments, expected: int | None) -> dict[str, Any]:
        timeout = arguments.seconds("timeout", PATIENCE)
        targets = {name: self._mode_index(name, mode) for name, mode in arguments.table("modes").items()}
        loop, settled = asyncio.get_running_loop(), asyncio.Event()
        because = arguments.text_or("because", "the manager asked for it")

        def guard() -> str | None:
            if expected is not None and expected != self._revision.value:
                return "a functionality has degraded by itself meanwhile: look at the component's state again"
            return None

        def tell() -> None:
            loop.call_soon_threadsafe(settled.set)

        switch = ModeSwitch(targets, self._runners, because, guard, tell)
        attempt = asyncio.ensure_future(self._host.on_data(switch.attempt))
        attempt.add_done_callback(self._log_failure)
        if await within(self._host, settled.wait(), timeout) is None and switch.claim():
            self._host.on_data(switch.release)
            raise CommandRefused(
                f"the change of {', '.join(targets)} was taken back: "
                f"user code did not return within {timeout:g} s{self._busy_words()}"
            )
        await settled.wait()
        if switch.refused is not None:
            raise CommandRefused(switch.refused)
        return {"from": switch.before}

    def _log_failure(self, work: asyncio.Future[Any]) -> None:
        if not work.cancelled() and (error := work.exception()) is not None:
            self._host.logger.error(f"changing modes failed: {type(error).__name__}: {error}")

    def _mode_index(self, functionality: str, mode: object) -> int:
        runner = next((runner for runner in self._runners if runner.name == functionality), None)
        if runner is None:
            listed = ", ".join(runner.name for runner in self._runners)
            raise CommandRefused(f"there is no functionality {functionality}; there are: {listed}")
        names = [declared.name for declared in runner.chain]
        if mode not in names:
            raise CommandRefused(f"{functionality} has no mode {mode!r}; its modes are: {', '.join(names)}")
        return names.index(str(mode))

    # -- parameters and state ----------------------------------------------------------------------

    async def _set(self, arguments: Arguments) -> dict[str, Any]:
        values = arguments.table("parameters")
        declared = self._component.parameters
        for name in values:
            if name not in declared:
                raise CommandRefused(f"there is no parameter {name}; there are: {', '.join(declared) or 'none'}")
        before = {name: declared[name].value for name in values}
        await self._data.run(lambda: self._host.set_parameters(values), arguments.seconds("timeout", PATIENCE))
        return {"from": before}

    async def _export_state(self, arguments: Arguments) -> dict[str, Any]:
        export = self._component.hooks.export_state
        if export is None:
            return {"state": None}
        state = await self._users(export, "on_export_state", arguments)
        if not isinstance(state, (bytes, bytearray)):
            raise CommandRefused(f"on_export_state returned {type(state).__name__}, not bytes")
        return {"state": base64.b64encode(state).decode("ascii")}

    async def _import_state(self, arguments: Arguments) -> dict[str, Any]:
        take_up = self._component.hooks.import_state
        if take_up is None:
            raise CommandRefused("the component takes no state: it has no on_import_state")
        try:
            state = base64.b64decode(arguments.text("state"), validate=True)
        except binascii.Error as error:
            raise CommandRefused(f"import_state: not base64 ({error})") from None
        await self._users(lambda: take_up(state), "on_import_state", arguments)
        return {}

    async def _users(self, function: Callable[[], T], what: str, arguments: Arguments) -> T:
        """Run a function of the author's. Raises CommandRefused with what it raised."""

        def guarded() -> T:
            try:
                return function()
            except CAUGHT as error:
                raise CommandRefused(f"{what} raised: {told_by(error)}") from None

        return await self._data.run(guarded, arguments.seconds("timeout", PATIENCE))

    # -- measuring ---------------------------------------------------------------------------------

    async def _record(self, arguments: Arguments) -> dict[str, Any]:
        ports = [self._attachments.input(name) for name in arguments.words("inputs")]
        on = arguments.flag("on")

        def turn() -> None:
            for port in ports:
                port.record(on)

        await self._data.run(turn, arguments.seconds("timeout", PATIENCE))
        return {"now": self._host.steady()}

    async def _records(self, arguments: Arguments) -> dict[str, Any]:
        port = self._attachments.input(arguments.text("input"))
        receipts = await self._data.run(lambda: list(port.receipts), arguments.seconds("timeout", PATIENCE))
        rows = []
        for received, native in receipts:
            info = self._host.read_info(native)
            rows.append([received, info.source, info.number, info.publisher])
        identity = bool(rows) and all(row[3] is not None for row in rows)
        return {"rows": rows, "publisher_identity": identity, "now": self._host.steady()}

    async def _ping(self, arguments: Arguments) -> dict[str, Any]:
        return {}

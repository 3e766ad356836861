"""The agent: a component's control thread. It carries out commands and reports the component's state.

Here are the rules that apply to every request: token, revision, repetition (docs/semantics.md section 7). What each
command does is in :mod:`.command_handlers`. The agent never runs user code: it has the data thread run it, and waits
for a bounded time.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import itertools
import uuid
from collections import OrderedDict
from collections.abc import Coroutine
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CommandRefused, MidstrideError
from midstride.model.component import DEFAULT_STOP, ComponentSpec
from midstride.node.author.declaration import DeclaredParts
from midstride.node.clock_history import STILL
from midstride.node.component_host import Host
from midstride.node.control.command_handlers import CommandHandlers
from midstride.node.control.mode_commands import Revision
from midstride.node.data.functionality_runner import CAUGHT, FunctionalityRunner, format_error
from midstride.node.diagnostic_status import diagnostics
from midstride.node.legible import legible
from midstride.node.loaded_program import ProgramFiles
from midstride.node.standalone import FLAG, StandaloneTopics, best_modes
from midstride.wire import commands, frames, replies
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import Command
from midstride.wire.frames import Reply, Request
from midstride.wire.state import NOT_WELCOMED, ComponentState, WireValue

# How often the state is reported while nothing changes (s): it shows that the component is alive, and what is busy.
HEARTBEAT: Final = 0.5
# Diagnostics are published with every so many of these reports: once a second, as ROS's tools expect.
DIAGNOSTICS_BEATS: Final = 2
# How many replies are kept for repeated requests.
REMEMBERED: Final = 1000
# How long requests under way may take to be answered when the component ends (s).
CLOSE_TIMEOUT: Final = 1.0
_FOREIGN_TOKEN: Final = "the token is not that of the system that the component belongs to"


@dataclass
class Agent:
    """``start_token`` is the one that the process was started with, empty where it was started by hand.

    ``diagnostics``: whether it publishes on ``/diagnostics``. ``patience``: for how long its goals go on once a
    successor takes new ones (s).
    """

    parts: DeclaredParts
    declaration: ComponentSpec
    host: Host
    start_token: str
    pid: int
    standalone: StandaloneTopics | None
    program: ProgramFiles
    diagnostics: bool = True
    patience: float = DEFAULT_STOP.patience

    def __post_init__(self) -> None:
        self._token = self.start_token
        self._uuid = uuid.uuid4().hex
        self._revision = Revision()
        self._replies: OrderedDict[str, asyncio.Task[Reply]] = OrderedDict()
        self._change_lock = asyncio.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = asyncio.Event()
        self._stopping = asyncio.Event()
        name, token = self.host.instance, self.start_token
        greeting = frames.Greeting(
            protocol=frames.PROTOCOL, instance=name, uuid=self._uuid, pid=self.pid, start_token=token
        )
        self._server = CommandServer(greeting, self.serve)
        self._handlers = CommandHandlers(
            self.parts, self.host, self._revision, self._degraded, self.report_state, lambda: self._token, self.patience
        )

    async def main(self) -> None:
        """Run from set-up to the end. Cancelled by a signal, it ends in order as well."""
        self._loop = asyncio.get_running_loop()
        for parameter in self.parts.parameters.values():
            parameter.changed = self._parameter_changed
        handlers, host = self._handlers, self.host
        if host.transport is not None and self.standalone is None:
            await self._server.open(host.transport)
        tasks = [self._in_background(self._heartbeat(), "the reports of its state have")]
        try:
            await host.on_data(handlers.set_up)
            host.parameters.on_changed(self._parameter_changed)
            try:
                await host.on_data(handlers.begin)
                if self.standalone is not None:
                    await self._run_alone(self.standalone)
                else:  # without a manager, nothing would restore what has degraded
                    tasks.append(self._in_background(handlers.reflex.run(), "the watch over its inputs has"))
                self._register()
                await self._stopping.wait()
            except asyncio.CancelledError:
                pass  # SIGTERM, SIGINT
            self._stopping.set()
            self._report_end()  # a manager that has not asked for it should know
            await handlers.end.run()
            if handlers.end.unfinished is not None or self.host.admission.goals.counts is not None:
                self._report_end()  # for the report of the change
        finally:
            for task in tasks:
                task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                # Requests that wait for a set-up that has failed are never answered.
                await self._server.close(CLOSE_TIMEOUT if self._ready.is_set() else 0.0)

    def _in_background(self, work: Coroutine[Any, Any, None], what: str) -> asyncio.Task[None]:
        """A task that lasts as long as the component, which ends if it fails: it would only seem to be well."""

        def ended(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (error := task.exception()) is not None:
                self.host.logger.error(f"{self.host.instance} ends, since {what} failed: {format_error(error)}")
                self._stopping.set()

        task = asyncio.get_running_loop().create_task(work)
        task.add_done_callback(ended)
        return task

    def stop(self) -> None:
        """End in order, on any thread. Does nothing if it ends already."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._stopping.set)

    def _register(self) -> None:
        """Report what the component declares to every manager that connects."""
        self._ready.set()
        self.report_state()
        declaration = NamedComponentForm.of(self.declaration)
        self._server.register(frames.Registration(declaration=declaration, endpoints=self.host.extra_endpoints()))
        if not self.start_token and self.standalone is None:
            self.host.logger.info(
                f"{self.host.instance} waits for a manager, degraded and unattached ({self.host.reachable}); "
                f"to run it without a manager: {self._standalone_example()}"
            )

    def _standalone_example(self) -> str:
        return " ".join([FLAG, *(f"{port}:=/{port}" for port in self.declaration.ports())])

    async def _heartbeat(self) -> None:
        for beat in itertools.count(1):
            await self.host.sleep(HEARTBEAT)
            if self._ready.is_set():
                state = self._report()
                # Of several instances of a role, one answers, and shows the diagnostics of the role's node.
                if self.diagnostics and state.answers and beat % DIAGNOSTICS_BEATS == 0:
                    self._publish_diagnostics(state)

    def _publish_diagnostics(self, state: ComponentState) -> None:
        try:
            self.host.publish_diagnostics(partial(diagnostics, state, self.declaration))
        except Exception as error:  # the platform's: reports to the manager continue without them
            self.diagnostics = False
            self.host.logger.error(f"nothing is published on /diagnostics any more: {type(error).__name__}: {error}")

    async def _run_alone(self, attachments: StandaloneTopics) -> None:
        for port, topics in attachments.items():
            for topic in topics:
                await self._handlers.carry_out(commands.AttachCommand(port=port, topic=topic), None)
        modes = best_modes(self.declaration, attachments)
        because = "started standalone: the best mode for what is attached"
        await self._handlers.carry_out(commands.ModesCommand(modes=modes, because=because), None)
        listed = ", ".join(f"{name} in mode {mode}" for name, mode in modes.items())
        self.host.logger.warning(f"{self.host.instance} runs without a manager: {listed}")
        if self.declaration.ports() and not attachments:
            self.host.logger.warning(
                f"{self.host.instance} is attached to no topic: it neither publishes nor receives anything. "
                f"Name the topics of its ports: {self._standalone_example()}"
            )

    async def serve(self, request: Request, token: str) -> Reply:
        """Carry out one request; an invalid one is refused with the reason."""
        try:
            command = frames.decode_command(request)
            self._check_sender(command, token)
        except CommandRefused as error:
            return self._refusal(request, str(error))
        if not isinstance(command, commands.PingCommand):  # answered before set-up has ended
            await self._ready.wait()
        if command.kind == "changing":
            return await self._change_once(request, command, token)
        return await self._carry_out(request, command, token)

    def _check_sender(self, command: Command[Any], token: str) -> None:
        """Raises CommandRefused for a client of another system."""
        if not self._token and isinstance(command, (commands.WelcomeCommand, commands.ObserveCommand)):
            return  # it belongs to no system yet: any of this user's managers may take it
        if not self._is_ours(token):
            raise CommandRefused(_FOREIGN_TOKEN)

    def _is_ours(self, token: str) -> bool:
        return bool(self._token) and hmac.compare_digest(token.encode(), self._token.encode())

    async def _change_once(self, request: Request, command: Command[Any], token: str) -> Reply:
        """Carry out a changing command once; a repeated request gets the first reply."""
        if not request.id:
            return self._refusal(request, f"`{command.name}` changes the component, so its request must have an id")
        answer = self._replies.get(request.id)
        if answer is None:
            # In a separate task: if the client disconnects, the command must not end half-way.
            answer = asyncio.get_running_loop().create_task(self._change(request, command, token))
            self._replies[request.id] = answer
            while len(self._replies) > REMEMBERED:
                self._replies.popitem(last=False)
        return await asyncio.shield(answer)

    async def _change(self, request: Request, command: Command[Any], token: str) -> Reply:
        async with self._change_lock:
            if self._stopping.is_set():
                return self._refusal(request, "the component is ending")
            expected, actual = request.revision, self._revision.value
            if expected != actual:
                return self._refusal(request, self._mismatch(expected, actual))
            return await self._carry_out(request, command, token)

    def _mismatch(self, expected: int | None, actual: int) -> str:
        """The refusal of a request that expects another revision: what changed it, if user code did by raising."""
        at, failure = self._revision.failure
        if expected is not None and expected < at:
            return failure
        named = "the request names none" if expected is None else f"the request expects {expected}"
        return f"the component is at revision {actual}, and {named}: observe it again, then retry"

    async def _carry_out(self, request: Request, command: Command[Any], token: str) -> Reply:
        try:
            result: WireValue = replies.Done()
            match command:
                case commands.ObserveCommand():
                    result = self.state()
                case commands.WelcomeCommand(manager=manager):
                    self._welcome(manager, token)
                case commands.PingCommand():
                    pass
                case commands.ProgramCommand():
                    result = await asyncio.to_thread(self.program.listed)
                case commands.StopCommand():
                    self._stopping.set()
                case commands.ReleaseCommand():
                    await self._release(command)
                case _:
                    result = await self._handlers.carry_out(command, request.revision)
        except (MidstrideError, *CAUGHT) as error:
            words = str(error)
            if not isinstance(error, MidstrideError):
                words = legible(f"`{command.name}` failed: {type(error).__name__}: {error}")
                self.host.logger.error(words)
            if command.kind == "changing":
                self.report_state()  # a part of it may have been carried out
            return self._refusal(request, words)
        if command.kind == "changing":
            self._revision.bump()
            self.report_state()  # before the reply: a client that has the reply also has the state
            if isinstance(command, commands.WelcomeCommand):
                result = self.state()
        return Reply(id=request.id, revision=self._revision.value, result=frames.encode_value(result))

    def _refusal(self, request: Request, words: str) -> Reply:
        return Reply(id=request.id, revision=self._revision.value, refused=legible(words))

    def _welcome(self, manager: str, token: str) -> None:
        if not self._token:
            self._token = token
        elif not self._is_ours(token):  # of two managers that welcome it at once the first wins
            raise CommandRefused(_FOREIGN_TOKEN)
        if not self.host.managed:
            self.host.logger.info(f"{self.host.instance} is managed by {manager}")
        self.host.managed = True

    async def _release(self, command: commands.ReleaseCommand) -> None:
        if self.start_token:
            raise CommandRefused("its manager started it and must end it: `release` is for components started by hand")
        await self._handlers.release(command.timeout)
        self._token = ""
        self.host.managed = False

    def state(self) -> ComponentState:
        """Read without waiting for the data thread."""
        imported = len(self.program.modules)
        ending = self._stopping.is_set()
        return self._handlers.state(self.host.instance, self._uuid, self.pid, self._waiting(), imported, ending)

    def _waiting(self) -> str | None:
        if self.standalone is None and not self.host.managed:
            return NOT_WELCOMED
        if self.host.now() == 0:
            return "use_sim_time is on, and nothing has arrived on /clock yet: modes with a rate are not called"
        still = self.host.clock_history.still_for(self.host.steady()) if self.host.simulated_time else 0.0
        if still > STILL:
            return f"/clock has not moved for {still:.0f} s: modes with a rate are not called"
        return None

    def report_state(self) -> None:
        """The state has changed: report it to every client and to the platform's own tools."""
        self.host.publish_state(self._report())

    def _report(self) -> ComponentState:
        state = self.state()
        self._server.report(frames.StateChanged(state=state))
        return state

    def _report_end(self) -> None:
        """Report the state of a component that ends, which it does in order also where that fails."""
        try:
            self._report()
        except Exception as error:
            self.host.logger.error(f"{self.host.instance} ends without a report of it: {type(error).__name__}: {error}")

    def _degraded(self, runner: FunctionalityRunner) -> None:
        """On either thread: a functionality has degraded by itself. The revision changes at once."""
        state = runner.state()
        words = f"{runner.name} is in mode {state.mode}: {state.because}"
        self._revision.bump(words)
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._report_degraded, words)

    def _parameter_changed(self) -> None:
        """On the data thread: a parameter has been set, by a command or by the platform's tools."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.report_state)

    def _report_degraded(self, words: str) -> None:
        self.host.logger.error(words)
        self.report_state()

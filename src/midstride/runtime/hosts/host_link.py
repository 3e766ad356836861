"""The manager's link to one host: connected, or being connected again, with pauses that grow.

While it is down, nothing on the host is known, and nothing is concluded: its components may run. Once it is back, the
exits that were missed come first. Where it is another host process by then, each component that the manager knows is
looked for.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from midstride.errors import BackendError, CallTimeout, ProtocolError, Unreachable
from midstride.model.component import KILL_AT_ONCE
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import Exited, HostLinkState
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts.call_forms import ExitedForm, HandleForm, RemainingForm, StopTimesForm, error_of
from midstride.runtime.hosts.host_order import HostOrder, HostReport
from midstride.runtime.hosts.passed_on import pass_on, read_line
from midstride.runtime.hosts.ssh_connection import HostFault, SshConnection
from midstride.runtime.timeouts import within
from midstride.wire.clock_offset import ClockAnswer, ClockOffset, clock_offset
from midstride.wire.frames import INVALID, OLDEST, PROTOCOL, SPOKEN
from midstride.wire.other_hosts import OtherHostAddress, introduce
from midstride.wire.sockets import ForwardedConnection
from midstride.wire.transport import Connection

log = logging.getLogger(__name__)
T = TypeVar("T")

# The pauses between attempts to connect (s): the first, the longest, and the part of each that is drawn.
FIRST_PAUSE: Final = 0.5
LONGEST_PAUSE: Final = 10.0
_DRAWN: Final = 0.3
# For how long a command that needs a host which cannot be reached waits for one more attempt (s).
AGAIN_SECONDS: Final = 5.0
# How long a host process may take to greet, and to answer a call that does not wait for anything (s).
GREET_SECONDS: Final = 5.0
CALL_SECONDS: Final = 30.0
CLOSED: Final = "the connection was closed"
# How often the clock of the host is asked for one measurement: the answer with the least round trip counts.
CLOCK_QUESTIONS: Final = 8


class HostLink:
    """``order``: what the host is asked to serve. ``folder``: of the local sockets. ``token``: the system's, as it is
    when a connection is made. ``reads``: the link is no manager's, and changes nothing there. ``superseded``: whether
    another manager has taken over, whose link a connection of this one would end: then none is made any more.

    ``known``: the instances of the system on all hosts, which are never orphans; two hosts may be one computer.
    ``on_exit`` is called with each exit there, ``on_change`` when the link is up or down, with words. ``elsewhere``
    connects to a component that is not there.
    """

    def __init__(
        self,
        host: HostSpec,
        order: HostOrder,
        folder: Path,
        token: Callable[[], str],
        on_exit: Callable[[Exited], object],
        on_change: Callable[[str], object] = lambda _: None,
        *,
        known: Callable[[], Iterable[str]] = tuple,
        reads: bool = False,
        superseded: Callable[[], bool] = lambda: False,
        connect: Callable[[HostSpec, Path], SshConnection] = SshConnection,
        elsewhere: Callable[[str], Awaitable[Connection]] | None = None,
    ) -> None:
        self.host, self._order, self._folder, self._token = host, order, folder, token
        self._on_exit, self._on_change = on_exit, on_change
        self._known, self._reads, self._connect, self._superseded = known, reads, connect, superseded
        self._elsewhere = elsewhere
        # Where the socket of the host process is forwarded to, while the link is up.
        self.socket = folder / f"{host.name}.sock"
        self._problem: str | None = "it has not been connected yet"
        self._since = time.time()  # it is connected, or not
        self.report: HostReport | None = None
        self.clock: ClockOffset | None = None  # as measured last
        self.state = frames.StateFrame()
        self.handles: dict[str, HandleForm] = {}  # of the components that run there, as far as is known
        self._ending: set[str] = set()  # the components that a call in progress ends
        self._lost: set[str] = set()  # those of which it is not known whether they were started: they are to end
        self._ssh: SshConnection | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._uuid, self._seen = "", 0  # of the host process, and its last event
        self._compared = ""  # the host process that was compared last with what is known to run
        self._calls: dict[int, asyncio.Future[frames.ResultFrame]] = {}
        self._number = 0
        self._random = random.Random(f"{order.system} {host.name}")
        self._keeping: asyncio.Task[None] | None = None
        self._tried = asyncio.Event()  # the first attempt is over
        self._hurry = asyncio.Event()  # the next attempt is to begin at once
        self._attempt, self._next = asyncio.Event(), asyncio.Event()  # set once it is over, or the host is reached
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def problem(self) -> str | None:
        """The reason why the host cannot be reached now, and what to do; None while it is connected."""
        return CLOSED if self._problem is None and self._writer is None else self._problem

    @property
    def shown(self) -> HostLinkState:
        """The link as the status shows it."""
        version = "" if self.report is None else self.report.version
        return HostLinkState(self.host.name, self.host.ssh, self._since, self.problem, version, self.clock)

    @property
    def is_used(self) -> bool:
        """Return whether a component may run there that was started through the link."""
        return bool(self.handles or self._lost)

    @property
    def connected(self) -> bool:
        return self.problem is None

    async def open(self) -> None:
        """Return once the first attempt is over; from then on the link is kept up. See ``problem``."""
        if self._keeping is None:
            self._keeping = asyncio.get_running_loop().create_task(self._keep())
        await self._tried.wait()

    async def try_again(self) -> None:
        """Begin an attempt at once where the host cannot be reached; return once it is over, or after a while."""
        if self.connected or self._keeping is None:
            return
        over = self._next
        self._hurry.set()
        with contextlib.suppress(asyncio.TimeoutError):
            async with within(AGAIN_SECONDS):
                await over.wait()

    async def close(self) -> None:
        """Leave the host; its components keep running."""
        if self._keeping is not None:
            tasks = (self._keeping, *self._tasks)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(self) -> None:
        pause, now = FIRST_PAUSE, asyncio.get_running_loop().time
        while not self._superseded():
            begun, why = now(), ""
            self._attempt, self._next = self._next, asyncio.Event()
            self._hurry.clear()
            try:
                await self._serve_connection()
                why = CLOSED
            except (BackendError, OSError) as error:
                why = str(error)
            except Exception as error:  # a fault of ours: it is tried again
                log.exception("the link to %s failed", self.host.name)
                why = f"{type(error).__name__}: {error}"
            if now() - begun > LONGEST_PAUSE:
                pause = FIRST_PAUSE
            before, self._problem = self._problem, why
            if why != before and self._tried.is_set():
                self._on_change(f"host {self.host.name} cannot be reached: {why}")
            self._tried.set()
            self._attempt.set()
            with contextlib.suppress(asyncio.TimeoutError):
                async with within(pause * (1 - _DRAWN * self._random.random())):
                    await self._hurry.wait()
            pause = min(2 * pause, LONGEST_PAUSE)
        self._problem = "another manager of this system has taken over"
        self._tried.set()
        self._next.set()

    async def _serve_connection(self) -> None:
        """Connect, and read until the connection ends. Raises BackendError."""
        connection = self._connect(self.host, self._folder)
        try:
            report = await connection.open(self._order)
            reader, writer = await _open(connection)
            try:
                await self._greet(connection, reader, writer)
                self.report, self._writer, self._ssh = report, writer, connection
                self.socket = connection.local
                reading = asyncio.ensure_future(self._read(reader))
                ending = asyncio.ensure_future(connection.ended())
                comparing = asyncio.ensure_future(self._compare_all())
                try:
                    await asyncio.wait((comparing, reading, ending), return_when=asyncio.FIRST_COMPLETED)
                    if comparing.done():
                        comparing.result()
                        was, self._problem, self._since = self._problem, None, time.time()
                        if self._tried.is_set():
                            self._on_change(f"host {self.host.name} is reached again (before: {was})")
                        self._tried.set()
                        self._attempt.set()
                        self._next.set()  # as that attempt is not needed
                        self._next = asyncio.Event()
                        await asyncio.wait((reading, ending), return_when=asyncio.FIRST_COMPLETED)
                    if ending.done():
                        raise Unreachable(ending.result())
                    reading.result()
                finally:
                    for task in (comparing, reading, ending):
                        task.cancel()
                    await asyncio.gather(comparing, reading, ending, return_exceptions=True)
            finally:
                if self.connected:
                    self._since = time.time()
                self._writer = self._ssh = None
                writer.close()
                self._fail_calls()
        finally:
            await connection.close()

    async def _greet(
        self, connection: SshConnection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        greeting = await _greeting(connection, reader)
        self._require(greeting)
        if self._superseded():
            raise HostFault("another manager of this system has taken over")
        hello: frames.FromManager = frames.ReaderHello(protocol=frames.HOST_PROTOCOL)
        if not self._reads:
            hello = frames.ManagerHello(
                protocol=frames.HOST_PROTOCOL, token=self._token(), uuid=self._uuid, seen=self._seen
            )
        writer.write(frames.encode(hello) + b"\n")
        answer = await _in_time(_frame(reader))
        if not isinstance(answer, frames.Accepted):
            raise ProtocolError("the host process did not accept the manager first")
        if answer.refused is not None:
            raise HostFault(answer.refused)
        self._uuid, self._seen = greeting.uuid, answer.seen

    def _require(self, greeting: frames.HostGreeting) -> None:
        """Raises HostFault where the host process is not the one that is meant, or speaks otherwise."""
        if (greeting.system, greeting.host) != (self._order.system, self.host.name):
            raise HostFault(
                f"its folder has the host process of {greeting.system}, there as host {greeting.host}: state another "
                "`folder` for one of the two"
            )
        if greeting.control not in SPOKEN:
            raise HostFault(
                f"its Midstride {greeting.version} speaks version {greeting.control} of the control protocol, and this "
                f"one speaks {OLDEST} to {PROTOCOL}: install the same version of Midstride on both"
            )

    async def _compare_all(self) -> None:
        """Learn what was missed, then end what is left. If the link ends meanwhile, the next one begins with this."""
        await self._compare()
        await self._end_orphans()
        self._compared = self._uuid
        await self._end_lost()

    async def _compare(self) -> None:
        """Have the host process watch what runs; what does not has ended meanwhile.

        Another host process than before knows nothing of it. The same one may have ended it for a call whose result was
        lost.
        """
        same = self._compared == self._uuid
        how = "the link was down to" if same else "`midstride host` did not run on"
        for handle in list(self.handles.values()):
            runs = await self._call(calls.Adopt(handle=handle), bool)
            if not runs and handle.instance not in self._ending and handle.instance in self.handles:
                words = f"{handle.instance} has ended while {how} {self.host.name}"
                self._exited(ExitedForm(instance=handle.instance, because=words))

    async def _end_orphans(self) -> None:
        """With another host process than before: end what the one before has started, and could tell nobody of."""
        if self._reads or self._compared in ("", self._uuid):
            return
        names = sorted({*self._known(), *self.handles})
        call = calls.EndOrphans(token=self._token(), known=names, stop=StopTimesForm.of(KILL_AT_ONCE))
        async with self._not_ended("what an earlier host process has started"):
            for instance in await self._call(call, list[str]):
                self._on_change(f"{instance}, which was being started on host {self.host.name}, was ended there")

    async def _end_lost(self) -> None:
        """End what may have been started, and nobody has waited for."""
        for instance in sorted(self._lost):
            async with self._not_ended(instance):
                await self._call(calls.End(instance=instance, stop=StopTimesForm.of(KILL_AT_ONCE)), list[RemainingForm])
                self._lost.discard(instance)

    @contextlib.asynccontextmanager
    async def _not_ended(self, what: str) -> AsyncIterator[None]:
        """Say what could not be ended there: a process that does not die is no reason to give the host up."""
        try:
            yield
        except (Unreachable, CallTimeout):
            raise
        except BackendError as error:
            self._on_change(f"{what} could not be ended on host {self.host.name}: {error}")

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while True:
            frame = await _frame(reader)
            if frame is None:
                return
            match frame:
                case frames.ResultFrame():
                    waiting = self._calls.pop(frame.number, None)
                    if waiting is not None and not waiting.done():
                        waiting.set_result(frame)
                case frames.ExitFrame() if frame.number > self._seen:
                    self._seen = frame.number
                    self._exited(frame.exited)
                case frames.StateFrame():
                    self.state = frame
                case frames.WantedFrame():
                    self._begin(self._bring(frame))
                case _:
                    pass

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _exited(self, exited: ExitedForm) -> None:
        self.handles.pop(exited.instance, None)
        self._on_exit(exited.exited())

    def _fail_calls(self) -> None:
        waiting, self._calls = self._calls, {}
        for each in waiting.values():
            if not each.done():
                each.set_exception(Unreachable(f"the connection to host {self.host.name} ended meanwhile"))
                each.exception()

    # -- calls ---------------------------------------------------------------------------------------------

    def require_connected(self) -> None:
        """Raises Unreachable, with why the host cannot be reached."""
        if (problem := self.problem) is not None:
            raise Unreachable(f"host {self.host.name} cannot be reached: {problem}")

    async def call(self, call: calls.HostCall, result: type[T], seconds: float | None = CALL_SECONDS) -> T:
        """Carry out a call there. Raises what its back end has raised; Unreachable, CallTimeout: it is not known."""
        self.require_connected()
        return await self._call(call, result, seconds)

    async def _call(self, call: calls.HostCall, result: type[T], seconds: float | None = CALL_SECONDS) -> T:
        """Carry out a call, also before the link counts as connected: first of all, what runs there is compared."""
        if self._writer is None:
            raise Unreachable(f"the connection to host {self.host.name} ended meanwhile")
        self._number += 1
        number = self._number
        waiting: asyncio.Future[frames.ResultFrame] = asyncio.get_running_loop().create_future()
        self._calls[number] = waiting
        if isinstance(call, calls.End):
            self._ending.add(call.instance)
        try:
            self._writer.write(frames.encode(frames.CallFrame(number=number, call=call)) + b"\n")
            async with within(seconds) if seconds is not None else contextlib.nullcontext():
                answer = await waiting
        except asyncio.TimeoutError:
            raise CallTimeout(f"host {self.host.name} has not answered within {seconds:g} s") from None
        finally:
            self._calls.pop(number, None)
            if isinstance(call, calls.End):
                self._ending.discard(call.instance)
        if answer.failed is not None:
            raise error_of(answer.kind, f"{answer.failed} (on host {self.host.name})")
        try:
            return msgspec.json.decode(answer.result, type=result)
        except INVALID as error:
            raise ProtocolError(f"host {self.host.name} has answered with something else: {error}") from None

    def lost(self, instance: str) -> None:
        """Nobody waits any more for the start of ``instance``: it is ended, now or once the link is back."""
        self._lost.add(instance)

        async def end() -> None:
            with contextlib.suppress(BackendError):  # the next link begins with it
                await self._end_lost()

        if self.connected:
            self._begin(end())

    async def measure_clock(self) -> ClockOffset:
        """By how much the system clock there is ahead of the one here. Raises BackendError."""
        answers = []
        for _ in range(CLOCK_QUESTIONS):
            asked = time.time_ns()
            other = await self.call(calls.ReadClock(), int, GREET_SECONDS)
            answers.append(ClockAnswer(asked, other, time.time_ns()))
        if (offset := clock_offset(answers)) is None:
            raise BackendError("the system clock was set back while the clock of another host was measured")
        self.clock = offset
        return offset

    async def connect(self, instance: str) -> ForwardedConnection:
        """The control connection of a component there. Raises Unreachable where nothing listens, CallTimeout."""
        connection = self._ssh_connection()
        try:
            reader, writer = await connection.channel(instance)
        except Unreachable as error:  # of the forwarding: the component may listen
            raise CallTimeout(f"host {self.host.name} cannot be reached: {error}") from None
        try:
            await introduce(reader, writer, OtherHostAddress(connection.local, instance))
        except Unreachable as error:
            writer.close()
            raise Unreachable(f"{error} (on host {self.host.name})") from None
        except BaseException:
            writer.close()
            raise
        return ForwardedConnection(reader, writer)

    async def _bring(self, wanted: frames.WantedFrame) -> None:
        """Connect a component there to one elsewhere."""
        hello = frames.BroughtHello(protocol=frames.HOST_PROTOCOL, number=wanted.number)
        connection: Connection | None = None
        try:
            if self._elsewhere is None:
                raise CallTimeout("only the manager connects hosts")
            connection = await self._elsewhere(wanted.instance)
        except BackendError as error:
            hello = msgspec.structs.replace(hello, refused=str(error), gone=isinstance(error, Unreachable))
        try:
            ssh = self._ssh_connection()
            reader, writer = await _open(ssh)
            try:
                await _greeting(ssh, reader)
                writer.write(frames.encode(hello) + b"\n")
                if connection is not None:
                    await pass_on(connection, reader, writer)
                else:
                    await reader.read(1)  # until it has been read there
            finally:
                writer.close()
        except (BackendError, OSError) as error:
            log.info("%s could not be connected to %s: %s", self.host.name, wanted.instance, error)
        finally:
            if connection is not None:
                connection.close()

    def _ssh_connection(self) -> SshConnection:
        if self._ssh is None:
            raise CallTimeout(f"host {self.host.name} cannot be reached: {self.problem}")
        return self._ssh


async def _open(connection: SshConnection) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await connection.channel(f"the forwarded socket of {connection.host.name}")


async def _greeting(connection: SshConnection, reader: asyncio.StreamReader) -> frames.HostGreeting:
    line = await _in_time(_line(reader))
    if line is None:
        await asyncio.sleep(0.1)  # what ssh says of it comes on another way
        raise HostFault(connection.why_not_forwarded())
    return frames.decode_greeting(line)


async def _in_time(answer: Coroutine[Any, Any, T]) -> T:
    """Raises HostFault where the host process does not answer in time."""
    try:
        async with within(GREET_SECONDS):
            return await answer
    except asyncio.TimeoutError:
        raise HostFault(
            f"its host process does not answer within {GREET_SECONDS:g} s: is it stopped, or the link overloaded?"
        ) from None


async def _frame(reader: asyncio.StreamReader) -> frames.FromHost | None:
    line = await _line(reader)
    return None if line is None else frames.decode_from_host(line)


async def _line(reader: asyncio.StreamReader) -> bytes | None:
    try:
        return await read_line(reader, frames.LONGEST_HOST_FRAME)
    except (OSError, ValueError):
        return None

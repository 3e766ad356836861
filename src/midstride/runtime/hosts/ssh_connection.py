"""One OpenSSH connection to a host: it starts `midstride host` there, and forwards the socket of that process.

It is one process, `ssh`, whose other end goes with it: the command there waits for the end of its standard input once
it has answered. So a manager that is killed leaves no connection behind. The host process does not belong to the
login, and goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec

from midstride.errors import BackendError, ProtocolError
from midstride.model.hosts import HostSpec
from midstride.runtime.hosts import ssh
from midstride.runtime.hosts.host_order import HOST_MARK, LONGEST_LINE, HostOrder, HostReport
from midstride.runtime.timeouts import within
from midstride.wire.sockets import open_socket

# How long a login and the start of the host process there may take (s), and a forwarding (s).
START_SECONDS: Final = 40.0
FORWARD_SECONDS: Final = 10.0
# How many lines a login shell may print before the answer, and how much of the messages is kept (bytes).
_MOST_LINES: Final = 200
_KEPT_ERRORS: Final = 8 * 1024
_END_SECONDS: Final = 2.0


class HostFault(BackendError):
    """A host cannot be used now: one sentence on why, with what to do."""


class SshConnection:
    """A connection that :meth:`open` makes. ``folder``: where its local sockets are. Used on one event loop."""

    def __init__(self, host: HostSpec, folder: Path) -> None:
        self.host = host
        # One for each manager: that of a killed one removes its socket, by this path, some time after the next began.
        self.control = folder / f"{host.name}.{os.getpid()}.ctl"
        self.local = folder / f"{host.name}.sock"
        self._forwarded: os.stat_result | None = None
        self.report: HostReport | None = None
        self._process: Process | None = None
        self._errors = bytearray()
        self._reading: asyncio.Task[None] | None = None

    async def open(self, order: HostOrder, environment: Mapping[str, str] = os.environ) -> HostReport:
        """Log in, have the host process found or started, and forward its socket. Raises HostFault."""
        try:
            async with within(START_SECONDS):
                report = await self._start(order, environment)
        except asyncio.TimeoutError:
            raise HostFault(
                f"`ssh {self.host.ssh}` has logged in, and `midstride host` has not answered there within "
                f"{START_SECONDS:g} s: what does `setup` run?"
            ) from None
        if report.problem is not None:
            raise HostFault(report.problem)
        await self._forward(report.socket)
        self.report = report
        return report

    async def _start(self, order: HostOrder, environment: Mapping[str, str]) -> HostReport:
        words = ssh.connect_command(self.host, self.control, environment)
        for left in self.control.parent.glob(f"{self.host.name}.*.ctl"):
            if left == self.control or not Path("/proc", left.suffixes[-2][1:]).exists():
                left.unlink(missing_ok=True)
        try:
            self._process = await asyncio.create_subprocess_exec(
                *words, stdin=PIPE, stdout=PIPE, stderr=PIPE, limit=LONGEST_LINE, start_new_session=True
            )
        except OSError as error:
            raise HostFault(f"`ssh` cannot be started: {error.strerror or error}; install OpenSSH's client") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._reading = asyncio.get_running_loop().create_task(self._read_errors(self._process))
        with contextlib.suppress(OSError):  # it has ended, which is explained below
            self._process.stdin.write(msgspec.json.encode(order) + b"\n")
            await self._process.stdin.drain()
        for _ in range(_MOST_LINES):
            try:
                line = await self._process.stdout.readline()
            except ValueError:
                raise HostFault("its login prints too much before `midstride host` answers") from None
            if line.startswith(HOST_MARK.encode()):
                self._errors.clear()  # they are of the login
                try:
                    return HostReport.read(line)
                except ProtocolError as error:
                    raise HostFault(str(error)) from None
            if not line:
                raise HostFault(await self.ended())
        raise HostFault("its login prints too much before `midstride host` answers")

    def why_not_forwarded(self) -> str:
        """The reason why the forwarded socket was closed before the host process greeted."""
        if ssh.refuses_forwarding(self.errors):
            return ssh.forwarding_refused()
        return "its host process ended as it was connected to"

    @property
    def errors(self) -> str:
        """The end of what ssh has written to standard error."""
        return self._errors.decode(errors="replace")

    async def _read_errors(self, process: Process) -> None:
        assert process.stderr is not None
        while data := await process.stderr.read(4096):
            self._errors += data
            del self._errors[:-_KEPT_ERRORS]

    async def _forward(self, remote: str) -> None:
        self.local.unlink(missing_ok=True)
        words = ssh.forward_command(self.host, self.control, self.local, remote)
        forwarding = await asyncio.create_subprocess_exec(*words, stdin=DEVNULL, stdout=DEVNULL, stderr=PIPE)
        try:
            async with within(FORWARD_SECONDS):
                _, errors = await forwarding.communicate()
        except asyncio.TimeoutError:
            forwarding.kill()
            await forwarding.wait()
            raise HostFault("its socket could not be forwarded in time: the connection hangs") from None
        if forwarding.returncode != 0:
            text = errors.decode(errors="replace")
            if ssh.refuses_forwarding(text + self.errors):
                raise HostFault(ssh.forwarding_refused())
            raise HostFault(f"its socket could not be forwarded: {ssh.last_line(text) or 'ssh said nothing'}")
        with contextlib.suppress(OSError):
            self._forwarded = self.local.lstat()

    async def channel(self, name: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """A new connection to the host process; ``name`` says what for. Raises Unreachable and CallTimeout."""
        return await open_socket(self.local, name)

    async def ended(self) -> str:
        """Wait until the connection has ended, and return why, with what to do."""
        assert self._process is not None
        assert self._reading is not None
        status = await self._process.wait()
        await asyncio.wait((self._reading,), timeout=_END_SECONDS)  # another process may have its standard error
        return ssh.meaning(self.host, status, self.errors)

    async def close(self) -> None:
        """End the connection; the host process keeps running."""
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            try:
                async with within(_END_SECONDS):
                    await process.wait()
            except asyncio.TimeoutError:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGKILL)
                await process.wait()
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.gather(self._reading, return_exceptions=True)
        if process is not None:
            process._transport.close()  # type: ignore[attr-defined]  # its pipes, which the loop may not outlast
        self.control.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            if self._forwarded is not None and os.path.samestat(self._forwarded, self.local.lstat()):
                self.local.unlink()  # else it is the one of a manager that has taken over

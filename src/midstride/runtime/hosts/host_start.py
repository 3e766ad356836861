"""The work of `midstride host`, which is called over SSH: find or start the host process, and describe it.

The host process is started in a session of its own, with nothing of the login's terminal: it keeps running
when the connection ends. Its workspace is below the folder of the host's declaration, by default the home
directory: not in a run-time folder, which the end of the last login removes.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec

from midstride.errors import ManagerError, ProtocolError
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts.host_order import HOST_MARK, LONGEST_SOCKET, HostOrder, HostReport
from midstride.runtime.workspace import ROOM, Workspace

_FOLDER: Final = ".midstride"
_PASSING: Final = "midstride-check-"
# How long the host process may take to listen (s): it joins ROS first.
START_SECONDS: Final = 30.0
_POLL: Final = 0.02
# How long one that is not needed any more may take to end (s).
_END_SECONDS: Final = 5.0
_LOGIND: Final = ("/etc/systemd/logind.conf", "/run/systemd/logind.conf", "/usr/lib/systemd/logind.conf")


def directory_of(order: HostOrder) -> Path:
    """The folder in which programs are started. Raises ManagerError where it is not there."""
    folder = Path(order.folder or "~").expanduser()
    if not folder.is_dir():
        raise ManagerError(
            f"the folder {folder} is not there: correct `folder`, or create it and copy the programs of this host to it"
        )
    return folder


def workspace_of(order: HostOrder) -> Workspace:
    """The workspace of the host process, made where it is not there. Raises ManagerError.

    Where there is none yet, an order that only reads gets one in the temporary folder, to be removed by
    :func:`remove_passing`.
    """
    folder = directory_of(order)
    path = folder / _FOLDER / f"{order.system}.{order.host}"  # a `.` is in no name of a system: no manager has it
    _require_short(path)
    if order.reads and not path.exists():
        base = path.parent if path.parent.exists() else folder
        try:
            with tempfile.TemporaryFile(dir=base, buffering=0) as trial:
                trial.write(bytes(ROOM))
        except OSError as error:
            raise ManagerError(_not_writable(folder, error)) from None
        path = Path(tempfile.mkdtemp(prefix=_PASSING)) / path.name
    try:
        for each in (path.parent, path):
            each.mkdir(mode=0o700, exist_ok=True)
        if path.stat().st_uid != os.getuid():
            raise ManagerError(f"the folder {path} there belongs to another user: state another `folder`")
        path.chmod(0o700)
    except OSError as error:
        raise ManagerError(_not_writable(folder, error)) from None
    workspace = Workspace(path)
    workspace.require_room()
    return workspace


def _require_short(path: Path) -> None:
    if len(os.fsencode(socket := socket_of(Workspace(path)))) > LONGEST_SOCKET:
        raise ManagerError(f"the path {socket} is too long for a socket: state a shorter `folder`")


def remove_passing(workspace: Workspace) -> None:
    """Remove a workspace that was made for an order that only reads."""
    if workspace.path.parent.name.startswith(_PASSING):
        shutil.rmtree(workspace.path.parent, ignore_errors=True)


def _not_writable(folder: Path, error: OSError) -> str:
    user = pwd.getpwuid(os.getuid()).pw_name
    return (
        f"the folder {folder} there cannot be written by {user} ({error.strerror or error}): state another `folder`, "
        f"or make it {user}'s (`sudo install -d -o {user} {folder}`)"
    )


def socket_of(workspace: Workspace) -> Path:
    return workspace.path / "host.sock"


def find_or_start(order: HostOrder, version: str) -> HostReport:
    """The report on the host process, which is started where none runs. What is wrong is in it."""
    report = HostReport(midstride_host=frames.HOST_PROTOCOL, version=version, user=pwd.getpwuid(os.getuid()).pw_name)
    report = msgspec.structs.replace(report, lingers=lingers(), kills=kills_user_processes())
    try:
        if order.protocol != frames.HOST_PROTOCOL:
            raise ManagerError(
                f"its Midstride {version} speaks version {frames.HOST_PROTOCOL} of the protocol between hosts, and the "
                f"manager version {order.protocol}: install the same version of Midstride on both"
            )
        workspace = workspace_of(order)
        if not _usable(running(workspace), order, version):
            try:
                start(order, workspace)
            except ManagerError:
                remove_passing(workspace)
                raise
        report = msgspec.structs.replace(
            report,
            socket=str(socket_of(workspace)),
            components=str(workspace.components),
            free_bytes=shutil.disk_usage(directory_of(order)).free,
            range=os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", ""),
        )
    except (ManagerError, ProtocolError) as error:
        report = msgspec.structs.replace(report, problem=str(error)[:4000])
    return report


def _usable(found: frames.HostGreeting | None, order: HostOrder, version: str) -> bool:
    """Return whether the host process that was found serves the order; one that need not go on has ended otherwise.

    Raises ManagerError where it watches components, and was started for other variables.
    """
    if found is None or order.reads:
        return found is not None
    same = (found.variables, found.middleware_settings) == (order.variables, order.middleware_settings)
    if found.running == 0 and not (same and found.version == version):
        _end(found.pid)
        return False
    if not same:
        differ = sorted({*found.variables.items()} ^ {*order.variables.items()})
        raise ManagerError(
            f"its host process {found.pid} watches {found.running} components that were started with other settings "
            f"({', '.join(f'{name}={value}' for name, value in differ) or 'of the middleware'}): start the manager "
            "with those, or `midstride down` first"
        )
    return True


def _end(pid: int) -> None:
    """End a host process that has greeted, and that watches nothing."""
    with contextlib.suppress(ProcessLookupError):
        descriptor = os.pidfd_open(pid)
        try:
            signal.pidfd_send_signal(descriptor, signal.SIGTERM)
            select.select([descriptor], [], [], _END_SECONDS)
        finally:
            os.close(descriptor)


def running(workspace: Workspace) -> frames.HostGreeting | None:
    """The greeting of the host process that runs; None where none does. Raises ProtocolError for another version."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    with contextlib.closing(connection):
        connection.settimeout(2.0)
        try:
            connection.connect(str(socket_of(workspace)))
            with connection.makefile("rb") as file:
                line = file.readline(frames.LONGEST_HOST_FRAME)
        except TimeoutError:
            raise ProtocolError(
                f"the host process of {workspace.path} does not answer: is it stopped? Its number is in "
                f"{workspace.path / 'lock'}"
            ) from None
        except OSError:
            return None
    return frames.decode_greeting(line.rstrip(b"\n")) if line else None


def start(order: HostOrder, workspace: Workspace) -> None:
    """Start the host process, and return once it listens. Raises ManagerError with the end of its log."""
    log = workspace.logs / "host.log"
    with log.open("ab") as output:
        output.truncate(0)
        process = subprocess.Popen(
            [sys.executable, "-m", "midstride", "_host", str(workspace.path)],
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd="/",
            env=environment_of(order, os.environ),
            start_new_session=True,
        )
    assert process.stdin is not None
    with process.stdin, contextlib.suppress(BrokenPipeError):
        process.stdin.write(msgspec.json.encode(order) + b"\n")
    deadline = time.monotonic() + START_SECONDS
    while running(workspace) is None:
        if process.poll() is not None:
            lines = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
            raise ManagerError(lines[-1].removeprefix("midstride: "))
        if time.monotonic() > deadline:
            process.kill()
            process.wait()
            raise ManagerError(f"its host process has not listened within {START_SECONDS:g} s; its log there: {log}")
        time.sleep(_POLL)


def environment_of(order: HostOrder, base: Mapping[str, str]) -> dict[str, str]:
    """The environment of the host process: that of the login, with what decides which nodes it can reach."""
    return {**base, **order.variables, "PYTHONUNBUFFERED": "1"}


def lingers() -> bool | None:
    """Return whether processes of this user outlive the last login (`loginctl enable-linger`); None: not known."""
    if not Path("/run/systemd/system").is_dir():
        return None
    return Path("/var/lib/systemd/linger", pwd.getpwuid(os.getuid()).pw_name).exists()


def kills_user_processes() -> bool | None:
    """Return whether logind ends the processes of a session with it (`KillUserProcesses`); None where there is no
    logind.
    """
    if not Path("/run/systemd/system").is_dir():
        return None
    found = False
    for file in reversed(_LOGIND):
        for path in (Path(file), *sorted(Path(f"{file}.d").glob("*.conf"))):
            with contextlib.suppress(OSError):
                for line in path.read_text(errors="replace").splitlines():
                    name, _, value = line.partition("=")
                    if name.strip() == "KillUserProcesses":
                        found = value.strip().lower() in ("yes", "true", "1", "on")
    return found


def answer_line(report: HostReport) -> str:
    """The line of JSON, which begins with ``HOST_MARK``."""
    line = msgspec.json.encode(report).decode()
    assert line.startswith(HOST_MARK)
    return line

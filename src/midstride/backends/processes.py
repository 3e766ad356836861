"""The manager's side of real platforms: components as processes of the operating system."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import json
import logging
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Final

from midstride.backends import heap
from midstride.backends.spares import Spares, fits
from midstride.codec.parameter import json_values
from midstride.errors import BackendError, CallTimeout, StartFailed, Unreachable
from midstride.foreign.page import GATES_FOLDER
from midstride.foreign.relayed_program import KILLED, RelayOrder, order_file
from midstride.model.component import StopTimes
from midstride.model.instance_names import log_file_name
from midstride.runtime.backend_protocol import Handle, Launch, RemainingProcess
from midstride.runtime.manager_clock import Clock, SystemClock
from midstride.runtime.process import reaper
from midstride.runtime.process.child_process import Process, end_orphans, find, spawn
from midstride.runtime.process.family import mark_of
from midstride.runtime.process.log_runs import begin_run
from midstride.runtime.process.reaper import Reaper, process_info
from midstride.wire import environment as variables
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import Transport

_OURS: Final = ("python", "python3")
log = logging.getLogger(__name__)

# How often free memory is given back and the logs of components are checked (s).
UPKEEP: Final = 60.0
# How long a log may get, and how much is then kept of it (bytes).
LONGEST_LOG: Final = 8 * 1024 * 1024
KEPT_OF_LOG: Final = 1024 * 1024


def command(
    arguments: Sequence[str], directory: Path, environment: Mapping[str, str], python: Callable[[], str]
) -> tuple[str, ...]:
    """The command with its program found. Raises StartFailed, naming what cannot be found.

    ``python`` and ``python3`` mean the interpreter that has the platform and Midstride, also where another one is first
    on the PATH. Any other interpreter is named by its path.
    """
    program, *rest = arguments
    if program in _OURS:
        return (python(), *rest)
    if "/" in program:
        found = shutil.which(os.path.join(directory, program))
    else:
        found = shutil.which(program, path=environment.get("PATH"))
    if found is None:
        raise StartFailed(f"cannot start `{' '.join(arguments)}`: there is no program {program} that can be run")
    return (found, *rest)


def prefixed(launch: Launch, command: tuple[str, ...], environment: Mapping[str, str]) -> tuple[str, ...]:
    """The command after the words of its prefix, such as `nice -n 5`. Raises StartFailed, naming what is not there."""
    if not launch.prefix:
        return command
    program, *rest = launch.prefix
    path = os.path.join(launch.directory, program) if "/" in program else program
    found = shutil.which(path, path=environment.get("PATH"))
    if found is None:
        raise StartFailed(
            f"{launch.instance}: there is no program {program} for its prefix `{' '.join(launch.prefix)}`"
        )
    return (found, *rest, *command)


def surroundings(launch: Launch, base: Mapping[str, str]) -> dict[str, str]:
    """``base`` with the variables that the component states, and without those that it does not inherit."""
    without = {name: value for name, value in base.items() if name not in launch.environment}
    return {**without, **{name: value for name, value in launch.environment.items() if value is not None}}


def differences(environment: Mapping[str, str], base: Mapping[str, str]) -> dict[str, str | None]:
    """The variables of ``environment`` that differ from those of ``base``; None for one that it lacks."""
    names = sorted({*environment, *base})
    return {name: environment.get(name) for name in names if environment.get(name) != base.get(name)}


def identity(launch: Launch, backend: str, control: Path) -> dict[str, str]:
    """The environment variables that make a process this component; ``control`` is the folder of the sockets."""
    set_values = (
        {variables.ENV_SET_PARAMETERS: json.dumps(json_values(launch.set_parameters))} if launch.set_parameters else {}
    )
    return {
        **set_values,
        variables.ENV_BACKEND: backend,
        variables.ENV_INSTANCE: launch.instance,
        variables.ENV_START: uuid.uuid4().hex,
        variables.ENV_NODE: launch.node,
        variables.ENV_STANDBY: "1" if launch.standby else "",
        variables.ENV_PATIENCE: f"{launch.patience:g}",
        variables.ENV_NAMESPACE: launch.namespace,
        variables.ENV_TOKEN: launch.token,
        variables.ENV_PARAMETERS: json.dumps(json_values(launch.parameters)),
        variables.ENV_CONTROL: str(control.absolute()),
        "PYTHONUNBUFFERED": "1",
    }


async def listens(transport: Transport, instance: str) -> bool:
    """Return whether a component of that name listens, or may do so: one started by hand, whose process is not
    known.
    """
    try:
        connection = await transport.connect(transport.address(instance))
    except Unreachable:
        return False
    except CallTimeout:
        return True
    connection.close()
    return True


class ProcessBackend(abc.ABC):
    """The common part of the back ends of real platforms: components as processes, their control sockets and their
    logs.

    ``control`` is the folder of the sockets, ``logs`` that of the logs (default: beside ROS's own). ``guardian`` ends
    what is started should this process be killed. To be opened, used and closed on one event loop.
    """

    name: str

    def __init__(self, control: Path, logs: Path | None, guardian: Reaper | None) -> None:
        self.clock: Clock = SystemClock()
        self.transport: Transport = SocketFolder(control)
        self._control = control
        self._logs = logs
        self._guardian = guardian
        # The processes that it watches, by instance.
        self._processes: dict[str, Process] = {}
        self._upkeep: asyncio.Task[None] | None = None
        self._spares: Spares | None = None

    @abc.abstractmethod
    def _environment_of_spares(self, token: str) -> dict[str, str]:
        """The environment of a process before its component is known. Raises BackendError where it cannot be said."""

    @abc.abstractmethod
    def _python(self) -> str:
        """The interpreter that `python3` means. Raises BackendError where none is known."""

    def keep_spares(self, number: int, token: str) -> None:
        try:
            if self._spares is None:
                if number == 0:
                    return
                self._spares = Spares(
                    f"{__package__}.{self.name}", self._python(), self._log_folder(token) / "spares.log"
                )
            # Each is given the word of its start with its program: else all would seem to be of one start.
            shared = self._environment_of_spares(token)
            self._spares.keep(number, {name: each for name, each in shared.items() if name != variables.ENV_START})
        except BackendError as error:
            log.warning("no spare process can be started: %s", error)

    def spares(self) -> int:
        return 0 if self._spares is None else self._spares.ready

    def takes_spare(self, arguments: Sequence[str], directory: Path) -> bool:
        ours = (*_OURS, self._spares.python) if self._spares is not None else _OURS
        return arguments[0] in ours and fits(arguments, directory)

    @abc.abstractmethod
    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        """A process has exited without being asked to. It is not watched any longer."""

    @abc.abstractmethod
    async def _died(self, instance: str) -> None:
        """A process has ended: the graph may still show its node."""

    async def _spawn(self, launch: Launch, node: str, command: Sequence[str], environment: Mapping[str, str]) -> Handle:
        """Start the process of the node that has the full name ``node``. Raises StartFailed."""
        log = self._log_folder(launch.token) / log_file_name(node)
        with contextlib.suppress(OSError):  # what starts the process reports it
            log.parent.mkdir(parents=True, exist_ok=True)
        begin_run(log, launch.instance)
        spares = None if launch.foreign is not None else self._spares  # it is loaded with its gate
        process = None if spares is None else await spares.run(command, launch.directory, environment, log)
        if process is None:
            process = spawn(command, launch.directory, environment, log)
        process.mark = environment.get(variables.ENV_START)
        self._watch(launch.instance, process)
        return Handle(launch.instance, process.pid, process.started, str(log))

    def _log_folder(self, token: str = "") -> Path:
        if self._logs is not None:
            return self._logs
        folder = os.environ.get("ROS_LOG_DIR")
        home = os.environ.get("ROS_HOME") or os.path.expanduser("~/.ros")
        if not folder:
            folder = f"{home}/log" if os.path.isabs(home) else f"{tempfile.gettempdir()}/ros-log"
        return Path(folder) / "midstride" / token[:12]

    async def adopt(self, handle: Handle) -> bool:
        instance = handle.instance
        if instance in self._processes:
            return True
        if handle.pid is None or handle.started is None:
            return await listens(self.transport, instance)
        log = None if handle.log is None else Path(handle.log)
        process = find(handle.pid, handle.started, variables.ENV_INSTANCE, instance, log)
        if process is None:
            return False
        process.mark = mark_of(process.pid)
        self._watch(instance, process)
        return process.running

    async def end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        killed: list[RemainingProcess] = []
        if (process := self._processes.get(instance)) is not None:
            killed = await process.end(stop)
            if process.status == KILLED and (order := order_file(self._control / GATES_FOLDER, instance)).exists():
                behind = RelayOrder.read(order)
                killed.append(RemainingProcess(None, behind.command[0], behind.stop.longest))
            self._forget(instance, process)
        await self._died(instance)
        return killed

    async def end_orphans(self, token: str, known: Container[str], stop: StopTimes) -> list[str]:
        return await end_orphans(token, known, stop)

    def families(self) -> dict[str, set[int]]:
        """By instance, the numbers of the processes that belong to it."""
        found = list(reaper.processes())
        return {instance: process.family(found) for instance, process in self._processes.items()}

    def is_stopped(self, instance: str) -> bool:
        process = self._processes.get(instance)
        info = None if process is None else process_info(process.pid)
        return info is not None and info.stopped

    def _watch(self, instance: str, process: Process) -> None:
        self._processes[instance] = process
        if self._guardian is not None:
            self._guardian.watch(process.pid, process.started)

        def exited(status: int | None) -> None:
            self._forget(instance, process)
            self._exited(instance, status, process)

        process.on_exit = exited
        if self._upkeep is None:
            self._upkeep = asyncio.get_running_loop().create_task(self._keep_up())

    def _forget(self, instance: str, process: Process) -> None:
        if self._processes.get(instance) is process:
            del self._processes[instance]
        if self._guardian is not None:
            self._guardian.release(process.pid)
        process.close()

    async def _keep_up(self) -> None:
        while True:
            await asyncio.sleep(UPKEEP)
            heap.give_back()
            for process in list(self._processes.values()):
                process.shorten_log(LONGEST_LOG, KEPT_OF_LOG)

    async def _stop_watching(self) -> None:
        """Stop watching; the processes keep running, except spares."""
        if self._spares is not None:
            await self._spares.close()
        if self._upkeep is not None:
            self._upkeep.cancel()
            self._upkeep = None
        for process in self._processes.values():
            process.close()
        self._processes.clear()

"""The program behind a relay (:mod:`midstride.foreign.relay`): what it is started with, and its process."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError, NodeError
from midstride.foreign.gate_file import write_gate_file
from midstride.model.component import ComponentSpec, StopTimes
from midstride.model.instance_names import PRIVATE_NAMES, dotted_name
from midstride.wire.state import WireValue

# What a relay exits with where it had to kill its program, as a shell has it.
KILLED: Final = 128 + signal.SIGKILL
_LIBC: Final = ctypes.CDLL(None)
_PR_SET_PDEATHSIG: Final = 1


class RelayOrder(WireValue, frozen=True, kw_only=True):
    """The program that a relay runs: ``command``, whose node has the full name ``node``.

    ``enclave``: that of the process of a program that gives its node its name itself; the node is found in it, and
    ``node`` is the name that is expected until then, empty where none is known. ``unnamed``: it was not passed a name.
    ``role``: what it is an instance of. ``predecessor``: the full name of the lifecycle node that it replaces, if any.
    ``topics``: by port, the full name of the topic that the program uses, which for an output is private.
    ``real``: by output that is attached, the topic on which the relay publishes. ``environment``: the variables that
    are others for the program than for the relay; None: it has none. ``stated``: the parameters that the specification
    has for this node; ``taken_over``: those that were set while its predecessor ran.
    """

    command: list[str]
    node: str
    declaration: NamedComponentForm
    topics: dict[str, str]
    environment: dict[str, str | None] = {}
    real: dict[str, str] = {}
    stated: dict[str, Any] = {}
    taken_over: dict[str, Any] = {}
    enclave: str = ""
    unnamed: bool = False
    role: str = ""
    predecessor: str = ""

    @property
    def stop(self) -> StopTimes:
        """The way in which its program is ended."""
        return self.declaration.declared().stop_times

    def write(self, path: Path) -> None:
        """Raises BackendError."""
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise BackendError(f"{path} cannot be written: {error.strerror or error}") from None
        write_gate_file(path, msgspec.json.encode(self))

    @classmethod
    def read(cls, path: Path) -> RelayOrder:
        """Raises BackendError."""
        try:
            return msgspec.json.decode(path.read_bytes(), type=cls)
        except (OSError, msgspec.DecodeError) as error:
            raise BackendError(f"{path} cannot be read: {error}") from None


def order_file(folder: Path, instance: str) -> Path:
    """The file of the order for the relay of ``instance``."""
    return folder / "relays" / f"{dotted_name(instance)}.json"


def differing(program: Mapping[str, str], relay: Mapping[str, str]) -> dict[str, str | None]:
    """The variables that are others in the environment of a program than in that of its relay."""
    return {name: program.get(name) for name in {*program, *relay} if program.get(name) != relay.get(name)}


def private_topics(component: ComponentSpec, instance: str) -> dict[str, str]:
    """The topics on which the program publishes instead, by output."""
    return {port: f"{PRIVATE_NAMES}relay/{instance.strip('/')}/{port}" for port in component.outputs}


class RelayedProgram:
    """The program, from its start to its end."""

    def __init__(self, order: RelayOrder) -> None:
        """Start it, on the main thread and before there are others. Raises NodeError."""
        environment = {name: value for name, value in os.environ.items() if name not in order.environment}
        environment |= {name: value for name, value in order.environment.items() if value is not None}
        self.words = " ".join(order.command)
        self._stop = order.stop
        parent = os.getpid()

        def end_with_relay() -> None:
            # In a new group: a signal to that of the relay does not reach it, which asks it to end itself.
            os.setpgid(0, 0)
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        try:
            self._process = subprocess.Popen(order.command, env=environment, preexec_fn=end_with_relay)
        except OSError as error:
            raise NodeError(f"cannot start `{self.words}`: {error.strerror or error}") from None
        self.pid = self._process.pid

    def status(self) -> int | None:
        """Return the exit status, 128 and the number for a signal, as in a shell; None while the program runs."""
        status = self._process.poll()
        return status if status is None or status >= 0 else 128 - status

    def watch(self, ended: Callable[[], None]) -> None:
        """Have ``ended`` called, in a thread, when it has exited."""

        def wait() -> None:
            self._process.wait()
            ended()

        threading.Thread(target=wait, daemon=True).start()

    def end(self) -> int:
        """End it and its group, as its component states; the status for the relay to exit with.

        That is the one of a program that has exited, else 0, or KILLED.
        """
        if (status := self.status()) is not None:
            return status
        stop = self._stop
        for number, patience in ((signal.SIGINT, stop.sigterm), (signal.SIGTERM, stop.sigkill)):
            if patience > 0:
                self._signal(number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(patience)
                    return 0
        self._signal(signal.SIGKILL)
        self._process.wait()
        times = f"{stop.sigterm:g} s after SIGINT and {stop.sigkill:g} s after SIGTERM"
        print(f"`{self.words}` had to be killed: it was still running {times}", file=sys.stderr, flush=True)
        return KILLED

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)

"""A simulated process: a component's script in a cooperative thread, with its own arguments, output and modules."""

from __future__ import annotations

import asyncio
import contextvars
import importlib.util
import io
import re
import sys
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, Final, Protocol

from midstride.backends.simulator.clock import SimulatedClock
from midstride.backends.simulator.control import SimulatedControl
from midstride.backends.simulator.cooperative_thread import CooperativeThread, Ended, Killed, Sleeps, Waits, Yielded
from midstride.backends.simulator.host import SimulatedHost
from midstride.backends.simulator.network import Network
from midstride.errors import BackendError, StartFailed
from midstride.node import process_context
from midstride.node.host import Host
from midstride.runtime.backend import Launch
from midstride.wire.transport import Transport

_PYTHON: Final = re.compile(r"python(3(\.\d+)?)?\Z")
# Lines of output that are kept.
KEPT: Final = 1000


class SimulatedPlatform(Protocol):
    """What a process needs of its simulator."""

    time: SimulatedClock
    network: Network
    control: SimulatedControl

    def register(self, instance: str, process: SimulatedProcess) -> None: ...


class ProcessOutput(io.TextIOBase):
    """What a process writes to its standard output and error: the last lines are kept."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque([""], maxlen=KEPT)

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        first, *rest = text.split("\n")
        self._lines[-1] += first
        self._lines.extend(rest)
        return len(text)

    def tail(self, lines: int = KEPT) -> str:
        return "\n".join(list(self._lines)[-lines:]).strip()


class SimulatedProcess:
    """Runs ``launch``. ``on_exit(process)`` is called once, when it has ended; ``status`` is then its exit status."""

    def __init__(
        self, platform: SimulatedPlatform, launch: Launch, pid: int, on_exit: Callable[[SimulatedProcess], None]
    ) -> None:
        self.platform = platform
        self.clock = platform.time
        self.network = platform.network
        self.transport: Transport = platform.control.of(self)
        self.launch = launch
        self.pid = pid
        self.log = ProcessOutput()
        self.host: SimulatedHost | None = None
        self.dead = False
        self.terminating = False
        # Being ended by the manager, which waits for that: its exit is not reported.
        self.exit_expected = False
        self.status: int | None = None
        self.gone = asyncio.Event()
        self._on_exit = on_exit
        self._program = SimulatedProgram(launch, self.log)
        self._thawed_at = 0.0
        self._asleep = False
        context = contextvars.copy_context()
        context.run(process_context.current.set, self._context())
        self.thread = CooperativeThread(launch.instance, self._program.run, context)

    @property
    def instance(self) -> str:
        return self.launch.instance

    @property
    def node(self) -> str:
        """Its full name in the graph: ``front/camera`` is node ``camera`` in ``/front``, whatever the namespace."""
        own, _, name = self.instance.strip("/").rpartition("/")
        inside = (own or self.launch.namespace).strip("/")
        return f"/{inside}/{name}" if inside else f"/{name}"

    def _context(self) -> process_context.ProcessContext:
        def factory(name: str, namespace: str) -> Host:
            return SimulatedHost(self, name)

        launch = self.launch
        return process_context.ProcessContext(
            factory=factory,
            instance=launch.instance,
            namespace=launch.namespace,
            token=launch.token,
            parameters=dict(launch.parameters),
            arguments=self._program.arguments,
            pid=self.pid,
        )

    # -- running -----------------------------------------------------------------------------------

    def ready(self) -> bool:
        """Whether the thread is waiting for work."""
        return not self._asleep and not self.dead

    def resume(self, work: Any = None) -> None:
        """Let the thread run, and handle what it yields for."""
        if self.dead:
            return
        with self._program.interpreter_state():
            try:
                yielded: Yielded = self.thread.resume(work)
            except BackendError as error:
                self.log.write(f"{error}\n")
                self._exit(-9)
                return
        if isinstance(yielded, Sleeps):
            self._asleep = True
            self.platform.time.loop.call_later(yielded.seconds, self._wake)
        elif isinstance(yielded, Ended):
            self._exit(self._program.status(yielded.error))
        elif self.host is not None:
            self.host.idle()

    def wait_for_work(self) -> Callable[[], None]:
        """In its thread: let the loop run until there is work."""
        work: Callable[[], None] = self.thread.yield_to_loop(Waits())
        return work

    def join_platform(self, instance: str) -> None:
        """Join the platform as ``instance``. Raises StartFailed where the name is taken."""
        self.platform.register(instance, self)

    def _wake(self) -> None:
        """A `time.sleep` of its code is over."""
        if self.frozen_until() > self.platform.time.steady():
            self.platform.time.loop.call_at(self.frozen_until_on_loop(), self._wake)
            return
        self._asleep = False
        self.resume()

    # -- signals and faults ------------------------------------------------------------------------

    def terminate(self) -> None:
        """SIGTERM: a component in ``start()`` ends in order; a process that has not got there ends at once."""
        self.terminating = True
        if self.host is not None and self.host.main is not None:
            self.host.main.cancel()
        elif not self.dead:
            self.kill(-15)

    def kill(self, status: int = -9) -> None:
        """End it at once, whatever it is doing."""
        if not self.dead:
            self._exit(status)

    def freeze(self, seconds: float) -> None:
        """As SIGSTOP, and SIGCONT after ``seconds``."""
        self._thawed_at = max(self._thawed_at, self.platform.time.steady() + seconds)

    def frozen_until(self) -> float:
        return self._thawed_at

    def frozen_until_on_loop(self) -> float:
        loop = self.platform.time.loop
        return max(loop.time(), loop.time() + self._thawed_at - self.platform.time.steady())

    async def wait_while_frozen(self) -> None:
        """Returns once it is not frozen. Raises CancelledError where it is dead, which ends its tasks."""
        while not self.dead and (left := self._thawed_at - self.platform.time.steady()) > 0:
            await self.platform.time.sleep(left)
        if self.dead:
            raise asyncio.CancelledError

    def _exit(self, status: int | None) -> None:
        self.dead = True
        self.status = status
        self.platform.network.remove_process(self)
        self.platform.control.remove(self)
        if self.host is not None and self.host.main is not None:
            self.host.main.cancel()
        with self._program.interpreter_state():
            self.thread.kill()
        self.gone.set()
        self._on_exit(self)


class SimulatedProgram:
    """The script or module of a command, with its own part of Python's global state."""

    def __init__(self, launch: Launch, log: ProcessOutput) -> None:
        command = " ".join(launch.arguments)
        if not launch.arguments or not _is_python(launch.arguments[0]):
            raise StartFailed(
                f"{launch.instance}: the simulator runs `python3 FILE.py` and `python3 -m MODULE`, not `{command}`"
            )
        rest = list(launch.arguments[1:])
        while rest and rest[0] in ("-u", "-B"):
            rest.pop(0)
        self._module: str | None = None
        if len(rest) > 1 and rest[0] == "-m":
            self._module, self._file = rest[1], rest[1]
            self.arguments = tuple(rest[2:])
        elif rest and not rest[0].startswith("-"):
            self._file = str(launch.directory / rest[0])
            self.arguments = tuple(rest[1:])
        else:
            raise StartFailed(f"{launch.instance}: the simulator cannot run `{command}`")
        self._log = log
        self._directory = str(launch.directory) if self._module else str(Path(self._file).parent)
        self._argv = [self._file, *self.arguments]
        self._main = ModuleType("__main__")
        self._modules: dict[str, ModuleType] = {"__main__": self._main}

    def run(self) -> None:
        """In the thread."""
        exec(self._load(), self._main.__dict__)

    def _load(self) -> CodeType:
        if self._module is not None:
            spec = importlib.util.find_spec(self._module)
            if spec is not None and spec.submodule_search_locations is not None:
                spec = importlib.util.find_spec(f"{self._module}.__main__")
            code = None if spec is None else getattr(spec.loader, "get_code", lambda name: None)(spec.name)
            if spec is None or code is None:
                print(f"No module named {self._module}", file=sys.stderr)
                raise SystemExit(1)
            self._main.__file__, self._main.__spec__, self._main.__package__ = spec.origin, spec, spec.parent
            return code  # type: ignore[no-any-return]  # a loader is Any
        try:
            source = Path(self._file).read_bytes()
        except OSError as error:
            print(f"can't open file {self._file!r}: {error.strerror}", file=sys.stderr)
            raise SystemExit(2) from None
        self._main.__file__ = self._file
        return compile(source, self._file, "exec")

    def status(self, error: BaseException | None) -> int:
        """The exit status, as Python has it; what was raised goes to the log."""
        match error:
            case None:
                return 0
            case SystemExit(code=None):
                return 0
            case SystemExit(code=int() as code):
                return code & 0xFF
            case SystemExit(code=words):
                self._log.write(f"{words}\n")
                return 1
            case Killed():
                return -9
            case _:
                own = str(Path(__file__).parent)
                trace = error.__traceback__
                while trace is not None and trace.tb_frame.f_code.co_filename.startswith(own):
                    trace = trace.tb_next
                self._log.write("".join(traceback.format_exception(type(error), error, trace)))
                return 1

    def interpreter_state(self) -> InterpreterState:
        return InterpreterState(self)


class InterpreterState:
    """While open, Python's global state is as it would be in a process that runs only this program."""

    def __init__(self, program: SimulatedProgram) -> None:
        self._program = program

    def __enter__(self) -> None:
        program = self._program
        self._before = (sys.stdout, sys.stderr, sys.argv)
        sys.stdout = sys.stderr = program._log
        sys.argv = program._argv
        sys.path.insert(0, program._directory)
        self._shadowed = {name: sys.modules.get(name) for name in program._modules}
        sys.modules.update(program._modules)
        self._known = len(sys.modules)

    def __exit__(self, *_: object) -> None:
        program = self._program
        self._keep_own_modules()
        for name, module in self._shadowed.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
        if program._directory in sys.path:
            sys.path.remove(program._directory)
        sys.stdout, sys.stderr, sys.argv = self._before

    def _keep_own_modules(self) -> None:
        """Keep modules from its own folder apart: another component's `helper` is another module."""
        if len(sys.modules) <= self._known or self._program._module is not None:
            return
        folder = self._program._directory.rstrip("/") + "/"
        for name in list(sys.modules)[self._known :]:  # a dictionary keeps the order of insertion
            file = getattr(sys.modules[name], "__file__", None)
            if isinstance(file, str) and file.startswith(folder):
                self._program._modules[name] = sys.modules.pop(name)


def _is_python(program: str) -> bool:
    return program == sys.executable or bool(_PYTHON.match(Path(program).name))

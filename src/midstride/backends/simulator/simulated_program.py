"""The program of a simulated process: its script or module, its output, and its part of Python's global state."""

from __future__ import annotations

import importlib.util
import io
import re
import sys
import traceback
from collections import deque
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final

from midstride.backends.processes import KEPT_OF_LOG, LONGEST_LOG
from midstride.backends.simulator.cooperative_thread import Killed
from midstride.errors import StartFailed
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.process.child_process import shorten

_PYTHON: Final = re.compile(r"python(3(\.\d+)?)?\Z")
# Lines of output that are kept.
KEPT: Final = 1000


class ProcessOutput(io.TextIOBase):
    """The standard output and error of a process: the last lines are kept, and ``file`` gets them all."""

    def __init__(self, file: Path | None = None) -> None:
        self._lines: deque[str] = deque([""], maxlen=KEPT)
        self._file = file

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        first, *rest = text.split("\n")
        self._lines[-1] += first
        self._lines.extend(rest)
        if self._file is not None:
            with open(self._file, "a", encoding="utf-8", errors="backslashreplace") as file:
                file.write(text)
                too_long = file.tell() > LONGEST_LOG
            if too_long:
                shorten(self._file, LONGEST_LOG, KEPT_OF_LOG)
        return len(text)

    def tail(self, lines: int = KEPT) -> str:
        return "\n".join(list(self._lines)[-lines:]).strip()


class SimulatedProgram:
    """The script or module of a command, with its own part of Python's global state."""

    def __init__(self, launch: Launch, log: ProcessOutput) -> None:
        command = " ".join(launch.arguments)
        program = launch.arguments[0] if launch.arguments else ""
        if program != sys.executable and not _PYTHON.match(Path(program).name):
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
        self.log = log
        self.directory = str(launch.directory) if self._module else str(Path(self._file).parent)
        self.argv = [self._file, *self.arguments]
        self._main = ModuleType("__main__")
        # Those that are its own, by name.
        self.modules: dict[str, ModuleType] = {"__main__": self._main}

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
                self.log.write(f"{words}\n")
                return 1
            case Killed():
                return -9
            case _:
                own = str(Path(__file__).parent)
                trace = error.__traceback__
                while trace is not None and trace.tb_frame.f_code.co_filename.startswith(own):
                    trace = trace.tb_next
                self.log.write("".join(traceback.format_exception(type(error), error, trace)))
                return 1

    def interpreter_state(self) -> _InterpreterState:
        """While open, Python's global state is as it would be in a process that runs only this program."""
        return _InterpreterState(self)

    def keep_own_modules(self, known: int) -> None:
        """Keep modules from its own folder apart, beyond the first ``known``: another's `helper` is another module."""
        if self._module is not None:
            return
        folder = self.directory.rstrip("/") + "/"
        for name in list(sys.modules)[known:]:  # a dictionary keeps the order of insertion
            file = getattr(sys.modules[name], "__file__", None)
            if isinstance(file, str) and file.startswith(folder):
                self.modules[name] = sys.modules.pop(name)


class _InterpreterState:
    """A class and no generator: it is entered for every message."""

    __slots__ = ("_before", "_known", "_program", "_shadowed")

    def __init__(self, program: SimulatedProgram) -> None:
        self._program = program

    def __enter__(self) -> None:
        program, modules = self._program, sys.modules
        self._before = (sys.stdout, sys.stderr, sys.argv)
        sys.stdout = sys.stderr = program.log
        sys.argv = program.argv
        sys.path.insert(0, program.directory)
        self._shadowed = [(name, modules.get(name)) for name in program.modules]
        modules.update(program.modules)
        self._known = len(modules)

    def __exit__(self, *raised: object) -> None:
        program, modules = self._program, sys.modules
        if len(modules) > self._known:
            program.keep_own_modules(self._known)
        for name, module in self._shadowed:
            if module is None:
                modules.pop(name, None)
            else:
                modules[name] = module
        if sys.path[:1] == [program.directory]:
            del sys.path[0]
        elif program.directory in sys.path:
            sys.path.remove(program.directory)
        sys.stdout, sys.stderr, sys.argv = self._before

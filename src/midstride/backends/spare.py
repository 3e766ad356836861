"""A spare: a process that has imported the client library, and joined ROS 2, before it knows its component.

It is forked by a :mod:`.fork_server`. Where that is impossible, ``python -m midstride.backends.spare MODULE DESCRIPTOR
ROOM`` starts one; ROOM is :data:`.process_title.ARGUMENT_ROOM`. It has MODULE prepare the process (``prepare()`` of a
back end's package), says so on its socket, and waits there for a :class:`SpareProgram`. That program finds its
arguments, environment, working directory, output, ``__main__`` and ``sys.path`` as in a process that was started for
it. If the socket closes instead, the spare exits.
"""

from __future__ import annotations

import importlib
import os
import runpy
import socket
import sys
from importlib.machinery import SourceFileLoader
from types import ModuleType
from typing import Final, NoReturn

import msgspec

from midstride.backends import process_title
from midstride.node import loaded_program
from midstride.wire.environment import ENV_INSTANCE

READY: Final = b"ready\n"


class SpareProgram(msgspec.Struct, frozen=True):
    """The program that a spare is to run: ``python FILE …`` or ``python -m MODULE …``, in ``directory``, with output
    to ``log``.
    """

    command: list[str]
    directory: str
    environment: dict[str, str]
    log: str


def main(module: str, descriptor: int) -> None:
    channel = socket.socket(fileno=descriptor)
    channel.set_inheritable(False)
    importlib.import_module(module).prepare()
    channel.sendall(READY)
    wait(channel)


def wait(channel: socket.socket) -> None:
    """Run the program that comes from ``channel``; return where it closes instead."""
    with channel, channel.makefile("rb") as lines:
        line = lines.readline()
    if line.endswith(b"\n"):
        _become(msgspec.json.decode(line, type=SpareProgram))
    # Else the manager has no use for it, or has ended.


def _become(own: SpareProgram) -> None:
    os.chdir(own.directory)
    for name in os.environ.keys() - own.environment.keys():
        del os.environ[name]
    for name, value in own.environment.items():
        if os.environ.get(name) != value:
            os.environ[name] = value
    process_title.show(own.command, ENV_INSTANCE, own.environment[ENV_INSTANCE])
    log = os.open(own.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    loaded_program.loads_now()
    sys.orig_argv = list(own.command)
    sys.modules["__main__"] = main_module = ModuleType("__main__")
    try:
        if own.command[1] == "-m":
            _search_first(os.getcwd())
            sys.argv = ["-m", *own.command[3:]]
            runpy._run_module_as_main(own.command[2])  # type: ignore[attr-defined]  # which is what `python -m` calls
        else:
            _search_first(os.path.dirname(os.path.realpath(own.command[1])))
            sys.argv = list(own.command[1:])
            _run_script(main_module, os.path.join(os.getcwd(), own.command[1]))
    except SystemExit:
        raise
    except BaseException as error:
        _fail(error)


def _search_first(folder: str) -> None:
    """Python itself puts the folder of the program first, unless it was asked not to."""
    if not getattr(sys.flags, "safe_path", False):
        sys.path[0] = folder


def _run_script(main_module: ModuleType, path: str) -> None:
    loader = SourceFileLoader("__main__", path)
    main_module.__dict__.update(__file__=path, __loader__=loader, __builtins__=sys.modules["builtins"], __cached__=None)
    exec(compile(loader.get_data(path), path, "exec", dont_inherit=True), main_module.__dict__)


def _fail(error: BaseException) -> NoReturn:
    """End as Python does where a program raises; the traceback begins in the program."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_code.co_filename in (__file__, runpy.__file__):
        trace = trace.tb_next
    sys.excepthook(type(error), error.with_traceback(trace), trace)
    sys.exit(130 if isinstance(error, KeyboardInterrupt) else 1)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

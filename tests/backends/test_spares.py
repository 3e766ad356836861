"""Spares run a program as a process that is started for it does; here without ROS."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.backends import fork_client
from midstride.backends.spares import Spares, fits
from midstride.model.component import KILL_AT_ONCE, StopTimes
from midstride.runtime.process.child_process import Process, spawn
from midstride.runtime.process.reaper import environment_value, process_info
from midstride.wire.environment import ENV_INSTANCE

SHOW = """
import json, os, sys
import beside
print(json.dumps({
    "argv": sys.argv, "orig": sys.orig_argv[1:], "path": sys.path[:1], "file": __file__, "name": __name__,
    "spec": __spec__ and (__spec__.name, __spec__.origin),
    "main": sys.modules["__main__"].__dict__ is globals(), "directory": os.getcwd(),
    "environment": dict(os.environ), "package": __package__, "files": sorted(map(int, os.listdir("/proc/self/fd"))),
    "leads": os.getsid(0) == os.getpgid(0) == os.getpid(), "parent": os.getppid(),
    "signals": [line for line in open("/proc/self/status") if line.startswith(("SigBlk", "SigIgn"))],
}, sort_keys=True))
"""
PROGRAMS = {
    "show.py": SHOW,
    "raises.py": "def f():\n    raise ValueError('no')\nf()\n",
    "syntax.py": "x = = 1\n",
    "status.py": "import sys\nsys.exit(7)\n",
    "words.py": "import sys\nsys.exit('in words')\n",
    "atexit_.py": "import atexit, threading, time\natexit.register(print, 'bye')\n"
    "threading.Thread(target=lambda: (time.sleep(0.2), print('thread'))).start()\n",
    "killed.py": "import os, signal\nos.kill(os.getpid(), signal.SIGUSR1)\n",
    "waits.py": "import time\nprint('waiting')\ntime.sleep(600)\n",
}
# What spares load.
MODULES = {
    "ready_made.py": "def load():\n    pass\nprepare = load\n",
    "broken_module.py": "def load():\n    raise RuntimeError('no ROS')\nprepare = load\n",
    "with_a_thread.py": "import threading\ndef load():\n    threading.Thread(target=threading.Event().wait, "
    "daemon=True).start()\nprepare = load\n",
    "with_numpy.py": "def load():\n    import numpy.random\nprepare = load\n",
}
WAYS = ("spare", "fork", "spare that was started")


class Bench:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name, text in {**PROGRAMS, **MODULES, "beside.py": ""}.items():
            (folder / name).write_text(text)
        path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.environment = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", ENV_INSTANCE: "it"}

    def spares(self, module: str = "ready_made") -> Spares:
        return Spares(module, sys.executable, self.folder / "spares.log")

    async def ready(self, spares: Spares, number: int = 1) -> None:
        spares.keep(number, self.environment)
        await until(lambda: spares.ready == number)

    async def run(self, spares: Spares, *arguments: str, log: str = "log") -> Process | None:
        return await spares.run([sys.executable, *arguments], self.folder, self.environment, self.folder / log)

    async def result(self, process: Process | None, log: Path) -> tuple[int | None, str]:
        assert process is not None
        status = await process.wait()
        process.close()
        return status, log.read_text()

    async def in_a_spare(self, way: str, *arguments: str) -> tuple[int | None, str]:
        """``way`` is one of WAYS."""
        spares = self.spares("with_a_thread" if way == "spare that was started" else "ready_made")
        try:
            await self.ready(spares)
            assert (spares.server is None) == (way == "spare that was started")
            if way == "fork":
                spares._end(spares._spares[0])
            assert spares.ready == (way != "fork")
            process = await self.run(spares, *arguments)
            assert spares.ready == 0
            return await self.result(process, self.folder / "log")
        finally:
            await spares.close()

    async def in_a_new_process(self, *arguments: str) -> tuple[int | None, str]:
        log = self.folder / "new.log"
        return await self.result(spawn([sys.executable, *arguments], self.folder, self.environment, log), log)


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


def run(body: Callable[[], Awaitable[Any]]) -> Any:
    async def bounded() -> Any:
        return await asyncio.wait_for(body(), 60)  # a machine may be busy

    return asyncio.run(bounded())


@pytest.mark.parametrize(
    ("arguments", "way"),
    [*((("show.py", "a b", "--c"), way) for way in WAYS), (("./show.py",), "spare"), (("-m", "show", "x"), "fork")],
)
def test_a_program_finds_what_it_finds_in_a_process_of_its_own(
    arguments: tuple[str, ...], way: str, tmp_path: Path
) -> None:
    bench = Bench(tmp_path)
    status, spare = run(lambda: bench.in_a_spare(way, *arguments))
    assert status == 0
    assert json.loads(spare) == json.loads(run(lambda: bench.in_a_new_process(*arguments))[1])


@pytest.mark.parametrize(
    ("program", "way"),
    [
        ("raises.py", "spare"),
        *(
            (program, "fork")
            for program in ("raises.py", "syntax.py", "status.py", "words.py", "atexit_.py", "killed.py")
        ),
    ],
)
def test_a_program_ends_as_in_a_process_of_its_own(program: str, way: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    assert run(lambda: bench.in_a_spare(way, program)) == run(lambda: bench.in_a_new_process(program))


def test_others_see_the_command_and_the_instance(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        log = tmp_path / "log"
        log.write_text("of an earlier process\n")
        process = await spares.run([sys.executable, "waits.py"], tmp_path, bench.environment, log)
        assert process is not None
        await until(lambda: process.last_words() == "waiting\n")
        assert environment_value(process.pid, ENV_INSTANCE) == "it"
        assert Path(f"/proc/{process.pid}/cmdline").read_text().rstrip("\0") == f"{sys.executable} waits.py"
        await spares.close()
        assert process.running  # no spare any longer
        await process.end(KILL_AT_ONCE)
        assert await process.wait() in (-signal.SIGTERM, -signal.SIGKILL)
        process.close()

    run(body)


def test_a_spare_without_a_manager_exits(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares, 2)
        first, second = [spare.process for spare in spares._spares]
        spares._spares[0].channel.close()  # as the end of the manager's process does
        assert await first.wait() == 0
        spares.keep(0, bench.environment)
        assert await second.wait() == 0
        await spares.close()

    run(body)


def test_a_spare_that_died_is_not_used_and_another_takes_its_place(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        dead = spares._spares[0].process.pid
        os.kill(dead, signal.SIGKILL)
        await until(lambda: spares.ready == 0)
        process = await bench.run(spares, "status.py")
        assert process is not None and process.pid != dead
        assert (await bench.result(process, tmp_path / "log"))[0] == 7
        await bench.ready(spares)
        await spares.close()

    run(body)


def test_a_spare_that_cannot_be_prepared_is_dropped(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares("broken_module")
        spares.keep(1, bench.environment)
        await until(lambda: not spares._spares)
        await spares.close()

    run(body)
    assert "no ROS" in (tmp_path / "spares.log").read_text()


def test_the_death_of_the_fork_server_harms_no_process(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        in_spare, forked = await bench.run(spares, "waits.py", log="1"), await bench.run(spares, "waits.py", log="2")
        await bench.ready(spares)
        server = spares.server
        assert in_spare is not None and forked is not None and server is not None
        os.kill(server.process.pid, signal.SIGKILL)
        await until(lambda: server.failed)
        assert (in_spare.running, forked.running, spares.ready) == (True, True, 1)
        another = await bench.run(spares, "status.py", log="3")
        assert (await bench.result(another, tmp_path / "3"))[0] == 7
        assert await bench.run(spares, "status.py") is None  # it is started as a new process
        await bench.ready(spares)
        assert spares.server is not None and spares.server is not server
        for process in (in_spare, forked):
            await process.end(StopTimes(0.0, 5.0))
            assert process.status == -signal.SIGTERM
            process.close()
        await spares.close()

    run(body)


def test_a_fork_server_that_stands_still_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        server = spares.server
        assert server is not None
        spares._end(spares._spares[0])
        os.kill(server.process.pid, signal.SIGSTOP)
        monkeypatch.setattr(fork_client, "_PATIENCE", 0.2)
        monkeypatch.setattr(fork_client, "_LEAVE", 0.1)
        assert await bench.run(spares, "status.py") is None
        assert spares.server is None
        await spares.close()
        assert not server.process.running

    run(body)


def test_what_was_forked_outlives_the_manager_and_the_fork_server_does_not(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        spares._end(spares._spares[0])
        process = await bench.run(spares, "waits.py")
        assert process is not None and spares.server is not None
        print(process.pid, spares.server.process.pid, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)

    async def gone(pid: int) -> None:
        while (info := process_info(pid)) is not None and info.alive:
            await asyncio.sleep(0.01)

    reading, writing = os.pipe()
    if (manager := os.fork()) == 0:
        os.dup2(writing, 1)
        sys.stdout = os.fdopen(1, "w")
        try:
            run(body)
        finally:
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading) as output:
        component, server = map(int, output.readline().split())
    assert os.waitstatus_to_exitcode(os.waitpid(manager, 0)[1]) == -signal.SIGKILL
    try:
        run(lambda: gone(server))
        info = process_info(component)
        assert info is not None and info.alive
    finally:
        os.kill(component, signal.SIGKILL)


def test_random_numbers_of_numpy_differ_between_forks(tmp_path: Path) -> None:
    pytest.importorskip("numpy")
    bench = Bench(tmp_path)
    (tmp_path / "draws.py").write_text("import numpy.random, random\nprint(numpy.random.rand(), random.random())\n")

    async def body() -> list[str]:
        spares = bench.spares("with_numpy")
        await bench.ready(spares)
        drawn = [await bench.result(await bench.run(spares, "draws.py", log=log), tmp_path / log) for log in "123"]
        await spares.close()
        return [word for _, words in drawn for word in words.split()]

    assert len(set(run(body))) == 6


def test_a_spare_of_another_environment_or_interpreter_is_not_used(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        log = tmp_path / "log"
        elsewhere = {**bench.environment, "ROS_NAMESPACE": "/robot"}
        long_name = {**bench.environment, ENV_INSTANCE: "x" * 300}
        assert await spares.run([sys.executable, "show.py"], tmp_path, elsewhere, log) is None
        assert await spares.run([sys.executable, "show.py"], tmp_path, long_name, log) is None
        assert await spares.run(["/usr/bin/another", "show.py"], tmp_path, bench.environment, log) is None
        assert spares.ready == 1
        await spares.close()

    run(body)


def test_which_commands_fit(tmp_path: Path) -> None:
    Bench(tmp_path)
    assert fits(["python3", "show.py", "-x"], tmp_path)
    assert fits(["python3", "-m", "package.module"], tmp_path)
    for arguments in (
        ["python3"],
        ["python3", "-m"],
        ["python3", "-u", "show.py"],
        ["python3", "nosuch.py"],
        ["python3", "show.py", "--ros-args", "-r", "a:=b"],
    ):
        assert not fits(arguments, tmp_path), arguments
    assert not fits(["python3", "show.py"], tmp_path / "nosuch")

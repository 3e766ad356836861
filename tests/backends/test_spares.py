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

from midstride.backends.spares import Spares, fits
from midstride.runtime.process import Process, spawn
from midstride.runtime.reaper import environment_value
from midstride.wire.environment import ENV_INSTANCE

SHOW = """
import json, os, sys
import beside
print(json.dumps({
    "argv": sys.argv, "orig": sys.orig_argv[1:], "path": sys.path[:1], "file": __file__, "name": __name__,
    "spec": __spec__ and (__spec__.name, __spec__.origin),
    "main": sys.modules["__main__"].__dict__ is globals(), "directory": os.getcwd(),
    "environment": dict(os.environ), "package": __package__, "children": sorted(os.listdir("/proc/self/fd"))[:3],
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
    "waits.py": "import time\nprint('waiting')\ntime.sleep(600)\n",
}


class Bench:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name, text in {**PROGRAMS, "beside.py": "", "ready_made.py": "def prepare():\n    pass\n"}.items():
            (folder / name).write_text(text)
        (folder / "broken_module.py").write_text("def prepare():\n    raise RuntimeError('no ROS')\n")
        path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.environment = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", ENV_INSTANCE: "it"}

    def spares(self, module: str = "ready_made") -> Spares:
        return Spares(module, sys.executable, self.folder / "spares.log")

    async def ready(self, spares: Spares, number: int = 1) -> None:
        spares.keep(number, self.environment)
        await until(lambda: spares.ready == number)

    async def result(self, process: Process | None, log: Path) -> tuple[int | None, str]:
        assert process is not None
        status = await process.wait()
        process.close()
        return status, log.read_text()

    async def in_a_spare(self, *arguments: str, log: str = "spare.log") -> tuple[int | None, str]:
        spares = self.spares()
        try:
            await self.ready(spares)
            command = [sys.executable, *arguments]
            process = spares.run(command, self.folder, self.environment, self.folder / log)
            assert spares.ready == 0
            return await self.result(process, self.folder / log)
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


@pytest.mark.parametrize("arguments", [("show.py", "a b", "--c"), ("./show.py",), ("-m", "show", "x")])
def test_a_program_finds_what_it_finds_in_a_process_of_its_own(arguments: tuple[str, ...], tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    status, spare = run(lambda: bench.in_a_spare(*arguments))
    assert status == 0
    assert json.loads(spare) == json.loads(run(lambda: bench.in_a_new_process(*arguments))[1])


@pytest.mark.parametrize("program", ["raises.py", "syntax.py", "status.py", "words.py", "atexit_.py"])
def test_a_program_ends_as_in_a_process_of_its_own(program: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    assert run(lambda: bench.in_a_spare(program)) == run(lambda: bench.in_a_new_process(program))


def test_others_see_the_command_and_the_instance(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        log = tmp_path / "log"
        log.write_text("of an earlier process\n")
        process = spares.run([sys.executable, "waits.py"], tmp_path, bench.environment, log)
        assert process is not None
        await until(lambda: process.last_words() == "waiting\n")
        assert environment_value(process.pid, ENV_INSTANCE) == "it"
        assert Path(f"/proc/{process.pid}/cmdline").read_text().rstrip("\0") == f"{sys.executable} waits.py"
        await spares.close()
        assert process.running  # no spare any longer
        await process.end(0.0)
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
        os.kill(spares._spares[0].process.pid, signal.SIGKILL)
        await until(lambda: spares.ready == 0)
        assert spares.run([sys.executable, "show.py"], tmp_path, bench.environment, tmp_path / "log") is None
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


def test_a_spare_of_another_environment_or_interpreter_is_not_used(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    async def body() -> None:
        spares = bench.spares()
        await bench.ready(spares)
        log = tmp_path / "log"
        elsewhere = {**bench.environment, "ROS_NAMESPACE": "/robot"}
        long_name = {**bench.environment, ENV_INSTANCE: "x" * 300}
        assert spares.run([sys.executable, "show.py"], tmp_path, elsewhere, log) is None
        assert spares.run([sys.executable, "show.py"], tmp_path, long_name, log) is None
        assert spares.run(["/usr/bin/another", "show.py"], tmp_path, bench.environment, log) is None
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

"""Component processes and the reaper, with real processes."""

from __future__ import annotations

import asyncio
import ctypes
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from midstride.backends import processes
from midstride.errors import BackendError, StartFailed
from midstride.model.component import KILL_AT_ONCE, StopTimes
from midstride.runtime.process import child_process as process_module
from midstride.runtime.process import family as families
from midstride.runtime.process import reaper
from midstride.runtime.process.child_process import Process, end_orphans, find, shorten, spawn, tail
from midstride.runtime.process.reaper import Reaper, process_info
from midstride.wire.environment import ENV_INSTANCE, ENV_START, ENV_TOKEN

VARIABLE = "MIDSTRIDE_TOKEN"

# Prints its own number and that of a child, then waits; `stubborn` ignores SIGTERM, and so does its child.
FAMILY = """
import os, signal, subprocess, sys, time
if "stubborn" in sys.argv:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(600)"])
print("up", os.getpid(), child.pid, flush=True)
if "leaves" in sys.argv:
    os._exit(3)
time.sleep(600)
"""

# Any process may trace it; `threads`: it has a second thread. Then it waits.
TRACED = """
import ctypes, sys, threading, time
ctypes.CDLL(None).prctl(0x59616D61, ctypes.c_ulong(-1), 0, 0, 0)
if "threads" in sys.argv:
    threading.Thread(target=time.sleep, args=(600,), daemon=True).start()
print("up", flush=True)
time.sleep(600)
"""

# Traces all threads of the process that it is given, as a debugger does at its prompt: it looks at nothing that happens
# to them. It ends with its input, or after a while.
DEBUGGER = """
import ctypes, os, select, sys
for thread in os.listdir(f"/proc/{sys.argv[1]}/task"):
    if ctypes.CDLL(None, use_errno=True).ptrace(0x4206, int(thread), None, None):
        sys.exit(os.strerror(ctypes.get_errno()))
print("traces", flush=True)
select.select([0], [], [], 20)
"""


def until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "the condition did not become true in time"
        time.sleep(0.005)


def alive(pid: int) -> bool:
    info = process_info(pid)
    return info is not None and info.alive


def group_members(group: int) -> list[int]:
    """The living processes of a process group."""
    return [process.pid for process in reaper.processes() if process.group == group and process.alive]


@pytest.fixture
def token() -> Iterator[str]:
    """A unique token. A process that still has it at the end was left behind by a fault, and is ended."""
    token = f"test-{uuid.uuid4().hex}"
    yield token
    reaper.end_groups({}, VARIABLE, token, grace=0.0)


def family(tmp_path: Path, token: str, *arguments: str) -> Process:
    environment = {"PATH": os.environ["PATH"], VARIABLE: token}
    return spawn([sys.executable, "-S", "-c", FAMILY, *arguments], tmp_path, environment, tmp_path / "log.txt")


async def child_of(process: Process) -> int:
    """The number of its child, once the family is up."""
    while not (text := tail(process.log)).startswith("up "):
        await asyncio.sleep(0.005)
    return int(text.split()[2])


def test_a_process_is_described_as_the_kernel_and_psutil_see_it(tmp_path: Path) -> None:
    program = tmp_path / "a ) b"  # the kernel writes this name in front of all numbers, and does not escape it
    program.symlink_to(Path(sys.executable).resolve())
    with subprocess.Popen([program, "-S", "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True) as process:
        seen = psutil.Process(process.pid)
        until(lambda: seen.name() == program.name)
        info = process_info(process.pid)
        assert info is not None and info.alive and info.group == os.getpgid(process.pid) == process.pid
        # psutil's time is that of the system clock: it may be a second off after the clock was adjusted.
        assert abs(info.started - (seen.create_time() - psutil.boot_time())) < 1.5
        process.kill()
        until(lambda: seen.status() == psutil.STATUS_ZOMBIE)
        zombie = process_info(process.pid)
        assert zombie == info._replace(alive=False)
    assert process_info(process.pid) is None


@pytest.mark.parametrize(
    ("code", "status"),
    [("raise SystemExit(7)", 7), ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -9), ("pass", 0)],
)
def test_the_exit_is_reported_with_its_status(tmp_path: Path, code: str, status: int) -> None:
    async def run() -> tuple[int | None, list[int | None]]:
        heard: list[int | None] = []
        process = spawn([sys.executable, "-S", "-c", code], tmp_path, {}, tmp_path / "log.txt")
        process.on_exit = heard.append
        await asyncio.wait_for(process.wait(), 10)
        process.close()
        return process.status, heard

    assert asyncio.run(run()) == (status, [status])


def test_an_exit_is_known_within_milliseconds(tmp_path: Path, token: str) -> None:
    async def run() -> float:
        process = family(tmp_path, token)
        await child_of(process)
        killed = time.monotonic()
        os.killpg(process.pid, signal.SIGKILL)
        await asyncio.wait_for(process.wait(), 10)
        process.close()
        return time.monotonic() - killed

    assert asyncio.run(run()) < 0.25


def test_an_ended_process_is_no_zombie(tmp_path: Path) -> None:
    async def run() -> int:
        process = spawn([sys.executable, "-S", "-c", ""], tmp_path, {}, tmp_path / "log.txt")
        await asyncio.wait_for(process.wait(), 10)
        process.close()
        return process.pid

    assert process_info(asyncio.run(run())) is None


def test_a_process_leads_a_session_and_the_log_has_its_output(tmp_path: Path, token: str) -> None:
    async def run() -> tuple[int, int, str]:
        process = family(tmp_path, token)
        await child_of(process)
        found = os.getsid(process.pid), os.getpgid(process.pid), tail(process.log)
        await process.end(StopTimes(0.0, 5.0))
        process.close()
        assert found[:2] == (process.pid, process.pid)
        return found

    assert asyncio.run(run())[2].startswith("up ")


@pytest.mark.parametrize("arguments", [(), ("stubborn",), ("leaves",)])
def test_ending_reaches_the_whole_group(tmp_path: Path, token: str, arguments: tuple[str, ...]) -> None:
    async def run() -> tuple[int, list[int]]:
        process = family(tmp_path, token, *arguments)
        child = await child_of(process)
        await process.end(StopTimes(0.0, 0.3))
        process.close()
        return child, group_members(process.pid)

    child, rest = asyncio.run(run())
    assert rest == []
    assert not alive(child)


@pytest.mark.parametrize(
    ("arguments", "grace", "killed"), [((), 5.0, False), (("stubborn",), 0.3, True), ((), 0, False)]
)
def test_ending_says_whether_sigkill_was_needed_after_the_time_given(
    tmp_path: Path, token: str, arguments: tuple[str, ...], grace: float, killed: bool
) -> None:
    async def run() -> bool:
        process = family(tmp_path, token, *arguments)
        child = await child_of(process)
        found = await process.end(StopTimes(0.0, grace))
        process.close()
        assert not found or {(each.pid, each.seconds) for each in found} <= {(process.pid, grace), (child, grace)}
        return process.pid in [each.pid for each in found]

    assert asyncio.run(run()) is killed


# Says which of SIGINT and SIGTERM came, and ends on the last one that it is given; without any, on none.
ASKED = """
import signal, sys
def came(number, frame):
    name = signal.Signals(number).name
    print(name, flush=True)
    if name == sys.argv[-1]:
        sys.exit(0)
signal.signal(signal.SIGINT, came)
signal.signal(signal.SIGTERM, came)
print("up", flush=True)
while True:
    signal.pause()
"""


def test_one_that_was_asked_to_end_before_gets_no_signal_while_it_does(tmp_path: Path) -> None:
    """A second signal would end it at once."""

    async def main() -> None:
        brief = [sys.executable, "-S", "-c", "import time; time.sleep(0.3)"]
        process = spawn(brief, tmp_path, {}, tmp_path / "log.txt")
        assert await process.end(StopTimes(0.0, 5.0, asked=60.0)) == []
        assert process.status == 0
        goes_on = spawn(["sleep", "600"], tmp_path, os.environ, tmp_path / "log.txt")
        assert await goes_on.end(StopTimes(0.0, 5.0, asked=0.05)) == []
        assert goes_on.status == -signal.SIGTERM

    asyncio.run(main())


@pytest.mark.parametrize(
    ("ends_on", "stop", "came", "is_killed"),
    [
        ("SIGINT", StopTimes(10.0, 10.0), ["SIGINT"], False),
        ("SIGTERM", StopTimes(1.0, 10.0), ["SIGINT", "SIGTERM"], False),
        ("SIGTERM", StopTimes(0.0, 10.0), ["SIGTERM"], False),
        ("nothing", StopTimes(1.0, 1.0), ["SIGINT", "SIGTERM"], True),
        ("SIGTERM", StopTimes(1.0, 0.0), ["SIGINT"], True),
    ],
)
def test_a_process_is_asked_with_sigint_then_with_sigterm_and_then_killed(
    tmp_path: Path, token: str, ends_on: str, stop: StopTimes, came: list[str], is_killed: bool
) -> None:
    async def main() -> None:
        command = [sys.executable, "-S", "-c", ASKED, ends_on]
        process = spawn(command, tmp_path, {"PATH": os.environ["PATH"], VARIABLE: token}, tmp_path / "log.txt")
        while tail(process.log) != "up\n":
            await asyncio.sleep(0.005)
        killed = await process.end(stop)
        process.close()
        assert tail(process.log).split() == ["up", *came]
        assert process.status == (-signal.SIGKILL if is_killed else 0)
        assert [each.pid for each in killed] == ([process.pid] if is_killed else [])

    asyncio.run(main())


def test_a_process_does_not_ignore_sigint_although_its_manager_does(tmp_path: Path, token: str) -> None:
    """A manager that a script has started in the background ignores it, and so would each of its children."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:

        async def main() -> int | None:
            process = family(tmp_path, token)
            await child_of(process)
            await process.end(StopTimes(20.0, 20.0))
            process.close()
            return process.status

        assert asyncio.run(main()) == -signal.SIGINT
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


# Starts others in sessions of their own, and says their numbers: a child, what that has started, and a daemon whose
# parent has exited. `stubborn` ones ignore SIGTERM; a `bare` child has no environment. Then it waits.
WIDE = """
import os, signal, subprocess, sys, time
stubborn = "signal.signal(signal.SIGTERM, signal.SIG_IGN);" if "stubborn" in sys.argv else ""
waits = f"import os, signal, time; {stubborn} print('left', os.getpid(), flush=True); time.sleep(600)"
python = [sys.executable, "-S", "-c"]
nested = f"import subprocess, sys; subprocess.run([sys.executable, '-S', '-c', {waits!r}], start_new_session=True)"
subprocess.Popen([*python, nested], start_new_session=True, env={} if "bare" in sys.argv else None)
subprocess.run([*python, f"import subprocess, sys; subprocess.Popen([sys.executable, '-S', '-c', {waits!r}])"],
               start_new_session=True)
signal.signal(signal.SIGINT, lambda *_: sys.exit())
print("up", flush=True)
if "leaves" in sys.argv:
    time.sleep(0.5)
    os._exit(3)
time.sleep(600)
"""


async def wide(tmp_path: Path, token: str, *arguments: str, instance: str = "wide") -> tuple[Process, list[int]]:
    """A process, and the numbers of two that it has started in other sessions."""
    environment = {
        "PATH": os.environ["PATH"],
        ENV_TOKEN: token,
        ENV_INSTANCE: instance,
        ENV_START: f"{token} {instance}",
    }
    process = spawn([sys.executable, "-S", "-c", WIDE, *arguments], tmp_path, environment, tmp_path / "log.txt")
    process.mark = environment[ENV_START]  # which cannot be read while the kernel loads the program
    lines: list[str] = []
    while "up" not in lines or len(left := [line for line in lines if line.startswith("left")]) < 2:
        await asyncio.sleep(0.005)
        lines = tail(process.log).splitlines()
    return process, [int(line.split()[1]) for line in left]


@pytest.mark.parametrize("arguments", [(), ("bare",), ("stubborn",)])
def test_what_it_has_started_in_other_sessions_is_ended_as_well(
    tmp_path: Path, token: str, arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "LEFT_GRACE", 0.2 if "stubborn" in arguments else 30.0)

    async def main() -> None:
        process, left = await wide(tmp_path, token, *arguments)
        assert all(os.getsid(pid) != process.pid for pid in left)
        killed = await process.end(StopTimes(10.0, 10.0))
        process.close()
        assert not any(alive(pid) for pid in [process.pid, *left])
        assert process.status == 0
        assert {each.pid for each in killed} == ({*left} if "stubborn" in arguments else set())

    asyncio.run(main())


def test_what_a_process_has_started_does_not_outlive_its_crash(tmp_path: Path, token: str) -> None:
    async def main() -> list[int]:
        process, left = await wide(tmp_path, token, "leaves")
        await asyncio.wait_for(process.wait(), 10)
        process.close()
        return left

    left = asyncio.run(main())
    until(lambda: not any(alive(pid) for pid in left))


def test_nothing_else_belongs_to_a_process(tmp_path: Path, token: str) -> None:
    """Not another instance, nor the same one that was started again, nor a process that has its number."""

    async def main() -> None:
        first, own = await wide(tmp_path / "first", token)
        others = [await wide(tmp_path / "second", token, instance="other"), await wide(tmp_path / "third", another)]
        info = process_info(first.pid)
        assert info is not None
        found = families.members(info, first.mark, {})
        assert len(found) == 4 and {first.pid, *own} < found.keys()  # and the parent of one of them
        for other, left in others:
            assert not {other.pid, *left} & found.keys()
        later = info._replace(started=info.started + 1.0)
        assert families.members(later, "another start", {}) == {}
        for process in (first, *(each for each, _ in others)):
            await process.end(KILL_AT_ONCE)
            process.close()

    another = f"{token}-another"
    for name in ("first", "second", "third"):
        (tmp_path / name).mkdir()
    try:
        asyncio.run(main())
    finally:
        reaper.end_groups({}, VARIABLE, another, grace=0.0)


def test_a_killed_leader_takes_its_group_with_it(tmp_path: Path, token: str) -> None:
    async def run() -> int:
        process = family(tmp_path, token, "stubborn")
        child = await child_of(process)
        os.kill(process.pid, signal.SIGKILL)
        assert await asyncio.wait_for(process.wait(), 10) == -signal.SIGKILL
        process.close()
        return child

    child = asyncio.run(run())
    until(lambda: not alive(child))


def test_a_stopped_process_ends_in_order(tmp_path: Path, token: str) -> None:
    async def run() -> int | None:
        process = family(tmp_path, token)
        await child_of(process)
        os.killpg(process.pid, signal.SIGSTOP)
        await process.end(StopTimes(0.0, 10.0))
        process.close()
        return process.status

    assert asyncio.run(run()) == -signal.SIGTERM


@contextmanager
def debugged(pid: int) -> Iterator[None]:
    command = [sys.executable, "-S", "-c", DEBUGGER, str(pid)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as debugger:
        assert debugger.stdout is not None and debugger.stderr is not None
        if debugger.stdout.readline() != b"traces\n":
            pytest.skip(f"no process can be traced here: {debugger.stderr.read().decode()}")
        yield
        assert debugger.poll() is None, "its end was waited for"
        debugger.communicate(b"")


def traced(tmp_path: Path, token: str, *arguments: str) -> Process:
    environment = {"PATH": os.environ["PATH"], VARIABLE: token}
    process = spawn([sys.executable, "-S", "-c", TRACED, *arguments], tmp_path, environment, tmp_path / "log.txt")
    until(lambda: tail(process.log) == "up\n")
    return process


def test_an_exit_under_a_debugger_is_reported_at_once_and_reaped_later(
    tmp_path: Path, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel shows the end of a traced process to its debugger alone, as long as that does not look."""
    monkeypatch.setattr(process_module, "REAP_AGAIN", 0.01)

    async def main() -> None:
        heard: list[int | None] = []
        process = traced(tmp_path, token)
        process.on_exit = heard.append
        with debugged(process.pid):
            os.kill(process.pid, signal.SIGKILL)
            await asyncio.wait_for(process.wait(), 10)
            process.close()
            assert heard == [None]
            assert process_info(process.pid) is not None
        while process_info(process.pid) is not None:
            await asyncio.sleep(0.005)
        assert process.status == -signal.SIGKILL

    asyncio.run(asyncio.wait_for(main(), 15))


@pytest.mark.parametrize("arguments", [(), ("threads",)])
def test_what_a_debugger_holds_is_ended(
    tmp_path: Path, token: str, arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "REAP_AGAIN", 0.01)

    async def main() -> None:
        process = traced(tmp_path, token, *arguments)
        with debugged(process.pid):
            await process.end(KILL_AT_ONCE)
            process.close()
            assert not process.running
        while process_info(process.pid) is not None:
            await asyncio.sleep(0.005)

    asyncio.run(asyncio.wait_for(main(), 15))


def test_orphans_are_adopted_until_the_last_one_that_asked_for_it_has_ended() -> None:
    def adopts() -> bool:
        found = ctypes.c_int()
        assert ctypes.CDLL(None).prctl(37, ctypes.byref(found), 0, 0, 0) == 0  # PR_GET_CHILD_SUBREAPER
        return bool(found.value)

    assert not adopts()
    with process_module.adopting_orphans():
        with process_module.adopting_orphans():
            assert adopts()
        assert adopts()
    assert not adopts()


def test_one_that_is_no_longer_watched_is_ended(tmp_path: Path, token: str) -> None:
    async def main() -> None:
        process = family(tmp_path, token)
        child = await child_of(process)
        ending = asyncio.ensure_future(process.end(KILL_AT_ONCE))
        await asyncio.sleep(0)
        process.close()
        await ending
        assert not alive(process.pid) and not alive(child)

    asyncio.run(main())


@pytest.mark.parametrize("leader_stays", [True, False])
def test_a_process_that_outlives_its_end_is_reported_when_it_exits(
    leader_stays: bool, tmp_path: Path, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that waits for a driver or a file server: the kernel removes it later, or a child of it."""
    monkeypatch.setattr(process_module, "KILL_PATIENCE", 0.1)

    async def main() -> None:
        exits: list[tuple[str, int | None]] = []
        backend = Platform(tmp_path / "control", None, None, exits)
        process = family(tmp_path, token)
        backend._watch("stuck", process)
        child = await child_of(process)
        stuck = {process.pid, child} if leader_stays else {child}

        def signal_group(group: int, number: signal.Signals) -> None:
            for member in set(group_members(group)) - stuck:
                os.kill(member, number)

        monkeypatch.setattr(reaper, "signal_group", signal_group)
        with pytest.raises(BackendError, match=r"was killed, but .* did not exit"):
            await backend.end("stuck", KILL_AT_ONCE)
        if leader_stays:
            assert exits == []
            stuck.clear()
            os.kill(process.pid, signal.SIGKILL)
            await asyncio.wait_for(process.wait(), 10)
            until(lambda: not alive(child))
        assert exits == [("stuck", -signal.SIGKILL)]
        assert "stuck" not in backend._processes
        await backend._stop_watching()

    asyncio.run(main())


def test_what_cannot_be_started_is_named(tmp_path: Path) -> None:
    async def run(arguments: list[str], directory: Path) -> None:
        spawn(arguments, directory, {}, tmp_path / "log.txt")

    with pytest.raises(StartFailed, match=r"cannot start `/no/such/program x`: No such file"):
        asyncio.run(run(["/no/such/program", "x"], tmp_path))
    with pytest.raises(StartFailed, match=r"the folder .*/nowhere does not exist"):
        asyncio.run(run([sys.executable], tmp_path / "nowhere"))


def test_what_cannot_be_watched_does_not_run(tmp_path: Path, token: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(pid: int) -> int:
        raise OSError(24, "Too many open files")

    async def main() -> None:
        monkeypatch.setattr(os, "pidfd_open", full)
        with pytest.raises(StartFailed, match=r"cannot watch .*: Too many open files"):
            spawn(("sleep", "600"), tmp_path, {**os.environ, VARIABLE: token}, tmp_path / "log")

    asyncio.run(main())
    assert not reaper.remaining_groups({}, VARIABLE, token)


def test_the_tail_of_a_log_is_whole_lines(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    log.write_text("".join(f"line {number}\n" for number in range(100)))
    assert tail(log, 20) == "line 98\nline 99\n"
    assert tail(log, 10_000).startswith("line 0\n")
    begins = log.stat().st_size
    assert tail(log, since=begins) == ""
    log.write_text("no such device\n")
    assert tail(log, since=begins) == "no such device\n", "it was emptied meanwhile"
    assert tail(tmp_path / "none") == tail(None) == ""


def test_the_end_of_a_log_is_that_of_this_process(tmp_path: Path) -> None:
    """A log is continued: what an earlier process of that name wrote does not explain why this one exited."""

    async def run(code: str) -> str:
        process = spawn([sys.executable, "-S", "-c", code], tmp_path, {}, tmp_path / "log.txt")
        await asyncio.wait_for(process.wait(), 10)
        process.close()
        return process.last_words()

    assert asyncio.run(run("print('no such device')")) == "no such device\n"
    assert asyncio.run(run("pass")) == ""
    assert asyncio.run(run("print('no such file')")) == "no such file\n"
    assert tail(tmp_path / "log.txt") == "no such device\nno such file\n"
    assert tail(tmp_path / "log.txt", 3, since=15) == ""


def test_a_long_log_is_cut_to_its_last_lines_and_its_writer_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with open(log, "ab", buffering=0) as writer:
        writer.write(b"".join(b"line %d\n" % number for number in range(1000)))
        assert not shorten(log, longest=log.stat().st_size, kept=100)
        assert shorten(log, longest=log.stat().st_size - 1, kept=100)
        writer.write(b"the next\n")
    assert log.read_text().splitlines() == [f"line {number}" for number in range(989, 1000)] + ["the next"]
    assert not shorten(tmp_path / "nowhere", longest=0, kept=0)


class Platform(processes.ProcessBackend):
    """Processes without any middleware. ``exits``: of which instance, and with which status."""

    def __init__(
        self, control: Path, logs: Path | None, guardian: Reaper | None, exits: list[tuple[str, int | None]]
    ) -> None:
        super().__init__(control, logs, guardian)
        self._exits = exits

    def _exited(self, instance: str, status: int | None, process: Process) -> None:
        self._exits.append((instance, status))

    async def _died(self, instance: str) -> None:
        pass

    def _python(self) -> str:
        return sys.executable

    def _environment_of_spares(self, token: str) -> dict[str, str]:
        return dict(os.environ)


def test_the_logs_of_running_components_are_kept_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "UPKEEP", 0.01)
    monkeypatch.setattr(processes, "LONGEST_LOG", 100_000)
    monkeypatch.setattr(processes, "KEPT_OF_LOG", 10_000)
    log = tmp_path / "log"
    talkative = (
        "import itertools, time\nfor n in itertools.count():\n    print(n, flush=True)\n    n % 50 or time.sleep(0.001)"
    )

    def last() -> int:
        return int(tail(log).rstrip("\n").rpartition("\n")[2] or 0)

    async def main() -> None:
        exits: list[tuple[str, int | None]] = []
        backend = Platform(tmp_path / "control", None, None, exits)
        backend._watch("talkative", spawn([sys.executable, "-u", "-c", talkative], tmp_path, os.environ, log))
        deadline = time.monotonic() + 60
        while not log.read_bytes()[:1] or log.read_bytes().startswith(b"0\n"):
            assert time.monotonic() < deadline, "the log was not truncated"
            await asyncio.sleep(0.01)
        cut_at = last()
        while last() <= cut_at:
            assert time.monotonic() < deadline, "its writer does not continue"
            await asyncio.sleep(0.01)
        assert "talkative" in backend._processes
        await backend.end("talkative", StopTimes(0.0, 3.0))
        assert "talkative" not in backend._processes
        assert exits == []
        await backend._stop_watching()

    asyncio.run(main())


def test_a_process_of_an_earlier_manager_is_found_and_watched(tmp_path: Path, token: str) -> None:
    starting = (
        "import asyncio, os, sys; from pathlib import Path; from midstride.runtime.process.child_process import spawn\n"
        "async def main():\n"
        "    process = spawn([sys.executable, '-S', '-c', 'import time; time.sleep(600)'], Path.cwd(),"
        " dict(os.environ), Path('log.txt'))\n"
        "    print(process.pid, process.started)\n"
        "    process.close()\n"
        "asyncio.run(main())\n"
    )
    earlier = subprocess.run(
        [sys.executable, "-W", "error", "-c", starting],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env={**os.environ, VARIABLE: token},
    )
    assert earlier.stderr == ""
    pid, started = int(earlier.stdout.split()[0]), float(earlier.stdout.split()[1])

    async def run() -> tuple[bool, int | None]:
        process = find(pid, started, VARIABLE, token)
        assert process is not None
        running = process.running
        await process.end(StopTimes(0.0, 5.0))
        process.close()
        return running, process.status

    assert asyncio.run(run()) == (True, None)
    assert not alive(pid)


def test_another_process_of_the_same_number_is_not_taken_for_it(tmp_path: Path, token: str) -> None:
    async def run() -> None:
        process = family(tmp_path, token)
        await child_of(process)
        pid, started = process.pid, process.started
        assert find(pid, started - 0.01, VARIABLE, token) is None
        assert find(pid, started, VARIABLE, "another token") is None
        again = find(pid, started, VARIABLE, token)
        assert again is not None
        again.close()
        await process.end(StopTimes(0.0, 5.0))
        process.close()
        assert find(pid, started, VARIABLE, token) is None

    asyncio.run(run())


def test_an_unrecorded_component_is_ended_and_nothing_else(tmp_path: Path, token: str) -> None:
    def component(name: str, token: str) -> Process:
        code = "import subprocess; subprocess.run(['sleep', '600'], start_new_session=True)"
        environment = {**os.environ, ENV_TOKEN: token, ENV_INSTANCE: name}
        return spawn((sys.executable, "-S", "-c", code), tmp_path, environment, tmp_path / "log")

    async def run() -> None:
        orphan, known, other = component("new", token), component("old", token), component("new", f"{token}-other")
        for process in (orphan, known, other):  # each with a child in another process group
            while len(carriers(process.pid)) < 2:
                await asyncio.sleep(0.005)
        whole_orphan = carriers(orphan.pid)
        assert await end_orphans(token, {"old"}, StopTimes(0.0, 5.0)) == ["new"]
        assert not any(alive(pid) for pid in whole_orphan)
        assert len(carriers(known.pid)) == len(carriers(other.pid)) == 2
        assert await end_orphans(token, {"old"}, StopTimes(0.0, 5.0)) == []
        assert await end_orphans(token, (), StopTimes(0.0, 5.0)) == ["old"]
        assert await end_orphans(f"{token}-other", (), StopTimes(0.0, 5.0)) == ["new"]
        for process in (orphan, known, other):
            process.close()

    def carriers(pid: int) -> list[int]:
        """The process and its child, which have one environment."""
        mine = [reaper.environment_value(pid, variable) for variable in (ENV_TOKEN, ENV_INSTANCE)]
        found = (seen.pid for seen in reaper.processes() if seen.alive)
        return [
            one for one in found if [reaper.environment_value(one, name) for name in (ENV_TOKEN, ENV_INSTANCE)] == mine
        ]

    asyncio.run(run())


# A manager with three families: a watched one, one with the token that is not watched, and a released one.
MANAGER = """
import asyncio, os, sys, time
from pathlib import Path
from midstride.runtime.process.reaper import Reaper
from midstride.runtime.process.child_process import spawn, tail

async def main(token, family):
    reaping = Reaper("MIDSTRIDE_TOKEN", token)
    bare = {"PATH": os.environ["PATH"]}
    started = []
    for name, environment in (("watched", bare), ("unwatched", {**bare, "MIDSTRIDE_TOKEN": token}), ("released", bare)):
        process = spawn([sys.executable, "-S", "-c", family], Path.cwd(), environment, Path(f"{name}.txt"))
        started.append(process.pid)
        if name != "unwatched":
            reaping.watch(process.pid, process.started)
        while not tail(Path(f"{name}.txt")).startswith("up "):
            await asyncio.sleep(0.005)
    reaping.release(process.pid)
    print(reaping.pid, *started, flush=True)
    await asyncio.sleep(600)

asyncio.run(main(*sys.argv[1:]))
"""


def test_a_killed_manager_leaves_nothing_behind(tmp_path: Path, token: str) -> None:
    manager = subprocess.Popen(
        [sys.executable, "-c", MANAGER, token, FAMILY], stdout=subprocess.PIPE, text=True, cwd=tmp_path
    )
    assert manager.stdout is not None
    pids = [int(word) for word in manager.stdout.readline().split()]
    assert len(pids) == 4
    reaping, watched, unwatched, released = pids
    children = {
        name: int((tmp_path / f"{name}.txt").read_text().split()[2]) for name in ("watched", "unwatched", "released")
    }
    try:
        assert all(map(alive, (*pids, *children.values())))
        os.kill(reaping, signal.SIGTERM)  # the reaper ignores what ends other processes
        manager.kill()
        manager.wait()
        until(lambda: not any(map(alive, (watched, unwatched, children["watched"], children["unwatched"], reaping))))
        assert alive(released)
        assert alive(children["released"])
    finally:
        manager.stdout.close()
        for pid in (watched, unwatched, released):
            with suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        until(lambda: not any(map(alive, (*pids, *children.values()))))


def test_what_remains_may_end_by_itself_before_it_is_killed(tmp_path: Path, token: str) -> None:
    script = "trap 'echo ended; exit 0' TERM; echo up; while :; do sleep 0.01; done"
    with subprocess.Popen(
        ["sh", "-c", script],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, VARIABLE: token},
        start_new_session=True,
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "up\n"
        reaper.end_groups({}, VARIABLE, token, grace=10.0)
        status = process.poll()
        process.kill()
        assert (status, process.stdout.read()) == (0, "ended\n")


def test_closing_the_reaper_ends_what_remains(tmp_path: Path, token: str) -> None:
    async def run() -> tuple[int, int]:
        with Reaper(VARIABLE, token) as reaping:
            process = family(tmp_path, token, "stubborn")
            reaping.watch(process.pid, process.started)
            child = await child_of(process)
            assert os.getsid(reaping.pid) == reaping.pid
            process.close()
        return process.pid, child

    pid, child = asyncio.run(run())
    assert not alive(pid)
    assert not alive(child)
    with suppress(ChildProcessError):
        os.waitpid(pid, 0)


def test_the_reaper_spares_a_later_process_of_the_same_number(tmp_path: Path, token: str) -> None:
    async def run() -> bool:
        environment = {"PATH": os.environ["PATH"]}
        process = spawn(
            [sys.executable, "-S", "-c", "import time; time.sleep(600)"], tmp_path, environment, tmp_path / "log.txt"
        )
        with Reaper(VARIABLE, token) as reaping:
            reaping.watch(process.pid, process.started - 5.0)
        survived = alive(process.pid)
        await process.end(StopTimes(0.0, 5.0))
        process.close()
        return survived

    assert asyncio.run(run())


def test_the_mark_of_a_process_is_read_once_and_known_from_then_on(monkeypatch: pytest.MonkeyPatch) -> None:
    leader, far = (reaper.ProcessInfo(-pid, -pid, started=float(pid), alive=True) for pid in (1, 2))
    asked: list[int] = []

    def mark_of(pid: int) -> str:
        asked.append(pid)
        return "start"

    monkeypatch.setattr(families, "mark_of", mark_of)
    for _ in range(2):
        assert families.members(leader, "start", {}, [leader, far]).keys() == {-1, -2}
    assert asked == [-2]
    families.members(leader, None, {}, [leader])  # which forgets what has ended


def test_of_orphans_a_group_ends_with_its_leader_and_those_without_one_each() -> None:
    def orphan(pid: int, group: int) -> reaper.ProcessInfo:
        return reaper.ProcessInfo(pid, group, started=1.0, alive=True)

    led = [orphan(10, 10), orphan(11, 10)]
    alone = [orphan(21, 20), orphan(22, 20)]  # its leader has exited
    assert process_module._leaders([*led, *alone]) == [led[0], *alone]

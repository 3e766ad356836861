"""`midstride up --foreground`: the command is the manager, and tells who has started it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from midstride.cli import main
from midstride.runtime.process.reaper import process_info
from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES, Midstride
from tests.cli.private_systemd import PrivateSystemd, why_not

TALKER = EXAMPLES / "talker" / "talker.stride"
PATIENCE = 90.0
# The exit status of a process that an earlier manager has started is not known.
DEGRADED = "STATUS=degraded, 1 of 2 nodes run: listener exited unexpectedly"
OTHER_TALKER = re.sub(r"(node talker +: )Talker", r"\1NewTalker", TALKER.read_text(encoding="utf-8"))


def manager(*words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = main(["_manager", "--backend", "sim", "--foreground", *words])
    return status, capsys.readouterr().err


def test_what_another_attempt_does_not_cure_has_a_status_of_its_own(
    capsys: pytest.CaptureFixture[str], midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(midstride.runtime))
    bad = midstride.runtime / "bad.stride"
    bad.write_text("system talker nonsense\n")
    status, said = manager(str(bad), capsys=capsys)
    assert status == 78 and "bad.stride:1:15" in said
    status, said = manager(str(bad), "--take-over", "talker", capsys=capsys)  # nothing of it runs
    assert status == 78 and "bad.stride:1:15" in said
    status, said = manager(str(TALKER), "--take-over", "robot", capsys=capsys)
    assert status == 78 and "its system is talker, and not robot; write the unit anew" in said
    with Workspace.of("talker").lock():
        status, said = manager(str(TALKER), capsys=capsys)
    assert status == 78 and "a manager of talker is running already" in said


def test_the_options_that_exclude_it(capsys: pytest.CaptureFixture[str]) -> None:
    for words, because in (
        (["--foreground", "--detach"], "exclude each other"),
        (["--foreground", "--stop-on-exit"], "leaves its components running"),
        (["--foreground", "--json"], "midstride log --follow --json"),
        (["--take-over", "talker"], "--take-over is for --foreground"),
    ):
        assert main(["up", str(TALKER), *words]) == 2
        assert because in capsys.readouterr().err


class Supervisor:
    """What systemd is for the manager: it has a socket for notices, reads what is printed, and sends signals."""

    def __init__(self, midstride: Midstride, folder: Path) -> None:
        self.midstride, self.output = midstride, folder / "output"
        self._address = folder / "notify"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self._address))
        self._socket.setblocking(False)
        self._process: subprocess.Popen[bytes] | None = None
        self.told: list[str] = []

    def start(self, *words: str) -> int:
        """Start a manager; its process number."""
        self.told.clear()
        with self.output.open("wb") as output:
            self._process = subprocess.Popen(
                self.midstride.command("up", *words, "--foreground"),
                env={**self.midstride.environment, "NOTIFY_SOCKET": str(self._address), "WATCHDOG_USEC": "3000000"},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        return self._process.pid

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, (self.told, self.output.read_text())
            time.sleep(0.02)

    def has(self, begin: str) -> bool:
        """Return whether an assignment was told that begins so."""
        try:
            while True:
                self.told += self._socket.recv(65536).decode().split("\n")
        except BlockingIOError:
            return any(each.startswith(begin) for each in self.told)

    def ready(self) -> None:
        self.until(lambda: self.has("READY=1"))

    def end(self, number: signal.Signals) -> int:
        assert self._process is not None
        self._process.send_signal(number)
        return self._process.wait(PATIENCE)

    def ended(self) -> int:
        assert self._process is not None
        return self._process.wait(PATIENCE)

    def close(self) -> None:
        self._socket.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()


@pytest.fixture
def supervisor(midstride: Midstride) -> Iterator[Supervisor]:
    found = Supervisor(midstride, midstride.runtime)
    try:
        yield found
    finally:
        found.close()
        midstride("down")


def processes(midstride: Midstride) -> dict[str, int]:
    status = midstride("status", "--json").json
    return {each["name"]: each["pid"] for each in status["instances"]}


@pytest.mark.full
@pytest.mark.ros2
def test_components_outlive_the_manager_that_the_command_is(supervisor: Supervisor) -> None:
    midstride = supervisor.midstride
    file = midstride.runtime / "talker.stride"
    file.write_text(TALKER.read_text().replace('"python3 ', f'"python3 {TALKER.parent}/'))
    words = (str(file), "--take-over", "talker")
    started = supervisor.start(*words)
    supervisor.ready()
    assert supervisor.has("STATUS=up, all 2 nodes run")
    assert "talker is up with " in supervisor.output.read_text()
    assert Workspace(midstride.runtime / "midstride" / "talker").manager() == started
    running = processes(midstride)
    environment = Path(f"/proc/{running['talker']}/environ").read_bytes()
    assert b"NOTIFY_SOCKET" not in environment and b"WATCHDOG" not in environment
    assert supervisor.end(signal.SIGKILL) == -signal.SIGKILL
    file.write_text("system talker\nhalf a line")  # somebody edits it meanwhile
    supervisor.start(*words)
    supervisor.ready()
    assert processes(midstride) == running
    assert "The system is taken over as it runs" in supervisor.output.read_text()
    # For systemd that is a failure: it starts another one.
    assert supervisor.end(signal.SIGTERM) == 128 + signal.SIGTERM
    supervisor.start(*words)
    supervisor.ready()
    assert processes(midstride) == running
    os.kill(running["listener"], signal.SIGKILL)
    supervisor.until(lambda: supervisor.has(DEGRADED))
    assert midstride("down").status == 0 and supervisor.ended() == 0
    assert supervisor.has("STOPPING=1") and supervisor.has("STATUS=down")
    talker = process_info(running["talker"])
    assert talker is None or not talker.alive


class Unit:
    """The unit of the talker in a systemd of its own, with files that a test can change."""

    NAME = "midstride-talker"

    def __init__(self, midstride: Midstride, folder: Path, *options: str) -> None:
        self.midstride = midstride
        for file in TALKER.parent.iterdir():
            if file.is_file():
                (folder / file.name).write_bytes(file.read_bytes())
        self.file = folder / TALKER.name
        self.systemd = PrivateSystemd(folder)
        unit = self.systemd.units / f"{self.NAME}.service"
        assert midstride("systemd", str(self.file), *options, "-o", str(unit)).status == 0
        settings = self.systemd.units / f"{unit.name}.d"
        settings.mkdir()
        (settings / "test.conf").write_text("[Service]\nWatchdogSec=4\n")
        wanted = self.systemd.units / "multi-user.target.wants"
        wanted.mkdir()
        (wanted / unit.name).symlink_to(unit)

    def __call__(self, verb: str, *words: str) -> int:
        return self.systemd.ctl(verb, *words, self.NAME).returncode

    def show(self, name: str) -> str:
        return self.systemd.show(self.NAME, name)

    def kill(self, number: str) -> None:
        """Send a signal to the manager alone, and wait for the next one."""
        restarts = int(self.show("NRestarts")) + 1
        assert self("kill", "--kill-whom=main", f"--signal={number}") == 0
        self.systemd.until(lambda: self.show("NRestarts") == str(restarts))
        self.active()

    def active(self) -> None:
        self.systemd.until(lambda: self.show("ActiveState") == "active")

    def processes(self) -> set[str]:
        """The processes in the unit's control group, but for the manager's."""
        if not (group := self.show("ControlGroup")):
            return set()
        found = set((self.systemd.group / group.strip("/") / "cgroup.procs").read_text().split())
        return found - {self._outside(self.show("MainPID"))}

    def _outside(self, pid: str) -> str:
        for status in Path("/proc").glob("[0-9]*/status"):
            try:
                numbers = next(line for line in status.read_text().splitlines() if line.startswith("NSpid:")).split()
            except OSError:
                continue
            if len(numbers) > 2 and numbers[-1] == pid:
                return numbers[1]
        raise AssertionError(pid)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run `midstride` where the unit's processes are."""
        environment = {"XDG_RUNTIME_DIR": str(self.midstride.runtime)}
        return self.systemd.run(sys.executable, "-m", "midstride", *words, **environment)


@pytest.mark.long
@pytest.mark.ros2
@pytest.mark.parametrize("setup", [False, True], ids=["with the paths of the shell", "with a script"])
def test_a_unit_in_a_systemd(setup: bool, midstride: Midstride) -> None:
    if (because := why_not()) is not None:
        pytest.skip(because)
    folder = midstride.runtime / "robot"
    folder.mkdir()
    script = folder / "setup.bash"
    script.write_text(
        "".join(
            f"export {name}='{os.environ[name]}'\n"
            for name in ("PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH", "ROS_DISTRO")
            if name in os.environ
        )
    )
    unit = Unit(midstride, folder, *(["--setup", str(script)] if setup else []))
    text = unit.file.read_text()
    with unit.systemd:
        unit.active()  # as it is wanted at boot
        assert unit.show("StatusText") == "up, all 2 nodes run"
        components = unit.processes()
        assert len(components) == 2
        unit.kill("KILL")
        assert unit.processes() == components
        unit.kill("TERM")
        assert unit.processes() == components
        unit.kill("STOP")  # it does not say any more that its loop turns
        assert unit.processes() == components

        unit.file.write_text("system talker\nnonsense")
        assert unit("reload") != 0 and unit.show("ActiveState") == "active"
        unit.kill("KILL")
        assert unit.processes() == components
        unit.file.write_text(OTHER_TALKER)
        assert unit("reload") == 0
        assert unit.run("status").stdout.count("NewTalker") == 1
        assert len(unit.processes() & components) == 1 and len(unit.processes()) == 2

        assert unit("restart") == 0
        assert not unit.processes() & components
        listener = midstride("status", "--json").json["instances"][0]["pid"]
        assert unit.systemd.run("kill", "-9", str(listener)).returncode == 0
        unit.systemd.until(lambda: unit.show("StatusText").startswith("degraded, 1 of 2 nodes run"))
        assert unit.show("ActiveState") == "active" and unit.show("NRestarts") == "0"
        assert unit("stop") == 0
        assert (unit.show("ActiveState"), unit.show("Result"), unit.processes()) == ("inactive", "success", set())

        assert unit("start") == 0
        assert unit.run("down").returncode == 0  # by hand
        unit.systemd.until(lambda: unit.show("ActiveState") == "inactive")
        time.sleep(3)  # longer than RestartSec
        assert (unit.show("ActiveState"), unit.show("NRestarts")) == ("inactive", "0")

        assert unit.run("up", str(unit.file), "--detach").returncode == 0  # by hand
        assert unit("start") != 0 and unit.show("ActiveState") == "failed"
        assert unit.run("status").returncode == 0
        assert unit.run("down").returncode == 0

        unit.file.write_text("nonsense")
        assert unit("start") != 0 and unit.show("ActiveState") == "failed"
        unit.file.write_text(text)
        (folder / "talker.py").write_text("raise SystemExit(4)\n")
        assert unit("start") == 0  # what can be started is up
        assert unit.show("StatusText").startswith("degraded, 1 of 2 nodes run: talker exited with status 4")
        assert unit("stop") == 0
        (folder / "listener.py").write_text("raise SystemExit(4)\n")
        unit("start", "--no-block")
        unit.systemd.until(lambda: int(unit.show("NRestarts")) > 1)  # nothing runs: again and again
        assert unit("stop") == 0 and unit.processes() == set()

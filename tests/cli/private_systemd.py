"""A systemd as the first process of namespaces of its own: with units from one folder, and none of the machine's.

It needs root, unshare(1), nsenter(1) and a cgroup2 that can be written. Processes, mounts, network, host name, IPC and
control groups are its own; files and shared memory are the machine's. What is left of it ends with it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

SYSTEMD = Path("/lib/systemd/systemd")
PATIENCE = 90.0
TARGETS = ("basic", "sysinit", "shutdown", "default", "multi-user")
NAMESPACES = ("--pid", "--fork", "--mount", "--cgroup", "--uts", "--ipc", "--net", "--mount-proc", "--kill-child")
# No setting of the machine is changed from inside: /proc/sys is read-only there, as in a container.
BEGIN = """set -e
mount --make-rprivate /
ip link set lo up
umount -R /sys/fs/cgroup
mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs -o mode=755 tmpfs /run
mkdir -p /run/systemd
mount --bind /proc/sys /proc/sys
mount -o remount,bind,ro /proc/sys
mount --bind "$LOG" /dev/console
exec "$@"
"""


def cgroup() -> Path | None:
    """Where the machine has its cgroup2."""
    found = (Path("/sys/fs/cgroup"), Path("/sys/fs/cgroup/unified"))
    return next((path for path in found if (path / "cgroup.procs").exists() and os.access(path, os.W_OK)), None)


def why_not() -> str | None:
    """The reason why no systemd can run here, if there is one."""
    for program in ("unshare", "nsenter", "ip", "systemctl"):
        if shutil.which(program) is None:
            return f"there is no {program}"
    if not SYSTEMD.exists():
        return "systemd is not installed"
    if os.geteuid() != 0 or cgroup() is None:
        return "a systemd of its own needs root and a cgroup2 that can be written"
    tried = subprocess.run(["unshare", *NAMESPACES, "true"], capture_output=True, text=True, check=False)
    return tried.stderr.strip() if tried.returncode else None


class PrivateSystemd:
    """Runs from ``with`` on; ``units`` is the folder of its units, ``log`` the file of what it says."""

    def __init__(self, folder: Path) -> None:
        self.units, self.log = folder / "units", folder / "systemd.log"
        self.group = cgroup() / f"midstride-test-{os.getpid()}" if cgroup() else folder  # type: ignore[operator]
        self._unshare: subprocess.Popen[bytes] | None = None
        self.units.mkdir()
        (self.units / "service.d").mkdir()  # holds for every service
        self.output = folder / "output"
        (self.units / "service.d" / "output.conf").write_text(f"[Service]\nStandardOutput=append:{self.output}\n")
        for name in TARGETS:
            (self.units / f"{name}.target").write_text(f"[Unit]\nDescription={name}\n")
        (self.units / "default.target").write_text("[Unit]\nDescription=default\nWants=multi-user.target\n")

    def __enter__(self) -> PrivateSystemd:
        self.group.mkdir()
        systemd = [str(SYSTEMD), "--system", "--log-target=console", "--log-level=info", "--show-status=no"]
        enter = f'echo $$ > {self.group}/cgroup.procs && exec unshare {" ".join(NAMESPACES)} sh -c "$0" sh "$@"'
        inherited = {"PATH": os.environ["PATH"]}
        with self.log.open("wb") as log:
            self._unshare = subprocess.Popen(
                ["sh", "-c", enter, BEGIN, *systemd],
                env={**inherited, "SYSTEMD_UNIT_PATH": str(self.units), "container": "other", "LOG": str(self.log)},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.until(lambda: self.ctl("is-system-running").stdout.strip() in ("running", "degraded", "starting"))
        return self

    def __exit__(self, *_: object) -> None:
        assert self._unshare is not None
        self._unshare.kill()
        self._unshare.wait()
        self.until(lambda: not self._left())
        for folder in sorted(self.group.rglob("*/"), reverse=True):
            folder.rmdir()
        self.group.rmdir()

    def _left(self) -> list[str]:
        return [line for path in self.group.rglob("cgroup.procs") for line in path.read_text().split()]

    def pid(self) -> int | None:
        """The number of systemd's process outside."""
        assert self._unshare is not None
        children = Path(f"/proc/{self._unshare.pid}/task/{self._unshare.pid}/children").read_text().split()
        return int(children[0]) if children else None

    def ctl(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run systemctl inside."""
        if (pid := self.pid()) is None or Path(f"/proc/{pid}/comm").read_text().strip() != "systemd":
            return subprocess.CompletedProcess(words, 1, "", "it has not begun")
        return self.run("systemctl", *words)

    def run(self, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command inside."""
        command = ["nsenter", "-a", "-t", str(self.pid()), *words]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE, check=False, env={**os.environ, **environment}
        )

    def show(self, unit: str, name: str) -> str:
        return self.ctl("show", unit, "--property", name, "--value").stdout.strip()

    def said(self) -> str:
        """The latest of what systemd and its services have printed."""
        return "".join(path.read_text(errors="replace")[-4000:] for path in (self.log, self.output) if path.exists())

    def until(self, condition: Callable[[], object], patience: float = PATIENCE) -> None:
        """Wait for a condition. Fails, with the log, where it does not come."""
        end = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < end, self.said()
            time.sleep(0.05)

"""The workspace: private, locked by one manager, and never half written."""

from __future__ import annotations

import fcntl
import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride.errors import ManagerBusy, ManagerError
from midstride.runtime.workspace import Workspace


@pytest.fixture(autouse=True)
def runtime_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    # Sockets have short paths, and pytest's own temporary folders long ones.
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


def test_the_workspace_is_a_private_folder_named_after_the_system(runtime_folder: Path) -> None:
    workspace = Workspace.of("patrol")
    assert workspace.path == runtime_folder / "midstride" / "patrol"
    assert stat.S_IMODE(workspace.path.stat().st_mode) == 0o700


def test_the_folder_of_logs_is_there_and_private_when_it_is_asked_for() -> None:
    workspace = Workspace.of("patrol")
    for _ in range(2):
        assert stat.S_IMODE(workspace.logs.stat().st_mode) == 0o700
    assert workspace.manager_log.parent == workspace.logs == workspace.path / "logs"


@pytest.mark.parametrize("name", ["", "../patrol", "a/b", ".hidden"])
def test_a_name_that_is_no_folder_is_refused(name: str) -> None:
    with pytest.raises(ManagerError, match="cannot name a running system"):
        Workspace.of(name)


def test_one_manager_at_a_time() -> None:
    workspace = Workspace.of("patrol")
    with workspace.lock(), pytest.raises(ManagerBusy, match=str(os.getpid())), workspace.lock():
        pass
    with workspace.lock():
        pass


def test_what_clears_the_temporary_folder_finds_it_locked_while_a_manager_runs() -> None:
    """So does systemd-tmpfiles, which skips a folder that it cannot lock."""

    def clear() -> None:
        folder = os.open(workspace.path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(folder)

    workspace = Workspace.of("patrol")
    with workspace.lock(), pytest.raises(BlockingIOError):
        clear()
    clear()


def test_a_system_is_listed_while_its_state_is_there() -> None:
    workspace = Workspace.of("patrol")
    assert Workspace.all() == []
    workspace.state.touch()
    assert Workspace.all() == [workspace]
    workspace.state.unlink()
    assert Workspace.all() == []


@pytest.mark.parametrize("folder", ["a file", "a file/deeper"])
def test_a_folder_that_cannot_be_made_is_named(
    folder: str, runtime_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (runtime_folder / "a file").write_text("")
    path = runtime_folder / folder
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    with pytest.raises(ManagerError, match=f"cannot create the folder {path}/midstride.*XDG_RUNTIME_DIR"):
        Workspace.of("patrol")


def test_a_socket_s_path_must_be_short(runtime_folder: Path) -> None:
    room = 107 - len(f"{runtime_folder}/midstride//manager.sock")
    assert Workspace.of("p" * room).path.is_dir()
    with pytest.raises(ManagerError, match=r"manager.sock is 2 bytes too long for a socket: shorten the name"):
        Workspace.of("p" * (room + 2))


def test_a_full_disk_is_told_before_anything_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    workspace = Workspace.of("patrol")
    workspace.require_room()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ManagerError, match=r"cannot write to .*/patrol: No space left on device"):
        workspace.require_room()
    assert not list(workspace.path.iterdir())


def test_a_manager_is_known_whether_it_answers_or_not() -> None:
    workspace = Workspace.of("patrol")
    assert workspace.manager() is None
    with workspace.lock():
        assert workspace.manager() is None  # held, but by no manager
    command = [sys.executable, "-S", "-c", "print(1, flush=True); input()", "_manager"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()  # the kernel may show no command line yet when Popen returns
        with workspace.lock():
            (workspace.path / "lock").write_text(str(process.pid))
            assert workspace.manager() == process.pid
        assert workspace.manager() is None  # it is about to end
        process.communicate(b"\n")
    with workspace.lock():
        (workspace.path / "lock").write_text(str(process.pid))
        assert workspace.manager() is None


def test_a_system_whose_state_somebody_removed_is_known_as_long_as_its_manager_runs() -> None:
    workspace = Workspace.of("patrol")
    holding = "import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_EX); print(1, flush=True); input()"
    with workspace.lock():
        pass
    command = [sys.executable, "-c", holding, str(workspace.path / "lock"), "_manager"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as manager:
        assert manager.stdout is not None
        manager.stdout.readline()
        (workspace.path / "lock").write_text(str(manager.pid))
        assert Workspace.all() == [workspace]
        manager.communicate(b"\n")
    assert Workspace.all() == []

"""The workspace of a host process: `up` makes it in the folder of the programs, and a check nowhere near them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec
import pytest

from midstride.errors import ManagerError
from midstride.runtime.hosts import host_start
from midstride.runtime.hosts.host_frames import HOST_PROTOCOL
from midstride.runtime.hosts.host_order import HostOrder
from midstride.runtime.hosts.host_start import find_or_start, remove_passing, workspace_of
from midstride.runtime.workspace import Workspace


def order(folder: Path, *, reads: bool = False) -> HostOrder:
    return HostOrder(protocol=HOST_PROTOCOL, system="home", host="arm", folder=str(folder), reads=reads)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of programs, with a temporary folder beside it."""
    for name in ("programs", "tmp"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    return tmp_path / "programs"


@pytest.mark.parametrize("reads", [True, False])
def test_a_folder_that_is_not_there_is_named_and_not_made(folder: Path, *, reads: bool) -> None:
    wrong = folder / "robto"
    found = find_or_start(order(wrong, reads=reads), "1").problem
    assert found == (
        f"the folder {wrong} is not there: correct `folder`, or create it and copy the programs of this host to it"
    )
    assert not wrong.exists()


def test_a_check_makes_nothing_in_the_folder_of_the_programs(folder: Path) -> None:
    space = workspace_of(order(folder, reads=True))
    assert list(folder.iterdir()) == [] and space.path.is_dir() and space.name == "home.arm"
    remove_passing(space)
    assert list((folder.parent / "tmp").iterdir()) == []


def test_a_check_beside_a_system_has_its_workspace(folder: Path) -> None:
    space = workspace_of(order(folder))
    assert workspace_of(order(folder, reads=True)) == space
    remove_passing(space)
    assert space.path == folder / ".midstride" / "home.arm" and space.path.is_dir()


def test_a_check_says_that_nothing_can_be_written_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    with pytest.raises(ManagerError, match=r"cannot be written by .* \(No space left on device\)"):
        workspace_of(order(folder, reads=True))


def test_a_host_process_that_does_not_start_for_a_check_leaves_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: HostOrder, workspace: Workspace) -> None:
        raise ManagerError("it has no ROS")

    monkeypatch.setattr(host_start, "start", fails)
    assert find_or_start(order(folder, reads=True), "1").problem == "it has no ROS"
    assert list((folder.parent / "tmp").iterdir()) == []


def test_the_host_process_of_a_check_removes_its_workspace(folder: Path) -> None:
    wanted = msgspec.structs.replace(order(folder, reads=True), backend="no such back end")
    space = workspace_of(wanted)
    done = subprocess.run(
        [sys.executable, "-m", "midstride", "_host", str(space.path)],
        input=msgspec.json.encode(wanted) + b"\n",
        capture_output=True,
        timeout=60,
    )
    assert done.returncode != 0 and not space.path.parent.exists(), done.stderr

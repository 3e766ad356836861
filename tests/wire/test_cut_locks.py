"""The lock of a cut: one of its two sides has it, whatever their processes, until it gives it back or ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from midstride.wire.cut_locks import FileLock
from midstride.wire.pipe import PipeLock, PipeNetwork
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import CutLock

HOLDER = """
import sys, pathlib
from midstride.wire.cut_locks import FileLock
lock = FileLock(pathlib.Path(sys.argv[1]), "cut")
print(lock.take(), flush=True)
sys.stdin.read()
"""


def exchanged(one: CutLock, other: CutLock, unrelated: CutLock) -> list[bool]:
    seen = [one.take(), one.take(), other.take(), unrelated.take()]
    other.give_back()  # which has none
    seen.append(other.take())
    one.give_back()
    return [*seen, other.take(), one.take()]


def test_one_side_has_it(tmp_path: Path) -> None:
    expected = [True, True, False, True, False, True, False]
    folder, pipes = SocketFolder(tmp_path), PipeNetwork()
    assert exchanged(*(folder.cut_lock(cut) for cut in ("a", "a", "b"))) == expected
    assert exchanged(*(pipes.cut_lock(cut) for cut in ("a", "a", "b"))) == expected
    assert folder.present() == {}, "it is no component"


def test_whether_another_side_has_it_can_be_seen_without_taking_it(tmp_path: Path) -> None:
    folder, pipes = SocketFolder(tmp_path), PipeNetwork()
    for one, other, unrelated in (
        [folder.cut_lock(cut) for cut in ("a", "a", "b")],
        [pipes.cut_lock(cut) for cut in ("a", "a", "b")],
    ):
        seen = [one.is_taken, other.is_taken]
        assert one.take()
        seen += [one.is_taken, other.is_taken, unrelated.is_taken]
        one.give_back()
        assert [*seen, one.is_taken, other.is_taken] == [False, False, False, True, False, False, False]
        assert other.take() and one.is_taken
        other.give_back()
    assert not FileLock(tmp_path / "no folder" / "locks", "a").is_taken


def test_a_lock_can_be_renounced_while_it_is_not_held(tmp_path: Path) -> None:
    folder, pipes = SocketFolder(tmp_path), PipeNetwork()
    for one, other in ((folder.cut_lock("a"), folder.cut_lock("a")), (pipes.cut_lock("a"), pipes.cut_lock("a"))):
        assert one.take() and not one.renounce() and one.take()
        assert other.renounce() and not other.take()
        one.give_back()
        assert not other.take() and one.take()


def test_the_end_of_its_process_gives_it_back(tmp_path: Path) -> None:
    path = tmp_path / "locks"
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "True\n"
        lock = FileLock(path, "cut")
        assert not lock.take()
        process.kill()
        process.wait()
        assert lock.take()


FORKING = """
import os, pathlib, sys
from midstride.wire.cut_locks import FileLock
locks = {cut: FileLock(pathlib.Path(sys.argv[1]), cut) for cut in ("dropped", "kept")}
others = {cut: FileLock(pathlib.Path(sys.argv[1]), cut) for cut in locks}
assert all(lock.take() for lock in locks.values())
ended, forked = os.pipe(), os.pipe()
child = os.fork()
if not child:
    os.close(ended[1])
    del locks["dropped"]
    os.write(forked[1], b"x")
    os.read(ended[0], 1)  # until the parent is done
    os._exit(0)
os.read(forked[0], 1)
print(others["dropped"].take(), others["kept"].take())
locks["kept"].give_back()
print(others["kept"].take())
os.close(ended[1])
os.waitpid(child, 0)
"""


def test_a_lock_is_given_back_while_a_forked_child_lives_and_not_by_that_child(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FORKING, str(tmp_path / "locks")]
    assert subprocess.run(command, capture_output=True, text=True, timeout=60).stdout.split() == [
        "False",
        "False",
        "True",
    ]


def test_a_forked_child_closes_the_file_and_leaves_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As above, in one process: a second descriptor is that of the parent."""
    lock, other = FileLock(tmp_path / "locks", "cut"), FileLock(tmp_path / "locks", "cut")
    assert lock.take() and lock._descriptor is not None
    of_the_parent = os.dup(lock._descriptor)
    with monkeypatch.context() as child:
        child.setattr(os, "getpid", lambda: -1)
        lock.give_back()
    assert not other.take()
    os.close(of_the_parent)
    assert other.take()


def test_a_lock_costs_a_descriptor_until_it_is_given_back(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    locks = [FileLock(tmp_path / "locks", "cut") for _ in range(10)]
    assert len(os.listdir("/proc/self/fd")) == before
    assert [lock.take() for lock in locks] == [True] + 9 * [False]
    assert len(os.listdir("/proc/self/fd")) == before + 10
    for lock in locks[5:]:
        lock.give_back()
    assert len(os.listdir("/proc/self/fd")) == before + 5
    locks.clear()
    del lock
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_lock_is_inherited_only_from_a_side_that_had_it_in_the_same_place(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    folder, elsewhere = SocketFolder(tmp_path), SocketFolder(tmp_path / "other")
    pipes = PipeNetwork()
    for one, other, apart in (
        (folder.cut_lock("a"), folder.cut_lock("a"), elsewhere.cut_lock("a")),
        (pipes.cut_lock("a"), pipes.cut_lock("a"), PipeLock({}, "a", "another memory")),
    ):
        assert one.take()
        apart.share(one.place)
        assert apart.place != one.place != "" and not apart.take_freed(), "nobody had this one"
        assert not other.take_freed(), "it does not know yet that the two are one"
        other.share(one.place)
        assert not other.take_freed(), "the other side has it"
        one.give_back()
        assert not apart.take_freed() and other.take_freed() and not one.take()


def test_what_was_found_taken_can_be_inherited(tmp_path: Path) -> None:
    """Where the new side has not reported where its lock is."""
    folder, pipes = SocketFolder(tmp_path), PipeNetwork()
    for one, other in ((folder.cut_lock("a"), folder.cut_lock("a")), (pipes.cut_lock("a"), pipes.cut_lock("a"))):
        assert not other.take_freed() and one.take() and not other.take() and not other.take_freed()
        one.give_back()
        assert other.take_freed() and not one.take()


def test_a_file_that_is_removed_and_made_again_does_not_free_it(tmp_path: Path) -> None:
    path = tmp_path / "locks"
    one, other = FileLock(path, "cut"), FileLock(path, "cut")
    assert one.take() and not other.take()
    path.unlink()
    path.touch()
    assert not other.take_freed(), "the file in which the other side has its lock counts"
    one.give_back()
    assert other.take_freed()


def test_without_its_folder_neither_side_has_it(tmp_path: Path) -> None:
    assert not FileLock(tmp_path / "none" / "locks", "cut").take()

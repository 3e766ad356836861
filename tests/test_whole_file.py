"""A file is replaced in one step, or stays as it was."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from midstride.whole_file import write_whole


def permissions(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_a_file_keeps_its_permissions_and_a_new_one_has_those_of_the_umask(tmp_path: Path) -> None:
    file = tmp_path / "a"
    before = os.umask(0o027)
    try:
        write_whole(file, b"1")
        assert (file.read_bytes(), permissions(file)) == (b"1", 0o640)
        file.chmod(0o755)
        write_whole(file, b"2")
        assert (file.read_bytes(), permissions(file)) == (b"2", 0o755)
        write_whole(file, b"3", mode=0o644)
        assert (file.read_bytes(), permissions(file)) == (b"3", 0o644)
    finally:
        os.umask(before)
    assert os.listdir(tmp_path) == ["a"]


def test_a_link_is_kept_and_a_name_may_be_as_long_as_names_are(tmp_path: Path) -> None:
    file = tmp_path / ("a" * 255)
    link = tmp_path / "link"
    link.symlink_to(file)
    write_whole(link, b"1")
    assert link.is_symlink() and file.read_bytes() == b"1"


@pytest.mark.parametrize(("owner", "step"), [(os, "fchmod"), (Path, "replace")])
def test_where_it_fails_the_file_is_as_before_and_nothing_is_left(
    owner: Any, step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"1")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(owner, step, full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(file, b"2")
    assert file.read_bytes() == b"1" and os.listdir(tmp_path) == ["a"]


def test_two_that_write_at_once_do_not_meet(tmp_path: Path) -> None:
    file = tmp_path / "a"
    contents = [bytes([65 + index]) * 5000 for index in range(4)]
    faults: list[BaseException] = []

    def write(content: bytes) -> None:
        try:
            for _ in range(50):
                write_whole(file, content)
                assert file.read_bytes() in contents
        except BaseException as error:
            faults.append(error)

    threads = [threading.Thread(target=write, args=(content,)) for content in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == [] and os.listdir(tmp_path) == ["a"]

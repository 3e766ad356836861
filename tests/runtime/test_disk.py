"""The databases of a manager: what cannot be used is left as it was found, and not kept open."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

import pytest

from midstride.runtime.records.disk import Disk, refused

SCHEMA = "CREATE TABLE IF NOT EXISTS rows (value)"


def is_open(path: Path) -> bool:
    """Whether this process has ``path`` open."""
    found = []
    for descriptor in os.listdir("/proc/self/fd"):
        try:
            found.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        except FileNotFoundError:  # that of the listing itself
            continue
    return str(path) in found


def test_a_file_that_is_no_database_is_not_kept_open(tmp_path: Path) -> None:
    path = tmp_path / "state.db"
    path.write_text("this is no database, " * 100)
    with pytest.raises(sqlite3.DatabaseError) as caught:
        Disk().open(path, SCHEMA)
    assert not is_open(path) and not refused(caught.value), "while its error is still being handled"
    with pytest.raises(sqlite3.DatabaseError) as caught:
        Disk().read_only(path)
    assert not is_open(path) and not refused(caught.value)


def test_a_database_is_open_until_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "state.db"
    assert Disk().read_only(path) is None and not path.exists()
    database = Disk().open(path, SCHEMA)
    assert is_open(path)
    database.write([("INSERT INTO rows VALUES (?)", (7,))])
    database.close()
    assert not is_open(path)
    read = Disk().read_only(path)
    assert read is not None and read.read("SELECT value FROM rows") == [(7,)]
    read.close()
    assert not is_open(path)


def test_a_damaged_database_is_set_aside_with_all_of_its_files_and_replaces_an_earlier_one(tmp_path: Path) -> None:
    disk, path = Disk(), tmp_path / "journal.db"
    for content in ("one", "two"):
        for suffix in ("", "-wal", "-shm"):
            path.with_name(path.name + suffix).write_text(content + suffix)
        aside = disk.set_aside(path)
        assert aside == tmp_path / "journal.damaged.db"
        assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {
            f"journal.damaged.db{suffix}": content + suffix for suffix in ("", "-wal", "-shm")
        }
    disk.remove(aside)
    assert list(tmp_path.iterdir()) == []

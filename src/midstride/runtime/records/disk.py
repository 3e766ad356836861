"""The disk, where a manager leaves records for the next one: SQLite databases, which it writes one transaction at a
time.

Every durable write of a manager goes through :meth:`Database.write`. So a test or a simulation that gives the manager
another :class:`Disk` can make a write fail, lose it, or cut it off.
"""

from __future__ import annotations

import os
import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any, Final, TypeAlias

from midstride.codec.writing import expressible
from midstride.errors import Superseded

# A statement in SQL, and its values.
Statement: TypeAlias = tuple[str, Sequence[str | float | None]]

_FILES: Final = ("", "-wal", "-shm")
# SQLite's words for damage that it reports as an error of the statement.
_DAMAGE: Final = ("no such table", "no such column", "Could not decode")


class Database:
    """An open database, usable from any thread. Each method raises sqlite3.Error or OSError."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self.connection = connection
        self._lock = Lock()

    def write(self, statements: Iterable[Statement], only_if: Statement | None = None) -> None:
        """Carry out all of ``statements`` or none; they are durable when the call returns.

        What UTF-8 cannot express, as in the path of a file, is written as an escape: SQLite would refuse all of them.
        Raises Superseded, and writes nothing, unless the query ``only_if`` finds a row.
        """
        with self._lock, self.connection:
            if only_if is not None:
                self.connection.execute("BEGIN IMMEDIATE")
                if self.connection.execute(*only_if).fetchone() is None:
                    raise Superseded("another manager of this system has taken over")
            for statement, values in statements:
                texts = (expressible(value) if isinstance(value, str) else value for value in values)
                self.connection.execute(statement, tuple(texts))

    def read(self, query: str, *values: str | float | None) -> list[tuple[Any, ...]]:
        """The rows that ``query`` finds."""
        with self._lock:
            return self.connection.execute(query, values).fetchall()

    def peek(self, query: str, values: Sequence[str | float | None]) -> list[tuple[Any, ...]] | None:
        """The rows of ``query``, without waiting; None while another thread uses the database, or on an error."""
        if not self._lock.acquire(blocking=False):
            return None
        try:
            return self.connection.execute(query, values).fetchall()
        except sqlite3.Error:
            return None
        finally:
            self._lock.release()

    def close(self) -> None:
        with self._lock, suppress(sqlite3.Error):
            self.connection.close()


class Lease:
    """The right to write to a database of a system, kept in its ``table``: the manager that took it last has it."""

    def __init__(self, table: str) -> None:
        self._superseded = False  # another manager has taken it
        self._acquired = False
        self._holder = (f"{os.getpid()} {secrets.token_hex(8)}",)
        self._acquire: Statement = (f"INSERT OR REPLACE INTO {table} VALUES ('holder', ?)", self._holder)
        self._held: Statement = (f"SELECT 1 FROM {table} WHERE key = 'holder' AND value = ?", self._holder)

    def write(self, database: Database, statements: Iterable[Statement]) -> None:
        """Write ``statements``; the first call takes the lease. Raises Superseded if another manager has it."""
        if not self._acquired:
            database.write([self._acquire, *statements])
            self._acquired = True
            return
        try:
            database.write(statements, only_if=self._held)
        except Superseded:
            self._superseded = True
            raise

    def superseded(self, database: Database | None) -> bool:
        """Return whether another manager has taken the lease, as a look at the database shows, or a write before."""
        if self._acquired and not self._superseded and database is not None:
            self._superseded = database.peek(*self._held) == []
        return self._superseded

    def renew(self) -> None:
        """The database is a new one: the next write takes the lease."""
        self._acquired = False


class ClosingConnection(sqlite3.Connection):
    """A connection that is closed where nothing refers to it any more; from Python 3.13 on, others warn of that.

    A manager that is killed, and one that gives up its system, leave theirs so.
    """

    def __del__(self) -> None:
        with suppress(sqlite3.Error):
            self.close()


class Disk:
    """The databases in files; a missing file is created for its user alone."""

    def open(self, path: Path, schema: str) -> Database:
        """Open the database in ``path``, after the statements of ``schema``, which may be repeated.

        Raises sqlite3.Error or OSError.
        """
        if not path.exists():  # whole, or not at all
            new = path.with_name(f"{path.name}.new")
            self.remove(new)
            os.close(os.open(new, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600))
            _connected(new, schema).close()
            new.rename(path)
        return Database(_connected(path, schema))

    def read_only(self, path: Path) -> Database | None:
        """The database in ``path`` as it is, or None if there is no such file. Raises sqlite3.Error."""
        if not path.exists():
            return None
        # Not SQLite's own read-only mode: what a killed manager wrote last must be taken from the write-ahead log.
        uri = f"{path.absolute().as_uri()}?mode=rw"
        connection = sqlite3.connect(uri, uri=True, factory=ClosingConnection)
        try:
            connection.execute("PRAGMA schema_version")
        except sqlite3.OperationalError:
            # A full disk has no room for the index of that log, which an only user keeps in its own memory.
            connection.close()
            connection = sqlite3.connect(uri, uri=True, factory=ClosingConnection)
            connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        except BaseException:
            connection.close()
            raise
        return Database(connection)

    def remove(self, path: Path) -> None:
        for suffix in _FILES:
            path.with_name(path.name + suffix).unlink(missing_ok=True)

    def set_aside(self, path: Path, because: str = "damaged") -> Path:
        """Keep a database that cannot be used under another name, instead of an earlier one; returns that name."""
        aside = path.with_name(f"{path.stem}.{because}{path.suffix}")
        self.remove(aside)
        for suffix in _FILES:
            with suppress(FileNotFoundError):
                path.with_name(path.name + suffix).rename(aside.with_name(aside.name + suffix))
        return aside


def _connected(path: Path, schema: str) -> sqlite3.Connection:
    connection = sqlite3.connect(path, check_same_thread=False, factory=ClosingConnection)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.executescript(schema)
    except BaseException:
        connection.close()
        raise
    return connection


def refused(error: Exception) -> bool:
    """Return whether the disk, or another user of the file, has refused this now; else the content is at fault."""
    if isinstance(error, sqlite3.OperationalError):
        return not any(words in str(error) for words in _DAMAGE)
    return isinstance(error, OSError)


DISK: Final = Disk()

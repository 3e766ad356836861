"""The disk that a simulated manager writes to: in memory, full at times; a write may be the last of its manager."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from midstride.runtime.records.disk import ClosingConnection, Database, Disk, Statement
from midstride.simulation.killable_manager import Life, ManagerKilled


class SimulatedDisk(Disk):
    """``kill_at``: the next write kills the manager before it, after it, or half-way, which undoes it.

    That is the next one to a table that ``kill_in`` names.
    """

    def __init__(self) -> None:
        self.full = False
        self.kill_at: Literal["before", "after", "torn"] | None = None
        self.kill_in = ""
        # The manager that writes; None for a reader.
        self.life: Life | None = None
        self._files: dict[Path, sqlite3.Connection] = {}

    def open(self, path: Path, schema: str) -> Database:
        if path not in self._files:
            if self.full:
                raise sqlite3.OperationalError("unable to open database file")
            self._files[path] = sqlite3.connect(":memory:", check_same_thread=False, factory=ClosingConnection)
        self._files[path].executescript(schema)
        return _Database(self, self._files[path])

    def read_only(self, path: Path) -> Database | None:
        return _Database(self, self._files[path]) if path in self._files else None

    def remove(self, path: Path) -> None:
        if (connection := self._files.pop(path, None)) is not None:
            connection.close()

    def set_aside(self, path: Path, because: str = "damaged") -> Path:
        self._files.pop(path, None)
        return path


class _Database(Database):
    def __init__(self, disk: SimulatedDisk, connection: sqlite3.Connection) -> None:
        super().__init__(connection)
        self._disk = disk
        self._life = disk.life

    def write(self, statements: Iterable[Statement], *args: Any, **named: Any) -> None:
        if self._life is not None and not self._life.alive:
            raise ManagerKilled
        if self._disk.full:
            super().write((), *args, **named)  # to look at the lease takes no room
            raise sqlite3.OperationalError("database or disk is full")
        statements, killed = list(statements), None
        if any(self._disk.kill_in in query for query, _ in statements):
            killed, self._disk.kill_at = self._disk.kill_at, None
        if killed == "before":
            self._kill()
        if killed == "torn":  # half of it is in the file, and not committed
            statements = [*statements, ("KILLED", ())]
        try:
            super().write(statements, *args, **named)
        except sqlite3.Error:
            if killed == "torn":
                self._kill()
            raise
        if killed == "after":
            self._kill()

    def _kill(self) -> None:
        if self._life is not None:
            self._life.kill()
        raise ManagerKilled

    def close(self) -> None:
        pass  # the file remains

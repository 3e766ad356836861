"""A disk that refuses a file of the folder of gates."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from midstride.foreign import gate_file
from midstride.whole_file import write_whole


class FullDisk:
    """Full for the file ``name`` from its creation on, until :meth:`has_room`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self._monkeypatch, self._name = monkeypatch, name
        monkeypatch.setattr(gate_file, "write_whole", self._write)

    def has_room(self) -> None:
        self._monkeypatch.setattr(gate_file, "write_whole", write_whole)

    def _write(self, path: Path, content: bytes) -> None:
        if path.name == self._name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write_whole(path, content)

"""A disk that refuses the files of the folder of gates."""

from __future__ import annotations

import errno
import os

import pytest

from midstride import whole_file
from midstride.foreign import gate_file


class FullDisk:
    """Full from its creation on, until :meth:`has_room`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._monkeypatch, self._written = monkeypatch, whole_file.write_whole
        monkeypatch.setattr(gate_file, "write_whole", self._refuse)

    def has_room(self) -> None:
        self._monkeypatch.setattr(gate_file, "write_whole", self._written)

    @staticmethod
    def _refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

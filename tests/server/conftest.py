from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest

from midstride.runtime.workspace import Workspace


@pytest.fixture
def workspace(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workspace]:
    with tempfile.TemporaryDirectory(prefix="ms") as folder:  # sockets have short paths, pytest's folders long ones
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Workspace.of("talker")

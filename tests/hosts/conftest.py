from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def tmp_path() -> Iterator[Path]:
    """A folder for the sockets of hosts, whose paths must be short: those of pytest's own folders are long."""
    with tempfile.TemporaryDirectory(prefix="ms", ignore_cleanup_errors=True) as folder:
        yield Path(folder)

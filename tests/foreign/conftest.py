"""What the tests of the gate share: the library, compiled once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from midstride.foreign import build


@pytest.fixture(scope="session")
def gate_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled library of the sources as they are."""
    cache = tmp_path_factory.mktemp("cache")
    return build.library({**os.environ, "XDG_CACHE_HOME": str(cache)})

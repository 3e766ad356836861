"""The limit of open files: raised for a manager, and not for what it starts."""

from __future__ import annotations

import asyncio
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride.model.component import KILL_AT_ONCE
from midstride.runtime.process import descriptors
from midstride.runtime.process.child_process import spawn


@pytest.fixture
def soft(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The low soft limit that this process was started with; above what other tests have left open in it."""
    monkeypatch.setattr(descriptors, "_given", None)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = 200 + max(map(int, os.listdir("/proc/self/fd")))
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, before[1]))
    yield limit
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def limit_of_a_child(folder: Path) -> int:
    async def main() -> int:
        process = spawn(["sleep", "600"], folder, os.environ, folder / "log")
        try:
            return resource.prlimit(process.pid, resource.RLIMIT_NOFILE)[0]
        finally:
            await process.end(KILL_AT_ONCE)
            process.close()

    return asyncio.run(main())


def test_components_keep_the_limit_that_the_user_had(soft: int, tmp_path: Path) -> None:
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    descriptors.raise_limit()
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (min(hard, descriptors.MOST), hard)
    descriptors.raise_limit()  # nothing is left to raise, and what was given is not forgotten
    assert limit_of_a_child(tmp_path) == soft


def test_no_limit_is_lowered(soft: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descriptors, "MOST", soft - 1)
    descriptors.raise_limit()
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] == soft == limit_of_a_child(tmp_path)

"""A container that runs gets no node whose library is another one than that which it may have loaded."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.backends.ros2.manager.shared_processes import SharedProcess
from midstride.errors import StartFailed
from midstride.runtime.process.reaper import process_info


def test_a_library_that_was_installed_meanwhile_is_refused_also_with_an_old_time(tmp_path: Path) -> None:
    own = process_info(os.getpid())
    assert own is not None
    process: Any = SimpleNamespace(started=own.started)
    shared = SharedProcess("front/pipeline", process, None)
    shared.require_current("front/camera", Path(os.__file__))
    shared.require_current("front/camera", tmp_path / "libabsent.so")
    library = tmp_path / "libcamera.so"
    library.write_bytes(b"new")
    os.utime(library, (1, 1))  # as of a package, whose files keep the times at which they were made
    with pytest.raises(StartFailed, match=r"cannot be loaded into front/pipeline: .*libcamera.so has changed since"):
        shared.require_current("front/camera", library)

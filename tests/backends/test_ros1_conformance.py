"""ROS 1 passes what every back end must pass."""

from __future__ import annotations

import uuid
from pathlib import Path

import pytest

from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import Reaper
from tests.backends.conformance import CHECKS_ON_ROS
from tests.backends.ros1_support import own_master_uri
from tests.backends.ros2_support import run
from tests.conformance import Check

pytestmark = pytest.mark.ros1

# The checks' own token is the same in every run, and another run may be going on.
OURS = "MIDSTRIDE_TEST_RUN"


@pytest.mark.parametrize("check", CHECKS_ON_ROS)
def test_ros1(check: Check, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride.backends.ros1 import create_backend

    this = uuid.uuid4().hex
    monkeypatch.setenv(OURS, this)
    with own_master_uri(), Reaper(OURS, this) as guarding:
        backend = create_backend(tmp_path / "components", logs=tmp_path / "logs", guardian=guarding)
        run(check(backend, tmp_path))
        assert reaper.remaining_groups({}, OURS, this) - {guarding.pid} == set()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 112))
def test_ros1_does_what_random_sequences_ask(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulator is asked the same ones (tests/backends/test_simulator_conformance.py)."""
    from midstride.backends.ros1 import create_backend
    from tests.conformance.walks import walk

    this = uuid.uuid4().hex
    monkeypatch.setenv(OURS, this)
    with own_master_uri(), Reaper(OURS, this) as guarding:
        backend = create_backend(tmp_path / "components", logs=tmp_path / "logs", guardian=guarding)
        run(walk(backend, tmp_path, seed))

"""ROS 2 passes what every back end must pass."""

from __future__ import annotations

import uuid
from pathlib import Path

import pytest

from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import Reaper
from tests.backends.conformance import CHECKS_ON_ROS, SERVICE_CHECKS_ON_ROS
from tests.backends.ros2_support import run
from tests.conformance import Check
from tests.conformance.walks import walk

pytestmark = pytest.mark.ros2

# The checks' own token is the same in every run, and another run may be going on.
OURS = "MIDSTRIDE_TEST_RUN"


def held(check: Check, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride.backends.ros2 import create_backend

    this = uuid.uuid4().hex
    monkeypatch.setenv(OURS, this)
    with Reaper(OURS, this) as guarding:
        backend = create_backend(folder / "components", logs=folder / "logs", guardian=guarding)
        run(check(backend, folder))
        assert reaper.remaining_groups({}, OURS, this) - {guarding.pid} == set()


@pytest.mark.parametrize("check", [*CHECKS_ON_ROS, *SERVICE_CHECKS_ON_ROS])
def test_ros2(check: Check, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held(check, tmp_path, monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 110))
def test_ros2_does_what_random_sequences_ask(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held(lambda backend, folder: walk(backend, folder, seed), tmp_path, monkeypatch)

"""The simulator passes what every back end must pass."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.testing.conformance import CHECKS, Check


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: str(check.__name__))
def test_the_simulator(check: Check, tmp_path: Path) -> None:
    simulator = Simulator()
    simulator.run(check(simulator, tmp_path))

"""The simulator passes what every back end must pass."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from tests.conformance import CHECKS, SERVICE_CHECKS, Check
from tests.conformance.walks import walk


@pytest.mark.parametrize("check", [*CHECKS, *SERVICE_CHECKS], ids=lambda check: str(check.__name__))
def test_the_simulator(check: Check, tmp_path: Path) -> None:
    simulator = Simulator()
    simulator.run(check(simulator, tmp_path))


@pytest.mark.parametrize("seed", range(100, 120))
@pytest.mark.parametrize("services", [False, True], ids=["topics", "services"])
def test_the_simulator_does_what_random_sequences_ask(seed: int, services: bool, tmp_path: Path) -> None:
    simulator = Simulator(jitter=0.002, seed=seed)
    simulator.run(walk(simulator, tmp_path, seed, services))

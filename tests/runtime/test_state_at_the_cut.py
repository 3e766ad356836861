"""State moves between the old one's last write and the new one's first: a bare reader has every number exactly once."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from tests.runtime.counting import Reader, at_rates, counting, exchanged, for_messages, settle, system


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rate", [50, 200])
def test_every_number_of_a_counter_is_written_once(rate: float, seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        phases = random.Random(seed)
        reader = Reader(simulator, "/out")
        for _ in range(10):
            await settle(phases.uniform(0.1, 0.2))
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert [(swap.missed, swap.lost, swap.duplicates) for swap in outcome.swaps] == [(0, 0, 0)]
            assert outcome.late == {}
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 10
        assert reader.longest_gap() < 2 / rate

    counting(
        system(tmp_path, at_rates(out=rate), out=rate), body, Simulator(seed=seed, latency=0.0003, jitter=0.0003)
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("pause", [None, 0.001])
def test_every_message_is_counted_once(pause: float | None, seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        phases = random.Random(seed)
        reader = Reader(simulator, "/out")
        for _ in range(10):
            await settle(phases.uniform(0.1, 0.2))
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        ticks = [int(word.split()[2]) for word in reader.words]
        assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
        assert reader.changes == 10
        assert reader.longest_gap() < 0.03, "with one publisher, the first newer message shows that all older have come"

    counting(
        system(tmp_path, for_messages(pause=pause), source=200),
        body,
        Simulator(seed=seed, latency=0.0003, jitter=0.0003),
    )

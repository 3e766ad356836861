"""The byte-level fuzzer: a few thousand inputs in every run, a million with `make test-long`."""

from __future__ import annotations

import resource
import time
from collections import Counter

import pytest

from .fuzz import MEGABYTES, SECONDS_PER_INPUT, check, inputs

# A million in all, in parts that can be run one by one (`-k 'million and 107'`) or in parallel.
PART = 50_000
SEEDS = range(100, 120)


def _run(count: int, seed: int) -> None:
    reached: Counter[str] = Counter()
    for number, data in enumerate(inputs(count, seed)):
        start = time.process_time()
        try:
            reached[check(data)] += 1
        except Exception as error:
            raise AssertionError(f"input {number} of seed {seed}: {data!r}") from error
        assert time.process_time() - start < SECONDS_PER_INPUT, data
    assert reached.total() == count
    assert all(reached[stage] >= count / 100 for stage in ("not text", "not parsed", "parsed", "loaded")), reached


@pytest.mark.parametrize("count", [400, pytest.param(1500, marks=pytest.mark.full)])
def test_some_mutated_inputs(count: int) -> None:
    _run(count, seed=2)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_million_mutated_inputs(seed: int) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _run(PART, seed)
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024 < MEGABYTES


def test_the_parts_make_a_million() -> None:
    assert PART * len(SEEDS) == 1_000_000

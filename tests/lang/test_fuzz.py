"""The byte-level fuzzer: a few thousand inputs each time, a million with `make test-long`."""

from __future__ import annotations

import resource

import pytest

from .fuzz import MEGABYTES, SECONDS_PER_INPUT, check, inputs


def _run(count: int, seed: int) -> None:
    import time

    for number, data in enumerate(inputs(count, seed)):
        start = time.process_time()
        try:
            check(data)
        except Exception as error:
            raise AssertionError(f"input {number} of seed {seed}: {data!r}") from error
        assert time.process_time() - start < SECONDS_PER_INPUT, data


def test_some_thousand_mutated_inputs() -> None:
    _run(3000, seed=2)


@pytest.mark.long
@pytest.mark.timeout(5400)
def test_a_million_mutated_inputs() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in range(10):
        _run(100_000, seed=100 + seed)
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024 < MEGABYTES

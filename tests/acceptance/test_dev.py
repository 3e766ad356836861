"""`midstride dev` on real ROS 2, beside a bare subscriber: what is saved is swapped in, faulty code is not let in.

MIDSTRIDE_SAVES says how many saves there are of each kind.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.support import benchmark, ended

pytestmark = [pytest.mark.ros2]

RATE = 50.0


@pytest.fixture
def bench() -> Iterator[Any]:
    # The paths of sockets must be short.
    with tempfile.TemporaryDirectory(prefix="ms") as folder, ended():
        made = benchmark("dev").Bench(Path(folder), RATE)
        with made.running():
            yield made


def saved_often(bench: Any, saves: int) -> list[float]:
    """The seconds from each save to the first message of its code."""
    latencies = []
    for number in range(1, saves + 1):
        version = f"v{number}"
        saved = bench.save(bench.talker(version))
        latencies.append(bench.first(version).at - saved)
        time.sleep(0.1)  # the next save comes while this one is measured
    return latencies


def refused_often(bench: Any, saves: int) -> None:
    """Each fault so often: its reason is on the screen, and soon; the old code goes on."""
    for number in range(saves):
        for fault in benchmark("dev").FAULTS:
            seen = len(bench.screen())
            took = bench.refused(fault, number)
            assert fault == "no message at all" or took < 10, f"{fault} is on the screen after {took:.1f} s"
            assert "rejected; the old code keeps running" in bench.screen()[seen:]
            heard = len(bench.heard)
            bench.until(lambda heard=heard: len(bench.heard) > heard, "the old code keeps running")
    assert {message.version for message in bench.heard[-10:]} == {"v0"}


def check_order(bench: Any) -> None:
    heard = len(bench.heard)
    bench.until(lambda: len(bench.heard) > heard + 20, "the topic goes on")
    assert bench.gaps() == []


@pytest.mark.full
def test_saved_code_is_swapped_in_and_no_number_is_missing(bench: Any) -> None:
    saved_often(bench, 5)
    check_order(bench)


@pytest.mark.full
def test_faulty_code_is_not_let_in_and_no_number_is_missing(bench: Any) -> None:
    refused_often(bench, 1)
    check_order(bench)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_fifty_saves(bench: Any) -> None:
    latencies = saved_often(bench, int(os.environ.get("MIDSTRIDE_SAVES", "50")))
    print(f"median {statistics.median(latencies):.2f} s, longest {max(latencies):.2f} s")
    check_order(bench)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_twenty_saves_of_each_fault(bench: Any) -> None:
    refused_often(bench, int(os.environ.get("MIDSTRIDE_SAVES", "20")))
    check_order(bench)

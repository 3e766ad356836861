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
# What is written into the talker's program, and what is then on the screen.
FAULTS = {
    "a syntax error": ("def normal()", "def normal(", "SyntaxError"),
    "an import error": ("from midstride", "import no_such_module\nfrom midstride", "No module named 'no_such_module'"),
    "an exception on the third call": (
        "    count += 1\n",
        "    count += 1\n    calls.append(1)\n    if len(calls) == 3:\n        raise ValueError('the third call')\n",
        "ValueError: the third call",
    ),
    "no message at all": ("    out.write(", "    str(", "has written nothing within"),
}


@pytest.fixture
def bench() -> Iterator[Any]:
    # The paths of sockets must be short.
    with tempfile.TemporaryDirectory(prefix="ms") as folder, ended():
        made = benchmark("dev").Bench(Path(folder), RATE)
        with made.running():
            yield made


def faulty(bench: Any, fault: str) -> str:
    old, new, _ = FAULTS[fault]
    text: str = bench.talker("faulty").replace("count = 0\n", "count = 0\ncalls = []\n")
    assert text.count(old) == 1, old
    return text.replace(old, new)


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
        for fault, (_, _, words) in FAULTS.items():
            seen = len(bench.screen())
            text = faulty(bench, fault) + f"# {number}\n"
            saved = bench.save(text)
            bench.until(lambda seen=seen, words=words: words in bench.screen()[seen:], f"{fault}: {words}")
            took = time.time() - saved
            assert fault == "no message at all" or took < 10, f"{fault} is on the screen after {took:.1f} s"
            assert "not let in, the old code goes on" in bench.screen()[seen:]
            heard = len(bench.heard)
            bench.until(lambda heard=heard: len(bench.heard) > heard, "the old code goes on")
    assert {message.version for message in bench.heard[-10:]} == {"v0"}


def check_order(bench: Any) -> None:
    time.sleep(0.5)
    assert len(bench.heard) > 20
    assert bench.gaps() == []


@pytest.mark.full
@pytest.mark.timeout(300)
def test_saved_code_is_swapped_in_and_no_number_is_missing(bench: Any) -> None:
    saved_often(bench, 5)
    check_order(bench)


@pytest.mark.full
@pytest.mark.timeout(300)
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

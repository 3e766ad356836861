"""Free heap memory is returned to the system. Measured in a fresh process: the heap of the test run is not known."""

from __future__ import annotations

import subprocess
import sys

# 30 MB in pieces that malloc serves, of which the last one keeps the others in the heap when they are freed.
FREED = """
from midstride.backends import heap

def resident():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * 4096

pieces = [bytes(3000) for _ in range(10000)]
del pieces[:-1]
before = resident()
heap.give_back()
print(before - resident())
"""


def test_free_memory_is_given_back() -> None:
    given_back = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True).stdout
    assert int(given_back) > 20_000_000

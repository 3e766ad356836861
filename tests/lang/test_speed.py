"""A thousand nodes are checked in under half a second, start-up included; the time grows with the text alone."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from pathlib import Path

from midstride.lang import load_text

from .systems import chain


def test_check_of_a_thousand_nodes(tmp_path: Path) -> None:
    """Processor time of the whole command, so that a busy machine does not count; the least of three."""
    file = tmp_path / "large.stride"
    file.write_text(chain(1000), encoding="utf-8")
    taken = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "midstride", "check", str(file)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert done.returncode == 0, done.stdout
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(taken) < 0.5, taken


def test_time_grows_with_the_text() -> None:
    def seconds(nodes: int) -> float:
        text, taken = chain(nodes), []
        for _ in range(3):
            start = time.process_time()
            assert load_text(text).specification is not None
            taken.append(time.process_time() - start)
        return min(taken)

    small, large = seconds(500), seconds(4000)
    assert large < 8 * 2.5 * small

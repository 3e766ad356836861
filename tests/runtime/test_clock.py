"""The clock of the operating system, as far as starts are paced by it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from midstride.runtime import manager_clock
from midstride.runtime.manager_clock import SystemClock

STAT = """\
cpu  400 0 400 9000 7 0 0 0 0 0
cpu0 100 0 100 1000 1 0 0 0 0 0
cpu1 100 0 100 3000 2 0 0 0 0 0
cpu2 200 0 200 5000 4 0 0 0 0 0
intr 1 2 3
"""


@pytest.mark.parametrize(
    ("allowed", "ticks"), [({0, 1, 2}, 9000), ({1}, 3000), ({0, 2}, 6000), ({14, 15}, 9000)], ids=str
)
def test_only_the_processors_that_components_run_on_count(
    allowed: set[int], ticks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`taskset`, or a container: the others may be idle while these are busy."""
    (tmp_path / "stat").write_text(STAT)
    monkeypatch.setattr(manager_clock, "STAT", tmp_path / "stat", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: allowed)
    assert SystemClock().processors() == len(allowed)
    assert SystemClock().idle() == ticks / os.sysconf("SC_CLK_TCK")


def test_the_kernel_s_own_figures_are_read() -> None:
    assert SystemClock().idle() >= 0.0

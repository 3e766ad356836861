"""Services of nodes without Midstride's API across replacements: every request is handled once, by bare clients' count.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 200 take too long.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.acceptance.foreign_support import robot
from tests.acceptance.serving import called, written
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "200"))


def replaced(folder: Path, components: Sequence[str]) -> None:
    """Replace the server by each of ``components`` under 20 clients; print what that costs them."""

    async def scenario() -> None:
        async with robot(load(written(folder)).require(), folder) as system:
            async with called(folder, system) as calls:
                for component in components:
                    await system.replaced(component)
                count = len(calls.answered)
                await system.until(lambda: len(calls.answered) > count + 40)
            assert len(system.changes()) == len(components)
            assert system.holes() == []
            found = sorted(each.latency for each in calls.answered)
            p50, p99 = (found[int(len(found) * part)] for part in (0.5, 0.99))
            print(f"{len(found)} requests, p50 {p50 * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, {found[-1] * 1e3:.1f} ms")

    with ended():
        run(scenario(), 3600)


def test_every_request_is_handled_once_across_replacements(tmp_path: Path) -> None:
    """From rclpy to C, where both functions that take a request are called in turn, and back."""
    replaced(tmp_path, ["Id", "Info", "Plain"])


@pytest.mark.long
@pytest.mark.parametrize("kinds", [("Other", "Plain"), ("Id", "Info")])
def test_every_request_is_handled_once_across_many_replacements(tmp_path: Path, kinds: tuple[str, str]) -> None:
    replaced(tmp_path, list(islice(cycle(kinds), REPLACEMENTS)))

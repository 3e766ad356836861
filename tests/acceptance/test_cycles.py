"""Functionalities of two processes that support each other in a cycle, on ROS 2: they change their modes at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.acceptance.support import ended, managed
from tests.backends.ros2_support import run
from tests.runtime.cyclic import MEMBERS, WITHOUT_CAMERA, cyclic, with_camera

pytestmark = [pytest.mark.ros2, pytest.mark.full]


def test_a_cycle_comes_up_and_is_degraded_and_upgraded_in_one_step(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def main() -> None:
        async with managed(tmp_path / "system", specification, tmp_path / "programs") as (manager, _):
            assert (await manager.status()).valid
            for request, kind, mode in (
                (WITHOUT_CAMERA, "degrade", "degraded"),
                (with_camera(specification), "upgrade", "normal"),
            ):
                outcome = await manager.change(request)
                assert outcome.outcome == "done", outcome.because
                [skew] = outcome.skews
                assert (skew.kind, set(skew.functionalities)) == (kind, MEMBERS)
                assert 0.0 <= skew.seconds < 1.0
                print(f"{kind}: within {1000 * skew.seconds:.2f} ms")
                for name in ("estimator", "corrector"):
                    assert (await manager.peek(name)).functionalities["work"].mode == mode

    with ended():
        run(main())

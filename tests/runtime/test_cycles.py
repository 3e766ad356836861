"""Functionalities that support each other in a cycle change their modes in one step, at one moment."""

from __future__ import annotations

from pathlib import Path

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from tests.runtime.cyclic import MEMBERS, WITHOUT_CAMERA, cyclic, with_camera
from tests.runtime.systems import managed


def test_a_cycle_is_degraded_and_upgraded_at_one_moment_although_calls_are_under_way(tmp_path: Path) -> None:
    specification = cyclic(tmp_path / "programs")

    async def body(manager: Manager, _: Simulator) -> None:
        assert (await manager.status()).valid
        for request, kind, mode in (
            (WITHOUT_CAMERA, "degrade", "degraded"),
            (with_camera(specification), "upgrade", "normal"),
        ):
            outcome = await manager.change(request)
            assert outcome.outcome == "done", outcome.because
            [skew] = outcome.skews
            assert (skew.kind, set(skew.functionalities)) == (kind, MEMBERS)
            assert 0.0 <= skew.seconds < 0.01, "a call takes 0.3 s or more"
            for name in ("estimator", "corrector"):
                assert (await manager.peek(name)).functionalities["work"].mode == mode

    managed("", tmp_path, body, specification=specification, directory=tmp_path / "programs")

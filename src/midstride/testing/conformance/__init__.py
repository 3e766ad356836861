"""The checks that any back end must pass: each an async function of a back end and a folder to work in.

``CHECKS`` lists them all. They are written with puppets, so they say the same of every platform;
what they leave to the platform are latencies and how long discovery takes. A back end's own tests
run each of them with an unopened back end::

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_conformance(check, tmp_path):
        simulator = Simulator()
        simulator.run(check(simulator, tmp_path))
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, Final, TypeAlias

from midstride.runtime.backend import Backend
from midstride.testing.conformance import calls, handovers, life, ports, walks

Check: TypeAlias = Callable[[Backend, Path], Coroutine[Any, Any, None]]

CHECKS: Final[tuple[Check, ...]] = (*life.CHECKS, *ports.CHECKS, *calls.CHECKS, *handovers.CHECKS, *walks.CHECKS)

__all__ = ["CHECKS", "Check"]

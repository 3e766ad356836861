"""The checks that any back end must pass: each an async function of a back end and a folder to work in.

``CHECKS`` lists them all. They use puppets, so they check the same on every platform, except for
latencies and the time that discovery takes. The tests of a back end run each check with an unopened back end::

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

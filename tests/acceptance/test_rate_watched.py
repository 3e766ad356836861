"""On ROS 2, a publisher that breaks its guarantee after the cut hands back to the old one, which is still warm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.plan.request import PlanRequest
from tests.acceptance.support import ended, managed
from tests.acceptance.test_node_name import specification
from tests.backends.counting import COUNTING
from tests.backends.ros2_support import run

pytestmark = pytest.mark.ros2

# Steady behind its gate, and silent once it has been live for a second: whatever the machine does, that is a break.
_FALLS_SILENT = """
live = []

def write():
    live.append(comp.is_live)
    if live.count(True) < 50:
        out.write(String(data="x"))

work.set_normal_mode(write, rate=50, outputs=[out])
"""


@pytest.mark.full
def test_a_publisher_that_falls_silent_after_the_cut_hands_back(tmp_path: Path) -> None:
    system = specification(tmp_path)
    text = COUNTING.replace('Component("counter")', 'Component("source")')
    normal = 'work.set_normal_mode(lambda: out.write(String(data="x")), rate=50, outputs=[out])'
    assert normal in text
    (tmp_path / "other.py").write_text(text.replace(normal, _FALLS_SILENT))
    other = system.components["OtherSource"]
    other = replace(other, run=str(other.run).replace("counter.py", "other.py"))
    timing = Map({"probation": 0.5, "probation_timeout": 30.0, "watch_after": 60.0})
    system = replace(system, components=system.components.set("OtherSource", other), timing=timing)

    async def main() -> None:
        async with managed(tmp_path / "system", system, tmp_path) as (manager, _):
            outcome = await manager.change(PlanRequest(replace=(("source", "OtherSource"),)))
            assert outcome.outcome == "rolled_back", outcome
            assert "source_2.out does not keep the 50 Hz that its mode guarantees" in str(outcome.because)
            assert "after the hand-over" in str(outcome.because)
            assert list(manager.configuration.instances) == ["source"]
            (component,) = (await manager.status()).instances
            assert component.name == "source" and component.ports[0].gate == "open"

    with ended():
        run(main())

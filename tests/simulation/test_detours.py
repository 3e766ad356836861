"""Plans with detours are carried out, rolled back and recovered as any other: rehearsed with faults."""

from __future__ import annotations

import pytest

from midstride.lang.load import load_text
from midstride.plan.request import PlanRequest
from midstride.simulation.campaign import Summary, simulate_many
from midstride.simulation.scenario import rehearsed

CROWDED = """
system crowded

contract Data = std_msgs/msg/String @ 10 Hz

topic /objects : Data
topic /log     : Data
topic /speed   : Data { publishers <= 1 }

resource gpu = 3

component Logger {
  run "logger"
  holds gpu 1
  input in : Data
  output out
  functionality log { uses in  produces out  mode normal { assume in  guarantee out : Data }  mode off { } }
}
component Old {
  run "old"
  holds gpu 2
  output out
  output speed
  functionality watch weight 20 {
    produces out, speed
    mode normal { guarantee out : Data  guarantee speed : Data }
    mode off { }
  }
}
component New like Old { run "new"  holds gpu 1 }
LIGHT
component Reader {
  run "reader"
  input in : Data
  functionality read { uses in  mode normal { assume in }  mode off { } }
}

node detector : Old { out -> /objects  speed -> /speed }
node logger   : Logger { in <- /objects  out -> /log }
node reader   : Reader { in <- /log }
"""


@pytest.mark.full
@pytest.mark.parametrize(
    ("light", "step"),
    [("", "remove"), ('component Light like Old { run "light"  holds nothing }', "handover")],
    ids=["moved", "stand-in"],
)
def test_a_plan_with_a_detour_is_rehearsed(light: str, step: str) -> None:
    specification = load_text(CROWDED.replace("LIGHT", light)).require()
    scenario = rehearsed(specification, PlanRequest(replace=(("detector", "New"),), detours=True))
    assert scenario.steps.count("remove") == 2
    assert step in scenario.steps
    summary = Summary()
    for run in simulate_many(range(20), scenario):
        summary.add(run)
    assert not summary.failed, "\n".join(f"seed {run.seed}: {'; '.join(run.problems)}" for run in summary.failed)
    assert {"done", "rolled_back"} <= summary.outcomes.keys()

"""Seeds of the built-in scenario: no invariant is violated, and each run repeats exactly."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from midstride.lang.load import load_text
from midstride.plan.request import PlanRequest
from midstride.simulation.campaign import Summary, simulate, simulate_many
from midstride.simulation.faults import KINDS, OF_LINKS
from midstride.simulation.scenario import rehearsed
from tests.simulation.planted import SYSTEMS, planted

# How many seeds a test runs. `make test` runs the first of these tests, `make test-all` three, `make test-long` all.
SEEDS = 50
FIRST = [
    0,
    *(pytest.param(first, marks=pytest.mark.full) for first in (SEEDS, 2 * SEEDS)),
    *(pytest.param(first, marks=pytest.mark.long) for first in range(3 * SEEDS, 10 * SEEDS, SEEDS)),
]


@pytest.mark.parametrize("first", FIRST)
def test_no_seed_violates_an_invariant(first: int) -> None:
    summary = Summary()
    for run in simulate_many(range(first, first + SEEDS)):
        summary.add(run)
    assert not summary.failed, "\n".join(
        f"midstride simulate --seed {run.seed}: {'; '.join(run.problems)}" for run in summary.failed
    )
    # Each kind strikes in one seed of 20 or so, so one of them may miss 100 of them.
    assert len(set(KINDS) - summary.struck.keys()) <= 1, "every kind of fault strikes"
    assert len(set(OF_LINKS) - summary.struck.keys()) <= 2, "and most of those between hosts, in one seed of five"
    assert {"done", "rolled_back", "killed"} <= summary.outcomes.keys()


def test_a_run_repeats_exactly_also_in_another_process() -> None:
    """Alone, too, although the seeds before it change the same system."""
    seeds = range(40, 50)
    here = [run.digest for run in simulate_many(seeds)]
    assert [run.digest for run in simulate_many(seeds, jobs=2)] == here
    assert simulate(47).digest == here[7]
    assert len(set(here)) == len(here)
    code = f"""
from midstride.simulation.campaign import simulate_many
print([run.digest for run in simulate_many({seeds!r})])
"""
    environment = {**os.environ, "PYTHONHASHSEED": "4711"}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == str(here)


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("gate opened early", 0),
        pytest.param("resumed without lock", 720, marks=pytest.mark.full),
        ("acknowledgement dropped", 0),
        ("dependants not lowered", 0),
        ("removal not recorded", 0),
        # Of the system on several hosts.
        ("exits repeated", 40),
        ("unreachable taken for crashed", 40),
        # Of the system with services and ROS actions.
        ("both answer", 80),
        ("answered again", 80),
        ("servers taken off", 200),
        # Of components that keep state.
        ("state set back", 0),
    ],
)
def test_a_fault_in_our_own_code_is_found(name: str, first: int) -> None:
    with planted(name) as words:
        runs = simulate_many(range(first, first + 100), name=SYSTEMS.get(name))
        assert any(words in problem for run in runs for problem in run.problems)


@pytest.mark.parametrize(
    "seed",
    [
        29789,  # a client notices after the next command that a crashed server has lost its request
        31199,  # the command to answer again does not reach the old server, whose successor has died
        35491,  # the manager is killed during a cut on a topic at 5 Hz
        39180,  # a server hangs when it begins to answer
        44983,  # a manager ends while a server that it has asked to end still finishes
        58287,  # an action server is attached again before a client has fetched a result
    ],
)
def test_no_invariant_is_violated_by_a_seed_that_once_did(seed: int) -> None:
    assert simulate(seed).problems == []


@pytest.mark.full
def test_services_and_actions_of_a_specification_are_simulated() -> None:
    """With stand-ins for programs that do not use the API; what serves outside of the system answers."""
    text = """
        system mission
        service /map  : nav_msgs/srv/GetMap responds within 0.1 s
        service /time : demo_msgs/srv/GetTime
        action  /dock : nav2_msgs/action/DockRobot
        environment { guarantee clock on /time : demo_msgs/srv/GetTime }
        component Server {
          run "server" gate preload
          server map  action server dock
          functionality serve {
            produces map, dock
            mode normal {
              guarantee map : nav_msgs/srv/GetMap responds within 0.1 s  guarantee dock : nav2_msgs/action/DockRobot
            }
            mode off { }
          }
        }
        component Client {
          run "client" gate preload
          client map : nav_msgs/srv/GetMap  client time : demo_msgs/srv/GetTime
          action client dock : nav2_msgs/action/DockRobot
          functionality work {
            uses map, time, dock
            mode normal { assume map  assume time  assume dock }
            mode off { }
          }
        }
        node serving : Server { map -> /map  dock -> /dock }
        node calling : Client { map <- /map  time <- /time  dock <- /dock }
    """
    scenario = rehearsed(load_text(text).require(), PlanRequest(restart=("serving",)))
    summary = Summary()
    for run in simulate_many(range(60), scenario):
        summary.add(run)
    assert not summary.failed, "\n".join(f"{run.seed}: {'; '.join(run.problems)}" for run in summary.failed)
    assert "done" in summary.outcomes


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 40), marks=pytest.mark.full)], ids=str)
def test_a_container_of_a_specification_is_simulated(seeds: range) -> None:
    """A crash of one of its nodes is a crash of all: each seed must bring all of them back."""
    text = """
        system grouped
        topic /a : std_msgs/msg/String @ 10 Hz
        topic /b : std_msgs/msg/String @ 10 Hz
        container box { run "component_container_mt" }
        component Talker {
          run component "demo::Talker" package "demo" gate preload
          output out as chatter
          functionality talk {
            produces out
            mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
            mode off { }
          }
        }
        component Hearer {
          run component "demo::Hearer" package "demo" gate preload
          input in : std_msgs/msg/String @ 10 Hz as chatter
          functionality hear { uses in  mode normal { assume in }  mode off { } }
        }
        node one   : Talker in box { out -> /a }
        node other : Talker in box { out -> /b }
        node hears : Hearer in box { in <- /a }
        node apart : Hearer { in <- /b }
    """
    specification = load_text(text).require()
    done = crashed = 0
    for restart, same in ((("box",), False), (("one",), False), (("one",), True)):
        request = PlanRequest(restart=restart, same_process=same).for_members(specification)
        summary = Summary()
        for run in simulate_many(seeds, rehearsed(specification, request)):
            summary.add(run)
            crashed += any(each.fault == "crash" for each in run.struck)
        assert not summary.failed, "\n".join(f"{run.seed}: {'; '.join(run.problems)}" for run in summary.failed)
        done += summary.outcomes["done"]
    assert done > 0 < crashed

"""What happens to the patrol robot, in virtual time with its real node code: beside what it is without Midstride."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest

from midstride.lang.load import load
from midstride.model.component import ComponentSpec
from tests.examples.conftest import EXAMPLES

# Not among the seeds that are published.
SEED = 901


def environment() -> dict[str, str]:
    """Of a process that imports the modules of the example, with other hashes than this one."""
    return {**os.environ, "PYTHONHASHSEED": "7", "PYTHONPATH": os.pathsep.join([str(EXAMPLES / "patrol"), *sys.path])}


@pytest.fixture
def trial(patrol: Callable[[str], ModuleType]) -> Any:
    return patrol("trial")


def test_the_robot_alone_is_the_robot_of_the_demonstration() -> None:
    with_world = load(EXAMPLES / "patrol" / "patrol.stride").require()
    alone = load(EXAMPLES / "patrol" / "on_hardware.stride").require()
    assert with_world.without_node("world").nodes == alone.nodes
    assert len(alone.nodes) == 12
    for name, component in alone.components.items():
        assert isinstance(component, ComponentSpec)
        assert component == with_world.components[name]


def test_where_the_lidar_driver_dies_it_slows_down_and_does_not_drive_blind(trial: Any) -> None:
    row = trial.run(SEED, "the lidar driver dies", "minimal", after=6.0)
    assert row["said"] == ["done"]
    assert (row["collisions"], row["blind"]) == (0, 0.0)
    assert row["lost"] > 0  # it was degraded until the driver was back


@pytest.mark.full
def test_without_midstride_it_drives_blind_meanwhile(trial: Any) -> None:
    row = trial.run(SEED, "the lidar driver dies", "restart", after=6.0)
    assert row["blind"] > 1.0
    assert trial.run(SEED, "the lidar driver dies", "nothing", after=6.0)["blind"] > 4.0


@pytest.mark.full
@pytest.mark.parametrize(
    ("event", "outcome"),
    [
        ("the lidar driver is replaced", "done"),
        ("a bad version is deployed", "rolled_back"),
        ("the manager dies", None),
    ],
)
def test_what_costs_nothing(trial: Any, event: str, outcome: str | None) -> None:
    row = trial.run(SEED, event, "minimal", after=8.0)
    assert row["said"] == ([] if outcome is None else [outcome])
    assert (row["collisions"], row["near_misses"], row["lost"], row["blind"]) == (0, 0, 0.0, 0.0)


@pytest.mark.full
@pytest.mark.parametrize(
    "event", ["the perception is upgraded", pytest.param("the detector hangs", marks=pytest.mark.long)]
)
def test_what_degrades_costs_less_than_by_quiescence_and_is_never_blind(trial: Any, event: str) -> None:
    minimal, quiesce = (trial.run(SEED, event, strategy, after=20.0) for strategy in ("minimal", "quiesce"))
    assert minimal["said"] == quiesce["said"] == ["done"]
    assert minimal["blind"] == 0.0
    assert 0 < minimal["lost"] < quiesce["lost"]


@pytest.mark.full
def test_a_manager_that_dies_after_the_new_driver_is_in_is_followed_by_one_that_manages_it(trial: Any) -> None:
    row = trial.run(5, "the manager dies", "paper", after=10.0)
    assert (row["said"], row["collisions"]) == ([], 0)
    assert row["lost"] < 150  # the driver was missing for the change, and not until the next manager


@pytest.mark.full
def test_a_run_is_the_same_again(trial: Any) -> None:
    first, second = (trial.run(SEED, "the detector hangs", "minimal", after=5.0) for _ in range(2))
    assert first == second


@pytest.mark.long
def test_runs_that_share_what_comes_before_the_event_are_those_that_do_not(trial: Any) -> None:
    """In another process, with other hashes; in two halls, one after the other."""
    cases = [("the lidar driver dies", "stop"), ("the manager dies", "minimal")]
    script = f"""
import json, trial
print(json.dumps([row for seed in (901, 902) for row in trial.runs(seed, {cases!r}, after=1.0)]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment(), timeout=120
    )
    assert done.returncode == 0, done.stderr
    alone = [trial.run(seed, *case, after=1.0) for seed in (902, 901) for case in cases]
    assert json.loads(done.stdout) == sorted(alone, key=lambda row: row["seed"])
    assert len({row["progress"] for row in alone}) == 4


def test_a_forked_run_that_fails_is_reported(trial: Any) -> None:
    script = """
import asyncio, fork
async def fails():
    raise ValueError("of the child")
async def main():
    if (other := fork.Fork()).is_child:
        await other.end(fails())
    other.result()
asyncio.run(main())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment(), timeout=60)
    assert done.returncode == 1
    assert "ValueError: of the child" in done.stderr and "RuntimeError: a forked run failed (status 1)" in done.stderr


@pytest.mark.full
def test_what_is_in_the_file_is_not_run_again(trial: Any, tmp_path: Path) -> None:
    every = [("none", "minimal")] + [(event, each) for event in trial.EVENTS for each in trial.strategies(event)]
    row = {"seed": SEED, "collisions": 0, "near_misses": 0, "progress": 9.0, "lost": 0.0, "blind": 0.0, "said": []}
    missing = ("the planner is killed", "nothing")
    rows = [{**row, "event": event, "strategy": strategy} for event, strategy in every if (event, strategy) != missing]
    out, figure = tmp_path / "rows.jsonl", tmp_path / "trial.svg"
    out.write_text("".join(json.dumps(each) + "\n" for each in rows))
    options = ["--worlds", "1", "--first", str(SEED), "--jobs", "2", "--out", str(out), "--figure", str(figure)]
    done = subprocess.run(
        [sys.executable, trial.__file__, *options], capture_output=True, text=True, env=environment(), timeout=120
    )
    assert done.returncode == 0, done.stderr
    *kept, added = [json.loads(line) for line in out.read_text().splitlines()]
    assert kept == rows
    assert (added["seed"], added["event"], added["strategy"]) == (SEED, *missing)
    assert added == trial.run(SEED, *missing)
    assert len(done.stdout.splitlines()) == 2 + len(every) and figure.exists()


def test_the_table_has_a_line_for_each_strategy_and_its_intervals(trial: Any) -> None:
    figures = {"near_misses": 1, "lost": 2.0, "blind": 0.5, "said": []}
    rows: list[dict[str, Any]] = []
    for seed in (1, 2):
        rows.append({"seed": seed, "event": "none", "strategy": "minimal", "collisions": 0, "progress": 30.0})
        killed = {"event": "the planner is killed", "strategy": "restart"}
        rows.append({"seed": seed, **killed, "collisions": seed - 1, "progress": 15.0})
    rows = [{**row, **figures} for row in rows]
    lines = list(trial.table(rows))
    assert len(lines) == 4
    # Half of the way in as much time: 17.5 of 35 s are lost.
    cells = [cell.strip() for cell in lines[3].strip("|").split("|")]
    assert cells[:6] == ["the planner is killed", "`restart`", "2", "1 (9% to 91%)", "2", "17.5 (17.5 to 17.5)"]
    drawn = ElementTree.fromstring(trial.figure(rows))
    (point,) = drawn.iter("{http://www.w3.org/2000/svg}circle")
    assert float(point.attrib["cx"]) == 210 + 300 / 2

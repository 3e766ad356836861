"""What happens to the patrol robot, in virtual time with its real node code: beside what it is without Midstride."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest

from midstride.lang.load import load
from midstride.model.component import ComponentSpec
from tests.examples.conftest import EXAMPLES

# Not among the seeds that are published.
SEED = 901


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
@pytest.mark.parametrize("event", ["the perception is upgraded", "the detector hangs"])
def test_what_degrades_costs_less_than_by_quiescence_and_is_never_blind(trial: Any, event: str) -> None:
    minimal, quiesce = (trial.run(SEED, event, strategy, after=14.0) for strategy in ("minimal", "quiesce"))
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

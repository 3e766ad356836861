"""Seeds of changes of a system with programs that end: the faults strike while one runs, and before and after it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from midstride.lang import load
from midstride.model.component import ComponentSpec
from midstride.model.specification import Node, Specification
from midstride.plan.request import PlanRequest
from midstride.simulation.campaign import Summary, simulate_many
from midstride.simulation.scenario import rehearsed

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SEEDS = 20


def system() -> Specification:
    specification = load(EXAMPLES / "talker" / "talker.stride").require()
    programs = {
        name: ComponentSpec.of(name, run=f"python3 {name}.py", once=True, gate="none") for name in ("Spawn", "Home")
    }
    specification = replace(specification, components=specification.components.update(programs))
    return specification.with_node(Node("spawner", "Spawn")).with_node(Node("homing", "Home"))


@pytest.mark.parametrize(
    "request_",
    [
        PlanRequest(restart=("spawner", "talker")),
        PlanRequest(replace=(("spawner", "Home"), ("talker", "NewTalker"))),
        PlanRequest(remove=("homing",), replace=(("talker", "NewTalker"),)),
    ],
    ids=["restart", "replace", "remove"],
)
@pytest.mark.parametrize(
    "first",
    [
        0,
        pytest.param(20, marks=pytest.mark.full),
        *(pytest.param(first, marks=pytest.mark.long) for first in range(40, 160, 20)),
    ],
)
def test_no_seed_violates_an_invariant(first: int, request_: PlanRequest) -> None:
    summary = Summary()
    for run in simulate_many(range(first, first + SEEDS), rehearsed(system(), request_)):
        summary.add(run)
    assert not summary.failed, "\n".join(f"{run.seed}: {'; '.join(run.problems)}" for run in summary.failed)
    assert {"done", "killed"} <= summary.outcomes.keys()

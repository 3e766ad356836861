"""A plan that would break a bond with a lifecycle manager is refused by the specification alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from midstride.cli.commands.plan_command import plan_command

BONDED = 'autostart = true  node_names = ["planner", "/other/mapper"]'
ROBOT = """system robot
component Planner {{ run "planner" {gate} }}
component NewPlanner {{ run "planner" {gate} }}
component Driver {{ run "driver" gate preload }}
component Manager {{ run "manager" gate none  parameters {{ {parameters} }} }}
{nodes}
node driver : Driver
"""


def planned(
    folder: Path, *request: str, parameters: str = BONDED, gate: str = "gate preload", namespace: str | None = None
) -> tuple[int, str]:
    file = folder / "robot.stride"
    nodes = "node planner : Planner\nnode manager : Manager\n"
    nodes = nodes if namespace is None else f"namespace {namespace} {{ {nodes} }}"
    file.write_text(ROBOT.format(parameters=parameters, gate=gate, nodes=nodes), encoding="utf-8")
    found = CliRunner().invoke(plan_command, [str(file), *request])
    return found.exit_code, " ".join((found.output + str(found.exception or "")).split())


@pytest.mark.parametrize("request_", [["--restart=planner"], ["--replace=planner=NewPlanner"], ["--remove=planner"]])
@pytest.mark.parametrize("gate", ["gate preload", "gate none", "gate relay"])
def test_ending_a_node_with_a_bond_is_refused(tmp_path: Path, request_: list[str], gate: str) -> None:
    code, said = planned(tmp_path, *request_, gate=gate)
    assert code and "planner cannot be replaced or removed: lifecycle manager /manager has a bond of 4 s" in said
    assert "remove the manager first" in said


@pytest.mark.parametrize(
    ("parameters", "seconds"),
    [
        (BONDED + " bond_timeout = 2.5", " of 2.5 s"),
        ('node_names = ["planner"] bond_timeout = 1.0', " of 1 s"),
        ('node_names = ["/planner"] autostart = false', " of 4 s"),
    ],
)
def test_the_manager_is_known_by_its_parameters(tmp_path: Path, parameters: str, seconds: str) -> None:
    code, said = planned(tmp_path, "--restart=planner", parameters=parameters)
    assert code and f"has a bond{seconds} with /planner" in said
    assert ("if it has none, as it is not Nav2's, state `bond_timeout = 0.0`" in said) == (
        "bond_timeout" not in parameters
    )


def test_names_are_in_the_namespace_of_the_manager(tmp_path: Path) -> None:
    code, said = planned(tmp_path, "--restart=robot/planner", namespace="robot")
    assert code and "lifecycle manager /robot/manager has a bond of 4 s with /robot/planner" in said


@pytest.mark.parametrize(
    "changed",
    [
        {"parameters": BONDED + " bond_timeout = 0.0"},
        {"parameters": 'autostart = true node_names = ["mapper"]'},
        {"parameters": 'autostart = true node_names = ["/robot/planner"]'},
        {"parameters": "autostart = true"},
        {"gate": "gate preload unnamed"},
    ],
)
def test_what_is_not_known_to_break_a_bond_is_planned(tmp_path: Path, changed: dict[str, str]) -> None:
    assert planned(tmp_path, "--restart=planner", **changed)[0] == 0


def test_other_nodes_and_the_manager_may_end(tmp_path: Path) -> None:
    assert planned(tmp_path, "--restart=driver")[0] == 0
    assert planned(tmp_path, "--remove=manager")[0] == 0

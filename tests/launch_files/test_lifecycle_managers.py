"""Launch files with a lifecycle manager: it goes on with its nodes, or Midstride manages them, without it."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from midstride.cli.commands.import_command import import_command
from midstride.lang.load import load_text
from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.model.component import Gate
from midstride.model.lifecycle_management import MANAGEMENTS, Management, has_bonds, managed_nodes
from midstride.model.specification import Order
from tests.launch_files.support import specification

NODES = "".join(
    f'<node pkg="nav" exec="{name}" name="{name}"/>' for name in ("controller_server", "planner_server", "bt_navigator")
)
NAMES = "[controller_server, planner_server, /bt_navigator]"


def manager(more: str = "", names: str = NAMES, autostart: str = "true") -> str:
    return (
        '<node pkg="nav" exec="lifecycle_manager" name="lifecycle_manager_navigation">'
        f'<param name="autostart" value="{autostart}"/><param name="node_names" value="{names}"/>{more}</node>'
    )


def of(
    folder: Path, body: str, management: Management = "manager"
) -> tuple[Imported, dict[str, Gate | None], list[str]]:
    """The import of a launch file, the gates of its nodes, and the findings on lifecycle managers."""
    file = folder / "robot.launch.xml"
    file.write_text(f"<launch>\n{body}\n</launch>\n", encoding="utf-8")
    found = import_launch_file(file, {}, {}, folder / "imported.stride", management=management)
    system = specification(found, folder)
    gates = {role: system.component_of(role).gate for role in system.nodes}
    said = [each for each in found.findings if each.kind == "lifecycle"]
    assert not any(each.left_out for each in said)
    return found, gates, [each.message for each in said]


def test_a_manager_goes_on_with_its_nodes_unless_something_else_is_asked_for(tmp_path: Path) -> None:
    _, gates, (said,) = of(tmp_path, NODES + manager())
    assert set(gates.values()) == {"preload"} and "lifecycle_manager_navigation" in gates
    assert said == (
        "`lifecycle_manager_navigation` manages the lifecycle of `controller_server`, `planner_server`, "
        "`bt_navigator`, and goes on with it; it has a bond with each and deactivates all when one breaks, so none can "
        "be replaced while it runs, unless it has none: state `bond_timeout = 0.0` then; with `--lifecycle midstride`, "
        "Midstride manages them, without it"
    )
    _, _, (said,) = of(tmp_path, NODES + manager('<param name="bond_timeout" value="0.0"/>'))
    assert "bond" not in said
    _, _, (said,) = of(tmp_path, NODES + manager('<param name="bond_timeout" value="4.0"/>'))
    assert "it has a bond with each" in said and "unless" not in said


def test_where_midstride_is_asked_for_the_manager_is_left_out_and_its_order_is_kept(tmp_path: Path) -> None:
    _, gates, (said,) = of(tmp_path, NODES + manager(), "midstride")
    assert gates == dict.fromkeys(("controller_server", "planner_server", "bt_navigator"), "lifecycle preload")
    assert said.startswith("`lifecycle_manager_navigation` is left out: Midstride manages the lifecycle of")
    system = specification(of(tmp_path, NODES + manager(), "midstride")[0], tmp_path)
    orders = [(each.first, each.then) for each in system.constraints if isinstance(each, Order)]
    assert orders == [("controller_server", "planner_server"), ("planner_server", "bt_navigator")]
    _, _, (said,) = of(tmp_path, NODES + manager(autostart="false"), "midstride")
    assert "`autostart` is false, and here they are active from the start" in said


def test_names_are_those_of_the_namespace_of_the_manager_and_a_parameter_file_may_have_them(tmp_path: Path) -> None:
    (tmp_path / "nav.yaml").write_text(
        "/robot/manager:\n  ros__parameters:\n    autostart: true\n    node_names: [planner_server]\n", encoding="utf-8"
    )
    inner = '<node pkg="nav" exec="planner_server" name="planner_server"/>'
    inner += f'<node pkg="nav" exec="lifecycle_manager" name="manager"><param from="{tmp_path}/nav.yaml"/></node>'
    body = f'<group><push-ros-namespace namespace="robot"/>{inner}</group>' + inner.replace("manager", "other")
    _, gates, (said,) = of(tmp_path, body, "midstride")
    assert gates["robot/planner_server"] == "lifecycle preload" and gates["planner_server"] == "preload"
    assert "robot/manager" not in gates and "other" in gates and "`robot/planner_server`" in said


def test_a_manager_of_which_a_node_is_not_here_goes_on_in_either_case(tmp_path: Path) -> None:
    names = "[controller_server, in_a_container]"
    for management in MANAGEMENTS:
        _, gates, (said,) = of(tmp_path, NODES + manager(names=names), management)
        assert set(gates.values()) == {"preload"} and "lifecycle_manager_navigation" in gates
        assert "it manages `in_a_container` as well, which is not here" in said


def test_a_lifecycle_node_of_a_manager_that_goes_on_has_no_gate_by_which_midstride_manages_it(tmp_path: Path) -> None:
    node = '<lifecycle_node pkg="nav" exec="planner" name="controller_server" namespace=""/>'
    alone = of(tmp_path, node)
    assert alone[1] == {"controller_server": "lifecycle preload"}
    (said,) = alone[2]
    assert "the launch file leaves `controller_server` unconfigured" in said
    names = "[controller_server]"
    _, gates, (said,) = of(tmp_path, node + manager(names=names))
    assert gates["controller_server"] == "preload" and "goes on with it" in said
    assert of(tmp_path, node + manager(names=names), "midstride")[1] == {"controller_server": "lifecycle preload"}


def test_a_specification_in_which_both_manage_a_node_is_refused(tmp_path: Path) -> None:
    found, _, _ = of(tmp_path, NODES + manager())
    assert not load_text(found.text).has_errors
    both = found.text.replace('run "planner_server" package "nav" gate preload', 'run "p" gate lifecycle preload')
    assert both != found.text
    (error,) = (each for each in load_text(both).diagnostics if each.severity == "error")
    assert error.code == "E027"
    assert "/planner_server has `gate lifecycle preload`, and lifecycle_manager_navigation manages" in error.message


def test_the_command_passes_what_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.xml"
    file.write_text(f"<launch>{NODES}{manager()}</launch>", encoding="utf-8")
    as_launched = CliRunner().invoke(import_command, [str(file)])
    taken_over = CliRunner().invoke(import_command, [str(file), "--lifecycle", "midstride"])
    assert "gate lifecycle preload" not in as_launched.output and "node lifecycle_manager" in as_launched.output
    assert "gate lifecycle preload" in taken_over.output and "node lifecycle_manager" not in taken_over.output


@pytest.mark.parametrize(
    ("parameters", "managed", "bonds"),
    [
        ({"node_names": ["a", "/b/c"], "autostart": True}, ("/robot/a", "/b/c"), True),
        ({"node_names": ["a"], "autostart": False, "bond_timeout": 0.0}, ("/robot/a",), False),
        ({"node_names": ["a"], "autostart": True, "bond_timeout": 0}, ("/robot/a",), False),
        ({"node_names": ["a"]}, (), True),
        ({"node_names": ["a"], "bond_timeout": 4.0}, ("/robot/a",), True),
        ({"node_names": "a", "autostart": True}, (), True),
        ({"autostart": True, "bond_timeout": 2.0}, (), True),
    ],
)
def test_nav2_s_manager_is_recognised_by_its_parameters(
    parameters: dict[str, object], managed: tuple[str, ...], bonds: bool
) -> None:
    assert managed_nodes("/robot/manager", parameters) == managed and has_bonds(parameters) is bonds

"""The launch files of examples/navigation, in XML and in Python, start the same; the page on them uses the former."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from midstride.launch_files.launch_import import Imported, import_launch_file
from tests.launch_files.support import specification

EXAMPLE = Path(__file__).parents[2] / "examples" / "navigation"


def imported(name: str, folder: Path) -> Imported:
    prefix = folder / "install"
    subprocess.run(["sh", EXAMPLE / "install.sh", prefix], check=True)
    found = os.environ.get("AMENT_PREFIX_PATH")
    environment = {**os.environ, "AMENT_PREFIX_PATH": os.pathsep.join(filter(None, (str(prefix), found)))}
    path = prefix / "share" / "nav_demo" / "launch" / name
    return import_launch_file(path, {}, environment, folder / "imported.stride", run_python=True)


def started(found: Imported, folder: Path) -> dict[str, dict[str, Any]]:
    """What is started, by role: its command, what it has of parameters, and how it is restarted."""
    system = specification(found, folder)
    return {
        role: {
            "run": (component := system.component_of(role)).run,
            "package": component.package,
            "gate": component.gate,
            "kind": (component.once, component.unnamed),
            "respawn": system.nodes[role].respawn,
            # Of a node that its program names, a section is for it.
            "parameters": {
                **{name: each.value for name, each in component.parameters.items()},
                **system.nodes[role].parameters,
                **{
                    name: value
                    for section in system.nodes[role].sections
                    if component.unnamed and section.matches(role)
                    for name, value in section.parameters.items()
                },
            },
        }
        for role in system.nodes
    }


def test_what_the_page_imports(tmp_path: Path) -> None:
    found = imported("bringup.launch.xml", tmp_path)
    assert found.findings.counts(left_out=True) == {"package": 1}
    nodes = started(found, tmp_path)
    assert {role: node["gate"] for role, node in nodes.items()} == {
        "make_folder": "none",
        "set_pose": "preload",
        "base_driver": "preload",
        "controller_server": "preload",
        "planner_server": "preload",
        "lifecycle_manager_navigation": "preload",
    }
    assert nodes["make_folder"]["kind"][0] and nodes["base_driver"]["kind"] == (False, True)
    assert nodes["base_driver"]["parameters"] == {"rate": 20.0}
    assert nodes["controller_server"]["parameters"] == {"controller_frequency": 20.0, "max_vel_x": 0.26}


def test_the_bring_up_of_nav2_has_its_21_nodes(tmp_path: Path) -> None:
    prefix = tmp_path / "install"
    subprocess.run(["sh", EXAMPLE / "nav2" / "install.sh", prefix], check=True)
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(prefix)}
    path = prefix / "share" / "nav2_bringup" / "launch" / "bringup.launch.xml"
    target, apart = tmp_path / "imported.stride", {"use_composition": "False"}
    alone = import_launch_file(path, apart, environment, target)
    managed = import_launch_file(path, apart, environment, target, management="midstride")
    composed = import_launch_file(path, {}, environment, target)
    split = import_launch_file(path, {}, environment, target, containers="split")
    nodes = started(alone, tmp_path)
    assert len(nodes) == 21 and alone.findings.counts() == {"lifecycle": 4}
    managers = {role for role in nodes if role.startswith("lifecycle_manager_")}
    assert len(managers) == 4 and set(started(managed, tmp_path)) == set(nodes) - managers
    assert set(started(split, tmp_path)) == set(started(composed, tmp_path)) == set(nodes)
    assert composed.text.count("in /nav2_container") == 21 and "/nav2_container" not in split.text
    assert nodes["planner_server"]["parameters"] == {"frequency": 5.0}


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="ROS 2's launch is on no package index")
def test_the_launch_files_in_python_start_the_same(tmp_path: Path) -> None:
    (tmp_path / "xml").mkdir()
    (tmp_path / "python").mkdir()
    xml, python = imported("bringup.launch.xml", tmp_path / "xml"), imported("bringup.launch.py", tmp_path / "python")
    assert python.findings.counts(left_out=True) == {"include": 1}
    assert started(python, tmp_path / "python") == started(xml, tmp_path / "xml")

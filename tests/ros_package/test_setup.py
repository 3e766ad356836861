"""The description of the ROS package says what that of the wheel says."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import midstride
from tests.test_architecture import imported, is_ros
from tools import changelog_rst

ROOT = Path(__file__).parents[2]
# Prints what setup.py gives to setuptools.
ASK = """
import distutils.core, json
made = distutils.core.run_setup("setup.py", stop_after="init")
print(json.dumps([made.get_version(), made.entry_points, made.data_files]))
"""


def described() -> list[object]:
    pytest.importorskip("setuptools")
    ask = "import setuptools\n" + ASK
    done = subprocess.run([sys.executable, "-c", ask], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    found: list[object] = json.loads(done.stdout)
    return found


def test_version_and_entry_points_are_those_of_the_wheel() -> None:
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    version, entry_points, _ = described()
    assert version == midstride.__version__ == ET.parse(ROOT / "package.xml").findtext("version")
    assert project["dynamic"] == ["version"]
    wheel = {"console_scripts": project["scripts"], **project["entry-points"]}
    assert entry_points == {
        group: [f"{name} = {value}" for name, value in entries.items()] for group, entries in wheel.items()
    }


def test_every_file_that_is_installed_is_there() -> None:
    files = described()[2]
    assert isinstance(files, list)
    assert [name for _, names in files for name in names if not (ROOT / name).is_file()] == []


def test_every_dependency_of_the_wheel_has_a_key_or_is_on_the_page() -> None:
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs" / "how-to" / "ros-package.md").read_text(encoding="utf-8")
    manifest = ET.parse(ROOT / "package.xml")
    keys = {element.text for element in manifest.iter("exec_depend")}
    for requirement in project["dependencies"]:
        name, bound = re.findall(r"^([\w-]+)>=([\d.]+)", requirement)[0]
        key = "python3-yaml" if name == "pyyaml" else f"python3-{name}"
        row = re.search(rf"^\| `{name}` \| {re.escape(bound)} \| (`{key}`|none|`{key}-pip`)", page, re.MULTILINE)
        assert row, f"{name} {bound} has no row in docs/how-to/ros-package.md"
        assert (key in keys) == (row[1] == f"`{key}`"), name


def test_every_package_of_ros_2_that_is_imported_is_in_the_manifest() -> None:
    keys = {element.text for element in ET.parse(ROOT / "package.xml").iter("exec_depend")}
    found = set()
    for file in (ROOT / "src" / "midstride" / "backends" / "ros2").rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        found |= {name.partition(".")[0] for _, name in imported(tree, "midstride", False) if is_ros(name)}
    # Humble has none, and later ones have it with rclpy.
    assert found - keys == {"type_description_interfaces"}
    assert {"rclpy", "launch_ros", "composition_interfaces"} <= found


def test_markdown_becomes_restructuredtext() -> None:
    text = "See [the **page**](a/b.md): `up -d` of a\nnode_2 *now*, and\\so"
    assert changelog_rst.as_rst(text) == r"See the page: ``up -d`` of a node\_2 \*now\*, and\\so"


def test_the_changelog_has_a_line_for_each_fragment(tmp_path: Path) -> None:
    (tmp_path / "changes").mkdir()
    (tmp_path / "changes" / "+a.fixed.md").write_text("Fixed `it`.\n", encoding="utf-8")
    (tmp_path / "changes" / "+b.added.md").write_text("Added\nit.\n", encoding="utf-8")
    (tmp_path / "CHANGELOG.md").write_text(
        "# C\n\n## 0.2.0 (2026-12-01)\n\n### Added\n\n- Two\n  lines.\n- One.\n\n## 0.1.0 (not released yet)\n\n"
        "- Old.\n"
    )
    assert changelog_rst.changelog(tmp_path, "0.3.0 (2026-12-02)").split("\n", 4)[4] == (
        "0.3.0 (2026-12-02)\n------------------\n* Added it.\n* Fixed ``it``.\n* Old.\n\n"
        "0.2.0 (2026-12-01)\n------------------\n* Two lines.\n* One.\n\n"
    )

"""The ROS package in a colcon workspace, with colcon from PyPI and the setuptools of Ubuntu 22.04."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from configparser import ConfigParser
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.cli.conftest import running
from tools import changelog_rst
from tools.wheel_contents import expected

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "ros-package.md"
EXTENSIONS = "ros bash recursive-crawl metadata package-selection package-information test-result"
COLCON = ["colcon-core", *(f"colcon-{name}" for name in EXTENSIONS.split())]
OLDEST = "setuptools==59.6.0"
SOURCES = ("colcon.pkg", "examples", "LICENSE", "package.xml", "pyproject.toml", "ros", "setup.cfg", "setup.py", "src")

NO_NOTIFICATION = {"COLCON_EXTENSION_BLOCKLIST": "colcon_core.event_handler.desktop_notification"}
SPECIFICATION = """
system chain
topic /a : std_msgs/msg/String
component Source {
  run "python3 -m chain_nodes.source"
  output out
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode off { }
  }
}
node source : Source { out -> /a }
"""


class Workspace:
    """A workspace with this package in it, and the commands that its user would type."""

    def __init__(self, folder: Path, python: Path) -> None:
        self.folder = folder
        self.install = folder / "install" / "midstride"
        self.environment = {
            "PATH": f"{python.parent}:/usr/bin:/bin",
            "HOME": str(folder),
            "MIDSTRIDE_BACKEND": "sim",
            **NO_NOTIFICATION,
        }
        package = folder / "src" / "midstride"
        ignored = shutil.ignore_patterns("__pycache__")
        package.mkdir(parents=True)
        for name in SOURCES:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, package / name, ignore=ignored)
            else:
                shutil.copy(source, package)
        shutil.copytree(ROOT / "tests" / "ros_package", package / "tests" / "ros_package", ignore=ignored)
        shutil.copy(ROOT / "tests" / "__init__.py", package / "tests")

    def run(self, command: str) -> str:
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def sourced(self, command: str) -> str:
        return self.run(f". install/setup.bash && {command}")


def commands() -> list[str]:
    """The commands of the page, from the build on. `ros2 run` starts the program that it finds in lib/midstride."""
    block = PAGE.read_text(encoding="utf-8").split("```console\n")[1].split("```")[0]
    _, built, after = block.partition("$ colcon build")
    assert built and "ros2 run midstride midstride check" in after
    found = [line.removeprefix("$ ") for line in (built + after).splitlines()]
    return [line.replace("ros2 run midstride ", "install/midstride/lib/midstride/") for line in found]


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("colcon")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=60)
    found = folder / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(found), "install", "--quiet", "--disable-pip-version-check"]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([*pip, *COLCON, OLDEST], env=clean, capture_output=True, text=True, timeout=200, check=False)
    if done.returncode != 0:
        assert os.environ.get("CI") != "true", done.stderr
        pytest.skip(f"colcon cannot be installed from PyPI: {done.stderr.strip().splitlines()[-1]}")
    # What Midstride needs besides is that of the tests, behind what was installed here.
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "beside.pth").write_text("".join(f"{path}\n" for path in sys.path if path.endswith("site-packages")))
    return found


@pytest.mark.full
@pytest.mark.ros2
def test_a_generated_package_is_built_and_brought_up_by_its_name(tmp_path: Path, python: Path) -> None:
    (tmp_path / "spec.stride").write_text(SPECIFICATION, encoding="utf-8")
    for midstride in running():
        folder = tmp_path / "src" / "chain"
        done = midstride("generate", str(tmp_path / "spec.stride"), "-o", str(folder))
        assert done.status == 0, done.err
        environment = {"PATH": f"{python.parent}:/usr/bin:/bin", "HOME": str(tmp_path), **NO_NOTIFICATION}
        print_paths = '. install/setup.bash && echo "$AMENT_PREFIX_PATH $PYTHONPATH"'
        command = ["bash", "-c", f"colcon build --symlink-install >&2 && {print_paths}"]
        built = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert built.returncode == 0, built.stderr
        prefixes, packages = built.stdout.split()
        before = os.environ.get("PYTHONPATH")
        midstride.environment |= {"AMENT_PREFIX_PATH": prefixes, "PYTHONPATH": f"{packages}:{before or ''}"}
        up = midstride("up", "chain", "spec.stride", "--detach", timeout=60)
        assert up.status == 0, up.out + up.err
        file = midstride("status", "--json").json["file"]
        assert file == str(tmp_path / "install" / "chain" / "share" / "chain" / "spec.stride")
        applied = midstride("apply", "package://chain/spec.stride", "--yes")
        assert applied.status == 0 and "already matches" in applied.out, applied.out + applied.err


@pytest.mark.full
def test_colcon_lists_builds_and_tests_the_package(tmp_path: Path, python: Path) -> None:
    workspace = Workspace(tmp_path, python)
    assert workspace.run("colcon list").split() == ["midstride", "src/midstride", "(ros.ament_python)"]
    # In the repository itself, with its examples, tests and environments, there is no other.
    assert workspace.run(f"colcon list --names-only --base-paths {ROOT}").split() == ["midstride"]
    assert workspace.run(" && ".join(commands()))
    (site,) = workspace.install.glob("lib/python*/site-packages")
    found = {
        str(path.relative_to(site))
        for path in (site / "midstride").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert found == {name for name in expected() if "/prebuilt/" not in name}
    (metadata,) = site.glob("midstride-*.egg-info/entry_points.txt")
    entries = ConfigParser()
    entries.read(metadata)
    built = {(group, *entry) for group in entries.sections() for entry in entries[group].items()}
    assert built == {(entry.group, entry.name, entry.value) for entry in distribution("midstride").entry_points}
    assert workspace.sourced("which midstride").strip() == str(workspace.install / "bin" / "midstride")
    assert "_midstride_completion" in workspace.sourced("complete -p midstride")
    assert str(site) in workspace.sourced("python -c 'import midstride; print(midstride.__file__)'")
    workspace.run("colcon test --return-code-on-test-failure")

    changelog = tmp_path / "CHANGELOG.rst"
    changelog.write_text(changelog_rst.changelog(heading="0.2.0 (2026-12-01)"), encoding="utf-8")
    ask = "from catkin_pkg.changelog import get_changelog_from_path as read"
    read = workspace.run(f"python -c '{ask}; print([v for v, _, _ in read(\"{changelog}\").foreach_version()])'")
    assert "0.2.0" in read

    shutil.rmtree(tmp_path / "build")
    shutil.rmtree(tmp_path / "install")
    workspace.run("colcon build --symlink-install")
    source = tmp_path / "src" / "midstride" / "src" / "midstride" / "__init__.py"
    module = workspace.sourced("python -c 'import midstride; print(midstride.__file__)'").strip()
    assert Path(module).resolve() == source.resolve()
    assert re.fullmatch(r"midstride \d+\.\d+\.\d+\n", workspace.sourced("midstride --version"))
    workspace.run("colcon test --return-code-on-test-failure")

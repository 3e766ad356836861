"""For ``colcon test``: the package that was built is whole and is used. Needs nothing but the package."""

from __future__ import annotations

import os
import subprocess
import unittest
from importlib.metadata import entry_points
from pathlib import Path

ROOT = Path(__file__).parents[2]
TALKER = ROOT / "examples" / "talker" / "talker.stride"
MARKER = Path("share", "ament_index", "resource_index", "packages", "midstride")


def prefix() -> Path:
    """Where the environment has this package."""
    found = [Path(each) for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    return next(each for each in found if (each / MARKER).is_file())


class InstalledPackage(unittest.TestCase):
    """The prefix of the package, as its set-up file shows it."""

    def test_files_of_a_ros_package_are_there(self) -> None:
        share = prefix() / "share" / "midstride"
        assert "<name>midstride</name>" in (share / "package.xml").read_text(encoding="utf-8")
        for shell in ("bash", "zsh"):
            assert (share / "environment" / f"midstride.{shell}").is_file()

    def test_the_programs_check_a_file_and_refuse_a_wrong_one(self) -> None:
        for program in (prefix() / "bin" / "midstride", prefix() / "lib" / "midstride" / "midstride"):
            for file, status in ((TALKER, 0), (ROOT / "LICENSE", 1)):
                done = subprocess.run([program, "check", file], capture_output=True, text=True, timeout=60, check=False)
                assert done.returncode == status, done.stdout + done.stderr

    def test_ros2_finds_the_command_and_its_verbs(self) -> None:
        assert [each.value for each in entry_points(group="ros2cli.command", name="midstride")] == [
            "midstride.cli.ros2_command:MidstrideCommand"
        ]
        assert {"check", "import", "up"} <= {each.name for each in entry_points(group="midstride.verb")}

    def test_launch_finds_the_extension(self) -> None:
        found = {each.name: each.value for each in entry_points(group="launch.frontend.launch_extension")}
        assert found.get("midstride") == "midstride.launch"

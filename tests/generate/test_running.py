"""Generated projects run without an edit, and edits survive regeneration, through the command line."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.backends.ros1_support import own_master_uri
from tests.cli.conftest import Midstride, nothing_lost, running

SEEDS = Path(__file__).parents[1] / "lang" / "seeds"


@pytest.fixture
def midstride() -> Iterator[Midstride]:
    yield from running()


@pytest.fixture
def patrol(tmp_path: Path) -> Path:
    for name in ("patrol.stride", "sensors.stride"):
        shutil.copy(SEEDS / name, tmp_path)
    return tmp_path / "patrol.stride"


def modes(midstride: Midstride) -> dict[str, str]:
    """The mode of each functionality; the component of each role."""
    status = midstride("status", "--json").json
    assert status["valid"], status
    return {
        **{f"{entry['role']}.{row['name']}": row["mode"]
           for entry in status["instances"] for row in entry["functionalities"]},
        **{entry["role"]: entry["component"] for entry in status["instances"]},
    }  # fmt: skip


@pytest.mark.parametrize(
    "backend",
    [
        pytest.param("sim", marks=pytest.mark.full),
        pytest.param("ros2", marks=(pytest.mark.ros2, pytest.mark.full)),
        pytest.param("ros1", marks=(pytest.mark.ros1, pytest.mark.full)),
    ],
)
def test_the_sample_is_generated_runs_and_is_changed(
    backend: str, midstride: Midstride, patrol: Path, tmp_path: Path
) -> None:
    """Both files of language.md, without an edit: from the text to a replacement in the running system."""
    folder = tmp_path / "made"
    generated = midstride("generate", str(patrol), "-o", str(folder), *(["--ros", "1"] if backend == "ros1" else []))
    assert generated.status == 0, generated.err
    assert generated.out.endswith(
        f"it starts with `midstride up patrol patrol.stride`.\nStart it with `midstride up {folder}/patrol.stride`.\n"
    )
    file = folder / "patrol.stride"
    assert midstride("check", "--strict", str(file)).status == 0
    with own_master_uri() if backend == "ros1" else nullcontext() as uri:
        midstride.environment |= {} if uri is None else {"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1"}
        up = midstride("up", str(file), "--backend", backend, "--detach")
        assert up.status == 0, up.out + up.err
        whole = {"lidar.sense": "normal", "detector.detect": "normal", "controller.control": "normal"}
        played = {"lidar": "Lidar", "detector": "ObstacleDetector", "controller": "MotorController"}
        assert modes(midstride) == whole | played
        # Both detectors use the camera, so the old one must be removed first, but the controller must stay at normal.
        refused = midstride("replace", "detector", "StereoDetector", "--yes", "--json")
        assert (refused.status, refused.json["outcome"]) == (1, "refused")
        assert "keep controller.control at normal" in refused.json["because"]
        assert modes(midstride) == whole | played
        calm = folder / "calm.stride"
        text = file.read_text(encoding="utf-8")
        calm.write_text(text.replace("keep  controller.control at normal", "keep controller.control at stop"))
        assert midstride("apply", str(calm), "--yes", "--json").json["plan"]["steps"] == []
        replaced = midstride("replace", "detector", "StereoDetector", "--yes", "--json", timeout=100)
        assert replaced.status == 0, replaced.out + replaced.err
        assert set(replaced.json["below_baseline_seconds"]) == {"detector.detect", "controller.control"}
        assert modes(midstride) == whole | played | {"detector": "StereoDetector"}
        # A lidar uses no resource: the new one starts beside the old one, and nothing is degraded.
        more = 'component SecondLidar like Lidar { run "python3 -m patrol.second" }\n'
        calm.write_text(calm.read_text() + more)
        again = midstride("generate", str(calm), "-o", str(folder), *(["--ros", "1"] if backend == "ros1" else []))
        assert "written" in again.out and "second.py" in again.out
        handed = midstride("replace", "lidar", "SecondLidar", "--from", str(calm), "--yes", "--json", timeout=100)
        assert handed.status == 0, handed.out + handed.err
        assert not any(handed.json["below_baseline_seconds"].values())
        assert nothing_lost(handed.json["swaps"], backend)
        assert midstride("down").status == 0


CHAIN = """system chain

contract Text = std_msgs/msg/String @ 10 Hz

topic /raw  : Text
topic /neat : Text

component Source {
  run "python3 source.py"
  output out
  functionality make {
    produces out
    mode normal { guarantee out : Text }
    mode off { }
  }
}

component Filter {
  run "python3 -m filters.first"
  input  in : Text
  output out
  functionality filter {
    uses in
    produces out
    mode normal { assume in   guarantee out : Text }
    mode off { }
  }
}

component Other like Filter { run "python3 -m filters.other" }

component Sink {
  run "python3 sink.py"
  input in : Text
  functionality use {
    uses in
    mode normal { assume in }
    mode off { }
  }
}

node source : Source { out -> /raw }
node filter : Filter { in <- /raw   out -> /neat }
node sink   : Sink   { in <- /neat }
"""


def test_edits_survive_regeneration(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    folder = tmp_path / "made"
    assert midstride("generate", str(specification), "-o", str(folder)).status == 0
    source = folder / "source.py"
    source.write_text(
        source.read_text().replace("class Source(SourceBase):", "MINE = 1\n\n\nclass Source(SourceBase):")
    )
    (folder / "setup.py").write_text("# all mine\n")
    again = midstride("generate", str(specification), "-o", str(folder))
    assert again.status == 0
    assert "written" not in again.out
    specification.write_text(CHAIN.replace("mode off { }", "mode low { guarantee out : Text }\n    mode off { }", 1))
    done = midstride("generate", str(specification), "-o", str(folder), "--json").json
    states = {entry["file"]: (entry["state"], entry["note"]) for entry in done["files"]}
    assert states["source.py"] == ("written", "new: make_low")
    assert states["chain.stride"] == ("written", None)
    assert states["setup.py"] == ("kept", "edited, left unchanged")
    assert states["sink.py"] == ("kept", None)
    assert "MINE = 1" in source.read_text()
    assert (folder / "setup.py").read_text() == "# all mine\n"
    (folder / "chain.stride").write_text(CHAIN + "# mine\n")
    kept = midstride("generate", str(specification), "-o", str(folder))
    assert "kept" in kept.out
    assert (folder / "chain.stride").read_text().endswith("# mine\n")


@pytest.mark.skipif(importlib.util.find_spec("setuptools") is None, reason="setuptools is not installed here")
@pytest.mark.parametrize("named", [["chain", "chain.stride"], ["package://chain/chain.stride"]])
def test_what_colcon_installs_runs(midstride: Midstride, tmp_path: Path, named: list[str]) -> None:
    """Programs run by path and programs run as modules, from the folder where colcon installs them."""
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    folder, prefix = tmp_path / "made", tmp_path / "install"
    assert midstride("generate", str(specification), "-o", str(folder)).status == 0
    # As colcon-core's tasks for Python packages do it.
    words = ["egg_info", "build", "install", "--prefix", str(prefix), "--record", str(tmp_path / "record")]
    command = [sys.executable, "-W", "ignore", "setup.py", *words, "--single-version-externally-managed"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    shutil.rmtree(folder)
    (packages,) = prefix.glob("lib/python3*/site-packages")
    midstride.environment |= {"PYTHONPATH": str(packages), "AMENT_PREFIX_PATH": str(prefix)}
    share = prefix / "share" / "chain"
    assert (share / "launch" / "chain.launch.py").exists()
    up = midstride("up", *named, "--backend", "sim", "--detach")
    assert up.status == 0, up.out + up.err
    assert "specification: package://chain/chain.stride\n" in midstride("status").out
    assert set(modes(midstride).values()) >= {"normal"}
    assert "off" not in modes(midstride).values()


def test_for_ros_1_there_are_catkins_files(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    folder = tmp_path / "made"
    assert midstride("generate", str(specification), "-o", str(folder), "--ros", "1").status == 0
    installed = 'install(FILES "chain.stride" "sink.py" "source.py" DESTINATION "${CATKIN_PACKAGE_SHARE_DESTINATION}")'
    assert installed in (folder / "CMakeLists.txt").read_text()
    assert "packages=['filters']" in (folder / "setup.py").read_text()
    assert 'args="package://chain/chain.stride"' in (folder / "launch" / "chain.launch").read_text()
    assert os.access(folder / "up.sh", os.X_OK)
    assert subprocess.run(["sh", "-n", str(folder / "up.sh")], check=False).returncode == 0
    for path in folder.glob("**/*.py"):
        compile(path.read_text(), str(path), "exec")


def test_a_component_that_cannot_be_generated_is_reported(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "s.stride"
    specification.write_text(
        'system s\ncomponent C { run "python3 c.py"   output out\n'
        "functionality f { produces out   mode a { }   mode b { } } }\n"
    )
    done = midstride("generate", str(specification), "-o", str(tmp_path / "made"))
    assert (done.status, done.out) == (1, "")
    assert "output out of C has no type" in done.err
    assert not (tmp_path / "made").exists()

"""What is generated runs at once, without an edit, and is edited and generated again by the command line."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

SEEDS = Path(__file__).parents[1] / "lang" / "seeds"


class Midstride:
    """The command line, with a folder of its own for what runs."""

    def __init__(self, runtime: Path) -> None:
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}

    def __call__(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "midstride", *words]
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
            env=self.environment,
            stdin=subprocess.DEVNULL,
        )


@pytest.fixture
def midstride() -> Iterator[Midstride]:
    runtime = Path(tempfile.mkdtemp(prefix="ms"))  # short: sockets live in it
    made = Midstride(runtime)
    yield made
    made("down")
    shutil.rmtree(runtime)


@pytest.fixture
def patrol(tmp_path: Path) -> Path:
    for name in ("patrol.stride", "sensors.stride"):
        shutil.copy(SEEDS / name, tmp_path)
    return tmp_path / "patrol.stride"


def test_the_sample_is_generated_and_runs(midstride: Midstride, patrol: Path, tmp_path: Path) -> None:
    folder = tmp_path / "made"
    done = midstride("generate", str(patrol), "-o", str(folder))
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(f"Start it with `midstride up {folder}/patrol.stride`.\n")
    assert midstride("check", "--strict", str(folder / "patrol.stride")).returncode == 0
    up = midstride("up", str(folder / "patrol.stride"), "--backend", "sim", "--detach")
    assert up.returncode == 0, up.stdout + up.stderr
    status = json.loads(midstride("status", "--json").stdout)
    modes = {row["name"]: row["mode"] for entry in status["components"] for row in entry["functionalities"]}
    assert modes == {"lidar.sense": "normal", "detector.detect": "normal", "controller.control": "normal"}
    assert midstride("down").returncode == 0


@pytest.mark.ros2
@pytest.mark.timeout(180)
def test_it_runs_on_ros_2(midstride: Midstride, tmp_path: Path) -> None:
    """Three nodes of messages that every ROS 2 has, generated and started."""
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    done = midstride("generate", str(specification), "-o", str(tmp_path))
    assert done.returncode == 0, done.stderr
    up = midstride("up", str(specification), "--backend", "ros2", "--detach")
    assert up.returncode == 0, up.stdout + up.stderr
    status = json.loads(midstride("status", "--json").stdout)
    modes = {row["mode"] for entry in status["components"] for row in entry["functionalities"]}
    assert modes == {"normal"}
    replaced = midstride("replace", "filter", "Other", "--yes", "--json")
    assert replaced.returncode == 0, replaced.stdout + replaced.stderr
    assert json.loads(replaced.stdout)["outcome"] == "done"


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


def test_generated_again_what_was_written_is_still_there(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    folder = tmp_path / "made"
    assert midstride("generate", str(specification), "-o", str(folder)).returncode == 0
    source = folder / "source.py"
    source.write_text(
        source.read_text().replace("class Source(SourceBase):", "MINE = 1\n\n\nclass Source(SourceBase):")
    )
    (folder / "setup.py").write_text("# all mine\n")
    again = midstride("generate", str(specification), "-o", str(folder))
    assert again.returncode == 0
    assert "written" not in again.stdout
    specification.write_text(CHAIN.replace("mode off { }", "mode low { guarantee out : Text }\n    mode off { }", 1))
    done = json.loads(midstride("generate", str(specification), "-o", str(folder), "--json").stdout)
    states = {entry["file"]: (entry["state"], entry["note"]) for entry in done["files"]}
    assert states["source.py"] == ("written", "new: make_low")
    assert states["chain.stride"] == ("written", None)
    assert states["setup.py"] == ("kept", "edited, left as it is")
    assert states["sink.py"] == ("kept", None)
    assert "MINE = 1" in source.read_text()
    assert (folder / "setup.py").read_text() == "# all mine\n"
    (folder / "chain.stride").write_text(CHAIN + "# mine\n")
    kept = midstride("generate", str(specification), "-o", str(folder))
    assert "kept" in kept.stdout
    assert (folder / "chain.stride").read_text().endswith("# mine\n")


def test_for_ros_1_there_are_catkins_files(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "chain.stride"
    specification.write_text(CHAIN, encoding="utf-8")
    folder = tmp_path / "made"
    assert midstride("generate", str(specification), "-o", str(folder), "--ros", "1").returncode == 0
    assert "catkin_install_python(PROGRAMS filters/first.py" in (folder / "CMakeLists.txt").read_text()
    assert 'args="$(dirname)/../chain.stride"' in (folder / "launch" / "chain.launch").read_text()
    assert os.access(folder / "up.sh", os.X_OK)
    assert subprocess.run(["sh", "-n", str(folder / "up.sh")], check=False).returncode == 0
    for path in folder.glob("**/*.py"):
        compile(path.read_text(), str(path), "exec")


def test_what_cannot_be_generated_is_said(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "s.stride"
    specification.write_text(
        'system s\ncomponent C { run "python3 c.py"   output out\n'
        "functionality f { produces out   mode a { }   mode b { } } }\n"
    )
    done = midstride("generate", str(specification), "-o", str(tmp_path / "made"))
    assert (done.returncode, done.stdout) == (1, "")
    assert "output out of C has no type" in done.stderr
    assert not (tmp_path / "made").exists()

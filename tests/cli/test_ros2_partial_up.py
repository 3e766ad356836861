"""A robot on real ROS 2 of which some programs end, fail or are missing: the rest comes up (R6, R11)."""

from __future__ import annotations

import json
import os
import signal
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# A node in plain rclpy.
TALK = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talk")
publisher = node.create_publisher(String, "out", 10)
node.create_timer(0.05, lambda: publisher.publish(String(data="here")))
try:
    rclpy.spin(node)
except BaseException:
    pass
"""
# A set-up that writes how often it has run, with its arguments.
SETUP = """
import sys
from pathlib import Path
file = Path(sys.argv[1])
runs = file.read_text() if file.exists() else ""
file.write_text(runs + " ".join(sys.argv[2:]) + "\\n")
if file.with_suffix(".fails").exists():
    sys.exit("the arm does not answer")
"""


def program(folder: Path, name: str, text: str) -> None:
    """An executable of the package `demo` in the ament prefix ``folder``."""
    for each in (folder / "lib" / "demo", folder / "share" / "ament_index" / "resource_index" / "packages"):
        each.mkdir(parents=True, exist_ok=True)
    (folder / "share" / "demo").mkdir(parents=True, exist_ok=True)
    (folder / "share" / "ament_index" / "resource_index" / "packages" / "demo").touch()
    file = folder / "lib" / "demo" / name
    file.write_text(f"#!{sys.executable}\n{text}")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)


def until(holds: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)


def compare_with_what_runs(described: list[dict[str, Any]], midstride: Midstride) -> None:
    """The command, the environment and the files of the driver are those that were shown before its start."""
    [driver, instant] = described
    assert (driver["node"], instant["node"], instant["once"]) == ("driver", "instant", True)
    [pid] = [each["pid"] for each in midstride("status", "--json").json["instances"] if each["name"] == "driver"]
    command = Path(f"/proc/{pid}/cmdline").read_text().split("\0")[:-1]
    # The program is a script: the kernel puts its interpreter first.
    assert command[1:] == driver["command"]
    pairs = (each.partition("=") for each in Path(f"/proc/{pid}/environ").read_text().split("\0")[:-1])
    environment = {name: value for name, _, value in pairs}
    shown = {name: value for name, value in driver["environment"].items() if value is not None}
    given = {"MIDSTRIDE_TOKEN", "MIDSTRIDE_START", "MIDSTRIDE_GATE_NODE"}
    assert {shown[name].partition(" ")[2] for name in given} == {"at the start)"}
    assert {name: environment.get(name) for name in shown if name not in given} == {
        name: value for name, value in shown.items() if name not in given
    }
    removed = {name for name, value in driver["environment"].items() if value is None}
    # With the wheels of ROS 2, an interpreter starts itself anew with these.
    assert not (removed & environment.keys()) - {"LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    for path, text in driver["files"].items():
        assert Path(path).read_text() == text


def test_a_launched_robot_comes_up_with_programs_that_end_fail_or_are_missing(
    midstride: Midstride, tmp_path: Path
) -> None:
    prefix, ran = tmp_path / "ws", tmp_path / "ran"
    program(prefix, "talk_exe", TALK)
    program(prefix, "setup", SETUP)
    path = f"{prefix}:{os.environ.get('AMENT_PREFIX_PATH', '')}".rstrip(":")
    midstride.environment["AMENT_PREFIX_PATH"] = path
    launch = tmp_path / "r9.launch.xml"
    launch.write_text(
        '<launch><node pkg="demo" exec="talk_exe" name="driver"><remap from="out" to="/r9"/>'
        '<param name="rate" value="20.0"/></node>'
        '<executable cmd="true" name="instant"/></launch>'
    )
    file = tmp_path / "r9.stride"
    assert midstride("import", str(launch), "-o", str(file)).status == 0
    shown = midstride.process("up", str(file), "--dry-run", "--json", timeout=60)
    assert shown.status == 0 and not (midstride.runtime / "midstride").exists(), shown.out + shown.err
    # R6: three times 0, and both nodes are there.
    up = midstride("up", str(file), "-d", timeout=60)
    compare_with_what_runs(shown.json["processes"], midstride)
    assert (up.status, up.out.splitlines()[-2]) == (0, "r9 is up (driver, instant)."), up.out + up.err
    assert up.out.splitlines()[-1].startswith("Up, all 2 nodes run; not measurable here: what driver does"), up.out
    status = midstride("status", "--json").json
    assert [(each["name"], each["done"]) for each in status["instances"]] == [("driver", False), ("instant", True)]
    assert status["crashed"] == []
    assert midstride("down").status == 0
    # Beside it: a set-up of the package, a program that is missing, and one that ends without having come up.
    text = file.read_text().replace("node driver", "node other").partition("node other")[0]
    file.write_text(
        text
        + f"""
component Setup {{ run "setup {ran} first" package "demo" once }}
component Missing {{ run "no_such_program" gate none }}
component Ends {{ run "true" gate none }}
node driver : TalkExe
node instant : True {{ respawn }}
node setup : Setup
node missing : Missing
node ends : Ends
"""
    )
    up = midstride("up", str(file), "-d", timeout=60)
    assert up.status == 3, up.out + up.err
    assert "r9 is up without ends, missing (driver, instant, setup)." in up.out.splitlines()
    assert "no_such_program" in up.out and 'if it had done its work then, state it: `run "…" once`' in up.out
    [arguments] = ran.read_text().splitlines()
    assert arguments.startswith("first --ros-args -r __node:=setup"), arguments
    crashed = midstride("status", "--json").json["crashed"]
    assert [(each["role"], each["status"]) for each in crashed] == [("ends", 0), ("missing", None)]
    # A later change neither needs nor restores them, nor runs the set-up again; nor does the next manager.
    restarted = midstride("restart", "driver", "--yes", timeout=60)
    assert restarted.status == 0, restarted.out + restarted.err
    assert "missing does not run, and this change does not start it" in restarted.out
    os.kill(midstride.manager("r9"), signal.SIGKILL)
    again = midstride("up", str(file), "-d", timeout=60)
    assert again.status == 3 and len(ran.read_text().splitlines()) == 1, again.out + again.err
    # It runs again when its command changes, and what fails is rolled back.
    changed = file.read_text().replace(f"{ran} first", f"{ran} second")
    file.write_text(changed)
    assert midstride("apply", str(file), "--yes", timeout=60).status == 0
    assert [line.split()[0] for line in ran.read_text().splitlines()] == ["first", "second"]
    ran.with_suffix(".fails").touch()
    failed = midstride("restart", "setup", "--yes", "--json", timeout=60)
    assert failed.status == 1 and "the arm does not answer" in json.dumps(failed.json)
    names = [each["name"] for each in midstride("status", "--json").json["instances"] if each["role"] == "setup"]
    assert names == ["setup_2"] and len(ran.read_text().splitlines()) == 3
    assert midstride("down").status == 0
    until(lambda: midstride("status").status == 1, "it is down")
    # All or nothing.
    strict = midstride("up", str(file), "-d", "--strict", timeout=60)
    assert strict.status == 1 and midstride("status").status == 1, strict.out + strict.err

"""``up --dry-run`` shows what would be started; nothing is started or written."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.cli import dry_run
from midstride.lang import load
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from tests.cli.conftest import EXAMPLES, Midstride
from tests.runtime.systems import rewritten

SETUP = """
component Setup { run "python3 setup.py --now" takes 2 s once }
component Gone { run "./nosuch" }
node setup : Setup
node gone : Gone
order setup before talker
"""


def test_processes_are_shown_in_the_order_of_their_starts(midstride: Midstride, tmp_path: Path) -> None:
    before = sorted(midstride.runtime.rglob("*"))
    file = str(EXAMPLES / "talker" / "talker.stride")
    done = midstride.process("up", file, "--backend", "sim", "--dry-run", "--json")
    assert done.status == 0, done.err
    assert [(each["node"], each["command"], each["because"]) for each in done.json["processes"]] == [
        ("listener", ["python3", "listener.py"], None),
        ("talker", ["python3", "talker.py"], None),
    ]
    assert done.json["steps"][0] == "create listener (Listener)" and len(done.json["steps"]) == 6
    text = midstride.process("up", file, "--backend", "sim", "--dry-run").out.splitlines()
    assert text[2:4] == ["1. listener (Listener)", "   python3 listener.py"]
    assert text[-1] == "Nothing was started, and nothing was written."
    assert sorted(midstride.runtime.rglob("*")) == before


def test_programs_that_end_and_those_that_are_missing_are_named(midstride: Midstride, tmp_path: Path) -> None:
    folder = rewritten("talker", tmp_path / "programs", lambda name, text: text + SETUP * name.endswith(".stride"))
    (folder / "setup.py").write_text("")
    done = midstride.process("up", str(folder / "talker.stride"), "--backend", "sim", "--dry-run", "--json")
    processes = {each["node"]: each for each in done.json["processes"]}
    assert [name for name in processes if name in ("setup", "talker")] == ["setup", "talker"]
    assert processes["setup"]["once"] and processes["setup"]["command"] == ["python3", "setup.py", "--now"]
    assert "not `./nosuch`" in processes["gone"]["because"]
    assert done.status == 3


@pytest.mark.ros2
def test_on_ros_2_arguments_environment_and_files_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What runs then has just these: tests/cli/test_ros2_partial_up.py."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    monkeypatch.setenv("SECRET", "s")
    (tmp_path / "s.stride").write_text(
        """system s
topic /r9 : std_msgs/msg/String
component Driver {
  run "python3 talk.py --fast" prefix "nice -n 5" gate preload
  environment { DEBUG = "1", unset SECRET }
  parameters { rate = 20.0 }
  output out
  functionality f { produces out  mode normal { guarantee out : std_msgs/msg/String }  mode quiet { } }
}
component Plain { run "python3 talk.py" gate none }
component One { run "python3 talk.py" gate none renames talk }
component Setup { run "true" once }
node plain : Plain
node one : One
namespace front { node driver : Driver { out -> /r9 } }
node setup : Setup
"""
    )
    (tmp_path / "talk.py").touch()
    specification = load(tmp_path / "s.stride").require()
    found = dry_run.dry_run(specification, "ros2", tmp_path, NO_OPTIONS)
    described = {each.node: each for each in found.processes}
    driver, plain, one, setup = (described[name] for name in ("front/driver", "plain", "one", "setup"))
    file = f"{tmp_path}/none/midstride/s/components/gates/parameters/front.driver.yaml"
    words = ["talk.py", "--fast", "--ros-args", "-r", "__node:=driver", "-r", "__ns:=/front", "-r", "out:=/r9"]
    assert driver.command[1:3] == ["-n", "5"] and driver.command[4:] == [*words, "--params-file", file]
    assert driver.files[file].splitlines()[-1].split() == ['"rate":', "20.0"]
    assert (driver.environment["DEBUG"], driver.environment["SECRET"]) == ("1", None)
    assert str(driver.environment["LD_PRELOAD"]).endswith(".so")
    assert (Path(setup.command[0]).name, setup.command[1:], setup.files) == ("true", [], {})
    # Without the library, a name is for all nodes of the process unless it is stated which one is meant.
    assert one.command[-2:] == ["-r", "talk:__node:=one"] and plain.command[-1] == "__node:=plain"
    assert [each.node for each in found.processes if each.names_all] == ["plain"]
    assert "\n".join(dry_run.lines(found)).count("names all nodes of a process: state `renames NAME`") == 1
    simulated = dry_run.dry_run(specification, "ros2", tmp_path, SystemOptions(use_sim_time=True))
    again = {each.node: each for each in simulated.processes}
    assert "use_sim_time" in again["front/driver"].files[file] and again["setup"].command == setup.command
    assert not (tmp_path / "none").exists()

"""The modules for Ansible, without Ansible: they call the real command, on a system that runs on the simulator."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import EXAMPLES, Midstride, running
from tests.fleet.collection import parameters, robot

TALKER = EXAMPLES / "talker" / "talker.stride"


@pytest.fixture(scope="module")
def executable(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The command as a file, as it is on a robot."""
    path = tmp_path_factory.mktemp("bin") / "midstride"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m midstride "$@"\n')
    path.chmod(0o755)
    return str(path)


@pytest.fixture(scope="module")
def system() -> Iterator[Midstride]:
    for midstride in running():
        done = midstride("up", str(TALKER), "--backend", "sim", "--detach")
        assert done.status == 0, done.err
        yield midstride


@pytest.fixture
def talker(system: Midstride, monkeypatch: pytest.MonkeyPatch) -> Midstride:
    monkeypatch.setenv("XDG_RUNTIME_DIR", system.environment["XDG_RUNTIME_DIR"])
    return system


@pytest.fixture
def new(tmp_path: Path) -> str:
    """A file in which another component talks."""
    path = tmp_path / "new.stride"
    path.write_text(TALKER.read_text().replace("talker   : Talker ", "talker   : NewTalker "))
    return str(path)


def component(midstride: Midstride) -> str:
    instances = midstride("status", "--json").json["instances"]
    return next(str(each["component"]) for each in instances if each["role"] == "talker")


def failure(function: Any, given: dict[str, Any], **modes: bool) -> Any:
    with pytest.raises(robot.Failure) as caught:
        function(given, **modes)
    json.dumps(caught.value.result)  # as Ansible returns it
    return caught.value


@pytest.mark.full
def test_a_change_is_planned_made_found_made_and_undone(talker: Midstride, executable: str, new: str) -> None:
    given = parameters(robot.APPLY, file=new, executable=executable)
    planned = robot.apply(given, check=True, diff=True)
    assert planned["changed"] and "report" not in planned and planned["version"] == 1
    assert planned["words"].startswith("Nothing degrades")
    assert [step["action"] for step in planned["plan"]["steps"]] == ["create", "upgrade", "handover", "remove"]
    assert "target" not in planned["plan"]
    assert "Nothing degrades" in planned["diff"]["prepared"] and "takes about" in planned["diff"]["prepared"]
    assert component(talker) == "Talker"

    done = robot.apply(given)
    assert (done["changed"], done["version_before"], done["version"]) == (True, 1, 2)
    assert done["report"]["outcome"] == "done" and done["report"]["swaps"][0]["missed"] == 0
    assert component(talker) == "NewTalker" and "diff" not in done
    entries = len(talker("history", "--json").json["changes"])
    again = robot.apply(given, diff=True)
    assert (again["changed"], again["version"], "report" in again, "diff" in again) == (False, 2, False, False)
    assert len(talker("history", "--json").json["changes"]) == entries

    back = parameters(robot.ROLLBACK, version=1, executable=executable)
    assert robot.rollback(back, check=True)["changed"] and component(talker) == "NewTalker"
    undone = robot.rollback(back)
    assert undone["changed"] and undone["report"]["outcome"] == "done" and component(talker) == "Talker"
    assert not robot.rollback(back)["changed"]


def test_what_degrades_is_said_before(talker: Midstride, executable: str, tmp_path: Path) -> None:
    file = tmp_path / "silent.stride"
    file.write_text(TALKER.read_text().replace("node talker   : Talker   { out -> /chatter }\n", ""))
    planned = robot.apply(parameters(robot.APPLY, file=str(file), executable=executable), check=True, diff=True)
    assert planned["plan"]["level_shifts"][0]["functionality"] == "listener.listen"
    assert "listener.listen is in mode degraded instead of normal" in planned["diff"]["prepared"]


def test_a_change_of_the_file_without_a_step_is_a_change(talker: Midstride, executable: str, tmp_path: Path) -> None:
    file = tmp_path / "limited.stride"
    file.write_text(TALKER.read_text() + "\nkeep listener.listen at normal\n")
    planned = robot.apply(parameters(robot.APPLY, file=str(file), executable=executable), check=True)
    assert (planned["changed"], planned["plan"]["steps"]) == (True, [])


def test_the_status_is_returned_and_judged_where_it_is_watched(talker: Midstride, executable: str) -> None:
    found = robot.status(parameters(robot.STATUS, executable=executable))
    assert (found["condition"]["state"], found["changed"], found["version"]) == ("up", False, found["version"])
    assert found["file"] and "status" not in found
    watched = parameters(robot.STATUS, executable=executable, watch=0.2, details=True)
    assert robot.status(watched)["status"]["instances"]


@pytest.mark.long
def test_a_fault_in_the_time_watched_is_a_failure(talker: Midstride, executable: str, tmp_path: Path) -> None:
    """A talker that writes one message of ten after a while passes the probation, and fails later."""
    program = (EXAMPLES / "talker" / "new_talker.py").read_text()
    tires = tmp_path / "tires.py"
    tires.write_text(program.replace("    out.write(", "    if said < 20 or not said % 10:\n        out.write("))
    file = tmp_path / "tires.stride"
    file.write_text(
        TALKER.read_text().replace("new_talker.py", str(tires)).replace("talker   : Talker ", "talker   : NewTalker ")
    )
    before = robot.status(parameters(robot.STATUS, executable=executable, watch=0.0))
    assert robot.apply(parameters(robot.APPLY, file=str(file), executable=executable))["changed"]
    failed = failure(robot.status, parameters(robot.STATUS, executable=executable, watch=60.0))
    assert failed.message.startswith("talker is degraded, ") and "and guarantees 10 Hz" in failed.message
    assert failed.result["condition"]["state"] == "degraded" and failed.result["version"] == before["version"] + 1
    back = robot.rollback(parameters(robot.ROLLBACK, version=before["version"], executable=executable))
    assert back["changed"] and component(talker) == "Talker"
    assert robot.status(parameters(robot.STATUS, executable=executable, watch=0.5))["condition"]["state"] == "up"


def test_the_manager_says_why_a_change_is_refused(talker: Midstride, executable: str, new: str) -> None:
    assert talker("lock", "--reason", "in the lift", "--by", "alice").status == 0
    try:
        for check in (False, True):
            failed = failure(robot.apply, parameters(robot.APPLY, file=new, executable=executable), check=check)
            assert "locked by alice" in failed.message and "in the lift" in failed.message
            assert failed.result["changed"] is False
    finally:
        assert talker("unlock").status == 0
    other = Path(new).with_name("other.stride")
    other.write_text(Path(new).read_text().replace("system talker", "system speaker"))
    failed = failure(robot.apply, parameters(robot.APPLY, file=str(other), executable=executable))
    assert "specification of another system, speaker" in failed.message


def test_a_file_with_an_error_and_one_that_is_not_there(talker: Midstride, executable: str, new: str) -> None:
    Path(new).write_text("system talker\nnode x : Nothing { }\n")
    failed = failure(robot.apply, parameters(robot.APPLY, file=new, executable=executable))
    assert f"{new}:2:" in failed.message and "Nothing" in failed.message
    gone = parameters(robot.APPLY, file="/nowhere/robot.stride", executable=executable)
    assert failure(robot.apply, gone).message == "there is no file /nowhere/robot.stride"
    unknown = parameters(robot.ROLLBACK, version=99, executable=executable)
    assert "the history has no version 99" in failure(robot.rollback, unknown).message


def test_a_robot_without_midstride_or_without_a_manager(
    executable: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    failed = failure(robot.status, parameters(robot.STATUS, executable=executable))
    assert failed.message.startswith("no system is running") and failed.result["error"] == "NoManager"
    script = tmp_path / "setup.bash"
    script.write_text("export NOTHING=1\n")
    for setup in ([], [str(script)]):
        absent = parameters(robot.APPLY, file=new, executable="no-midstride", setup=setup)
        assert failure(robot.apply, absent).message.startswith("no-midstride cannot be run on the robot (")
    gone = parameters(robot.APPLY, file=new, executable=executable, setup=["/nowhere/setup.bash"])
    assert failure(robot.apply, gone).message == "setup: there is no file /nowhere/setup.bash on the robot"


def test_scripts_are_read_in_order_and_one_that_fails_is_named(executable: str, tmp_path: Path) -> None:
    first, second = tmp_path / "first.bash", tmp_path / "second.bash"
    first.write_text(f"export XDG_RUNTIME_DIR={tmp_path}/none\n")
    second.write_text('export XDG_RUNTIME_DIR="$XDG_RUNTIME_DIR/inner"\n')
    given = parameters(robot.STATUS, executable=executable, setup=[str(first), str(second)])
    assert f"{tmp_path}/none/inner" in failure(robot.status, given).message
    first.write_text("echo no overlay >&2; return 3\n")
    assert "status 125" in (message := failure(robot.status, given).message) and "no overlay" in message


@pytest.mark.parametrize(
    ("status", "outcome", "words"), [(0, "done", "no manager"), (1, "failed", "entirely: it hung")]
)
def test_what_was_changed_is_known_where_the_manager_does_not_answer_afterwards(
    tmp_path: Path, status: int, outcome: str, words: str
) -> None:
    plan = {"steps": ["a step"], "start": {}, "target": {}, "continuity": {"headline": "nothing is lost"}}
    report = {"outcome": outcome, "because": "it hung", "plan": plan, "continuity": plan["continuity"]}
    error = {"error": {"kind": "NoManager", "message": "no manager runs"}}
    history = {"changes": [{"version": 3}]}
    command = tmp_path / "midstride"
    command.write_text(
        f"""#!/bin/sh
case "$*" in
*--dry-run*) echo '{json.dumps(plan)}' ;;
*--yes*) touch {tmp_path}/changed; echo '{json.dumps(report)}'; exit {status} ;;
history*) [ ! -e {tmp_path}/changed ] || exec echo '{json.dumps(error)}'; echo '{json.dumps(history)}' ;;
esac
"""
    )
    command.chmod(0o755)
    failed = failure(robot.apply, parameters(robot.APPLY, file="/x.stride", executable=str(command)))
    assert words in failed.message and failed.result["changed"] is True
    assert failed.result["report"]["outcome"] == outcome and failed.result["version_before"] == 3
    assert "version" not in failed.result


def test_a_program_that_cannot_be_run_is_named(tmp_path: Path) -> None:
    command = tmp_path / "midstride"
    command.write_text("of another kind")
    command.chmod(0o755)
    failed = failure(robot.status, parameters(robot.STATUS, executable=str(command)))
    assert failed.message.startswith(f"{command} cannot be run on the robot (")


def test_a_command_of_something_else_is_no_answer(tmp_path: Path) -> None:
    other = tmp_path / "midstride"
    other.write_text("#!/bin/sh\necho hello\n")
    other.chmod(0o755)
    failed = failure(robot.status, parameters(robot.STATUS, executable=str(other)))
    assert failed.message == f"`{other} status` ended with status 0 without an answer in JSON, and said: hello"


@pytest.mark.long
def test_the_time_limit_ends_the_command_and_not_the_change(talker: Midstride, executable: str, new: str) -> None:
    given = parameters(robot.APPLY, file=new, executable=executable, timeout=1.2)
    given["strategy"] = "stop"  # with a second of probation and more
    failed = failure(robot.apply, given)
    assert failed.result["timed_out"] and "had not ended after 1.2 s" in failed.message
    assert "The manager continues with the change" in failed.message
    assert talker("apply", str(TALKER), "--yes").status == 0  # after it
    assert component(talker) == "Talker"

"""``history`` and ``rollback`` on a running system, also over the death of its manager."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest

from midstride.cli.running_systems import find_records, find_workspace
from midstride.errors import NoManager
from midstride.runtime.records.disk import DISK
from midstride.runtime.records.journal_records import SCHEMA
from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES, Midstride
from tests.test_ament_index import planted

TALKER = str(EXAMPLES / "talker" / "talker.stride")


def up(midstride: Midstride, *options: str) -> None:
    done = midstride("up", TALKER, "--backend", "sim", "--detach", *options)
    assert done.status == 0, done.err


@pytest.mark.full
def test_a_change_is_shown_and_rolled_back(midstride: Midstride) -> None:
    up(midstride)
    refused = midstride("rollback", "--yes")
    assert refused.status == 1 and "the history has no earlier version of the specification" in refused.err
    assert midstride("replace", "talker", "NewTalker", "--yes").status == 0
    assert midstride("rollback").status == 2, "it asks first, and there is no terminal"
    plan = midstride("rollback", "--dry-run")
    assert plan.status == 0 and "rollback to version 1" in plan.out and "NewTalker" not in plan.out
    assert midstride("rollback", "1", "--dry-run", "--json").json["steps"]
    assert len(midstride("history", "--json").json["changes"]) == 2, "nothing was changed"

    done = midstride("rollback", "--yes", "--json")
    assert done.status == 0 and done.json["outcome"] == "done"
    assert [(swap["missed"], swap["lost"]) for swap in done.json["swaps"]] == [(0, 0)]
    nodes = {each["role"]: each["component"] for each in midstride("status", "--json").json["instances"]}
    assert nodes == {"talker": "Talker", "listener": "Listener"}

    changes = midstride("history", "--json").json["changes"]
    assert [(change["number"], change["outcome"], change["version"]) for change in changes] == [
        (1, "done", 1),
        (2, "done", 2),
        (3, "done", 1),
    ]
    assert changes[2]["by"].endswith(": rollback to version 1") and changes[2]["missed"] == 0
    assert [change["number"] for change in midstride("history", "--json", "-n", "1").json["changes"]] == [3]
    shown = midstride("history")
    assert shown.status == 0
    replaced = next(line for line in shown.out.splitlines() if "replace talker with" in line)
    total = changes[1]["total"]
    cells = replaced.split("replace talker with")[1].split()
    assert cells[:5] == ["done", "kept", "v2", f"{total}/{total}", "0"] and replaced.startswith("2  20")
    unknown = midstride("rollback", "9", "--yes")
    assert unknown.status == 1 and "the history has no version 9 of the specification" in unknown.err


@pytest.mark.full
def test_the_next_manager_has_the_history_of_the_one_that_was_killed(midstride: Midstride) -> None:
    up(midstride)
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    shown = midstride("history")
    assert shown.status == 0 and "the manager of talker has exited" in shown.err and " done " in shown.out
    up(midstride)  # the components of the simulator end with their manager
    document = midstride("history", "--json").json
    assert [change["command"] for change in document["changes"]] == ["up", "up"]
    assert document["damaged"] is None


@pytest.mark.full
def test_a_damaged_history_is_kept_aside(midstride: Midstride) -> None:
    up(midstride)
    assert midstride("down").status == 0
    journal = midstride.runtime / "midstride" / "talker" / "journal.db"
    journal.write_bytes(b"\xff" * 9000)
    up(midstride)
    shown, status = midstride("history"), midstride("status")
    for out in (shown.out, status.out):
        assert f"the journal {journal} was damaged (file is not a database)" in out
        kept = f"it is kept as {journal.with_name('journal.damaged.db')}"
        assert kept in " ".join(out.split()), "it may take two lines"
    assert status.status == 0


@pytest.mark.full
def test_a_system_that_is_down_shows_what_it_has_left(midstride: Midstride, tmp_path: Path) -> None:
    up(midstride)
    assert midstride("replace", "talker", "NewTalker", "--yes").status == 0
    while_up = midstride("history", "--json").json
    file = tmp_path / "change.html"
    assert midstride("report", "-o", str(file), "--json").json == midstride("report", "--change", "2", "--json").json
    assert midstride("down").status == 0

    shown = midstride("history", "--json")
    assert shown.status == 0 and shown.err == "(talker is down: this is what it has left)\n"
    assert shown.json["changes"] == while_up["changes"]
    assert [each["kind"] for each in shown.json["incidents"]][-1] == "down"
    assert "replace talker with" in midstride("history").out
    assert midstride("report", "--json").json["change"] == while_up["changes"][-1]
    assert midstride("report", "-o", str(file)).status == 0 and "NewTalker" in file.read_text()
    unknown = midstride("report", "--change", "7")
    assert unknown.status == 1 and "the history has no change 7" in unknown.err
    assert "I heard" in midstride("logs", "listener").out
    assert midstride("status").status == 1, "it is down all the same"


def left(midstride: Midstride, system: str, *, begun: bool = False) -> Workspace:
    """The files of a system that is down, with one change in its journal; ``begun``: without an outcome."""
    folder = midstride.runtime / "midstride" / system
    folder.mkdir(parents=True)
    journal = DISK.open(folder / "journal.db", SCHEMA)
    outcome = None if begun else "done"
    row = "INSERT INTO changes (at, command, total, before, after, outcome) VALUES (1e9, ?, 3, 1, 1, ?)"
    journal.write([(row, (f"up {system}", outcome))])
    journal.close()
    return Workspace(folder)


def test_of_several_systems_that_are_down_one_is_named(midstride: Midstride) -> None:
    left(midstride, "arm")
    assert "up arm" in midstride("history").out
    left(midstride, "base")
    refused = midstride("history")
    assert refused.status == 2
    assert "no system is running; of those that are down (arm, base) choose one with --system NAME" in refused.err
    assert "up base" in midstride("history", "--system", "base").out
    assert midstride("history", "--system", "bse").err == (
        "midstride history: no system bse is running; did you mean `base`?\n"
    )


def test_what_acts_on_a_running_system_does_not_take_one_that_is_down(
    midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    left(midstride, "arm")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(midstride.runtime))
    assert find_records(None).name == "arm"
    for system in (None, "arm"):  # as for `capture --probe`
        with pytest.raises(NoManager, match="no system"):
            find_workspace(system)


def test_a_change_that_no_manager_goes_on_with_was_interrupted(midstride: Midstride) -> None:
    space = left(midstride, "arm", begun=True)
    assert "interrupted" in midstride("history").out
    space.journal.write_bytes(b"\xff" * 9000)
    refused = midstride("history")
    assert refused.status == 1
    assert f"cannot read the journal {space.journal}: file is not a database" in refused.err


@pytest.mark.full
def test_a_specification_of_a_package_is_named_by_it(
    midstride: Midstride, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix = planted(tmp_path, "robot")
    monkeypatch.setenv("AMENT_PREFIX_PATH", prefix)
    midstride.environment["AMENT_PREFIX_PATH"] = prefix
    shutil.copytree(EXAMPLES / "talker", tmp_path / "share" / "robot", dirs_exist_ok=True)
    assert midstride("up", "robot", "talker.stride", "--backend", "sim", "--detach").status == 0
    words = [each["words"] for each in midstride("history", "--json").json["incidents"] if each["kind"] == "up"]
    assert words == ["talker is up from package://robot/talker.stride: 2 components"]

"""``midstride logs``: what components have written, also across replacements and crashes."""

from __future__ import annotations

import json
import os
import select
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from midstride.cli.commands import logs_command
from midstride.cli.component_logs import LONGEST_TAIL, Appended, last_lines, log_files
from midstride.runtime.process.log_runs import begin_run, run_begun
from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES, Midstride
from tests.cli.statuses import component, crash, status


def test_a_nodes_log_is_printed(talker: Midstride) -> None:
    deadline = time.monotonic() + 30
    while len(talker("logs", "listener").out.splitlines()) < 5:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    every = talker("logs", "listener").out.splitlines()
    assert all(line.startswith("[INFO] [listener]: ") for line in every) and "I heard" in every[-1]
    assert len(talker("logs", "listener", "-n", "2").out.splitlines()) == 2
    assert talker("logs", "listener", "-n", "0").out == ""
    document = json.loads(talker("logs", "listener", "--lines", "1", "--json").out)
    assert document["instance"] == "listener" and "I heard" in document["line"]


def test_an_unknown_node_is_an_error_with_a_near_miss(talker: Midstride) -> None:
    refused = talker("logs", "listner")
    assert (refused.status, refused.out) == (1, "")
    assert refused.err == "midstride logs: there is no log of listner in the system talker; did you mean `listener`?\n"


def test_without_a_manager_the_files_are_there_all_the_same(tmp_path: Path) -> None:
    for name in ("talker", "talker_2", "talker_x", "front.talker", "manager"):
        workspace(tmp_path, **{name: f"of {name}"})
    space = Workspace(tmp_path)
    assert [path.stem for path in log_files(space, "talker", None)] == ["talker", "talker_2"]
    assert [path.stem for path in log_files(space, "front/talker", None)] == ["front.talker"]
    assert [path.stem for path in log_files(space, "talker_2", None)] == ["talker_2"]
    assert log_files(space, "manager", None) == []


def test_after_a_crash_the_log_of_the_instance_that_crashed_is_shown_too(tmp_path: Path) -> None:
    space = workspace(tmp_path, talker="of the first", talker_2="of the second", talker_3="of the third")

    def found(live: dict[str, str], crashed: list[str], node: str) -> list[str]:
        components = [component(name, role=role) for name, role in live.items()]
        found = status(*components, crashed=[crash(name) for name in crashed])
        return [path.stem for path in log_files(space, node, found)]

    assert found({"talker_3": "talker"}, [], "talker") == ["talker_3"]
    assert found({"talker_3": "talker"}, [], "talker_3") == ["talker_3"]
    assert found({"talker_3": "talker"}, ["talker_2"], "talker") == ["talker_2", "talker_3"]
    assert found({}, ["talker_2"], "talker") == ["talker_2"]
    assert found({}, ["talker_2"], "talker_2") == ["talker_2"]


def test_nodes_that_share_a_container_share_its_log(tmp_path: Path) -> None:
    space = workspace(tmp_path, pipeline="of both", talker_2="of one for itself", manager="of the manager")
    shared = {**component("talker", role="talker"), "container": "pipeline", "process": "pipeline"}
    alone = {**component("talker_2", role="talker"), "container": "pipeline"}

    def found(node: str, *components: dict[str, Any]) -> list[str]:
        return [path.stem for path in log_files(space, node, status(*components))]

    assert found("talker", shared) == found("pipeline", shared) == ["pipeline"]
    assert found("talker", alone) == ["talker_2"]
    assert found("pipeline", shared, alone) == ["pipeline", "talker_2"]
    assert found("manager") == []


def test_the_copy_of_another_hosts_log_is_that_of_the_instances_there(tmp_path: Path) -> None:
    """An instance here may have the name of an earlier one there."""
    space = workspace(tmp_path, talker="here")
    (space.logs / "arm").mkdir()
    for name in ("talker", "talker_2"):
        (space.logs / "arm" / f"{name}.log").write_text("there\n")
    os.utime(space.logs / "talker.log", (1, 1))
    hosts = [
        {
            "name": "arm",
            "destination": "arm",
            "connected": True,
            "since": 1.0,
            "because": None,
            "version": "",
            "instances": [],
        }
    ]

    def found(*components: dict[str, Any], **more: Any) -> list[str]:
        paths = log_files(space, "talker", status(*components, hosts=hosts, **more))
        return [str(path.relative_to(space.logs)) for path in paths]

    assert found(component("talker")) == ["talker.log"]
    assert found(component("talker", host="arm")) == ["arm/talker.log"]
    assert found(component("talker", host="seen-from-inside-a-container")) == ["talker.log"]
    assert found(crashed=[crash("talker_2")]) == ["arm/talker_2.log"]
    assert [path.stem for path in log_files(space, "talker", None)] == ["talker", "talker", "talker_2"]


@pytest.mark.parametrize(
    ("fields", "problems", "words"),
    [
        ({"log_file": None}, {}, "talker was started elsewhere, so its output is there"),
        (
            {"log_file": "/run/talker.log"},
            {},
            "the log of talker, /run/talker.log, is not there: it was removed, or could not be written",
        ),
        (
            {"log_file": "arm:/far/talker.log", "host": "arm"},
            {"arm": "its connection is silent"},
            "the log of talker is arm:/far/talker.log, and cannot be read now: its connection is silent",
        ),
    ],
)
def test_a_node_without_a_log_is_said_to_be_so_for_the_reason(
    fields: dict[str, Any], problems: dict[str, str], words: str
) -> None:
    assert logs_command.why_no_log("talker", status({**component("talker"), **fields}), problems) == words


def test_after_a_container_has_crashed_its_log_is_that_of_its_nodes(tmp_path: Path) -> None:
    """The last one is meant, where they had moved to another process."""
    space = workspace(tmp_path, pipeline="of both", pipeline_2="of both, later", talker_2="of one for itself")
    os.utime(space.logs / "pipeline.log", (1, 1))

    def found(node: str, *names: str) -> list[str]:
        crashed = [crash(name, container="pipeline") for name in names]
        return [path.stem for path in log_files(space, node, status(crashed=crashed))]

    assert found("talker", "talker", "listener") == ["pipeline_2"]
    assert found("pipeline", "talker", "listener") == ["pipeline_2"]
    assert found("talker", "talker_2") == ["talker_2"]
    assert found("pipeline", "talker_2", "listener") == ["talker_2", "pipeline_2"]


def workspace(folder: Path, **logs: str) -> Workspace:
    (folder / "logs").mkdir(exist_ok=True)
    for name, text in logs.items():
        (folder / "logs" / f"{name}.log").write_text(text + "\n")
    return Workspace(folder)


RUNS = """before
==== talker was started 2026-11-26 09:00:00 ====
[INFO] [1795230947.628793895] [talker]: of the first
==== talker was started 2026-11-26 10:00:00 ====
[INFO] [1795230948.500000000] [talker]: of the second
[INFO] [12.500000000] [talker]: in simulated time
==== no line of ours ====
"""


def test_of_several_runs_in_a_log_the_latest_is_shown_in_local_time(midstride: Midstride) -> None:
    folder = midstride.runtime / "midstride" / "patrol"
    (folder / "logs").mkdir(parents=True)
    (folder / "journal.db").touch()
    (folder / "logs" / "talker.log").write_text(RUNS)
    latest = [
        f"[INFO] [{time.strftime('%H:%M:%S', time.localtime(1795230948))}.500] [talker]: of the second",
        "[INFO] [12.500000000] [talker]: in simulated time",
        "==== no line of ours ====",
    ]
    shown = midstride("logs", "talker")
    assert (shown.status, shown.out.splitlines()) == (0, latest)
    assert "(talker was started 2026-11-26 10:00:00; 1 earlier run: `midstride logs talker --all`)" in shown.err
    assert midstride("logs", "talker", "-n", "2").out.splitlines() == latest[1:]
    every = midstride("logs", "talker", "--all").out.splitlines()
    assert every[:2] == ["before", "==== talker was started 2026-11-26 09:00:00 ===="] and every[-3:] == latest
    documents = [json.loads(line) for line in midstride("logs", "talker", "--json").out.splitlines()]
    assert documents[0]["line"] == "[INFO] [1795230948.500000000] [talker]: of the second"


def test_a_replacement_that_has_ended_is_named_and_its_log_is_shown(
    midstride: Midstride, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = midstride.runtime / "midstride" / "patrol" / "logs"
    folder.mkdir(parents=True)
    (folder.parent / "journal.db").touch()
    for name, at, text in (("src", "10:00:00", "old"), ("src_2", "10:30:00", "ValueError"), ("src_3", "09:00:00", "x")):
        (folder / f"{name}.log").write_text(f"==== {name} was started 2026-11-26 {at} ====\n{text}\n")
    monkeypatch.setattr(logs_command, "_status", lambda _: status(component("src", role="src")))
    shown = midstride("logs", "src")
    assert shown.out == "old\n"
    assert "(src_2, which has ended, has a log as well: `midstride logs src_2`)" in shown.err
    shown = midstride("logs", "src_2")
    assert (shown.out, "has a log as well" in shown.err) == ("ValueError\n", False)
    assert midstride("logs", "src_4").status == 1


def test_the_begin_of_a_run_is_on_a_line_of_its_own(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    begin_run(log, "front/a")
    with log.open("a") as file:
        file.write("half a line")
    begin_run(log, "front/a")
    first, half, second = log.read_text().splitlines()
    assert half == "half a line"
    assert run_begun(first) is not None and run_begun(second) is not None and run_begun(half) is None
    begin_run(tmp_path / "missing" / "a.log", "a")  # what starts the process reports it


def test_a_restarted_node_does_not_show_what_ran_before(midstride: Midstride) -> None:
    for _ in range(2):
        assert midstride("up", str(EXAMPLES / "talker" / "talker.stride"), "--backend", "sim", "-d").status == 0
        deadline = time.monotonic() + 30
        while "I heard" not in midstride("logs", "listener").out:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        shown = midstride("logs", "listener").out
        assert shown.count("listener is managed by") == 1 and "was started" not in shown
        assert midstride("down").status == 0
    whole = (midstride.runtime / "midstride" / "talker" / "logs" / "listener.log").read_text()
    assert whole.count("==== listener was started") == whole.count("listener is managed by") == 2


def test_the_end_of_a_long_log_is_read_and_no_more(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    log.write_text("".join(f"{number:09d}\n" for number in range(LONGEST_TAIL // 5)))
    lines, end = last_lines(log)
    assert end == log.stat().st_size and len(lines) == LONGEST_TAIL // 10
    assert lines[-1] == f"{LONGEST_TAIL // 5 - 1:09d}" and all(len(line) == 9 for line in lines[:100])


def test_whole_lines_are_followed_also_where_a_log_is_shortened(tmp_path: Path) -> None:
    log, appended = tmp_path / "a.log", Appended()
    log.write_text("before\n")
    appended.follow(log, log.stat().st_size)
    with log.open("a") as file:
        file.write("one\ntw")
    assert [line for _, line in appended.lines()] == ["one"]
    with log.open("a") as file:
        file.write("o\n")
    assert [line for _, line in appended.lines()] == ["two"]
    log.write_text("kept\n")
    assert list(appended.lines()) == []
    with log.open("a") as file:
        file.write("three\n")
    assert [line for _, line in appended.lines()] == ["three"]
    log.unlink()
    assert list(appended.lines()) == []


def test_following_goes_on_across_a_replacement(talker: Midstride) -> None:
    following = talker.start("logs", "listener", "--follow")
    try:
        assert following.stdout is not None
        until(following, "I heard")
        assert talker("restart", "listener", "--yes").status == 0
        until(following, "==> listener_2 <==")
        until(following, "I heard")
        following.send_signal(signal.SIGINT)
        following.communicate(timeout=60)
        assert following.returncode == 0
    finally:
        following.kill()
        following.communicate()


def until(process: Any, words: str) -> list[str]:
    """The lines up to the first with these words."""
    lines: list[str] = []
    while not (lines and words in lines[-1]):
        assert select.select([process.stdout], [], [], 30)[0] or process.stdout.buffer.peek(1), lines
        lines.append(process.stdout.readline())
        assert lines[-1], lines
    return lines


def test_what_a_component_writes_cannot_move_the_cursor(talker: Midstride) -> None:
    name = next(entry["name"] for entry in talker("status", "--json").json["instances"] if entry["role"] == "talker")
    with (talker.runtime / "midstride" / "talker" / "logs" / f"{name}.log").open("ab") as file:
        file.write(b"\x1b[2Jgone\xff\n")
    assert talker("logs", "talker", "-n", "1").out == "\\x1b[2Jgone\ufffd\n"

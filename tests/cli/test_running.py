"""Running systems by the command line: a real manager process, real node code, the simulator below."""

from __future__ import annotations

import json
import os
import re
import resource
import select
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from midstride.cli import main
from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES, Midstride, alive, unwritten
from tests.cli.terminal import Terminal
from tests.examples import json_form

TALKER = str(EXAMPLES / "talker" / "talker.stride")


def playing(midstride: Midstride, role: str = "talker") -> tuple[str, str]:
    """The instance that plays a role, and its component."""
    components = midstride("status", "--json").json["instances"]
    return next((entry["name"], entry["component"]) for entry in components if entry["role"] == role)


@pytest.mark.full
def test_up_shows_its_progress(midstride: Midstride) -> None:
    done = midstride("up", TALKER, "--backend", "sim", "-d")
    assert (done.status, done.err) == (0, "")
    assert re.search(r"✓ 1/6 create listener \(Listener\) \d+", done.out)
    assert done.out.splitlines()[-1] == "talker is up (listener, talker)."
    manager = midstride.manager("talker")
    assert os.getsid(manager) == manager
    again = midstride("up", TALKER, "--backend", "sim", "-d")
    assert (again.status, again.out) == (1, "")
    assert f"talker is already running (manager process {manager})" in again.err
    down = midstride("down")
    assert (down.status, down.out) == (0, "talker is down.\n")
    assert midstride("status").status == 1
    up = midstride("up", TALKER, "--backend", "sim", "--json")
    assert (up.status, up.json["instances"], up.err) == (0, ["listener", "talker"], "")
    assert midstride("down", "--json").json == {"outcome": "done", "killed": [], "system": "talker"}


def test_status_shows_the_live_components(talker: Midstride) -> None:
    document = talker("status", "--json").json
    assert (document["system"], document["backend"], document["valid"]) == ("talker", "sim", True)
    modes = {
        (entry["name"], row["name"]): row["mode"] for entry in document["instances"] for row in entry["functionalities"]
    }
    assert set(modes.values()) == {"normal"}
    shown = talker("status")
    assert shown.status == 0
    assert "talker on sim: up, all 2 nodes run\n" in shown.out
    assert "/chatter: " in shown.out


def test_a_manager_that_this_user_may_not_connect_to_is_not_said_to_have_exited(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Not in TMPDIR, which another user may not be allowed to enter.
    with tempfile.TemporaryDirectory(prefix="ms", dir="/tmp") as folder, socket.socket(socket.AF_UNIX) as listening:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        workspace = Workspace.of("patrol")
        workspace.state.touch()
        listening.bind(str(workspace.socket))
        listening.listen()
        for path in (Path(folder), workspace.path.parent, workspace.path):
            path.chmod(0o755)
        workspace.socket.chmod(0)
        with workspace.lock():
            before = os.geteuid()
            if before == 0:  # whom no permission stops
                os.seteuid(65534)
            try:
                status = main(["status"])
            finally:
                os.seteuid(before)
    expected = f"midstride status: this user may not connect to {workspace.socket}: "
    assert (status, capsys.readouterr().err) == (1, f"{expected}run the command as the user that runs the manager\n")


def test_status_verbose_shows_how_each_component_was_started_and_what_is_set(talker: Midstride) -> None:
    brief, verbose = talker("status").out, talker("status", "--verbose").out
    assert verbose.startswith(brief.partition("\n")[0]) and "python3 talker.py" not in brief
    assert re.search(r"^talker +– +python3 talker.py +system +\S+/logs/talker.log *$", verbose, re.MULTILINE)
    assert "Middleware: none: messages stay in the manager's process" in verbose
    refused = talker("up", TALKER, "--backend", "sim", "--use-sim-time")
    assert (refused.status, "--use-sim-time is for ROS 2" in refused.err) == (2, True)


@pytest.mark.full
def test_a_system_in_a_folder_whose_name_is_no_utf_8_runs(midstride: Midstride, tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"f\xfcnf")
    shutil.copytree(EXAMPLES / "talker", folder)
    up = midstride.process("up", str(folder / "talker.stride"), "--backend", "sim", "--detach")
    assert up.status == 0, up.err
    status = midstride("status")
    assert status.status == 0, status.err
    assert r"f\udcfcnf/talker.stride" in status.out
    replaced = midstride("replace", "talker", "NewTalker", "--yes")
    assert replaced.status == 0, replaced.err
    assert [change["outcome"] for change in midstride("history", "--json").json["changes"]] == ["done", "done"]
    log = midstride.runtime / "midstride" / "talker" / "logs" / "manager.log"
    assert "Traceback" not in log.read_text(encoding="utf-8", errors="replace")


def test_a_manager_raises_its_limit_of_open_files(midstride: Midstride) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 1000), hard))
    try:
        assert midstride("up", TALKER, "--backend", "sim", "--detach").status == 0
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert resource.prlimit(midstride.manager("talker"), resource.RLIMIT_NOFILE) == (min(hard, 65_536), hard)


def test_status_of_single_nodes(talker: Midstride) -> None:
    instances = [each["name"] for each in talker("status", "--json").json["instances"]]
    (name,) = (each for each in instances if each.startswith("talker"))
    for node in ("talker", name):
        document = talker("status", node, "--json").json
        assert [each["name"] for each in document["instances"]] == [name]
        assert [each["name"] for each in document["topics"]] == ["/chatter"]
    shown = talker("status", name, "--verbose")
    assert shown.status == 0 and "Listener" not in shown.out and "python3 listener.py" not in shown.out
    assert len(talker("status", "talker", "listener", "--json").json["instances"]) == 2
    refused = talker("status", "talkr")
    assert (refused.status, refused.out) == (1, "")
    assert "no node talkr is running; did you mean `talker`?" in refused.err


def test_the_specification_of_another_system_is_not_applied(talker: Midstride) -> None:
    other = EXAMPLES / "filter" / "filter.stride"
    refused = talker("apply", str(other), "--yes")
    assert refused.status == 1
    assert refused.err == (
        f"midstride apply: {other} is the specification of another system, filter, and talker is running: "
        f"`midstride up {other}` starts it beside this one\n"
    )


def test_why_and_log(talker: Midstride) -> None:
    why = talker("why", "listener.listen")
    assert (why.status, why.out.splitlines()[0]) == (0, "listener.listen is in mode normal")
    assert talker("why", "listener.listen", "--json").json["functionality"] == "listener.listen"
    refused = talker("why", "listener.lissen")
    assert refused.status == 1
    assert "there is no functionality listener.lissen; did you mean `listener.listen`?" in refused.err
    node = talker("why", "listener")
    assert node.status == 1 and "there is no functionality listener; did you mean `listener.listen`?" in node.err
    events = talker("log", "--json").json
    assert [event["n"] for event in events] == list(range(1, len(events) + 1))
    assert talker("log", "--since", str(len(events) - 1), "--json").json == events[-1:]
    assert "talker is up" in talker("log").out
    assert talker("log", "--since", "5m", "--json").json[-1] == events[-1]
    assert talker("log", "--since", "0s", "--json").json == []
    refused = talker("log", "--since", "yesterday")
    assert (refused.status, "'yesterday' is neither the number of an event nor a time" in refused.err) == (2, True)


@pytest.mark.full
def test_log_and_watch_show_what_is_past_only_where_that_is_asked_for(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
    for component in ("NewTalker", "Talker"):
        assert midstride("replace", "talker", component, "--yes").status == 0
    every = midstride("log", "--all").out.splitlines()
    latest = midstride("log")
    assert latest.out.splitlines() == every[-20:] and len(every) > 20
    assert latest.err == f"({len(every) - 20} earlier events: `midstride log --all`)\n"
    last = midstride("log", "--json").json[-1]["n"]
    for words in (["watch", "--json"], ["watch"]):
        watching = midstride.start(*words)
        try:
            assert watching.stdout is not None
            while not select.select([watching.stdout], [], [], 0.5)[0]:  # until it watches
                assert watching.poll() is None
                assert midstride("restart", "talker", "--yes").status == 0
            line = watching.stdout.readline()
            if words[-1] == "--json":
                assert json.loads(line)["n"] > last
            else:
                assert "up talker" not in line
        finally:
            watching.kill()
            watching.communicate()


@pytest.mark.parametrize(
    "words", [("replace", "talkr", "NewTalker"), ("replace", "talker", "NewTalkr"), ("remove", "x")]
)
def test_a_refused_change_changes_nothing(talker: Midstride, words: tuple[str, ...]) -> None:
    before = talker("status", "--json").json["revision"]
    done = talker(*words, "--yes")
    assert done.status == 1
    assert "Refused, nothing was changed: there is no " in done.out
    refused = talker(*words, "--yes", "--json")
    assert (refused.status, refused.json["outcome"]) == (1, "refused")
    assert "there is no " in refused.json["because"]
    assert talker("status", "--json").json["revision"] == before


def test_a_replacement_is_shown_and_measured(talker: Midstride) -> None:
    done = talker("replace", "talker", "NewTalker", "--yes")
    assert done.status == 0, done.err
    lines = done.out.splitlines()
    assert lines[0] == "replace talker with NewTalker"
    assert "Nothing degrades: every functionality that remains keeps its level throughout." in lines
    assert [line.split()[1] for line in lines if "✓" in line] == ["1/4", "2/4", "3/4", "4/4"]
    assert re.match(r"/chatter +listener.in +\d+ ms +1\.\d\d", lines[-1])
    back = talker("--json", "replace", "talker", "Talker", "--yes").json
    assert (back["outcome"], back["because"], back["plan"]["strategy"]) == ("done", None, "minimal")
    (swap,) = back["swaps"]
    assert (swap["topic"], swap["subscriber"], swap["lost"], swap["duplicates"]) == ("/chatter", "listener.in", 0, 0)
    assert playing(talker)[1] == "Talker"


@pytest.mark.full
def test_the_paper_s_strategy_is_measured_as_well(talker: Midstride) -> None:
    _, component = playing(talker)
    other = "NewTalker" if component == "Talker" else "Talker"
    done = talker("replace", "talker", other, "--yes", "--strategy", "paper", "--json").json
    assert done["outcome"] == "done"
    assert done["below_baseline_seconds"]["listener.listen"] > 0
    assert talker("replace", "talker", component, "--yes").status == 0


def test_nodes_come_and_go(talker: Midstride) -> None:
    added = talker("add", "second", "Listener", "in=/chatter", "--yes", "--json")
    assert added.json["outcome"] == "done"
    assert playing(talker, "second") == ("second", "Listener")
    exported = talker("export", "--json").json
    assert exported["nodes"]["second"] == {"component": "Listener", "attachments": {"in": ["/chatter"]}}
    removed = talker("remove", "second", "--yes", "--json")
    assert (removed.json["outcome"], removed.json["swaps"]) == ("done", [])


def test_components_of_another_file(talker: Midstride, tmp_path: Path) -> None:
    document = json_form("talker")
    other = {**document["components"]["Talker"], "run": "other"}  # of no concern: the request does not name it
    document["components"] = {"Ear": document["components"]["Listener"], "Talker": other}
    document["nodes"] = {}
    file = tmp_path / "more.json"
    file.write_text(json.dumps(document))
    done = talker("add", "ear", "Ear", "in=/chatter", "--from", str(file), "--yes")
    assert done.status == 0, done.out + done.err
    assert playing(talker, "ear") == ("ear", "Ear")
    assert talker("remove", "ear", "--yes").status == 0


def test_apply_takes_the_system_to_a_file(talker: Midstride, tmp_path: Path) -> None:
    document = json_form("talker")
    document["nodes"]["third"] = {"component": "Listener", "attachments": {"in": ["/chatter"]}}
    file = tmp_path / "three.json"
    file.write_text(json.dumps(document))
    done = talker("apply", str(file), "--yes", "--json")
    assert (done.status, done.json["outcome"]) == (0, "done")
    assert playing(talker, "third") == ("third", "Listener")
    assert talker("apply", TALKER, "--yes").status == 0
    assert len(talker("status", "--json").json["instances"]) == 2


def test_without_a_terminal_a_change_needs_yes(talker: Midstride) -> None:
    before = len(talker("log", "--json").json)
    done = talker("remove", "listener")
    assert (done.status, done.out) == (2, "")
    assert "not a terminal; pass --yes" in done.err
    assert len(talker("log", "--json").json) == before


def test_a_change_asks_for_confirmation(talker: Midstride) -> None:
    events = len(talker("log", "--json").json)
    with Terminal(talker, "add", "second", "Listener", "in=/chatter") as terminal:
        shown = terminal.until("Proceed? [y/N]: ")
        assert "create second (Listener)" in shown
        assert "Nothing degrades" in shown
        terminal.press("n\n")
        assert "Nothing was changed." in terminal.rest()
        assert terminal.status == 1
    assert len(talker("log", "--json").json) == events
    with Terminal(talker, "add", "second", "Listener", "in=/chatter") as terminal:
        terminal.until("Proceed? [y/N]: ")
        terminal.press("y\n")
        assert "Done in" in terminal.rest()
        assert terminal.status == 0
    assert talker("remove", "second", "--yes").status == 0


@pytest.mark.full
def test_only_the_plan_that_was_shown_is_carried_out(talker: Midstride) -> None:
    """A change between the preview and the yes: the plan that was shown is not the one that would be carried out."""
    with Terminal(talker, "remove", "listener") as terminal:
        terminal.until("Proceed? [y/N]: ")
        assert talker("add", "second", "Listener", "in=/chatter", "--yes").status == 0
        terminal.press("y\n")
        assert "the configuration has changed since the plan was shown" in " ".join(terminal.rest().split())
        assert terminal.status == 1
    assert playing(talker, "listener") == ("listener", "Listener")
    assert talker("remove", "second", "--yes").status == 0


def test_two_changes_at_once_take_turns(talker: Midstride) -> None:
    done: list[Any] = []

    def add(name: str) -> None:
        done.append(talker.process("add", name, "Listener", "in=/chatter", "--yes", "--json").json["outcome"])

    threads = [threading.Thread(target=add, args=(name,)) for name in ("left", "right")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert done == ["done", "done"]
    assert talker("remove", "left", "right", "--yes").status == 0


GOES_ON = "The manager continues with the change; `midstride log` shows how it ends."


def test_a_client_that_is_interrupted_says_that_the_change_goes_on(talker: Midstride) -> None:
    changing = talker.start("restart", "talker", "--yes", "--json")
    try:
        await_change(talker, begun=True)
        changing.send_signal(signal.SIGINT)
        out, _ = changing.communicate(timeout=20)
        assert (changing.returncode, GOES_ON in out) == (130, True)
    finally:
        changing.kill()
        changing.communicate()
    await_change(talker, begun=False)


@pytest.mark.full
def test_a_client_whose_reader_goes_says_that_the_change_goes_on(talker: Midstride, tmp_path: Path) -> None:
    errors = tmp_path / "errors"
    with errors.open("w") as file:
        command = talker.command("restart", "talker", "--yes")
        changing = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True, env=talker.environment)
    with changing:
        try:
            assert changing.stdout is not None
            assert changing.stdout.readline() == "restart talker\n"
            changing.stdout.close()  # as `head -1` does
            assert changing.wait(20) == 1
            assert GOES_ON in errors.read_text()
        finally:
            changing.kill()
    await_change(talker, begun=False)


def await_change(system: Midstride, begun: bool) -> None:
    end = time.monotonic() + 20
    while (system("status", "--json").json["running"] is not None) is not begun:
        assert time.monotonic() < end


@pytest.mark.parametrize("command", [["watch"], ["log", "--follow"]])
def test_watch_prints_a_document_on_each_line(command: list[str], talker: Midstride) -> None:
    watching = talker.start(*command, *(["--all"] if command == ["watch"] else []), "--json")
    try:
        assert watching.stdout is not None
        events = [json.loads(watching.stdout.readline()) for _ in range(3)]
        watching.send_signal(signal.SIGINT)
        events += [json.loads(line) for line in watching.stdout]
        assert [event["n"] for event in events] == list(range(1, len(events) + 1))
        assert watching.wait(20) == 0
    finally:
        watching.kill()
        watching.communicate()


@pytest.mark.full
def test_the_system_keeps_running_when_the_live_view_is_left(midstride: Midstride) -> None:
    with Terminal(midstride, "up", TALKER, "--backend", "sim") as terminal:
        terminal.until("Ctrl-C leaves the view")
        terminal.press("\x03")
        assert "talker keeps running:" in terminal.rest()
        assert terminal.status == 0
    assert midstride("status", "--json").json["valid"]
    with Terminal(midstride, "watch") as terminal:
        terminal.until("listener.in")
        assert midstride("down").status == 0
        assert "talker is down." in terminal.rest()
        assert terminal.status == 0


def test_ctrl_c_during_start_up_stops_the_system(midstride: Midstride, tmp_path: Path) -> None:
    document = json_form("talker")
    document["components"]["Talker"]["run"] = "python3 never.py"
    (tmp_path / "never.py").write_text("import time\nwhile True:\n    time.sleep(1)\n")
    (tmp_path / "listener.py").write_text((EXAMPLES / "talker" / "listener.py").read_text())
    file = tmp_path / "never.json"
    file.write_text(json.dumps(document))
    midstride.environment["MIDSTRIDE_REGISTRATION_TIMEOUT"] = "1000"
    with Terminal(midstride, "up", str(file), "--backend", "sim") as terminal:
        terminal.until("create listener")  # while the talker does not register, longer than any test may take
        terminal.press("\x03")
        assert "Stopping everything started for talker" in terminal.rest()
        assert terminal.status == 130
    assert midstride("status").status == 1


def test_ctrl_c_before_the_manager_answers_stops_the_system(midstride: Midstride) -> None:
    """The manager has been started by then, in its own session, and would still start the system."""
    with Terminal(midstride, "up", TALKER, "--backend", "sim") as terminal:
        log = midstride.runtime / "midstride" / "talker" / "logs" / "manager.log"
        while not log.exists():
            time.sleep(0.001)
        terminal.press("\x03")
        assert "Stopping everything started for talker" in terminal.rest()
        assert terminal.status == 130
    assert "no system is running" in midstride("status").err


@pytest.mark.full
def test_the_log_of_a_running_manager_is_cut(midstride: Midstride) -> None:
    midstride("up", TALKER, "--backend", "sim", "--detach")
    log = midstride.runtime / "midstride" / "talker" / "logs" / "manager.log"
    with log.open("ab") as output:
        output.write(b"a line\n" * 1_300_000)
    while not 0 < log.stat().st_size <= 1_048_576:
        time.sleep(0.05)
    assert log.read_bytes().startswith(b"a line\n")
    flags = re.search(r"flags:\s+(\d+)", Path(f"/proc/{midstride.manager('talker')}/fdinfo/2").read_text())
    assert flags is not None
    assert int(flags[1], 8) & os.O_APPEND  # else the next line would be written at the old end


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("import nothing_of_the_kind\n", "No module named 'nothing_of_the_kind'"),
        pytest.param(
            "raise SystemExit(3)\n", "talker exited with status 3 before it registered", marks=pytest.mark.full
        ),
        pytest.param(
            (EXAMPLES / "talker" / "talker.py").read_text().replace('"out"', '"output"'),
            "output out is declared, but the node does not have it",
            marks=pytest.mark.full,
        ),
        pytest.param(None, "can't open file", marks=pytest.mark.full),
    ],
)
def test_a_component_that_does_not_come_up(
    midstride: Midstride, tmp_path: Path, program: str | None, message: str
) -> None:
    for file in (EXAMPLES / "talker").iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    (tmp_path / "talker.py").unlink()
    if program is not None:
        (tmp_path / "talker.py").write_text(program)
    done = midstride("up", str(tmp_path / "talker.stride"), "--backend", "sim", "-d", "--strict")
    assert done.status == 1
    assert done.err.startswith("midstride up: ")
    assert message in done.err
    assert "midstride/cli" not in done.err
    failed = midstride("up", str(tmp_path / "talker.stride"), "--backend", "sim", "--strict", "--json")
    assert (failed.status, failed.json["error"]["kind"]) == (1, "StepFailed")
    assert not (midstride.runtime / "midstride" / "talker" / "state.db").exists()


@pytest.mark.full
def test_the_api_over_tcp(midstride: Midstride) -> None:
    with socket.create_server(("127.0.0.1", 0)) as door:
        port = door.getsockname()[1]
    up = midstride("up", TALKER, "--backend", "sim", "-d", "--http", str(port))
    assert up.status == 0, up.err
    token_file = midstride.runtime / "midstride" / "talker" / "token"
    assert up.out.splitlines()[-1] == f"API: http://127.0.0.1:{port}/api/v1, token in {token_file}"
    token = token_file.read_text()
    assert httpx.get(f"http://127.0.0.1:{port}/api/v1/view").status_code == 401
    answer = httpx.get(f"http://127.0.0.1:{port}/api/v1/view", headers={"Authorization": f"Bearer {token}"})
    assert answer.json()["valid"]


@pytest.mark.full
def test_several_systems(talker: Midstride) -> None:
    file = str(EXAMPLES / "obstacle" / "obstacle.stride")
    assert talker("up", file, "--backend", "sim", "-d").status == 0
    done = talker("status")
    assert (done.status, done.out) == (2, "")
    assert "several systems are running (obstacle, talker); choose one with --system NAME" in done.err
    assert talker("status", "--system", "obstacle").out.startswith("obstacle on sim")
    assert talker("status", "--system", "talkr").err.endswith("did you mean `talker`?\n")
    assert talker("down", "--system", "obstacle").status == 0
    assert talker("status").status == 0


@pytest.mark.full
def test_the_state_of_a_killed_manager_is_recovered_from(midstride: Midstride) -> None:
    """In the simulator components die with their manager; what is left written must not be in anybody's way."""
    assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
    manager = midstride.manager("talker")
    os.kill(manager, signal.SIGSTOP)
    done = midstride("down")
    assert (done.status, done.out) == (1, "")
    assert f"the manager of talker (process {manager}) is running but does not answer" in done.err
    os.kill(manager, signal.SIGKILL)
    while alive(manager):
        time.sleep(0.01)
    done = midstride("status")
    assert done.status == 1
    assert "the manager of talker has exited" in done.err
    with unwritten(midstride) as late:
        assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
        assert late.wait(20) == -signal.SIGINT
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    with unwritten(midstride) as late:
        assert midstride("down").out == "talker is down.\n"
        assert late.wait(20) == -signal.SIGINT
    assert midstride("down").status == 1


@pytest.mark.full
def test_the_view_reports_that_the_manager_has_exited(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
    watching = midstride.start("watch", "--all")
    try:
        assert watching.stdout is not None
        assert "up talker" in watching.stdout.readline()
        os.kill(midstride.manager("talker"), signal.SIGTERM)
        assert watching.stdout.read().endswith("The manager of talker has exited; its components keep running.\n")
        assert watching.wait(20) == 1
    finally:
        watching.kill()
        watching.communicate()

"""What needs no running system: help, wrong usage, specifications in files, plans."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
import pytest

import midstride as package
from midstride.backends import NAMES
from midstride.cli import main, render, render_status
from midstride.cli.change_options import parse_value
from midstride.cli.command_list import COMMANDS, GROUPS
from midstride.cli.input_files import read_json, write
from midstride.cli.output import console
from midstride.errors import MidstrideError
from midstride.model.specification import Specification
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records.state_store import StateStore
from midstride.wire.folders import workspace_root
from tests.cli import statuses
from tests.cli.conftest import EXAMPLES, Midstride
from tests.examples import json_form, json_text

TALKER = str(EXAMPLES / "talker" / "talker.stride")


@pytest.fixture(autouse=True)
def nothing_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with open("/dev/null") as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        yield


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    status = main(words)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


# -- starting fast, and the public names ----------------------------------------------------------------


def test_help_imports_nothing_slow() -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "midstride", "--help"], capture_output=True, text=True, check=True
    )
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    slow = {"rich", "asyncio", "fastapi", "uvicorn", "httpx", "pydantic", "rclpy", "immutables", "http.client"}
    assert not imported & slow
    assert not [
        name for name in imported if name.startswith(("midstride.model", "midstride.node", "midstride.runtime"))
    ]
    assert all(f"\n  {name} " in done.stdout for name in COMMANDS)


def test_help_and_the_reference_have_the_same_headings(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "--help")
    assert status == 0
    shown: dict[str, list[str]] = {}
    for line in out.partition("Options:")[2].splitlines()[1:]:
        if line.endswith(":"):
            shown[line.rstrip(":")] = commands = []
        elif shown and line:
            commands.append(line.split()[0])
    assert shown == {heading: list(commands) for heading, commands in GROUPS.items()}
    page = (EXAMPLES.parent / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    sections = dict(part.split("\n", 1) for part in page.split("\n## ")[1:])
    for heading, names in shown.items():
        assert set(names) <= set(re.findall(r"\w+", sections[heading])), heading


def test_the_public_names_are_there() -> None:
    for name in package.__all__:
        assert getattr(package, name) is not None
    assert set(package.__all__) - {"__version__"} == set(package._HOMES)
    assert set(package.__all__) <= set(dir(package))
    with pytest.raises(AttributeError, match="no attribute 'Componet'"):
        package.__getattr__("Componet")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, name, "--help")
    assert status == 0
    assert out.startswith(f"Usage: midstride {name}")
    assert "--json" in out


def test_the_list_of_subcommands_has_whole_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    assert "..." not in run(capsys, "param", "--help")[1].partition("Commands:")[2]


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"midstride {package.__version__}\n", "")


# -- wrong usage: status 2, one clear line -----------------------------------------------------------------


def test_a_fall_is_not_confused_with_that_of_a_node_with_a_longer_name() -> None:
    """`cam_left` is no instance of `cam`, as `cam_2` is: a group degrades together, each to its own mode."""
    modes = {name: {"from": "on", "to": to} for name, to in (("cam_left.see", "slow"), ("cam_2.see", "off"))}
    fall = {"functionality": "cam.see", "from_step": 1, "to_step": None, "seconds": 1.0, "because": "…"}
    step = {"action": "degrade", "modes": modes, "seconds": 1.0}
    costs = {"strategy": "paper", "proved_minimal": False, "disruption": 1.0, "lower_bound": 0.0, "makespan": 1.0}
    fallen = {"degraded": ["cam.see"], "degradations": [{**fall, "unserved_from_step": None}], "level_shifts": []}
    plan = msgspec.convert({**costs, **fallen, "seconds": 1.0, "steps": [step]}, PlanPreview)
    assert "cam.see to off for" in render.falls(plan)


def test_a_plan_without_steps_reports_nothing_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "plan", TALKER, "--to", TALKER)
    assert (status, out.splitlines()[1:]) == (0, ["Nothing to do: the system already matches the target."])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["replce"], "midstride: there is no command `replce`; did you mean `replace`?"),
        (["replace"], "midstride replace: missing argument 'NODE'"),
        (["status", "--systm", "x"], "midstride status: no such option '--systm'. Did you mean '--system'?"),
        (["replace", "talker", "NewTalker"], "not a terminal; pass --yes"),
        (
            ["plan", TALKER],
            "midstride plan: nothing to change: pass --to NEW, --replace, --restart, --add, --remove or --on",
        ),
        (["plan", TALKER, "--replace", "talker"], "`talker` is not of the form NODE=COMPONENT"),
        (["plan", TALKER, "--replace", "=Talker"], "`=Talker` is not of the form NODE=COMPONENT"),
        (["plan", TALKER, "--add", "second"], "`second` is not of the form 'NODE COMPONENT PORT=TOPIC…'"),
        (["plan", TALKER, "--to", TALKER, "--remove", "talker"], "--to cannot be combined with --replace"),
        (["simulate", "--seed", "3", "--seeds", "9"], "--seed runs this one only: leave --seeds out"),
        (["simulate", TALKER, "--system", "spread"], "--system names a built-in system: leave FILE or --system out"),
        (["simulate", "--on", "talker=arm"], "pass the FILE of the system to change"),
        (["simulate", "--seed", "3", "--jobs", "2"], "--seed runs this one only: leave --jobs out"),
        (["export", TALKER, "--system", "talker"], "--system is for the running system: leave FILE out"),
        (["export", TALKER, "--schema"], "--schema is that of every specification: leave FILE and --system out"),
        (["diff", TALKER, TALKER, "--system", "talker"], "--system is for the running system: leave NEW out"),
        (["diff", TALKER, TALKER, "--keep-code"], "--keep-code is for the running system: leave NEW out"),
        (
            ["logs", "talker", "-n", "few"],
            "midstride logs: invalid value for '--lines' / '-n': 'few' is not a whole number",
        ),
        (["check", "--include-path", "x", TALKER], "it comes before the command: `midstride --include-path DIR …`"),
        (["history", "-n", "0"], "0 is not in the range"),
        (["param", "sett", "a", "b", "1"], "midstride param: there is no command `sett`; did you mean `set`?"),
        (["down", "talker"], "got unexpected extra argument (talker); a system is named with --system NAME"),
        (["dashboard", "a", "--system", "b"], "name the system once, as SYSTEM or with --system"),
        (["verify", TALKER, "--limit", "long"], "'long' is not a number"),
        (
            ["plan", TALKER, "--remove", "talker", "--strategy", "fast"],
            "'fast' is not one of 'minimal', 'paper', 'quiesce'",
        ),
        (["up", TALKER, "--backend", "ros3"], "'ros3' is not one of " + ", ".join(map(repr, NAMES))),
        (["up", TALKER, "--http-host", "0.0.0.0"], "--http-host needs --http PORT"),
        (["up", TALKER, "--http", "0"], "invalid value for '--http': 0 is not in the range 1<=x<=65535"),
        (["log", "--since", "-1"], "invalid value for '--since': -1 is not in the range x>=0"),
        (["demo", "talkr"], "there is no example `talkr`; did you mean `talker`?"),
        (["add", "second", "Listener", "in", "--yes"], "`in` is not of the form PORT=TOPIC, such as out=/chatter"),
    ],
)
def test_wrong_usage(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, *words)
    assert (status, out) == (2, "")
    assert message in err.splitlines()[0]
    assert "--help`" in err.splitlines()[-1]
    status, out, _ = run(capsys, *words, "--json")
    document = json.loads(out)
    assert (status, document["error"]["kind"]) == (2, "UsageError")


def test_no_command_at_all(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys)
    assert (status, out) == (2, "")
    assert err.startswith("Usage: midstride")


@pytest.mark.parametrize("words", [["status"], ["watch"], ["log"], ["down"], ["why", "a.b"], ["remove", "a", "--yes"]])
def test_the_error_without_a_manager_says_how_to_start_one(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    where = f"none in {workspace_root()}, where those of this user and XDG_RUNTIME_DIR are"
    message = f"no system is running: {where}; start one with `midstride up FILE`"
    assert run(capsys, *words) == (1, "", f"midstride {words[0]}: {message}\n")
    status, out, _ = run(capsys, "--json", *words)
    document = json.loads(out)
    assert (status, document["error"]) == (1, {"kind": "NoManager", "message": message})


def test_every_change_that_fails_has_an_outcome(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = {"replace": ["a", "A"], "restart": ["a"], "add": ["a", "A"], "remove": ["a"], "apply": [TALKER]}
    arguments |= {"rollback": []}
    assert arguments.keys() == GROUPS["Changes to the running system"].keys() - {"param"}
    for command, words in arguments.items():
        status, out, _ = run(capsys, command, *words, "--yes", "--json")
        document = json.loads(out)
        assert (status, document["outcome"], document["error"]["kind"]) == (1, "refused", "NoManager"), command
        assert document["because"] == document["error"]["message"]


@pytest.mark.parametrize("command", ["status", "down"])
def test_one_of_several_systems_without_managers_must_be_named(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("talker", "filter"):
        (tmp_path / "midstride" / name).mkdir(parents=True)
        store = StateStore(tmp_path / "midstride" / name / "state.db")
        store.begin("sim", "no process bears it", Specification(name))
        store.close()
    status, out, err = run(capsys, command)
    assert (status, out) == (1, "")
    assert "may still be running: filter, talker. Choose one with --system NAME" in err
    assert run(capsys, "down", "--system", "talker")[:2] == (0, "talker is down.\n")
    assert run(capsys, "down")[:2] == (0, "filter is down.\n")


def test_a_system_that_is_not_running(capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = run(capsys, "status", "--system", "patrol")
    assert (status, err.split("; ")[0]) == (1, "midstride status: no system patrol is running")


# -- specifications in files ---------------------------------------------------------------------------------


def test_the_examples_have_no_problems(capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(EXAMPLES / name / f"{name}.stride") for name in ("filter", "obstacle", "talker")]
    status, out, err = run(capsys, "check", *files)
    assert (status, err) == (0, "")
    assert "no problems found" in out
    status, out, _ = run(capsys, "check", *files, "--json", "--strict")
    assert (status, json.loads(out)) == (0, {"ok": True, "diagnostics": []})


def broken(folder: Path, **changes: Any) -> str:
    document = json_form("talker")
    document.update(changes)
    file = folder / "broken.json"
    file.write_text(json.dumps(document))
    return str(file)


def test_every_error_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nodes = {"talker": {"component": "Talkr", "attachments": {"out": ["/chatter"]}}}
    file = broken(tmp_path, topcs={}, nodes=nodes)
    status, out, _ = run(capsys, "check", file)
    assert status == 1
    assert "error[E002]: a specification has no key `topcs`" in out
    assert f"{file}:" in out
    assert "Talkr" in out
    assert "did you mean `Talker`?" in out
    status, out, _ = run(capsys, "--json", "check", file)
    document = json.loads(out)
    assert (status, document["ok"]) == (1, False)
    first = document["diagnostics"][0]
    assert {"code", "severity", "file", "line", "column", "message", "help"} <= set(first)
    assert {fault["code"] for fault in document["diagnostics"]} >= {"E002", "E008"}


def test_a_warning_counts_with_strict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nodes = {"listener": {"component": "Listener", "attachments": {"in": ["/chatter"]}}}
    file = broken(tmp_path, nodes=nodes)
    status, out, _ = run(capsys, "check", file)
    assert (status, "warning" in out) == (0, True)
    assert run(capsys, "check", file, "--strict")[0] == 1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("talkr.stride", "did you mean `talker.stride`?"),
        ("", "is a folder; give a file in it: "),
        ("/dev/zero", "/dev/zero has more than 64 million characters: wrong file?"),
    ],
)
def test_a_missing_or_unusable_file(name: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = EXAMPLES / "talker" / name
    for words in (
        ["up", str(file), "-d"],
        ["plan", str(file), "--remove", "x"],
        ["export", str(file)],
        ["dev", str(file)],
    ):
        status, out, err = run(capsys, *words)
        assert (status, out) == (1, "")
        assert err.startswith(f"midstride {words[0]}: ")
        assert err.count("\n") == 1
        assert message in err
        assert err.count(str(file)) == 1 or name == ""


def test_a_hidden_file_is_not_suggested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`generate` keeps a list of what it wrote, in JSON."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".midstride-generated.json").write_text("{}")
    (tmp_path / "robot.stride").write_text("system robot\n")
    assert run(capsys, "check", ".")[2] == "midstride check: . is a folder; give a file in it: robot.stride\n"
    assert run(capsys, "check", "a.json")[2] == "midstride check: there is no file a.json; known: robot.stride\n"


def test_not_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "half.json"
    file.write_text('{"system": ')
    status, _, err = run(capsys, "up", str(file))
    assert (status, err.startswith(f"midstride up: {file}: /: not JSON: ")) == (1, True)
    assert "line 1, column 12" in err


def test_the_export_is_the_same_specification(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "export", TALKER, "--json")
    assert status == 0
    assert json.loads(out) == json_form("talker")
    again = tmp_path / "again.json"
    again.write_text(out)
    assert run(capsys, "export", str(again))[1] == out


# -- plans ------------------------------------------------------------------------------------------------------


def test_the_paper_s_seven_steps(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "plan", TALKER, "--replace", "talker=NewTalker", "--strategy", "paper")
    assert status == 0
    steps = [line.split(maxsplit=1)[1].rsplit("  ", 1)[0].strip() for line in out.splitlines() if line[:1].isdigit()]
    assert steps == [
        "degrade listener.listen from normal to degraded",
        "detach talker.out from /chatter",
        "remove talker",
        "create talker_2 (NewTalker)",
        "upgrade talker_2.talk from degraded to normal",
        "attach talker_2.out to /chatter",
        "upgrade listener.listen from degraded to normal",
    ]
    assert out.startswith("talker.stride: replace talker with NewTalker\n")
    assert "Degrades: listener.listen to degraded for about" in out


def test_a_plan_in_which_nothing_degrades(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "plan", TALKER, "--replace", "talker=NewTalker")
    assert status == 0
    assert "Nothing degrades" in out
    assert "proved minimal" in out
    status, out, _ = run(capsys, "plan", TALKER, "--replace", "talker=NewTalker", "--json")
    document = json.loads(out)
    assert (document["strategy"], document["proved_minimal"], document["degraded"]) == ("minimal", True, [])
    assert [step["action"] for step in document["steps"]] == ["create", "upgrade", "handover", "remove"]
    assert document["target"]["nodes"]["talker"]["component"] == "NewTalker"


def test_the_search_for_a_proof_may_be_given_a_time(capsys: pytest.CaptureFixture[str]) -> None:
    for seconds in ("2s", "0.5"):
        status, out, _ = run(capsys, "plan", TALKER, "--replace", "talker=NewTalker", "--within", seconds)
        assert (status, "proved minimal" in out) == (0, True)
    for seconds in ("soon", "-1s", "inf"):
        status, _, err = run(capsys, "plan", TALKER, "--replace", "talker=NewTalker", "--within", seconds)
        assert status == 2
        assert f"{seconds} is not a number of seconds, such as 5s" in err
    status, _, err = run(capsys, "plan", "--replace", "talker=NewTalker", "--within", "5s")
    assert (status, "--within needs FILE" in err) == (2, True)


def test_the_plans_of_every_strategy_are_compared_on_one_time_axis(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("plan", TALKER, "--replace", "talker=NewTalker", "--compare")
    status, out, err = run(capsys, *words)
    assert (status, err) == (0, "")
    assert [line.split()[:2] for line in out.splitlines()[2:6]] == [
        ["minimal", "0"],
        ["paper", "3.6"],
        ["quiesce", "3.6"],
        ["stop", "8.4"],
    ]
    axes = dict(line.split() for line in out.partition("listener.listen\n")[2].splitlines()[:4])
    assert {name: set(axis) for name, axis in axes.items()} == {
        "minimal": {"─"},
        "paper": {"▒"},
        "quiesce": {"▒"},
        "stop": {"▒", "█"},
    }
    # A hand-over takes the probation of its output, 1 s at 10 Hz, and nothing falls meanwhile.
    assert len(axes["stop"]) == 60 > len(axes["minimal"]) > len(axes["paper"])
    _, out, _ = run(capsys, *words, "--json")
    plans = json.loads(out)["strategies"]
    assert [(name, plan["strategy"], len(plan["steps"])) for name, plan in plans.items()] == [
        ("minimal", "minimal", 4),
        ("paper", "paper", 7),
        ("quiesce", "quiesce", 8),
        ("stop", "stop", 12),
    ]


def on_one_gpu(folder: Path) -> Path:
    """A talker and its replacement that do not fit on the GPU together."""
    document = json_form("talker")
    document["resources"] = {"gpu": {"capacity": 1}}
    for name in ("Talker", "NewTalker"):
        document["components"][name]["holds"] = {"gpu": 1}
    document["components"]["Light"] = {**document["components"]["Talker"], "holds": {}}
    file = folder / "talker.json"
    file.write_text(json.dumps(document))
    return file


def test_a_plan_may_make_detours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("plan", str(on_one_gpu(tmp_path)), "--replace", "talker=NewTalker", "--detours")
    status, out, err = run(capsys, *words)
    assert (status, err) == (0, "")
    assert "Detour: talker_3 (Light) stands in for talker during the change." in out
    assert "Disruption 0 weighted functionality-seconds (proved minimal, with detours)" in out
    plan = json.loads(run(capsys, *words, "--json")[1])
    assert (plan["proof_space"], plan["proved_minimal"], plan["degraded"]) == ("detours", True, [])
    plans = json.loads(run(capsys, *words, "--compare", "--json")[1])["strategies"]
    assert [plan["proof_space"] for plan in plans.values()] == ["detours", "direct", "direct", "direct"]
    status, _, err = run(capsys, *words, "--strategy", "paper")
    assert (status, "--detours is for the strategy minimal alone" in err) == (2, True)


def test_a_plan_is_explained_with_what_it_would_cost_to_keep_what_falls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = on_one_gpu(tmp_path)
    status, out, err = run(capsys, "plan", str(file), "--replace", "talker=NewTalker", "--explain")
    assert (status, err) == (0, "")
    assert "`create talker_2 (NewTalker)` has to wait: resource gpu: 2 held by talker, talker_2" in out
    assert "It cannot be kept at normal: no plan was found" in out
    status, _, err = run(capsys, "plan", str(file), "--replace", "talker=NewTalker", "--explain", "--compare")
    assert status == 2 and "--explain" in err


def test_a_strategy_that_refuses_does_not_hide_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json_form("talker")
    document["constraints"] = [{"keep": "listener.listen", "at": "normal"}]
    file = tmp_path / "talker.json"
    file.write_text(json.dumps(document))
    status, out, _ = run(capsys, "plan", str(file), "--replace", "talker=NewTalker", "--compare")
    assert status == 0
    assert "0 (minimal)" in out
    assert "paper: " in out and "keep listener.listen" in out
    status, _, err = run(capsys, "plan", str(file), "--replace", "nobody=NewTalker", "--compare")
    assert status == 1 and "nobody" in err
    status, _, err = run(capsys, "plan", TALKER, "--remove", "talker", "--compare", "--strategy", "paper")
    assert status == 2 and "--strategy" in err


def test_a_plan_shows_what_stays_lower(capsys: pytest.CaptureFixture[str]) -> None:
    file = str(EXAMPLES / "obstacle" / "obstacle.stride")
    _, out, _ = run(capsys, "plan", file, "--remove", "detector")
    assert "Afterwards: controller.control is in mode degraded instead of normal." in out
    assert "Nothing degrades" not in out


def test_a_plan_shows_that_a_replaced_role_stays_lower(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json_form("talker")
    document["components"]["NewTalker"]["functionalities"]["talk"]["modes"]["normal"]["assumes"] = [
        {"type": "sensor_msgs/msg/Image"}
    ]
    file = tmp_path / "talker.json"
    file.write_text(json.dumps(document))
    _, out, _ = run(capsys, "plan", str(file), "--replace", "talker=NewTalker")
    assert "Afterwards: talker.talk is in mode degraded instead of normal." in out
    assert "Nothing degrades" not in out


def test_a_topic_that_the_environment_satisfies_has_a_publisher(capsys: pytest.CaptureFixture[str]) -> None:
    contract: dict[str, Any] = {"type": "nav_msgs/msg/Odometry", "rate": None, "publishers": [], "outside": []}
    topics = [
        {**contract, "name": name, "topic": name, "satisfied": satisfied, "subscribers": ["amcl.odom"]}
        for name, satisfied in (("/odom", True), ("/map", False))
    ]
    console().print(render_status.status(statuses.status(topics=topics)))
    shown = capsys.readouterr().out
    assert "/odom: the environment → amcl.odom" in shown
    assert "/map: no publisher → amcl.odom  (not satisfied)" in shown


def test_a_node_is_added_to_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "plan", TALKER, "--add", "second Listener in=/chatter", "--json")
    document = json.loads(out)
    assert status == 0
    assert document["target"]["nodes"]["second"] == {"component": "Listener", "attachments": {"in": ["/chatter"]}}


def test_a_change_of_nothing_is_not_rehearsed(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "simulate", TALKER, "--to", TALKER)
    assert (status, out) == (0, "Nothing to do, and nothing was rehearsed: the system already matches the target.\n")
    status, out, _ = run(capsys, "simulate", TALKER, "--to", TALKER, "--seed", "3", "--json")
    assert (status, json.loads(out)["seeds"]) == (0, 0)


def test_a_node_to_add_may_be_written_as_ros_writes_it(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "plan", TALKER, "--add", "/second Listener in=/chatter", "--json")
    assert (status, json.loads(out)["steps"][0]["instance"]) == (0, "second")
    status, out, _ = run(capsys, "plan", TALKER, "--add", "/talker Talker out=/chatter")
    assert (status, out) == (1, "")


def test_to_another_specification(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nodes = {"listener": {"component": "Listener", "attachments": {"in": ["/chatter"]}}}
    status, out, _ = run(capsys, "plan", TALKER, "--to", broken(tmp_path, nodes=nodes), "--json")
    assert status == 0
    assert [step["action"] for step in json.loads(out)["steps"]] == ["degrade", "detach", "remove"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--replace", "talkr=NewTalker"], "there is no node `talkr`; did you mean `talker`?"),
        (["--replace", "talker=NewTalkr"], "there is no component `NewTalkr`; did you mean `NewTalker`?"),
        (["--remove", "nobody"], "there is no node `nobody`; known: listener, talker"),
        (["--add", "second Listener in=/chater"], "there is no topic `/chater` (did you mean `/chatter`?)"),
        (["--add", "second Listener inn=/chatter"], "Listener has no port `inn` (did you mean `in`?)"),
        (["--add", "'b ad' Listener in=/chatter"], "`b ad` is not a valid node name"),
        (["--replace", "talker=Listener"], "Listener cannot replace talker: it has no port out"),
    ],
)
def test_a_plan_that_is_refused(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, "plan", TALKER, *words)
    assert (status, out) == (1, "")
    assert message in err
    status, out, _ = run(capsys, "plan", TALKER, *words, "--json")
    document = json.loads(out)
    assert (status, document["outcome"]) == (1, "refused")
    assert message in document["because"]
    assert "steps" not in document


# -- pipes and encodings -------------------------------------------------------------------------------------------


def test_a_closed_pipe_is_not_an_error(midstride: Midstride) -> None:
    command = " ".join(midstride.command("export", TALKER))
    done = subprocess.run(
        ["sh", "-c", f"{command} | head -c 1; sleep 0.1"],
        capture_output=True,
        text=True,
        check=True,
        env=midstride.environment,
    )
    assert (done.stdout, done.stderr) == ("{", "")


def test_json_with_a_byte_order_mark_is_read_everywhere(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "\ufeff" + json_text("talker")
    path = tmp_path / "marked.json"
    path.write_text(text, encoding="utf-8")
    for words in (["check", path], ["export", path], ["plan", path, "--remove", "listener"]):
        assert run(capsys, *map(str, words))[0] == 0
    _, plan, _ = run(capsys, "plan", TALKER, "--remove", "listener", "--json")
    monkeypatch.setattr("sys.stdin", StringIO("\ufeff" + plan))
    assert read_json(Path("-")) == json.loads(plan)


def test_json_that_is_not_utf_8_is_reported_as_other_files_are(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "latin.json"
    path.write_bytes('{"system": "größe"}'.encode("latin-1"))
    status, out, _ = run(capsys, "check", str(path), "--json")
    document = json.loads(out)
    assert (status, document["ok"], [each["code"] for each in document["diagnostics"]]) == (1, False, ["E101"])
    status, out, err = run(capsys, "export", str(path))
    assert (status, out) == (1, "")
    assert f"cannot read {path}: it is not valid UTF-8; save it as UTF-8" in err


@pytest.mark.parametrize("stream", ["stdin", "stdout", "stderr"])
def test_a_closed_stream_is_not_an_error(
    stream: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python has None for a standard stream that its caller has closed, as in `midstride … >&-`."""
    monkeypatch.setattr(f"sys.{stream}", None)
    try:
        assert run(capsys, "remove", "talker")[0] == 2
        assert run(capsys, "plan", TALKER, "--replace", "talker=NewTalker")[0] == 0
    finally:
        getattr(sys, stream).close()


def test_a_file_is_written_whole_or_stays_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`generate` and `capture --into` rewrite what a user has edited."""
    file, link = tmp_path / "talker.py", tmp_path / "link.py"
    file.write_text("mine\n")
    file.chmod(0o750)
    link.symlink_to(file)
    write(link, "new\n")
    assert link.is_symlink() and file.read_text() == "new\n" and file.stat().st_mode & 0o777 == 0o750

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fchmod", full)
    with pytest.raises(MidstrideError, match="No space left on device"):
        write(file, "newer\n")
    assert file.read_text() == "new\n" and sorted(os.listdir(tmp_path)) == ["link.py", "talker.py"]


def test_an_output_that_cannot_be_written_is_reported(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for words in (["plan", TALKER, "--remove", "talker"], ["export", TALKER], ["explain", "E008", "--json"]):
        with open("/dev/full", "w") as full:
            monkeypatch.setattr("sys.stdout", full)
            status = main(words)
        message = capsys.readouterr().err
        assert (status, message) == (1, f"midstride {words[0]}: cannot write the output: No space left on device\n")


def test_a_runtime_folder_that_cannot_be_made(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/dev/null")
    status, out, err = run(capsys, "up", TALKER)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert "cannot create the folder /dev/null/midstride" in err


def test_characters_outside_the_encoding_are_replaced(midstride: Midstride, tmp_path: Path) -> None:
    file = tmp_path / "größe.json"
    file.write_text(json_text("talker"))
    done = midstride.process(
        "plan", str(file), "--replace", "talker=NewTalker", PYTHONIOENCODING="ascii", PYTHONUTF8="0"
    )
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("gr??e.json: replace talker")
    assert "hand over /chatter from talker.out to talker_2.out" in done.out


def test_piped_tables_are_not_folded(midstride: Midstride) -> None:
    done = midstride.process("plan", TALKER, "--replace", "talker=NewTalker", "--strategy", "paper", COLUMNS="40")
    assert "/chatter has no publisher, after step 2" in done.out


def test_a_role_that_degrades_and_is_then_removed_is_shown_as_unserved(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "s.stride"
    path.write_text(
        """system s
        topic /in : std_msgs/msg/String
        topic /cmd : std_msgs/msg/String
        resource motor
        environment { guarantee world on /in : std_msgs/msg/String }
        component Old {
          run "old"
          holds motor
          input in : std_msgs/msg/String
          output cmd
          functionality drive {
            uses in produces cmd
            mode normal { assume in guarantee cmd : std_msgs/msg/String }
            mode stop { guarantee cmd : std_msgs/msg/String }
          }
        }
        component New like Old { run "new" }
        node base : Old { in <- /in cmd -> /cmd }
        """,
        encoding="utf-8",
    )
    status, out, _ = run(capsys, "plan", str(path), "--replace", "base=New")
    assert status == 0
    assert "Degrades: base.drive to stop, unserved from step 3 on, for about" in out


DEEP = "[" * 100_000


@pytest.mark.parametrize(
    "text", [DEEP, '{"system": "s", "nodes": {"n": ' * 2000, "{}", "[]", '{"steps": [{}]}', "{", "\udcff"]
)
@pytest.mark.parametrize(
    "words",
    ["check {}", "graph {}", "diff {} {}", "impact {} a.b", "up {} --backend sim", "verify --plan {}", "demo {}"],
)
def test_a_json_file_that_is_damaged_is_named(
    words: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "demo.json"
    file.write_bytes(text.encode(errors="surrogateescape"))
    name = tmp_path if words.startswith("demo") else file
    status, out, err = run(capsys, *words.format(name, name).split())
    assert status == 1
    assert any("demo.json" in line for line in (out + err).splitlines()[:2])
    assert not any(word in out + err for word in ("Traceback", "RecursionError", "KeyError", "TypeError"))


def test_json_that_is_nested_too_deep_is_reported_where_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.json"
    file.write_text('{"system": "s",\n "nodes":\n  ' + '{"n":' * 100_000)
    status, out, _ = run(capsys, "check", str(file))
    assert status == 1 and "not JSON: nested too deep" in out and f"{file}:3:" in out


def test_half_of_a_surrogate_pair_is_reported_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "s.json"
    file.write_text('{"system":\n "\\ud800"}')
    status, out, _ = run(capsys, "check", str(file))
    assert status == 1 and "half of a surrogate pair" in out and f"{file}:2:3" in out


def test_what_was_generated_is_forgotten_where_its_record_is_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / ".midstride-generated.json").write_text(DEEP)
    status, _, err = run(capsys, "generate", TALKER, "-o", str(tmp_path))
    assert (status, err) == (0, "")


def test_a_value_that_is_nested_too_deep_is_text() -> None:
    assert parse_value(DEEP) == DEEP

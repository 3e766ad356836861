"""`midstride param`: the parameters of running nodes, as a user sees and sets them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import msgspec
import pytest
from immutables import Map

from midstride.cli.change_options import misread, parse_value
from midstride.cli.commands import param
from midstride.cli.running_systems import not_running
from midstride.lang import load_text
from midstride.model.component import ParameterSection
from midstride.runtime.records.status_forms import ParametersReport, ParameterStatus
from tests.cli.conftest import Midstride, running
from tests.cli.statuses import component, crash, status

SPECIFICATION = """{
  "system": "tuned",
  "topics": {"/chatter": {"type": "std_msgs/msg/String", "rate": 10}},
  "components": {
    "Talker": {
      "run": "python3 talker.py",
      "outputs": ["out"],
      "parameters": {"gain": {"value": 1.5, "changeable": true}},
      "functionalities": {
        "talk": {
          "produces": ["out"],
          "modes": {
            "normal": {"guarantees": {"out": {"type": "std_msgs/msg/String", "rate": 10}}},
            "degraded": {}
          }
        }
      }
    }
  },
  "nodes": {"talker": {"component": "Talker", "attachments": {"out": ["/chatter"]}}}
}"""

PROGRAM = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])

def check(value):
    if value < -10:
        raise ValueError("it must be at least -10")

gain = comp.parameter("gain", 1.5, on_change=check)
names = comp.parameter("names", ["a"], on_change=lambda value: None)
talk.set_normal_mode(lambda: out.write(String(data=str(gain.value))), rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tuned")
    (folder / "tuned.json").write_text(SPECIFICATION)
    (folder / "talker.py").write_text(PROGRAM)
    return folder


@pytest.fixture(scope="module")
def tuned(folder: Path) -> Iterator[Midstride]:
    for midstride in running():
        up = midstride("up", str(folder / "tuned.json"), "--backend", "sim", "--detach")
        assert up.status == 0, up.err
        yield midstride


@pytest.mark.full
def test_values_that_are_not_finite_are_shown_set_and_kept(midstride: Midstride, folder: Path) -> None:
    file = str(folder / "tuned.json")
    up = midstride("up", file, "--backend", "sim", "--detach")
    assert up.status == 0, up.err
    for text, shown, form in ((".inf", "inf", "inf"), ("-5.0", "-5.0", None), (".nan", "nan", "nan")):
        done = midstride("param", "set", "talker", "gain", text)
        assert (done.status, done.out.partition(",")[0]) == (0, f"{done.out.partition(':')[0]}: gain = {shown}")
        assert f"gain = {shown}, set at run time (started with 1.5)" in midstride("status").out
        restarted = midstride("restart", "talker", "--yes", "--json")
        assert restarted.status == 0, restarted.err
        kept = [(each["parameter"], each["fate"]) for each in restarted.json["parameters"]]
        assert kept == [("gain", "kept")]
        value = midstride("param", "get", "talker", "gain", "--json").json["value"]
        assert value == ({"float": form} if form else float(text))
    # The same file changes nothing, and the next manager finds what was set.
    assert "Nothing to do" in midstride("apply", file, "--yes").out
    assert midstride.saved("tuned").values == {"talker": {"gain": math.nan}}
    declared = midstride("restart", "talker", "--declared-parameters", "--yes")
    assert declared.status == 0, declared.err
    assert midstride("param", "get", "talker", "gain").out.startswith("gain = 1.5")


def test_parameters_are_shown_set_and_kept(tuned: Midstride, folder: Path) -> None:
    assert tuned("param", "list").out == "talker: gain = 1.5\ntalker: names = ['a']\n"
    done = tuned("param", "set", "talker", "gain", "-2.5")
    assert (done.status, done.out) == (0, "talker: gain = -2.5, set at run time (started with 1.5)\n")
    assert "talker: gain = -2.5, set at run time (started with 1.5)" in tuned("status").out
    assert tuned("param", "get", "talker", "gain", "--json").json == {
        "name": "gain",
        "value": -2.5,
        "declared": 1.5,
        "set_at_run_time": True,
    }
    done = tuned("restart", "talker", "--yes")
    assert done.status == 0, done.err
    assert done.out.count("talker: gain = -2.5, set at run time: kept\n") == 2  # in the plan and in the report
    assert tuned("param", "get", "talker", "gain").out == "gain = -2.5, set at run time (started with 1.5)\n"
    assert tuned("--json", "param", "list", "talker_2").json["talker_2"][0]["value"] == -2.5

    for asked in ("talker.talk", "talker_2.talk"):
        assert tuned("why", asked).out.splitlines()[0] == "talker.talk (talker_2) is in mode normal"
        document = tuned("why", asked, "--json").json
        assert (document["functionality"], document["instance"]) == ("talker.talk", "talker_2")
    unknown = tuned("why", "talker.talc").err
    assert "there is no functionality talker.talc; did you mean `talker.talk`?\n" in unknown

    kept = tuned("plan", "--restart", "talker_2")
    assert (kept.status, "talker: gain = -2.5, set at run time: kept\n" in kept.out) == (0, True)
    assert kept.out.startswith("tuned: restart talker_2")
    document = tuned("plan", "--restart", "talker", "--declared-parameters", "--json").json
    assert [(each["parameter"], each["fate"]) for each in document["parameters"]] == [("gain", "not_kept")]
    whole = tuned("plan", "--to", str(folder / "tuned.json"), "--system", "tuned", "--json").json
    assert (whole["steps"], whole.get("parameters", [])) == ([], [])
    assert tuned("param", "get", "talker_2", "gain").status == 0, "a plan changes nothing"

    done = tuned("restart", "talker", "--yes", "--declared-parameters")
    assert done.status == 0, done.err
    assert "talker: gain = -2.5, set at run time: not kept, as requested; it becomes 1.5" in done.out
    assert tuned("param", "get", "talker", "gain").out == "gain = 1.5\n"

    assert tuned("param", "set", "talker", "names", "[x, y]", "--json").json["parameters"][0]["value"] == ["x", "y"]
    done = tuned("apply", str(folder / "tuned.json"), "--yes", "--declared-parameters", "--json")
    assert (done.status, done.json["parameters"]) == (0, []), "the specification does not declare it"


@pytest.mark.parametrize("option", [("--declared-parameters",), ("--system", "tuned")])
def test_a_plan_for_a_file_refuses_what_is_for_a_running_system(
    tuned: Midstride, folder: Path, option: tuple[str, ...]
) -> None:
    refused = tuned("plan", str(folder / "tuned.json"), "--restart", "talker", *option)
    assert (refused.status, f"{option[0]} is for the running system" in refused.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("set", "talker", "gain", "-11"), "it must be at least -10"),
        (("set", "talker", "gain", "loud"), "takes a value like 1.5 (float), not 'loud'"),
        (("set", "talker", "gain", "1e3"), "YAML reads `1e3` as a string; write a float: 1000.0\n"),
        (("set", "talker", "names", "on"), "YAML reads `on` as a boolean; write a list of strings: '[\"on\"]'\n"),
        (("set", "talker", "gian", "1"), "there is no parameter gian"),
        (("set", "talker", "midstride.state", "x"), "shows the state of the component and cannot be set"),
        (("set", "talkr", "gain", "1"), "did you mean `talker`?"),
        (("get", "talker", "gian"), "did you mean `gain`?"),
        (("get", "talkr", "gain"), "did you mean `talker`?"),
        (("list", "talkr"), "did you mean `talker`?"),
    ],
)
def test_what_cannot_be_set_or_shown_is_refused_with_the_reason(
    tuned: Midstride, words: tuple[str, ...], reason: str
) -> None:
    done = tuned("param", *words)
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith(f"midstride param {words[0]}: ")
    assert reason in done.err


def test_the_log_has_a_refused_setting_with_the_reason(tuned: Midstride) -> None:
    assert tuned("param", "set", "talker", "gain", "-11").status == 1
    command, outcome = (line.partition(" ")[2] for line in tuned("log").out.splitlines()[-2:])
    assert command == "param set talker gain = -11"
    assert re.fullmatch(r"outcome: refused: talker\w* refused `set`: ValueError: it must be at least -10", outcome)
    assert tuned("log", "--json").json[-1]["outcome"] == "refused"


def test_add_reads_values_as_param_set_does(tuned: Midstride) -> None:
    words = ("add", "second", "Talker", "out=/chatter", "--yes", "--param")
    refused = tuned(*words, "gain=loud")
    assert refused.err == "midstride add: --param gain: YAML reads `loud` as a string; write a float, such as 1.5\n"
    refused = tuned(*words, "use_sim_time=1")
    assert "--param use_sim_time: YAML reads `1` as an integer; write a boolean, such as false\n" in refused.err
    assert tuned(*words, "gain=0x10", "--json").json["outcome"] == "done"
    try:
        assert tuned("param", "get", "second", "gain", "--json").json["value"] == 16.0
    finally:
        assert tuned("remove", "second", "--yes").status == 0


@pytest.mark.parametrize(
    ("text", "like", "hint"),
    [
        ("2", 1.5, None),
        ("[]", ["a"], None),
        ("on", "a", "YAML reads `on` as a boolean; write a string: '\"on\"'"),
        ("[1, 2]", "a", "YAML reads `[1, 2]` as a list of integers; write a string: '\"[1, 2]\"'"),
        ("3", [1], "YAML reads `3` as an integer; write a list of integers: '[3]'"),
        ("[1, 2.5]", [0.5], "YAML reads `[1, 2.5]` as a string; write a list of floats, such as '[0.5]'"),
        ("1", True, "YAML reads `1` as an integer; write a boolean, such as true"),
    ],
)
def test_what_yaml_reads_as_another_type_is_said_with_what_to_write(text: str, like: Any, hint: str | None) -> None:
    assert misread("gain", text, {"gain": like}) == hint


def test_names_of_parameters_are_completed(tuned: Midstride) -> None:
    line = ("midstride param set talker g", "4")
    done = tuned.process(timeout=60, _MIDSTRIDE_COMPLETE="zsh_complete", COMP_WORDS=line[0], COMP_CWORD=line[1])
    assert (done.out.replace("\\n", "\n"), done.err) == ("plain\ngain\n_\n", "")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-1.5", -1.5),
        ("true", True),
        ("on", True),
        ("'1'", "1"),
        ("loud", "loud"),
        ("", ""),
        ("a: b", "a: b"),
        ("[1, 2]", [1, 2]),
        ("[1, x]", "[1, x]"),
        ("[", "["),
        ("2026-11-22", "2026-11-22"),
        ("null", "null"),
        ("2026-13-01", "2026-13-01"),
        ("!!bool x", "!!bool x"),
        ("!!timestamp x", "!!timestamp x"),
        ("[]", []),
    ],
)
def test_a_value_is_read_as_ros2_param_set_reads_it(text: str, value: object) -> None:
    assert (parse_value(text), type(parse_value(text))) == (value, type(value))


@pytest.mark.ros2
def test_ros_2_reads_values_the_same_way() -> None:
    from rclpy.parameter import get_parameter_value, parameter_value_to_python

    for text in ("1", "-1.5", "true", "on", "'1'", "loud", "[1, 2]", "[1, x]", "1e3"):
        expected = parameter_value_to_python(get_parameter_value(text))
        expected = list(expected) if not isinstance(expected, (bool, int, float, str)) else expected
        assert (parse_value(text), type(parse_value(text))) == (expected, type(expected)), text


def test_a_node_that_has_crashed_is_not_said_to_be_unknown() -> None:
    remedy = "`midstride restart talker` restores it"
    crashed = status(component("listener"), crashed=[crash("talker_2", role="talker", remedy=remedy)])
    for node in ("talker", "talker_2"):
        assert str(not_running(crashed, node)) == f"talker_2 exited unexpectedly (status -9); {remedy}"
    assert str(not_running(crashed, "talkr")) == "no node talkr is running; did you mean `talker`?"


def test_values_that_are_stated_and_not_reported_are_listed(monkeypatch: pytest.MonkeyPatch, run: Any) -> None:
    """As of a program without parameter services, or that does not declare what its file states."""
    text = """
    system patrol
    component Base { run "base" gate preload parameters { rate = 5 } }
    node base : Base { parameters { rate = 7 } }
    """
    specification = load_text(text).require()
    node = specification.nodes["base"]
    sections = (ParameterSection("/**", Map(frame="map", rate=1)), ParameterSection("/other", Map(other=1)))
    specification = changed(specification, nodes=specification.nodes.set("base", changed(node, sections=sections)))
    value = {"name": "rate", "value": 7, "declared": 7, "set_at_run_time": False}
    reported: list[Any] = []
    unread: Any = msgspec.UNSET

    class Stated:
        def status(self) -> Any:
            return status(component("base_2", role="base", node="/base_2", parameters=reported))

        def specification(self) -> Any:
            return specification

        def parameters(self, node: str | None = None) -> Any:
            found = msgspec.convert(reported, list[ParameterStatus])
            return [ParametersReport("base_2", found, unread)]

    monkeypatch.setattr(param, "find", lambda _: (Stated(), None))
    assert run("param", "list")[:2] == (
        0,
        "base_2: frame = 'map' is stated; the node does not say which it has\n"
        "base_2: rate = 7 is stated; the node does not say which it has\n",
    )
    reported.append(value)
    assert (
        run("param", "list", "base")[1]
        == "base_2: rate = 7\nbase_2: frame = 'map' is stated; the node has no such parameter\n"
    )
    refused = run("param", "get", "base", "frame")
    assert refused[0] == 1 and "frame of base_2 is not known: 'map' is stated; the node has no such" in refused[2]
    assert json.loads(run("param", "list", "--json")[1]) == {"base_2": [value]}
    unread = "base_2 does not say its parameters: its parameter services do not answer"
    assert run("param", "list", "base")[1].splitlines() == [
        "base_2: rate = 7 (when it last answered)",
        "base_2: frame = 'map' is stated; the node has no such parameter",
        unread,
    ]


def test_parameters_of_several_nodes_are_set_as_one_change(tuned: Midstride) -> None:
    preview = tuned("param", "set", "talker.gain=3", "talker.names=[b]", "--dry-run")
    assert preview.status == 0, preview.err
    assert "set gain = 3.0, names = ['b'] on talker" in preview.out
    before = tuned("param", "get", "talker", "gain").out
    done = tuned("param", "set", "talker.gain=3", "talker.names=[b]")
    assert done.status == 0, done.err
    assert "gain = 3.0: set; it was " in done.out
    assert before != tuned("param", "get", "talker", "gain").out
    commands = [each["command"] for each in tuned("history", "--json").json["changes"]]
    assert "set talker.gain = 3, talker.names = ['b']" in commands
    refused = tuned("param", "set", "talker.gain=-11")
    assert refused.status == 1 and "it must be at least -10" in refused.out + refused.err
    assert tuned("param", "get", "talker", "gain", "--json").json["value"] == 3.0
    unknown = tuned("param", "set", "talker.gian=1", "--dry-run")
    assert unknown.status == 1 and "talker has no parameter gian; did you mean `gain`?" in unknown.err
    loud = tuned("param", "set", "talker.gain=loud", "--dry-run")
    assert loud.status == 1 and "write a float" in loud.err
    assert tuned("restart", "talker", "--yes", "--declared-parameters").status == 0


@pytest.mark.parametrize(
    ("words", "because"),
    [
        (("talker", "gain"), "write NODE NAME VALUE, or NODE.NAME=VALUE for each parameter"),
        (("talker.gain=1", "talker.gain=2"), "talker.gain is given twice"),
        (("talker.gain=1", "gain=2"), "`gain=2` is not of the form NODE.NAME=VALUE, such as camera.rate=10"),
        (("talker.gain=1", "gain"), "`gain` is not of the form NODE.NAME=VALUE, such as camera.rate=10"),
        (("talker", "gain", "1", "--dry-run"), "write NODE NAME VALUE, or NODE.NAME=VALUE"),
    ],
)
def test_what_is_neither_form_of_a_setting_is_refused(tuned: Midstride, words: tuple[str, ...], because: str) -> None:
    refused = tuned("param", "set", *words)
    assert refused.status == 2 and because in refused.err

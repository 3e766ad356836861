"""Launch files in XML and YAML become specifications: all that they state is in them, or is reported at its line."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from midstride.errors import SpecificationError
from midstride.lang.load import load_text
from midstride.lang.source_files import INCLUDE_PATH
from midstride.launch_files import launch_interpreter, python_files
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.launch_import import import_launch_file
from midstride.model.component import StopTimes
from midstride.model.respawn import RespawnPolicy
from tests.launch_files.support import commands, imported, kinds, of_xml, specification

XML = """<launch>
  <arg name="rate" default="50"/>
  <arg name="robot" default="r$(var rate)"/>
  <let name="fast" value="$(eval '$(var rate) > 20')"/>
  <group>
    <push-ros-namespace namespace="$(var robot)"/>
    <node pkg="demo" exec="talker.py" name="talker" if="$(var fast)" output="screen">
      <remap from="chatter" to="/chat"/>
      <param name="rate" value="$(var rate)"/>
      <param name="words" value="[a, b]"/>
      <param name="frame">
        <param name="id" value="map" type="str"/>
      </param>
    </node>
    <node pkg="demo" exec="slow" name="slow" unless="$(var fast)"/>
  </group>
  <node pkg="demo" exec="listener" name="listener" namespace="ears" respawn="true" respawn_delay="2.0" args="--loud"/>
</launch>
"""
YAML = """
launch:
- arg: {name: rate, default: "50"}
- arg: {name: robot, default: r$(var rate)}
- let: {name: fast, value: $(eval '$(var rate) > 20')}
- group:
  - push_ros_namespace: {namespace: $(var robot)}
  - node:
      pkg: demo
      exec: talker.py
      name: talker
      if: $(var fast)
      remap:
      - {from: chatter, to: /chat}
      param:
      - {name: rate, value: $(var rate)}
      - {name: words, value: [a, b]}
      - name: frame
        param:
        - {name: id, value: map}
  - node: {pkg: demo, exec: slow, name: slow, unless: $(var fast)}
- node:
    pkg: demo
    exec: listener
    name: listener
    namespace: ears
    respawn: "true"
    respawn_delay: 2.0
    args: --loud
"""
IMPORTED = """component Talker {
  run "talker.py --ros-args -r chatter:=/chat" package "demo" gate preload
  parameters {
    rate = 50
    words = ["a", "b"]
    frame.id = "map"
  }
}
"""


@pytest.mark.parametrize(("ending", "text"), [("xml", XML), ("yaml", YAML)])
def test_a_launch_file_becomes_a_specification(tmp_path: Path, ending: str, text: str) -> None:
    file = tmp_path / f"robot.launch.{ending}"
    file.write_text(text)
    found = imported(file)
    assert IMPORTED in found.text and "system robot\n" in found.text
    assert kinds(found) == ["package", "restart"]  # the package once
    system = specification(found, tmp_path)
    assert {node.role for node in system.nodes.values()} == {"r50/talker", "ears/listener"}
    assert commands(found, tmp_path)["ears/listener"] == "listener --loud"
    (listener,) = (node for node in system.nodes.values() if node.role == "ears/listener")
    assert listener.respawn == RespawnPolicy(delay=2.0, max_delay=2.0, max_retries=None), "launch restarts it for ever"
    [finding] = [each for each in found.findings if each.kind == "restart"]
    first = '<node pkg="demo" exec="listener"' if ending == "xml" else "- node:"
    assert first in text.splitlines()[int(finding.place.rpartition(":")[2]) - 1]


def test_arguments_of_the_command_replace_defaults(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.xml"
    file.write_text(XML)
    found = imported(file, {"rate": "3", "colour": "red"})
    assert set(commands(found, tmp_path)) == {"r3/slow", "ears/listener"}
    assert "no launch file that was read declares `colour`" in [each.message for each in found.findings]


def test_scopes(tmp_path: Path) -> None:
    """A group keeps what is set in it, unless it says otherwise; an include does not."""
    (tmp_path / "inner.launch.xml").write_text(
        '<launch><arg name="x" default="d"/><let name="y" value="$(var x)"/>'
        '<node exec="./a" name="a" args="$(var x) $(dirname)"/></launch>'
    )
    found = of_xml(
        tmp_path,
        """<let name="x" value="1"/>
        <group><let name="x" value="2"/><set_remap from="in" to="/out"/><node exec="./b" name="b"/></group>
        <group scoped="false"><let name="z" value="3"/></group>
        <node exec="./c" name="c" args="$(var x) $(var z)"/>
        <group forwarding="false"><keep name="z" value="4"/><node exec="./d" name="d" args="$(var z)"/></group>
        <include file="$(dirname)/inner.launch.xml"><arg name="x" value="5"/></include>
        <node exec="./e" name="e" args="$(var x)$(var y)"/>""",
    )
    assert kinds(found) == []
    assert commands(found, tmp_path) == {
        "a": f"./a 5 {tmp_path}",
        "b": "./b --ros-args -r in:=/out",
        "c": "./c 1 3",
        "d": "./d 4",
        "e": "./e 55",
    }


def test_values_of_parameters_are_read_by_pyyaml_and_by_ros_and_in_parameter_files_by_ros_alone(tmp_path: Path) -> None:
    written = {"a": "y", "b": "010", "c": "08", "d": "1e3", "e": "1.5", "f": "on"}
    lines = "".join(f"    {name}: {text}\n" for name, text in written.items())
    (tmp_path / "p.yaml").write_text(f"second:\n  ros__parameters:\n{lines}", encoding="utf-8")
    own = "".join(f'<param name="{name}" value="{text}"/>' for name, text in written.items())
    body = (
        f'<node pkg="demo" exec="first" name="first">{own}</node>'
        f'<node pkg="demo" exec="second" name="second"><param from="{tmp_path / "p.yaml"}"/></node>'
    )
    system = specification(of_xml(tmp_path, body), tmp_path)
    # launch writes the first ones as they are, but for those that PyYAML reads as something else than text
    assert dict(system.instance("first").parameters) == {"a": True, "b": 8, "c": 8.0, "d": 1000.0, "e": 1.5, "f": True}
    assert dict(system.instance("second").parameters) == {"a": True, "b": 8, "c": 8.0, "d": 1000.0, "e": 1.5, "f": True}


def test_nodes_that_run_the_same_share_a_component(tmp_path: Path) -> None:
    found = of_xml(
        tmp_path,
        """<node exec="./camera" name="left"/><node exec="./camera" name="right"/>
        <node exec="./lidar" name="front"/><node exec="./lidar" name="back"><param name="r" value="1"/></node>""",
    )
    system = specification(found, tmp_path)
    assert {node.role: node.component for node in system.nodes.values()} == {
        "left": "Camera",
        "right": "Camera",
        "front": "Front",
        "back": "Back",
    }


def test_parameter_files_are_named_where_the_specification_may_read_them(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "a.yaml").write_text("/**:\n  ros__parameters:\n    gain: 1.5\n    mode: slow\n")
    (tmp_path / "config" / "b.yaml").write_text("robot:\n  ros__parameters:\n    frame: $(var frame)\n    mode: fast\n")
    found = of_xml(
        tmp_path,
        """<let name="frame" value="map"/>
        <node exec="./robot" name="robot">
          <param from="$(dirname)/config/a.yaml"/>
          <param from="$(dirname)/config/b.yaml" allow_substs="true"/>
          <param name="gain" value="2.5"/>
        </node>
        <node exec="./other" name="other">
          <param name="mode" value="none"/><param from="$(dirname)/config/a.yaml"/>
        </node>""",
    )
    system = specification(found, tmp_path)
    assert found.text.count('parameters "config/a.yaml"') == 2 and kinds(found) == []
    assert {node.role for node in system.nodes.values()} == {"robot", "other"}
    assert 'frame = "map"' in found.text and 'mode = "fast"' in found.text and "gain = 2.5" in found.text
    values = {name: dict(system.instance(name).parameters) for name in ("robot", "other")}
    assert values["robot"] == {"gain": 2.5, "mode": "fast", "frame": "map"}
    assert values["other"] == {"gain": 1.5, "mode": "slow"}  # where the file comes last


def test_what_cannot_be_taken_over_is_reported_at_its_line(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("a: [1, x]\n")
    (tmp_path / "more.launch.py").write_text("")
    found = of_xml(
        tmp_path,
        """<arg name="who"/>
        <arg name="colour" default="red"><choice value="blue"/></arg>
        <include file="$(find-pkg-share nix)/launch/a.launch.xml"/>
        <include file="$(dirname)/gone.launch.xml"/>
        <include file="$(dirname)/more.launch.py"/>
        <group if="$(var who)"><node exec="./lost" name="lost"/></group>
        <node exec="./named"/>
        <node pkg="nix" exec="run" name="input" on_exit="shutdown">
          <param name="who" value="$(var who)"/>
          <param from="$(dirname)/bad.yaml"/>
          <remap from="a" to="$(var who)"/>
        </node>
        <node_container pkg="nix" exec="box" name="box" namespace="">
          <composable_node pkg="nix" plugin="nix::Filter" name="filter"/>
        </node_container>
        <executable cmd="rviz2 -d a.rviz"/>
        <timer period="3.0"><node exec="./late" name="late"/></timer>
        <shutdown/>
        <node exec="./late" name="late"/>
        <let name="maybe" value="1" if="$(var who)"/>
        <node exec="./last" name="last" args="$(var maybe)"><param name="t" value="{a: 1}"/></node>""",
    )
    seen = [(finding.place.rpartition(":")[2], finding.kind) for finding in found.findings]
    assert seen == [
        ("22", "refused"),  # before anything is carried out
        ("2", "argument"),
        ("3", "argument"),
        ("4", "package"),
        ("5", "include"),
        ("6", "python"),
        ("7", "condition"),
        ("8", "name"),
        ("9", "package"),
        ("12", "argument"),
        ("10", "argument"),
        ("9", "unsupported"),
        ("17", "program"),
        ("19", "unsupported"),
        ("21", "condition"),
        ("22", "condition"),
        ("9", "name"),
        ("18", "name"),
        ("11", "parameters"),
        ("18", "later"),
    ]
    assert set(commands(found, tmp_path)) == {"named", "input_2", "filter", "rviz2", "late", "late_2", "last"}
    assert found.findings.counts()["unsupported"] == 2
    assumed = {"name": 3, "package": 1, "later": 1, "program": 1}
    assert found.findings.counts(left_out=False) == assumed and "package" in found.findings.counts(left_out=True)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ('respawn="true" respawn_delay="2 s"', "refuses this file: `respawn_delay` of `node`: `2 s` is not a number"),
        ('respawn="true" respawn_delay="nan"', "`nan` is not a number from 0"),
        ('respawn="true" respawn_delay="-1"', "`-1` is not a number from 0"),
        ('respawn="true" respawn_max_retries="many"', "`respawn_max_retries` of a node is left out"),
    ],
)
def test_numbers_that_launch_does_not_take_are_left_out(tmp_path: Path, attributes: str, message: str) -> None:
    found = of_xml(tmp_path, f'<node pkg="" exec="n" name="n" {attributes}/>')
    assert kinds(found) == ["refused" if "refuses" in message or "-1" in message else "unsupported", "restart"]
    assert message in str(next(iter(found.findings)))
    assert found.nodes == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("far", 1e300),
        ("far", 9223372036854775807),
        ("joint-1", 1),
        ("1st", 2),
        ("plugins/x", "7"),
        ("text", "two\nlines"),
        ("text", "x" * 9000),
    ],
)
def test_what_the_language_cannot_state_is_in_a_parameter_file_beside_it(
    tmp_path: Path, name: str, value: int | float | str
) -> None:
    body = f'<node pkg="" exec="n" name="n" namespace="a"><param name="{name}" value="$(var v)" type="KIND"/></node>'
    body = body.replace("KIND", type(value).__name__) + '<node pkg="" exec="m" name="m"/>'
    found = of_xml(tmp_path, f'<arg name="v"/>{body}', {"v": str(value)})
    assert kinds(found) == [] and "imported.parameters.yaml" in found.text
    system = specification(found, tmp_path)
    assert dict(system.instance("a/n").parameters) == {name: value} and not system.instance("m").parameters
    printed = import_launch_file(tmp_path / "robot.launch.xml", {"v": str(value)}, {}, None)
    if name == "text" and "\n" in str(value):
        assert kinds(printed) == [] and 'text = "two\\nlines"' in printed.text
    else:
        assert kinds(printed) == ["parameters"] and "with `-o FILE`" in str(next(iter(printed.findings)))


def test_numbers_that_are_not_finite_are_written(tmp_path: Path) -> None:
    params = '<param name="far" value="inf" type="float"/><param name="gains" value="[-.inf, 1.0, .nan]"/>'
    found = of_xml(tmp_path, f'<node pkg="" exec="n" name="n">{params}</node>')
    assert kinds(found) == []
    assert "far = inf" in found.text and "gains = [-inf, 1.0, nan]" in found.text


@pytest.mark.parametrize(
    ("attributes", "before", "stop"),
    [
        ("", "", None),
        ('sigterm_timeout="12" sigkill_timeout="2.5"', "", StopTimes(12.0, 2.5)),
        ('sigkill_timeout="$(var patience)"', '<let name="patience" value="9"/>', StopTimes(5.0, 9.0)),
        ("", '<arg name="sigterm_timeout" default="20"/>', StopTimes(20.0, 5.0)),
        ('sigterm_timeout="3"', '<let name="sigterm_timeout" value="20"/>', StopTimes(3.0, 5.0)),
        ("", '<let name="sigkill_timeout" value="soon"/>', None),
    ],
    ids=["launch's default", "both", "a variable", "the whole launch", "a node of it", "no number"],
)
def test_how_long_a_process_may_take_to_end_is_taken_over(
    tmp_path: Path, attributes: str, before: str, stop: StopTimes | None
) -> None:
    found = of_xml(tmp_path, f'{before}<node pkg="" exec="n" name="n" {attributes}/>')
    # Launch carries out no substitution there.
    assert kinds(found) == ["refused"] * ("$(var" in attributes)
    (component,) = load_text(found.text).require().components.values()
    assert component.stop == stop


def test_files_outside_are_not_read_and_others_not_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "a.launch.xml").write_text('<launch><node exec="./a" name="a"/></launch>')
    (outside / "a.yaml").write_text("/**:\n  ros__parameters:\n    password: secret\n")
    (inside / "secret.xml").write_text("<secret>secret</secret>")
    (inside / "secret.yaml").write_text("secret: secret\n")
    (inside / "secret.launch").write_text("secret")
    (inside / "secret.txt").write_text("secret")
    (inside / "link.launch.xml").symlink_to(outside / "a.launch.xml")
    monkeypatch.chdir(inside)
    body = "".join(
        f'<include file="{name}"/>\n' for name in ("secret.xml", "secret.yaml", "secret.launch", "secret.txt")
    )
    body += '<include file="../outside/a.launch.xml"/><include file="link.launch.xml"/>'
    body += '<node exec="./b" name="b"><param from="../outside/a.yaml"/><param from="secret.yaml"/></node>'
    found = of_xml(inside, body)
    assert kinds(found) == ["include"] * 6 + ["parameters"] * 2
    assert found.nodes == 1 and "secret" not in found.text
    assert all("secret" not in str(each).replace("`secret.", "") for each in found.findings)
    monkeypatch.setenv(INCLUDE_PATH, str(outside))
    assert of_xml(inside, body).nodes == 3  # the two names of one file in the folder that is now named, and `b`


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.launch.xml", "<robot/>"),
        ("a.launch.xml", "<launch>"),
        ("a.launch.xml", ""),
        ("a.launch.xml", '<!DOCTYPE l [<!ENTITY a "aaaa">]><launch>&a;</launch>'),
        ("a.launch.xml", "<launch>" * 100 + "</launch>" * 100),
        ("a.launch.yaml", "launch: [1]\n"),
        ("a.launch.yaml", "launch:\n- a: {}\n  b: {}\n"),
        ("a.launch.yaml", "launch: 3\n"),
        ("a.launch.yaml", "robot: []\n"),
        ("a.launch.yaml", "- \tx"),
        ("a.txt", "<launch/>"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SpecificationError, match="cannot import"):
        imported(tmp_path / name)


def test_a_launch_file_that_includes_itself_ends(tmp_path: Path) -> None:
    found = of_xml(tmp_path, '<include file="$(filename)"/><include file="$(filename)"/>')
    assert "include" in kinds(found)


def test_packages_are_found_where_they_are_installed_and_in_source_trees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index = tmp_path / "ros" / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    program = tmp_path / "ros" / "lib" / "demo" / "a"
    program.parent.mkdir(parents=True)
    program.symlink_to("/bin/true")
    launch = tmp_path / "ros" / "share" / "demo" / "launch"
    launch.mkdir(parents=True)
    (launch / "a.launch.xml").write_text('<launch><node pkg="demo" exec="a" name="a"/></launch>')
    source = tmp_path / "src" / "own" / "launch"
    source.mkdir(parents=True)
    (source.parent / "package.xml").write_text("<package><name>own_package</name></package>")
    (source / "b.launch.xml").write_text('<launch><node pkg="own_package" exec="b" name="b"/></launch>')
    (tmp_path / "src" / "left").mkdir()
    (tmp_path / "src" / "left" / "package.xml").symlink_to(tmp_path / "gone")  # as `--symlink-install` leaves behind
    (tmp_path / "robot").mkdir()
    monkeypatch.setenv(INCLUDE_PATH, str(tmp_path / "src"))
    found = of_xml(
        tmp_path / "robot",
        """<include file="$(find-pkg-share demo)/launch/a.launch.xml"/>
        <include file="$(find-pkg-share own_package)/launch/b.launch.xml"/>""",
        AMENT_PREFIX_PATH=str(tmp_path / "ros"),
    )
    assert kinds(found) == [] and found.nodes == 2 and found.files == 3


def test_a_process_has_its_prefix_and_environment_and_a_package_executable_is_started_itself(tmp_path: Path) -> None:
    found = of_xml(
        tmp_path,
        """<set_env name="MODE" value="a b"/><set_parameter name="use_sim_time" value="true"/>
        <node exec="./a" name="a" launch-prefix="nice -n 5">
          <env name="LD_PRELOAD" value=""/><param name="plugins/x" value="'7'"/>
        </node>
        <node pkg="p" exec="b" name="b"><env name="LD_PRELOAD" value="libx.so"/></node>""",
    )
    assert kinds(found) == ["package"]
    components = specification(found, tmp_path).components
    assert {
        name: (each.run, each.package, each.prefix, dict(each.environment)) for name, each in components.items()
    } == {
        "A": ("./a", None, "nice -n 5", {"MODE": "a b", "LD_PRELOAD": ""}),
        "B": ("b", "p", None, {"MODE": "a b", "LD_PRELOAD": "libx.so"}),
    }
    assert found.text.count("use_sim_time = true") == 2


def test_a_variable_that_is_taken_away_is_not_inherited(tmp_path: Path) -> None:
    found = of_xml(
        tmp_path,
        """<set_env name="MODE" value="a"/><unset_env name="RMW_IMPLEMENTATION"/><unset_env name="MODE"/>
        <node exec="./a" name="a"><env name="B" value="1"/></node>
        <group><set_env name="MODE" value="b"/><node exec="./b" name="b"/></group>""",
    )
    assert kinds(found) == []
    components = specification(found, tmp_path).components
    assert {name: dict(component.environment) for name, component in components.items()} == {
        "A": {"MODE": None, "RMW_IMPLEMENTATION": None, "B": "1"},
        "B": {"RMW_IMPLEMENTATION": None, "MODE": "b"},
    }


def test_a_lifecycle_node_has_its_gate(tmp_path: Path) -> None:
    found = of_xml(tmp_path, '<lifecycle_node pkg="nav" exec="map" name="map" namespace=""/>')
    assert 'run "map" package "nav" gate lifecycle preload' in found.text and kinds(found) == [
        "refused",
        "package",
        "lifecycle",
    ]
    refused, _, finding = found.findings
    assert "up to launch_ros 0.28, it has no element `lifecycle_node`" in refused.message and not refused.left_out
    assert "the launch file leaves `map` unconfigured; here Midstride activates it at its start" in finding.message
    assert "write `gate preload`" in finding.message and not finding.left_out


def test_a_launch_file_in_python_is_a_program_and_not_carried_out_unasked(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    found = of_xml(tmp_path, f'<include file="{file}"/>')
    assert kinds(found) == ["python"] and "--run-python" in str(next(iter(found.findings)))
    with pytest.raises(SpecificationError, match="--run-python"):
        imported(file)
    assert not (tmp_path / "ran").exists()


def found_in_python(file: Path, *processes: Mapping[str, object], left: list[list[object]] | None = None) -> object:
    """What the process that carries out launch files in Python says of these."""
    process = {
        "place": [str(file), 1],
        "package": "",
        "prefix": [],
        "environment": {},
        "cleared": False,
        "folder": None,
        "shell": False,
        "respawn": None,
        "after": None,
        "texts": {},
        "stop": {},
        "label": "",
    }
    state = {"namespace": "/top", "remaps": [], "parameters": [], "variables": {"k": "1", "p": "2"}, "environment": {}}
    described = [{**process, **each} for each in processes]
    return {"processes": described, "left": left or [], "declared": [], "files": 2, "state": state}


def test_nodes_of_a_launch_file_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What its process describes; that process is checked where `launch` is (test_python_launch.py)."""
    ros = f"-r __node:=a -r __ns:=/top/g --params-file {tmp_path}/a.yaml --params-file /t/launch_params_1 -r in:=/out"
    described = found_in_python(
        tmp_path / "b.launch.py",
        {
            "type": "LifecycleNode",
            "package": "demo",
            "executable": "a",
            "words": ["/opt/a", "--x", "7", "--ros-args", *ros.split()],
            "stop": {"sigterm": 12.0},
            "state": "active",
            "texts": {"/t/launch_params_1": "/**:\n  ros__parameters:\n    rate: 50.0\n"},
        },
        left=[["unsupported", "`OpaqueCoroutine` in Python is left out", str(tmp_path / "b.launch.py"), 2]],
    )
    asked = []

    def carried_out(path: str, given: Mapping[str, object], environment: object) -> object:
        asked.append((Path(path).name, given))
        return described

    monkeypatch.setattr(launch_interpreter, "carried_out", carried_out)
    (tmp_path / "b.launch.py").write_text("one\ntwo\n")
    (tmp_path / "a.yaml").write_text("/**:\n  ros__parameters:\n    gain: 2\n")
    (tmp_path / "a.launch.xml").write_text(
        '<launch><arg name="n"/><let name="k" value="1"/><push-ros-namespace namespace="top"/>'
        f'<include file="{tmp_path}/b.launch.py"><arg name="p" value="2"/></include></launch>'
    )
    found = import_launch_file(tmp_path / "a.launch.xml", {}, {}, tmp_path / "a.stride", run_python=True)
    given = {"variables": {"k": "1", "p": "2"}, "arguments": ["p"], "namespace": "/top", "remaps": [], "parameters": []}
    assert asked == [("b.launch.py", given)]
    assert kinds(found) == ["argument", "unsupported", "package", "lifecycle"] and found.files == 3
    places = [finding.place.rpartition("/")[2] for finding in found.findings]
    assert places[1:] == ["b.launch.py:2", "b.launch.py:1", "b.launch.py:1"]
    assert "launch activates `top/g/a` by events; here Midstride does" in str(list(found.findings)[-1])
    assert 'run "a --x 7 --ros-args -r in:=/out" package "demo" stop sigterm 12 s gate lifecycle preload' in found.text
    assert "rate = 50.0" in found.text and 'parameters "a.yaml"' in found.text and "namespace top/g" in found.text


def test_a_node_of_a_launch_file_in_python_is_named_as_one_in_xml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = {"type": "Node", "executable": "./2d-driver.py", "words": ["./2d-driver.py"]}
    described = found_in_python(tmp_path / "a.launch.py", node)
    monkeypatch.setattr(launch_interpreter, "carried_out", lambda *_: described)
    (tmp_path / "a.launch.py").write_text("")
    found = import_launch_file(tmp_path / "a.launch.py", {}, {}, None, run_python=True)
    in_xml = of_xml(tmp_path, '<node exec="./2d-driver.py"/>')
    assert set(commands(found, tmp_path)) == set(commands(in_xml, tmp_path)) == {"node_2d_driver"}
    assert [finding.message for finding in found.findings] == [finding.message for finding in in_xml.findings]


def test_a_command_for_a_shell_in_python_is_called_by_its_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["/opt/map_tool --ros-args -r out:=/c"]
    described = found_in_python(tmp_path / "a.launch.py", {"type": None, "words": words, "shell": True})
    monkeypatch.setattr(launch_interpreter, "carried_out", lambda *_: described)
    (tmp_path / "a.launch.py").write_text("")
    found = import_launch_file(tmp_path / "a.launch.py", {}, {}, None, run_python=True)
    assert commands(found, tmp_path) == {"map_tool": f"sh -c '{words[0]}'"}


def test_what_names_its_own_folder_after_a_file_in_python_differs_in_launch_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other").mkdir()
    included = tmp_path / "other" / "b.launch.py"
    included.write_text("")
    monkeypatch.setattr(launch_interpreter, "carried_out", lambda *_: found_in_python(included))
    file = tmp_path / "a.launch.xml"
    include = '<include file="$(dirname)/other/b.launch.py"/>'
    for before, expected in (("", 0), (include, 1)):
        file.write_text(f'<launch>{before}<executable cmd="tool $(dirname)" name="tool"/></launch>')
        found = import_launch_file(file, {}, {}, tmp_path / "a.stride", run_python=True)
        said = [str(each) for each in found.findings if "`$(dirname)` after an include" in str(each)]
        assert len(said) == expected


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("import sys; sys.exit(3)", "cannot be imported"),
        ("raise RuntimeError('no luck')", "it failed: RuntimeError: no luck"),
        ("import sys; print(1); sys.exit(1)", "it failed: exit status 1"),
        ("pass", "it has ended the process that carried it out, with status 0"),
    ],
)
def test_a_launch_file_in_python_that_cannot_be_carried_out(script: str, why: str) -> None:
    with pytest.raises(UnknownValue, match=why):
        python_files.carried_out("a.launch.py", {}, dict(os.environ), (sys.executable, "-c", script))


@pytest.mark.parametrize("started", ["", "subprocess.Popen(['sleep', '600']); "])
def test_what_carries_out_a_launch_file_in_python_ends_with_all_that_it_has_started(started: str) -> None:
    script = f"import subprocess, time; {started}print('x', flush=True); time.sleep(600)"
    with pytest.raises(UnknownValue, match=r"it has not ended within 0\.5 s"):
        python_files.carried_out("a.launch.py", {}, dict(os.environ), (sys.executable, "-c", script), timeout=0.5)


def test_what_holds_an_output_open_does_not_hold_up_the_end() -> None:
    script = "import subprocess, sys; subprocess.Popen(['sleep', '600']); sys.exit('no luck')"
    with pytest.raises(UnknownValue, match="it failed: no luck"):
        python_files.carried_out("a.launch.py", {}, dict(os.environ), (sys.executable, "-c", script))


def test_a_launch_file_with_a_line_break_in_its_name(tmp_path: Path) -> None:
    file = tmp_path / "one\ntwo\x1b.launch.xml"
    file.write_text('<launch><node exec="./a" name="a"/></launch>')
    found = imported(file)
    assert "# one\\ntwo" in found.text and "\x1b" not in found.text and found.nodes == 1


def test_names_that_are_words_of_the_language(tmp_path: Path) -> None:
    """A namespace keeps its name, as a path; parameters do anyway."""
    found = of_xml(
        tmp_path,
        """<node exec="./a" name="a" namespace="system">
          <param name="mode" value="1"/><param name="a.topic" value="2"/>
        </node>
        <node exec="./b" name="b" namespace="node/input"/>""",
    )
    assert kinds(found) == [] and set(commands(found, tmp_path)) == {"system/a", "node/input/b"}
    assert "mode = 1" in found.text and "a.topic = 2" in found.text


@pytest.mark.parametrize(
    ("command", "shown", "name"),
    [("python3 -u talker.py --loud", "python3 -u talker.py", "talker"), ("./bin/talker x", "./bin/talker", "talker")],
)
def test_a_program_is_named_with_its_script(tmp_path: Path, command: str, shown: str, name: str) -> None:
    (finding,) = of_xml(tmp_path, f'<executable cmd="{command}"/>').findings
    assert f"`{shown}` is started as the node of `{name}`, which names itself" in finding.message


def test_the_name_of_an_executable_is_a_label_and_no_name_of_a_node(tmp_path: Path) -> None:
    """As in launch, which does not pass it to the program: a node in it keeps the name that the program gives it."""
    found = of_xml(
        tmp_path,
        """<executable cmd="./bin/talker x" name="shown"/>
        <executable cmd="./bin/other --ros-args -r __node:=own" name="label"/>""",
    )
    assert re.search(r'run "\./bin/talker x" gate preload unnamed', found.text)
    assert re.search(r'run "\./bin/other" gate preload\n', found.text)
    assert re.search(r"node shown *:", found.text) and re.search(r"node own *:", found.text)
    first, second = (finding.message for finding in found.findings)
    assert "`./bin/talker` is started as the node of `shown`, which names itself" in first
    assert "`./bin/other` is started as the node `own`" in second


@pytest.mark.parametrize("value", ["!!bool x", "!!timestamp x", "!!int x", "!!float x"])
def test_a_value_that_is_not_of_its_tag_is_no_yaml(tmp_path: Path, value: str) -> None:
    file = tmp_path / "robot.launch.yaml"
    file.write_text(f"launch:\n- arg: {{name: a, default: {value}}}\n")
    with pytest.raises(SpecificationError, match=r"not valid YAML|a value that launch does not take"):
        import_launch_file(file, {}, {}, None)
    found = of_xml(tmp_path, f'<node exec="./a" name="a"><param name="p" value="{value}"/></node>')
    assert dict(specification(found, tmp_path).instance("a").parameters) == {"p": value}


def test_a_section_with_the_name_of_a_node_and_another_namespace_is_named_as_a_mistake(tmp_path: Path) -> None:
    values = "ros__parameters: {rate: 1}"
    (tmp_path / "a.yaml").write_text(f"n:\n  {values}\n/**/m:\n  {values}\nother:\n  {values}\n")
    body = "".join(f'<node exec="./{name}" name="{name}"><param from="$(dirname)/a.yaml"/></node>' for name in "nm")
    found = of_xml(tmp_path, f'<group><push-ros-namespace namespace="robot"/>{body}</group>')
    (finding,) = found.findings
    assert finding.kind == "parameters" and not finding.left_out
    assert "the section `n` is for the node `/n`; ROS does not give it to `/robot/n`" in finding.message
    assert finding.message.endswith("write `/robot/n:` or `/**/n:`")
    assert kinds(of_xml(tmp_path, body)) == []


def test_what_a_specification_needs_of_other_folders_is_in_its_first_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "robot").mkdir()
    sections = "a:\n  ros__parameters: {rate: 1}\ninner:\n  ros__parameters: {rate: 2}\n"
    (tmp_path / "config" / "a.yaml").write_text(sections)
    body = '<node exec="./a" name="a"><param from="$(env CONFIG)/a.yaml"/></node>'
    launch = tmp_path / "robot" / "robot.launch.xml"
    launch.write_text(f"<launch>{body}</launch>")
    prefix = tmp_path / "prefix"
    (prefix / "share").mkdir(parents=True)
    (prefix / "share" / "config").symlink_to(tmp_path / "config")
    given = {"CONFIG": str(prefix / "share" / "config"), "AMENT_PREFIX_PATH": str(prefix)}
    found = import_launch_file(launch, {}, given, tmp_path / "robot" / "a.stride")
    assert "rate = 1" in found.text and "a.yaml" not in found.text and found.text.startswith("# Imported from")
    (finding,) = found.findings
    assert "what is for no node named here (`inner`) is left out" in finding.message
    assert f"`midstride --include-path {os.path.realpath(tmp_path)}/config import …`" in finding.message
    monkeypatch.setenv(INCLUDE_PATH, str(tmp_path / "config"))
    found = import_launch_file(launch, {}, given, tmp_path / "robot" / "a.stride")
    assert len(found.findings) == 0
    assert found.text.startswith(
        f"# Needs files of other folders: `midstride --include-path {tmp_path}/config COMMAND …`"
    )


def test_a_value_that_launch_gives_to_all_nodes_of_a_process_is_for_all(tmp_path: Path) -> None:
    (tmp_path / "two.yaml").write_text(
        "two: {ros__parameters: {rate: 20.0}}\nlocal_costmap: {local_costmap: {ros__parameters: {width: 3}}}\n"
    )
    file = '<param from="$(dirname)/two.yaml"/>'
    rate = '<param name="rate" value="7.0"/>'
    for body, own, other in (
        (f'<node exec="./two" name="two">{file}{rate}</node>', 7.0, 7.0),
        (f'<node exec="./two" name="two">{rate}{file}</node>', 20.0, 7.0),
        (f'<set_parameter name="rate" value="7.0"/><node exec="./two" name="two">{file}</node>', 20.0, 7.0),
        ('<node exec="./two" name="two" args="--ros-args -p rate:=7.0"/>', 7.0, 7.0),
        (f'<node exec="./two" name="two"><param name="rate" value="1.0"/>{rate}</node>', 7.0, 7.0),
        # In a namespace that is stated, launch gives the value to that node alone.
        (f'<node exec="./two" name="two" namespace="">{file}{rate}</node>', 7.0, None),
    ):
        found = of_xml(tmp_path, body)
        assert kinds(found) == [], [str(each) for each in found.findings]
        node = specification(found, tmp_path).nodes["two"]
        assert specification(found, tmp_path).instance("two").parameters["rate"] == own, body
        of_other = {section.pattern: section.parameters.get("rate") for section in node.sections}
        assert of_other.get("/**") == other, body


def test_a_parameter_file_that_cannot_be_read_is_named_for_each_node_that_would_have_it(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("/**/w_*: {ros__parameters: {rate: [1, x]}}\n")
    nodes = "".join(
        f'<node exec="./{name}" name="{name}"><param from="$(dirname)/bad.yaml"/></node>\n' for name in "ab"
    )
    found = of_xml(tmp_path, nodes)
    assert [each.message for each in found.findings] == [
        f"`bad.yaml` is left out: line 1 is not of a parameter file that can be read (of `{name}`)" for name in "ab"
    ]


def test_a_value_for_all_that_the_language_cannot_state_is_in_a_file_for_all(tmp_path: Path) -> None:
    (tmp_path / "two.yaml").write_text("inner: {ros__parameters: {width: 3}}\n")
    (tmp_path / "all.yaml").write_text("/**: {ros__parameters: {joint-1: 1.0, rate: 2.0}}\n")
    file, every = ('<param from="$(dirname)/NAME.yaml"/>'.replace("NAME", name) for name in ("two", "all"))
    odd, text = '<param name="joint-1" value="7.0"/>', '<param name="text" value="$(var v)" type="str"/>'
    for body, own, of_others in (
        (file + odd, {"joint-1": 7.0}, {"joint-1": 7.0}),
        (odd + every, {"joint-1": 1.0, "rate": 2.0}, {"joint-1": 1.0, "rate": 2.0}),
        (every + odd, {"joint-1": 7.0, "rate": 2.0}, {"joint-1": 7.0, "rate": 2.0}),
        (text, {"text": "x" * 9000}, {"text": "x" * 9000}),
    ):
        found = of_xml(tmp_path, f'<arg name="v"/><node exec="./two" name="two">{body}</node>', {"v": "x" * 9000})
        assert kinds(found) == [], [str(each) for each in found.findings]
        system = specification(found, tmp_path)
        assert dict(system.instance("two").parameters) == own, body
        inner: dict[str, object] = {}
        for section in system.nodes["two"].sections:
            inner |= dict(section.parameters) if section.matches("other") else {}
        assert inner == of_others, body


def test_a_value_for_all_of_another_type_than_that_of_the_node_is_named_where_there_may_be_further_nodes(
    tmp_path: Path,
) -> None:
    inner = "inner: {ros__parameters: {width: 3}}"
    (tmp_path / "own.yaml").write_text(f"two: {{ros__parameters: {{rate: fast}}}}\n{inner}\n")
    rate = '<param name="rate" value="1.5"/>'
    found = of_xml(tmp_path, f'<node exec="./two" name="two">{rate}<param from="$(dirname)/own.yaml"/></node>')
    (finding,) = found.findings
    assert dict(specification(found, tmp_path).instance("two").parameters) == {"rate": "fast"}
    assert "launch gives `rate` to all nodes of the process of `two`" in finding.message and not finding.left_out
    assert "if `inner` is in this process" in finding.message


def test_links_of_a_sourced_workspace_are_followed(tmp_path: Path) -> None:
    """As `colcon build --symlink-install` makes them."""
    source = tmp_path / "src" / "demo"
    source.mkdir(parents=True)
    (source / "a.launch.xml").write_text(
        '<launch><node exec="./a" name="a"><param from="$(dirname)/a.yaml"/></node></launch>'
    )
    (source / "a.yaml").write_text("a:\n  ros__parameters: {rate: 1}\n")
    share = tmp_path / "install" / "share" / "demo"
    share.mkdir(parents=True)
    for name in ("a.launch.xml", "a.yaml"):
        (share / name).symlink_to(source / name)
    index = tmp_path / "install" / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    (tmp_path / "robot").mkdir()
    body = '<include file="$(find-pkg-share demo)/a.launch.xml"/>'
    found = of_xml(tmp_path / "robot", body, AMENT_PREFIX_PATH=str(tmp_path / "install"))
    assert kinds(found) == [] and "rate = 1" in found.text
    assert kinds(of_xml(tmp_path / "robot", f'<include file="{share}/a.launch.xml"/>')) == ["include"]  # not sourced


def test_commands_are_run_only_if_the_user_says_so(tmp_path: Path) -> None:
    file = tmp_path / "robot.launch.xml"
    file.write_text(
        """<launch><node exec="./a" name="a">
        <param name="robot_description" value="$(command 'cat $(dirname)/robot.xml')" type="str"/>
        <param name="failed" value="$(command 'sh -c &quot;echo no luck >&amp;2; exit 3&quot;')"/>
        <param name="warned" value="$(command 'sh -c &quot;echo x; echo y >&amp;2&quot;' ignore)"/>
        </node></launch>"""
    )
    (tmp_path / "robot.xml").write_text("<robot>\n" + "x" * 9000 + "\n</robot>\n")
    unasked = import_launch_file(file, {}, dict(os.environ), tmp_path / "imported.stride")
    assert kinds(unasked) == ["command"] * 3 and "--run-commands" in str(next(iter(unasked.findings)))
    found = import_launch_file(file, {}, dict(os.environ), tmp_path / "imported.stride", run_commands=True)
    (failed,) = found.findings
    assert failed.kind == "command" and "has failed: exit status 3: no luck" in failed.message
    parameters = dict(specification(found, tmp_path).instance("a").parameters)
    assert parameters == {"robot_description": (tmp_path / "robot.xml").read_text(), "warned": "x"}
    assert 'parameters "imported.parameters.a.yaml"' in found.text


def test_what_is_started_later_follows_the_others(tmp_path: Path) -> None:
    found = of_xml(
        tmp_path,
        """<timer period="5.0"><node exec="./last" name="last"/></timer>
        <timer period="2.0">
          <node exec="./late" name="late"/><timer period="1.5"><node exec="./later" name="later"/></timer>
        </timer>
        <node exec="./a" name="a"/><node exec="./b" name="b"/>""",
    )
    assert [line for line in found.text.splitlines() if line.startswith("order")] == [
        "order /a before /late",
        "order /b before /late",
        "order /late before /later",
        "order /later before /last",
    ]
    assert {each.message.partition(",")[0] for each in found.findings} == {
        "`late` is started 2 s later in launch",
        "`later` is started 3.5 s later in launch",
        "`last` is started 5 s later in launch",
    }
    assert kinds(found) == ["later"] * 3 and not found.findings.counts(left_out=True)


def test_an_executable_of_a_package_is_started_itself(tmp_path: Path) -> None:
    index = tmp_path / "ros" / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "demo").touch()
    program = tmp_path / "ros" / "lib" / "demo" / "talker"
    program.parent.mkdir(parents=True)
    program.symlink_to("/bin/true")
    found = of_xml(
        tmp_path,
        """<executable cmd="ros2 run demo talker --x" name="a"/>
        <executable cmd="$(exec-in-pkg talker demo) --y" name="b"/>
        <executable cmd="ros2 bag record /a" name="c"/>""",
        AMENT_PREFIX_PATH=str(tmp_path / "ros"),
    )
    assert [line.strip() for line in found.text.splitlines() if "run " in line] == [
        'run "talker --x" package "demo" gate preload unnamed',
        'run "talker --y" package "demo" gate preload unnamed',
        'run "ros2 bag record /a" gate preload unnamed',
    ]


@pytest.mark.parametrize(
    ("element", "once"),
    [
        ('<executable cmd="true" name="a"/>', True),
        ('<executable cmd="/bin/mkdir -p /tmp/maps" name="a"/>', True),
        ('<executable cmd="ros2 service call /reset std_srvs/srv/Empty" name="a"/>', True),
        ('<executable cmd="ros2 topic pub --once /go std_msgs/msg/Empty" name="a"/>', True),
        ('<executable cmd="ros2 run controller_manager spawner base" name="a"/>', True),
        ('<node pkg="controller_manager" exec="spawner" name="a" args="base"/>', True),
        ('<node pkg="ros_gz_sim" exec="create" name="a" args="-name robot"/>', True),
        ('<node pkg="gazebo_ros" exec="spawn_entity.py" name="a"/>', True),
        ('<node pkg="controller_manager" exec="spawner" name="a" respawn="true"/>', False),
        ('<executable cmd="true" name="a" respawn="true"/>', False),
        ('<node pkg="controller_manager" exec="ros2_control_node" name="a"/>', False),
        ('<node pkg="other" exec="spawner" name="a"/>', False),
        ('<executable cmd="ros2 topic pub -r 1 /go std_msgs/msg/Empty" name="a"/>', False),
        ('<executable cmd="ros2 bag record -a" name="a"/>', False),
        ('<executable cmd="python3 tool.py" name="a"/>', False),
    ],
)
def test_a_program_that_is_known_to_end_is_once(element: str, once: bool, tmp_path: Path) -> None:
    found = of_xml(tmp_path, element)
    component = specification(found, tmp_path).component_of("a")
    assert component.once == once
    assert ("once" in kinds(found)) == once


@pytest.mark.parametrize(
    ("stated", "limit"),
    [("", None), ('respawn_max_retries="-1"', None), ('respawn_max_retries="3"', 3)],
)
def test_restarts_are_limited_as_launch_limits_them(stated: str, limit: int | None, tmp_path: Path) -> None:
    element = f'<node pkg="" exec="n" name="n" respawn="true" respawn_delay="2" {stated}/>'
    found = of_xml(tmp_path, element)
    policy = specification(found, tmp_path).nodes["n"].respawn
    assert policy is not None and policy.max_retries == limit
    assert kinds(found) == (["restart"] if limit is None else [])
    element = '<node pkg="" exec="n" name="n" respawn="true" respawn_max_retries="0"/>'
    assert specification(of_xml(tmp_path, element), tmp_path).nodes["n"].respawn is None


def test_a_node_that_gets_another_name_here_keeps_the_parameters_of_its_own(tmp_path: Path) -> None:
    """Launch writes them in a section with the name that it knows, and files have them there, too."""
    (tmp_path / "of_server.yaml").write_text("/arm/server: {ros__parameters: {limit: 4}}\n", encoding="utf-8")
    node = """<node pkg="demo" exec="d" name="server" namespace="arm">
  <param name="rate" value="5"/><param from="$(dirname)/of_server.yaml"/>
</node>"""
    found = of_xml(tmp_path, node)
    system = specification(found, tmp_path)
    assert dict(system.instance("arm/server_2").parameters) == {"rate": 5, "limit": 4}
    assert {each.kind for each in found.findings} == {"package", "name"}

"""Hosts in the language: read, checked, written as JSON and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.codec.configuration_form import ConfigurationForm, InstanceForm, decode_configuration
from midstride.codec.form import encode
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.lang import format_text
from midstride.lang.load import load
from midstride.lang.service import LanguageService
from midstride.model.component import Resource
from midstride.model.hosts import HostSpec
from midstride.model.specification import Specification, initial
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.launches import launch_of

TEXT = """system two
host arm { ssh "robot@arm"   setup "/opt/ros/jazzy/setup.bash"   folder "/opt/robot" }
host base { }
topic /grip : std_msgs/msg/String @ 10 Hz
topic /plan : std_msgs/msg/String @ 10 Hz
resource gpu        = 2
resource gpu on arm = 3

component Worker {
  run "python3 -m worker"
  holds gpu 2
  output out
  functionality work {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode degraded { }
  }
}
component Idle { run "python3 -m idle" }

node gripper : Worker on arm { out -> /grip }
node planner : Worker        { out -> /plan }
"""


def read(folder: Path, text: str = TEXT, **files: str) -> Specification:
    for name, fragment in files.items():
        (folder / f"{name}.stride").write_text(fragment, encoding="utf-8")
    path = folder / "s.stride"
    path.write_text(text, encoding="utf-8")
    return load(path).require()


def errors(folder: Path, text: str, **files: str) -> list[tuple[str, str, str, str]]:
    """The code, the place, the message and the help of each error."""
    for name, fragment in files.items():
        (folder / f"{name}.stride").write_text(fragment, encoding="utf-8")
    path = folder / "s.stride"
    path.write_text(text, encoding="utf-8")
    found = [each for each in load(path).diagnostics if each.severity == "error"]
    return [(each.code, each.span.text if each.span else "", each.message, each.help or "") for each in found]


def test_it_is_read_and_written(tmp_path: Path) -> None:
    specification = read(tmp_path)
    arm = HostSpec("arm", "robot@arm", "/opt/ros/jazzy/setup.bash", "/opt/robot")
    assert dict(specification.hosts) == {"arm": arm, "base": HostSpec("base", "base")}
    assert {role: node.host for role, node in specification.nodes.items()} == {"gripper": "arm", "planner": ""}
    assert dict(specification.resources) == {"gpu": Resource("gpu", 2.0), "gpu on arm": Resource("gpu", 3.0, "arm")}
    assert decode_specification(encode_specification(specification)) == specification
    document = encode_specification(specification)
    assert document["hosts"] == {
        "arm": {"ssh": "robot@arm", "setup": "/opt/ros/jazzy/setup.bash", "folder": "/opt/robot"},
        "base": {},
    }
    assert document["resources"] == {"gpu": {"capacity": 2}, "gpu on arm": {"capacity": 3, "host": "arm"}}
    assert (document["nodes"]["gripper"]["host"], "host" in document["nodes"]["planner"]) == ("arm", False)
    assert format_text(TEXT).text == TEXT


def test_an_instance_and_its_start_are_on_the_host_of_the_node(tmp_path: Path) -> None:
    specification = read(tmp_path)
    configuration = initial(specification)
    gripper = configuration.instances["gripper"]
    assert (gripper.host, dict(gripper.resource_usage)) == ("arm", {"gpu on arm": 2.0})
    assert {name: int(amount) for name, amount in configuration.held.items()} == {"gpu": 2, "gpu on arm": 2}
    assert InstanceForm.of(gripper).instance() == gripper
    assert decode_configuration(encode(ConfigurationForm.of(configuration))) == configuration
    launch = launch_of(gripper, "simulator", token="t", directory=tmp_path, options=SystemOptions())
    assert launch.host == "arm"


def test_a_namespace_an_included_file_and_a_container_give_their_nodes_a_host(tmp_path: Path) -> None:
    more = """
namespace left on arm {
  node a : Idle
  node b : Idle on base
  node c : Idle on manager
  namespace inner { node d : Idle }
}
include "part.stride" on base
container box on arm { }
component Loaded { run component "demo::Loaded" package "demo" gate preload }
node e : Loaded in box
"""
    part = "resource camera\ncomponent Camera { holds camera }\nnode f : Camera\nnamespace g on arm { node h : Idle }\n"
    specification = read(tmp_path, TEXT + more, part=part)
    hosts = {role: node.host for role, node in specification.nodes.items() if node.component != "Worker"}
    assert hosts == {
        "left/a": "arm",
        "left/b": "base",
        "left/c": "",
        "left/inner/d": "arm",
        "f": "base",
        "g/h": "arm",
        "e": "arm",
    }
    assert specification.resources["camera on base"] == Resource("camera", 1.0, "base")
    assert specification.containers["box"].host == "arm"
    assert decode_specification(encode_specification(specification)) == specification


def test_a_file_may_be_included_on_two_hosts_where_its_names_do_not_meet(tmp_path: Path) -> None:
    part = "node f : Idle\n"
    twice = TEXT + 'include "part.stride" on base\nnamespace n { include "part.stride" on arm }\n'
    assert {role: each.host for role, each in read(tmp_path, twice, part=part).nodes.items() if role[-1] == "f"} == {
        "f": "base",
        "n/f": "arm",
    }
    shared = TEXT + 'include "part.stride" on base\ninclude "part.stride" on arm\n'
    read(tmp_path, shared, part="component Shared { }\n")
    help = "include the file in another namespace the second time, or move node `f` out of it"
    assert errors(tmp_path, shared, part=part) == [
        ("E007", "arm", "node `f` is on host base and on host arm: its file is included on both", help)
    ]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("node x : Idle on amr", ("E008", "amr", "there is no host `amr`", "did you mean `arm`?")),
        ("namespace n on amr { }", ("E008", "amr", "there is no host `amr`", "did you mean `arm`?")),
        ("host arm { }", ("E007", "arm", "host `arm` is already declared", "use another name")),
        (
            "node x : Worker on base",
            (
                "E019",
                "base",
                "x is on host base and holds gpu, which only the host of the manager and host arm have: a process "
                "cannot use the resources of another host",
                "declare `resource gpu on base`, or put the node `on manager` or `on arm`",
            ),
        ),
        (
            'component L { run component "d::L" package "d" gate preload }\ncontainer box on arm\n'
            "node x : L in box on base",
            (
                "E019",
                "base",
                "x is on host base, and its container box is on host arm: a container loads nodes on its own host "
                "alone",
                "write `on arm`, or name a container that is on host base",
            ),
        ),
        (
            "node x : Worker on arm",
            (
                "E023",
                "gpu",
                "nodes hold 4 of gpu on arm (gripper 2, x 2), but its capacity is 3",
                "remove a node that holds it, or raise the capacity",
            ),
        ),
        (
            'host other { ssh "robot@other -p 22" }',
            (
                "E018",
                '"robot@other -p 22"',
                "`robot@other -p 22` is no destination of `ssh`",
                'write it as `ssh "robot@arm"`; options belong in ~/.ssh/config, under a name of their own',
            ),
        ),
        (
            'host other { }\n  folder "/opt" }',
            ("E124", "}", "this `}` closes host `other` before `folder`, which belongs inside it", "remove it"),
        ),
    ],
)
def test_what_is_wrong_is_said_with_what_to_write(tmp_path: Path, line: str, expected: tuple[str, ...]) -> None:
    assert errors(tmp_path, f"{TEXT}{line}\n") == [expected]


def test_a_port_and_a_parameter_may_still_be_called_host(tmp_path: Path) -> None:
    text = TEXT + (
        "topic /h : std_msgs/msg/String\n"
        'component Named { output host parameters { host = "x" } functionality f { produces host mode a { '
        "guarantee host : std_msgs/msg/String } mode b { } } }\n"
        "node named : Named { host -> /h }\nhost third { }\n"
    )
    specification = read(tmp_path, text)
    assert specification.components["Named"].outputs == ("host",)
    assert sorted(specification.hosts) == ["arm", "base", "third"]


def test_without_hosts_nothing_of_them_is_written(tmp_path: Path) -> None:
    plain = TEXT.replace(" on arm = 3", "2 = 3").replace(" on arm", "").replace("gpu        = 2", "gpu = 4")
    plain = "\n".join(line for line in plain.splitlines() if not line.startswith("host "))
    specification = read(tmp_path, plain)
    assert "host" not in str(encode_specification(specification))
    assert "host" not in str(encode(ConfigurationForm.of(initial(specification))))
    moved = replace(specification, nodes=Map())
    assert moved.hosts == Map()


def test_an_editor_shows_finds_renames_and_offers_hosts() -> None:
    file, text = Path("/ws/two.stride"), TEXT + "namespace n on arm { node x : Idle }\n"
    service = LanguageService(read=lambda path: text)
    service.open(file, text)
    lines = text.splitlines()
    line = lines.index("node gripper : Worker on arm { out -> /grip }") + 1
    column = lines[line - 1].index("arm") + 2
    shown = service.hover(file, line, column) or ""
    assert all(part in shown for part in ("`arm`", "reached as `robot@arm`", "runs `gripper`, `n/x`"))
    definition = service.definition(file, line, column)
    assert definition is not None and text[: definition.start].count("\n") == 1
    edits = service.rename(file, line, column, "left_arm")
    assert [span.text for span, _ in edits] == ["arm"] * 4 and {new for _, new in edits} == {"left_arm"}
    offered = {each.word for each in service.complete(file, line, column - 1) if each.kind == "host"}
    assert offered == {"arm", "base", "manager"}
    gpu = lines.index("resource gpu on arm = 3") + 1
    shown = service.hover(file, gpu, len("resource g")) or ""
    assert "on host arm: capacity 3" in shown and "\ncapacity 2" in shown.replace("- ", "").replace("  ", "")

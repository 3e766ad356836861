"""The parameter file that a program without Midstride's API is started with, read by rcl's own parser."""

from __future__ import annotations

import math
import random
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.own_names import OwnNames, StartName
from midstride.backends.ros2.manager.parameter_file import parameter_file, write_parameters
from midstride.backends.ros2.manager.start_arguments import StartArguments
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import StartFailed
from midstride.lang.load import load
from midstride.lang.parameter_files import SectionInFile
from midstride.lang.source import Source, Span
from midstride.model.component import ParameterSection
from midstride.model.specification import Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.specification_diff import differences
from midstride.runtime.backend_protocol import Launch
from midstride.wire.sockets import SocketFolder
from tests.lang.test_rcl_parameters import comparable, drawn_file, needs_rcl
from tests.rcl_parser import rcl_sections

COMPONENT = """component C {
  run "program" gate preload
  %s
  functionality f { mode a { } mode b { } }
}
"""


def effective(sections: Sequence[tuple[str, Mapping[str, Any]]], role: str) -> dict[str, Any]:
    """What rclcpp and rclpy give a node: the sections in their order, the later one over the earlier."""
    found: dict[str, Any] = {}
    for pattern, values in sections:
        if SectionInFile(pattern, Span(Source("", ""), 0, 0), {}).matches(role):
            found |= {name: comparable(value) for name, value in values.items()}
    return found


def loaded(folder: Path, text: str, files: Mapping[str, str]) -> Specification | None:
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    (folder / "s.stride").write_text("system s\n" + text, encoding="utf-8")
    return load(folder / "s.stride").specification


def written(specification: Specification, role: str, folder: Path, name: str = "") -> list[tuple[str, dict[str, Any]]]:
    """The sections that rcl reads from the file of an instance of ``role``."""
    instance = specification.instance(role, name or role)
    path = parameter_file(folder, instance.name)
    if not write_parameters(path, instance.sections, f"/{instance.name}", instance.parameters):
        return []
    found = rcl_sections([path])
    assert found is not None, path.read_text()
    return found


def rcls(folder: Path, files: Sequence[str]) -> list[tuple[str, dict[str, Any]]] | None:
    return rcl_sections([folder / name for name in files])


@needs_rcl
@pytest.mark.parametrize(
    "text",
    [
        "/**: {ros__parameters: {a: 1, b: 2}}\nn: {ros__parameters: {a: 3}}\n",
        "n: {ros__parameters: {a: 3}}\n/**: {ros__parameters: {a: 1, b: 2}}\n",
        "/**: {ros__parameters: {a: 1}}\nn: {ros__parameters: {a: 3}}\n/**: {ros__parameters: {a: 2, b: 2}}\n",
        "n: {ros__parameters: {a: 3}}\ninner: {n: {ros__parameters: {a: 5.5}}}\n/*/n: {ros__parameters: {c: x}}\n",
    ],
    ids=["before", "after", "twice", "inner"],
)
@pytest.mark.parametrize("name", ["n", "n_2"])
def test_every_node_of_the_process_gets_what_rcl_gives_it(text: str, name: str, tmp_path: Path) -> None:
    specification = loaded(tmp_path, COMPONENT % 'parameters "p.yaml"' + "node n : C\n", {"p.yaml": text})
    assert specification is not None
    original, ours = rcls(tmp_path, ["p.yaml"]), written(specification, "n", tmp_path, name)
    assert original is not None
    assert effective(ours, name) == effective(original, "n")
    for other in ("inner/n", "other", "a/b/c"):
        assert effective(ours, other) == effective(original, other)


@needs_rcl
@pytest.mark.parametrize(
    ("component", "node"),
    [
        ('parameters { use_sim_time = true gain = 2 } parameters "p.yaml"', ""),
        ('parameters "p.yaml" parameters { use_sim_time = true gain = 2 }', ""),
        ('parameters { use_sim_time = false gain = 1 } parameters "p.yaml"', "{ parameters { use_sim_time = true } }"),
    ],
    ids=["before the file", "after it", "in the node"],
)
def test_simulated_time_that_is_stated_is_that_of_the_whole_process(component: str, node: str, tmp_path: Path) -> None:
    """As a parameter of a launch file is, which reaches each node of the process: a buffer of transforms, a costmap."""
    file = {"p.yaml": "inner: {ros__parameters: {rate: 5.0}}\n"}
    specification = loaded(tmp_path, COMPONENT % component + f"node n : C {node}\n", file)
    assert specification is not None
    found = written(specification, "n", tmp_path)
    assert effective(found, "inner") == {"use_sim_time": comparable(True), "rate": comparable(5.0)}
    assert effective(found, "a/b") == {"use_sim_time": comparable(True)}
    assert effective(found, "n")["use_sim_time"] == comparable(True)


@needs_rcl
@pytest.mark.parametrize(
    ("component", "node", "own", "others"),
    [
        ("parameters for all { rate = 7.0 }", "", 7.0, {"inner": 7.0, "a/b": 7.0}),
        ("parameters for all { rate = 7.0 }", "parameters { rate = 8.0 }", 8.0, {"inner": 7.0, "a/b": 7.0}),
        ("parameters { rate = 7.0 }", "parameters for all { rate = 8.0 }", 8.0, {"inner": 8.0, "a/b": 8.0}),
        # As with launch, a section counts at the place where its name is met first.
        ('parameters for all { rate = 7.0 } parameters "p.yaml"', "", 7.0, {"inner": 5.0, "a/b": 7.0}),
        ('parameters "p.yaml" parameters for all { rate = 7.0 }', "", 7.0, {"inner": 7.0, "a/b": 7.0}),
        ('parameters "p.yaml" parameters { rate = 7.0 }', "", 7.0, {"inner": 5.0}),
    ],
)
def test_a_value_for_all_reaches_each_node_of_the_process(
    component: str, node: str, own: float, others: dict[str, float], tmp_path: Path
) -> None:
    file = {"p.yaml": "inner: {ros__parameters: {rate: 5.0}}\n"}
    specification = loaded(tmp_path, COMPONENT % component + f"node n : C {{ {node} }}\n", file)
    assert specification is not None
    found = written(specification, "n", tmp_path)
    assert effective(found, "n") == {"rate": comparable(own)}
    assert {name: effective(found, name) for name in ("inner", "a/b") if effective(found, name)} == {
        name: {"rate": comparable(value)} for name, value in others.items()
    }


@needs_rcl
def test_simulated_time_of_a_file_is_for_the_nodes_of_its_section(tmp_path: Path) -> None:
    file = {"p.yaml": "n: {ros__parameters: {use_sim_time: true}}\n"}
    specification = loaded(tmp_path, COMPONENT % 'parameters "p.yaml"' + "node n : C\n", file)
    assert specification is not None
    found = written(specification, "n", tmp_path)
    assert (effective(found, "inner"), effective(found, "n")) == ({}, {"use_sim_time": comparable(True)})


@needs_rcl
@pytest.mark.parametrize("seed", range(4))
def test_drawn_files_mean_the_same_in_the_file_of_the_process(seed: int, tmp_path: Path) -> None:
    drawn = random.Random(seed)
    compared = 0
    for _ in range(150):
        files = {f"p{index}.yaml": drawn_file(drawn) for index in range(drawn.choice([1, 1, 2, 3]))}
        statements = "\n".join(f'parameters "{name}"' for name in files)
        specification = loaded(tmp_path, COMPONENT % statements + "node n : C\n", files)
        original = rcls(tmp_path, list(files))
        if specification is None or original is None:
            continue
        name = drawn.choice(["n", "n_2"])
        ours = written(specification, "n", tmp_path, name)
        assert effective(ours, name) == effective(original, "n"), files
        for other in ("m", "m/n", "a/m/n"):
            assert effective(ours, other) == effective(original, other), files
        assert decode_specification(encode_specification(specification)) == specification
        compared += 1
    assert compared > 20


@needs_rcl
def test_every_value_and_name_is_read_again_as_it_is(tmp_path: Path) -> None:
    values: dict[str, Any] = {
        "flags": [True, False],
        "counts": [1, -(2**63), 2**63 - 1],
        "reals": [1.0, 1e20, -0.0, 5e-324, 1e-310, 0.1, 1e-5, math.inf, -math.inf, math.nan],
        "texts": ["", "yes", "1.5", " a: b\n\t'\"\\", "\U0001f916 grün\x7f", "x" * 9000, "#", "~"],
        "none": [],
        "joint-1": 1,
        "1st": 2,
        "a: b": 3,
        "slash/name": 4,
        "with blank": 5,
        "n" * 3000: 6,
        "dotted.na me": "x",
    }
    path = tmp_path / "gates" / "p.yaml"
    assert write_parameters(path, [ParameterSection("/**", Map(use_sim_time=True))], "/ns/n", values)
    found = rcl_sections([path])
    assert found is not None and [name for name, _ in found] == ["/**", "/ns/n"]
    assert {name: comparable(value) for name, value in found[1][1].items()} == {
        name: comparable(value) for name, value in values.items()
    }
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_the_file_is_written_for_a_start_and_deleted_with_the_process(tmp_path: Path) -> None:
    files = {"p.yaml": "talker: {ros__parameters: {rate: 2.0}}\ninner: {ros__parameters: {rate: 5.0}}\n"}
    specification = loaded(tmp_path, COMPONENT % 'parameters "p.yaml"' + "node talker : C\n", files)
    assert specification is not None
    instance, component = specification.instance("talker"), specification.components["C"]
    nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path), lambda node: None)
    given: dict[str, object] = {"rate": 9.0}  # set while its predecessor ran
    launch = Launch("talker_2", "", (), "t", tmp_path, dict(instance.parameters), given, sections=instance.sections)
    arguments = StartArguments(tmp_path / "gates").of(launch, component, StartName("/talker_2"))
    path = parameter_file(tmp_path / "gates", "talker_2")
    assert arguments == ["--ros-args", "-r", "__node:=talker_2", "--params-file", str(path)]
    assert path.read_text().splitlines() == [
        *('"inner":', "  ros__parameters:", '    "rate": 5.0'),
        *('"/talker_2":', "  ros__parameters:", '    "rate": 9.0'),
    ]
    nodes.gone("talker_2")
    assert not path.exists()
    plain = Launch("talker", "", (), "t", tmp_path)
    assert StartArguments(tmp_path / "gates").of(plain, component, StartName("/talker")) == [
        "--ros-args",
        "-r",
        "__node:=talker",
    ]


@pytest.mark.parametrize(
    ("statements", "rate"),
    [
        ('parameters "p.yaml"  parameters { rate = 40.0 }', 40.0),
        ('parameters { rate = 40.0 }  parameters "p.yaml"', 20.0),
        ('parameters "p.yaml"  parameters { rate = 40.0 }  parameters "q.yaml"', 30.0),
        ("parameters { rate = 40.0 }", 40.0),
    ],
)
@pytest.mark.parametrize("where", ["component", "node"])
def test_of_files_and_values_the_later_one_wins(statements: str, rate: float, where: str, tmp_path: Path) -> None:
    files = {
        "p.yaml": "n: {ros__parameters: {rate: 20.0}}\n",
        "q.yaml": "n: {ros__parameters: {rate: 30.0}}\n",
    }
    declared = COMPONENT % (statements if where == "component" else "parameters { rate = 1.0 }")
    node = "node n : C\n" if where == "component" else f"node n : C {{ {statements} }}\n"
    specification = loaded(tmp_path, declared + node, files)
    assert specification is not None
    assert specification.instance("n").parameters == Map(rate=rate)


def test_defaults_of_a_component_come_before_the_files_outside_and_what_follows_its_files_after_them(
    tmp_path: Path,
) -> None:
    files = {
        "all.yaml": "/**: {ros__parameters: {a: 1, b: 1, c: 1}}\n",
        "p.yaml": "/**: {ros__parameters: {b: 2, c: 2}}\n",
    }
    text = 'parameters "all.yaml"\n' + COMPONENT % (
        'parameters { a = 0, b = 0, c = 0 }  parameters "p.yaml"  parameters { d = 3 }'
    )
    inherited = "component D like C { parameters { c = 4 } }\nnode n : C\nnode m : D\n"
    specification = loaded(tmp_path, text + inherited, files)
    assert specification is not None
    assert specification.instance("n").parameters == Map(a=1, b=2, c=2, d=3)
    assert specification.instance("m").parameters == Map(a=1, b=2, c=4, d=3)


def test_a_section_of_a_further_node_is_part_of_what_a_node_is(tmp_path: Path) -> None:
    text = COMPONENT % 'parameters "p.yaml"' + "node n : C\nnode m : C\n"
    own = "n: {ros__parameters: {a: 1}}\nm: {ros__parameters: {a: 1}}\n"
    files = {"p.yaml": own + "n/costmap: {ros__parameters: {rate: 5.0}}\n"}
    before = loaded(tmp_path, text, files)
    assert before is not None
    # Another node of the system is not in the process.
    assert before.nodes["n"].sections == (ParameterSection("n/costmap", Map(rate=5.0)),)
    after = loaded(tmp_path, text, {"p.yaml": files["p.yaml"].replace("rate: 5.0", "rate: .nan")})
    assert after is not None
    (change, _) = differences(before, after)
    assert (change.subject, change.kind) == ("node m", "replaced")
    assert change.details == ("parameter rate of the section n/costmap: 5.0 -> nan",)
    assert len(change_between(initial(before), before, after).coming) == 2
    again = loaded(tmp_path, text, {"p.yaml": files["p.yaml"].replace("rate: 5.0", "rate: .nan")})
    assert again is not None and differences(after, again) == [] and again == after
    assert change_between(initial(after), after, again).coming == ()


def test_each_of_two_nodes_of_a_program_gets_its_own_section(tmp_path: Path) -> None:
    files = {
        "p.yaml": "front: {ros__parameters: {rate: 30.0, port: 1}}\nrear: {ros__parameters: {rate: 15.0, far: 2}}\n"
    }
    specification = loaded(tmp_path, COMPONENT % 'parameters "p.yaml"' + "node front : C\nnode rear : C\n", files)
    assert specification is not None
    assert specification.instance("front").parameters == Map(rate=30.0, port=1)
    assert specification.instance("rear").parameters == Map(rate=15.0, far=2)
    report = load(tmp_path / "s.stride").diagnostics
    assert report == ()
    misspelt = COMPONENT % "parameters { rate = 1.0 }" + "node n : C { parameters { raet = 2.0 } }\n"
    assert loaded(tmp_path, misspelt, {}) is None
    (fault,) = load(tmp_path / "s.stride").diagnostics
    assert (fault.code, fault.message, fault.help) == ("E008", "C has no parameter `raet`", "did you mean `rate`?")


UNNAMED = (COMPONENT % "%s").replace("gate preload", "gate preload unnamed")


def unnamed_launch(specification: Specification, role: str, instance: str, folder: Path) -> Launch:
    found = specification.instance(role, instance)
    return Launch(instance, "", (), "t", folder, dict(found.parameters), {}, sections=found.sections, role=role)


@needs_rcl
@pytest.mark.parametrize(
    ("statements", "launch"),
    [
        ('parameters "p.yaml"  parameters { rate = 40.0 }', "p.yaml inline.yaml"),
        ('parameters { rate = 40.0 }  parameters "p.yaml"', "inline.yaml p.yaml"),
        ('parameters { rate = 40.0 }  parameters "q.yaml"', "inline.yaml q.yaml"),
        ('parameters "q.yaml"  parameters { rate = 40.0 }  parameters "p.yaml"', "q.yaml inline.yaml p.yaml"),
    ],
)
@pytest.mark.parametrize("role", ["n", "talk"])  # an import calls it as its executable, as its program often does
def test_a_node_that_its_program_names_gets_what_launch_gives_it(
    statements: str, launch: str, role: str, tmp_path: Path
) -> None:
    files = {
        "p.yaml": "talk: {ros__parameters: {rate: 20.0}}\n",
        "q.yaml": "/**: {ros__parameters: {rate: 30.0, all: 1}}\ntalk: {ros__parameters: {own: 2}}\n",
        "inline.yaml": "/**: {ros__parameters: {rate: 40.0}}\n",  # as launch writes values for such a node
    }
    specification = loaded(tmp_path, UNNAMED % statements + f"node {role} : C\n", files)
    assert specification is not None
    original = rcls(tmp_path, launch.split())
    assert original is not None
    component = specification.components["C"]
    assert component.unnamed and decode_specification(encode_specification(specification)) == specification
    nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path), lambda node: None)

    def started(instance: str, running: str = "") -> tuple[list[str], list[tuple[str, dict[str, Any]]]]:
        given = unnamed_launch(specification, role, instance, tmp_path)
        name = nodes.start_name(given, component, lambda node: node == running)
        arguments = StartArguments(tmp_path / "gates").of(given, component, name)
        found = rcl_sections([parameter_file(tmp_path / "gates", instance)])
        assert found is not None and "--enclave" in arguments
        return arguments, found

    # At first its name is not known.
    arguments, found = started(role)
    assert not any("__node" in word for word in arguments)
    assert effective(found, "talk") == effective(original, "talk")
    assert effective(found, "other") == effective(original, "other")
    # Then it is, also to the next manager: it keeps the name where that is free, and is renamed alone beside another.
    OwnNames(tmp_path / "gates").note(role, "/talk")
    nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path), lambda node: None)
    arguments, found = started(f"{role}_2")
    assert not any("__node" in word for word in arguments)
    assert effective(found, "talk") == effective(original, "talk")
    arguments, found = started(f"{role}_2", running="/talk")
    assert arguments[:3] == ["--ros-args", "-r", "talk:__node:=talk_2"]
    assert effective(found, "talk_2") == effective(original, "talk")
    with pytest.raises(StartFailed, match="a node /talk is running already"):
        started(role, running="/talk")


@pytest.mark.parametrize("gate", ["preload", "relay", "lifecycle", "lifecycle preload", "none"])
def test_a_program_behind_any_gate_may_name_its_node(gate: str, tmp_path: Path) -> None:
    text = (COMPONENT % "").replace("gate preload", f"gate {gate} unnamed") + "node n : C\n"
    made = loaded(tmp_path, text, {})
    assert made is not None and made.components["C"].unnamed


@pytest.mark.parametrize("gate", ["preload", "relay", "lifecycle", "lifecycle preload", "none"])
def test_one_node_of_several_is_named_where_it_is_stated_what_its_program_calls_it(gate: str, tmp_path: Path) -> None:
    text = (COMPONENT % "").replace("gate preload", f"gate {gate} renames cam") + "namespace a { node n : C }\n"
    made = loaded(tmp_path, text, {})
    assert made is not None
    assert decode_specification(encode_specification(made)) == made
    nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path), lambda node: None)
    launch = Launch("a/n_2", "a", (), "t", tmp_path, role="a/n")
    component = made.components["C"]
    name = nodes.start_name(launch, component, lambda node: node == "/a/n")
    assert (name.full, name.passed) == ("/a/n_2", True)
    assert StartArguments(tmp_path / "gates").of(launch, component, name)[:5] == [
        "--ros-args",
        "-r",
        "cam:__node:=n_2",
        "-r",
        "__ns:=/a",
    ]


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        (
            "renames cam",
            "C `renames cam`, but has no gate: it uses Midstride's API, which names its node after its role",
        ),
        ("gate none unnamed renames cam", "C is `unnamed`, so its node keeps its name, and yet it `renames cam`"),
    ],
)
def test_what_does_not_fit_the_name_of_a_node_is_refused(stated: str, message: str, tmp_path: Path) -> None:
    text = (COMPONENT % "").replace("gate preload", stated) + "node n : C\n"
    assert loaded(tmp_path, text, {}) is None
    fault = load(tmp_path / "s.stride").diagnostics[0]
    assert (fault.code, fault.message) == ("E027", message)


def test_a_component_with_the_api_is_named_by_it(tmp_path: Path) -> None:
    text = (COMPONENT % "").replace("gate preload", "unnamed") + "node n : C\n"
    assert loaded(tmp_path, text, {}) is None
    fault = load(tmp_path / "s.stride").diagnostics[0]
    assert (fault.code, fault.message) == (
        "E027",
        "C is `unnamed`, but has no gate: it uses Midstride's API, which names its node after its role",
    )

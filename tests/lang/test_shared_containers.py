"""Containers that composable nodes share, in the language: read, checked, written as JSON and back, compared."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.codec.configuration_form import InstanceForm
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import PlanRefused
from midstride.lang import format_text
from midstride.lang.load import load
from midstride.model.component import ContainerProgram, SharedContainer, StopTimes
from midstride.model.specification import Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import requested_change
from midstride.plan.estimate import Estimate
from midstride.plan.request import PlanRequest
from midstride.plan.specification_diff import differences
from midstride.plan.strategies.registry import planner
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.launches import launch_of

TEXT = """system grouped
topic /a : std_msgs/msg/String @ 10 Hz
topic /b : std_msgs/msg/String @ 10 Hz

component Talker {
  run component "demo::Talker" package "demo" gate preload
  output out as chatter
  functionality talk {
    produces out
    mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }
    mode degraded { }
  }
}

namespace front {
  container pipeline { run "component_container_mt --fast" package "rclcpp_components" }
  node a : Talker in pipeline { out -> /a }
}
node b : Talker in /front/pipeline { out -> /b }
"""
PROGRAM = 'container pipeline { run "component_container_mt --fast" package "rclcpp_components" }'


def read(folder: Path, text: str = TEXT) -> Specification:
    path = folder / "s.stride"
    path.write_text(text, encoding="utf-8")
    return load(path).require()


def errors(folder: Path, *edits: tuple[str, str]) -> list[tuple[str, str, str]]:
    text, path = TEXT, folder / "s.stride"
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return [(each.code, each.message, each.help or "") for each in load(path).diagnostics if each.severity == "error"]


def test_it_is_read_written_and_compared(tmp_path: Path) -> None:
    specification = read(tmp_path)
    program = ContainerProgram("component_container_mt --fast", "rclcpp_components")
    assert dict(specification.containers) == {"front/pipeline": program}
    assert specification.members_of("front/pipeline") == ["b", "front/a"]
    instance = specification.instance("front/a")
    assert (instance.container, instance.process) == (SharedContainer("front/pipeline", program), "front/pipeline")
    assert decode_specification(encode_specification(specification)) == specification
    assert InstanceForm.of(instance).instance() == instance
    assert format_text(TEXT).text == TEXT
    default = read(tmp_path, TEXT.replace(PROGRAM, "container pipeline"))
    assert default.containers["front/pipeline"] == ContainerProgram()
    assert [str(each) for each in differences(specification, default)] == [
        "container front/pipeline: changed\n"
        "  run: component_container_mt --fast of package rclcpp_components -> component_container of package "
        "rclcpp_components",
        "node b: replaced\n  container front/pipeline has another program or environment",
        "node front/a: replaced\n  container front/pipeline has another program or environment",
    ]
    alone = read(tmp_path, TEXT.replace(" in /front/pipeline", ""))
    assert [str(each) for each in differences(specification, alone)] == [
        "node b: replaced\n  container: front/pipeline -> not stated"
    ]


STATED = """container pipeline {
    run "component_container_mt --fast" package "rclcpp_components" prefix "nice -n 5" takes 9 s stop sigterm 7 s
    environment { A = "b"   unset C }
  }"""


def test_its_process_has_a_prefix_an_environment_and_times(tmp_path: Path) -> None:
    plain = read(tmp_path)
    stated = read(tmp_path, TEXT.replace(PROGRAM, STATED).replace('"demo" gate', '"demo" takes 2 s gate'))
    program = stated.containers["front/pipeline"]
    assert program == ContainerProgram(
        "component_container_mt --fast",
        "rclcpp_components",
        "nice -n 5",
        Map({"A": "b", "C": None}),
        9.0,
        StopTimes(sigterm=7.0),
    )
    assert decode_specification(encode_specification(stated)) == stated
    instance = stated.instance("b")
    assert InstanceForm.of(instance).instance() == instance
    started = instance.started
    assert (started.startup_seconds, started.stop) == (11.0, StopTimes(sigterm=7.0))
    assert started.prefix == "nice -n 5"
    launch = launch_of(instance, "ros2", token="", directory=tmp_path, options=SystemOptions())
    assert launch.prefix == ("nice", "-n", "5")
    assert launch.environment == {"A": "b", "C": None}
    assert str(differences(plain, stated)[0]) == (
        "container front/pipeline: changed\n"
        "  prefix: not stated -> nice -n 5\n"
        "  takes: not stated -> 9.0\n"
        "  stop: not stated -> drain 2 s patience 60 s sigterm 7 s sigkill 5 s\n"
        "  variable A: added, 'b'\n"
        "  variable C: added, unset"
    )


def test_other_times_of_a_container_replace_nothing_and_another_environment_all(tmp_path: Path) -> None:
    before = read(tmp_path)
    times = read(tmp_path, TEXT.replace('"rclcpp_components" }', '"rclcpp_components" takes 9 s stop sigterm 7 s }'))
    change = changed(before, PlanRequest(to=times))
    assert (change.coming, change.leaving) == ((), ())
    ended = change.in_target_context(change.final)
    assert {each.started.stop for each in ended.instances.values()} == {StopTimes(sigterm=7.0)}
    other = read(tmp_path, TEXT.replace('"rclcpp_components" }', '"rclcpp_components"  environment { A = "b" } }'))
    assert changed(before, PlanRequest(to=other)).leaving == ("b", "front/a")


@pytest.mark.parametrize(
    ("edits", "code", "message", "help"),
    [
        ([("in pipeline", "in pipline")], "E008", "no container `front/pipline`", "did you mean `front/pipeline`?"),
        ([("in /front/pipeline", "in /pipe")], "E008", "there is no container `pipe`", ""),
        ([("node a", "node pipeline")], "E007", "names both a container and a node", "another name"),
        ([('component "demo::Talker" package "demo"', '"talker"')], "E027", "is no composable node", "omit `in`"),
        ([('package "demo"', 'package "demo" in "box"')], "E027", "states another program", "omit"),
        ([(" gate preload", ' prefix "nice" gate preload')], "E027", "states a prefix", "state it for the container"),
        ([("  output", '  environment { A = "b" }\n  output')], "E027", "states an environment", "for the container"),
        ([('--fast"', '--fast" stop drain 3 s')], "E027", "states `drain`, and only its nodes", "their components"),
        (
            [(PROGRAM, PROGRAM[:-1] + 'environment { MIDSTRIDE_X = "" } }')],
            "E009",
            "set by Midstride itself",
            "remove",
        ),
        ([(PROGRAM, PROGRAM[:-1] + 'environment { A = "1" A = "2" } }')], "E007", "duplicate variable `A`", "own name"),
        ([('rclcpp_components"', 'rclcpp_components" prefix "\'"')], "E009", "not a valid shell command", ""),
        ([("component_container_mt", "./box")], "E009", "names a file", "executable"),
        ([('"rclcpp_components"', '"b x"')], "E009", "not a valid package", ""),
        ([(PROGRAM, PROGRAM + "\n" + PROGRAM)], "E007", "container `front/pipeline` is already declared", ""),
        ([('run "component_container_mt --fast"', "run box")], "E120", "the program of a component container", ""),
        ([("Talker in pipeline", "Talker in")], "E120", "the name of a container", ""),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path, edits: list[tuple[str, str]], code: str, message: str, help: str
) -> None:
    found = errors(tmp_path, *edits)
    assert any(each == code and message in said and help in hint for each, said, hint in found), found


@pytest.mark.parametrize(
    ("request_", "refused"),
    [
        (PlanRequest(restart=("front/pipelin",)), "there is no node or container `front/pipelin`; did you mean"),
        (PlanRequest(remove=("front/pipelin",)), "there is no node or container `front/pipelin`; did you mean"),
        (PlanRequest(restart=("spare",)), "container spare has no node; `in spare` puts one into it"),
    ],
)
def test_a_container_that_is_not_known_or_empty_is_refused(tmp_path: Path, request_: PlanRequest, refused: str) -> None:
    specification = read(tmp_path)
    containers = specification.containers.set("spare", specification.containers["front/pipeline"])
    with pytest.raises(PlanRefused, match=re.escape(refused)):
        request_.for_members(replace(specification, containers=containers))


# -- in which process each new instance is ---------------------------------------------------------------------


def changed(specification: Specification, request: PlanRequest, before: Change | None = None) -> Change:
    start = initial(specification) if before is None else before.final
    request = request.for_members(specification)
    return requested_change(start, specification, request, request.target(specification))


def processes(change: Change) -> dict[str, str]:
    return {name: instance.process for name, instance in change.final.instances.items()}


def test_one_leaves_for_a_process_for_itself_and_all_return_together(tmp_path: Path) -> None:
    specification = read(tmp_path)
    first = changed(specification, PlanRequest(restart=("b",)))
    assert processes(first) == {"b_2": "", "front/a": "front/pipeline"}
    assert any("b is unloaded from front/pipeline" in each for each in planner()(first).remarks)
    second = changed(specification, PlanRequest(restart=("front/pipeline",)), first)
    assert processes(second) == {"b_3": "front/pipeline_2", "front/a_2": "front/pipeline_2"}
    assert any("loaded into a new process, front/pipeline_2" in each for each in planner()(second).remarks)
    third = changed(specification, PlanRequest(restart=("front/pipeline",)), second)
    assert set(processes(third).values()) == {"front/pipeline"}


def test_a_plan_says_how_long_a_destructor_may_hold_up_the_others_of_its_container(tmp_path: Path) -> None:
    first = changed(read(tmp_path), PlanRequest(restart=("b",)))
    held_up = "may hold up front/a for as long as it takes"
    assert any(f"{held_up} (not measured yet for Talker)" in each for each in planner()(first).remarks)
    measured = replace(first, measured=Map({"remove Talker": Estimate(0.6, 0.5, 0.71)}))
    assert any(f"{held_up} (measured: Talker ended within 710 ms)" in each for each in planner()(measured).remarks)


@pytest.mark.parametrize(
    ("program", "gate", "said"),
    [
        ("component_container_mt", "lifecycle preload", True),
        ("component_container_mt --fast", "lifecycle preload", True),
        ("component_container_mt", "preload", False),
        ("component_container_isolated", "lifecycle preload", False),
    ],
)
def test_a_plan_says_which_container_may_crash_as_it_unloads_a_lifecycle_node(
    tmp_path: Path, program: str, gate: str, said: bool
) -> None:
    text = TEXT.replace("component_container_mt --fast", program).replace("gate preload", f"gate {gate}")
    specification = read(tmp_path, text)
    words = "b is a lifecycle node: rclcpp's component_container_mt may crash or hang as it unloads one"
    alone = planner()(changed(specification, PlanRequest(restart=("b",)))).remarks
    assert any(each.startswith(words) for each in alone) is said
    together = planner()(changed(specification, PlanRequest(restart=("front/pipeline",)))).remarks
    assert not any("lifecycle node" in each for each in together), "its process ends"


def creates(change: Change) -> dict[str, float]:
    """How long each new instance takes to start, as the plan has it."""
    plan = planner()(change)
    return {step.action.instances()[0]: step.seconds for step in plan.steps if step.action.kind == "create"}


@pytest.mark.parametrize(("own", "stated"), [("", 1.0), (" takes 2 s", 2.0)])
def test_a_plan_counts_the_start_of_a_new_process_of_a_container(tmp_path: Path, own: str, stated: float) -> None:
    slow = TEXT.replace(PROGRAM, PROGRAM.replace(" }", " takes 7 s }"))
    specification = read(tmp_path, slow.replace('"demo" gate preload', f'"demo"{own} gate preload'))
    alone = changed(specification, PlanRequest(restart=("b",)))
    assert creates(alone) == {"b_2": 7.0 + stated}
    together = changed(specification, PlanRequest(restart=("front/pipeline",)))
    assert creates(together) == {"b_2": 7.0 + stated, "front/a_2": 7.0 + stated}
    inside = changed(specification, PlanRequest(restart=("b",), same_process=True))
    assert creates(inside) == {"b_2": stated}, "its process runs"
    without = changed(specification, PlanRequest(remove=("b",)))
    joins = PlanRequest(add=(specification.nodes["b"],))
    assert creates(requested_change(without.final, without.target, joins, joins.target(without.target))) == {
        "b": stated
    }
    measured = replace(alone, measured=Map({"create Talker": Estimate.exactly(8.5)}))
    assert creates(measured) == {"b_2": 8.5 if not own else 9.0}, "with the start of the container"


WITHIN = (
    TEXT.replace(
        "node b : Talker",
        """component Hears {
  run component "demo::Hears -e use_intra_process_comms:=true" package "demo" gate none
  input in : std_msgs/msg/String @ 10 Hz as chatter
  functionality hear {
    uses in
    mode normal { assume in }
    mode off { }
  }
}
component Open like Talker { run component "demo::Talker -e use_intra_process_comms:=true" package "demo" gate none }
node c : Open in /front/pipeline { out -> /c }
node from_a : Hears in /front/pipeline { in <- /a }
node from_c : Hears in /front/pipeline { in <- /c }
node b : Talker""",
    )
    .replace(
        'run component "demo::Talker" package', 'run component "demo::Talker -e use_intra_process_comms:=true" package'
    )
    .replace("topic /b ", "topic /c : std_msgs/msg/String @ 10 Hz\ntopic /b ")
)


def given_up(change: Change) -> list[str]:
    return [each for each in planner()(change).remarks if "through the middleware" in each]


def test_each_topic_that_leaves_the_process_is_named_before_the_start(tmp_path: Path) -> None:
    specification = read(tmp_path, WITHIN)
    empty = Specification("grouped", connectors=specification.connectors)
    whole = PlanRequest(to=specification)
    at_the_start = requested_change(initial(empty), empty, whole, whole.target(empty))
    assert given_up(at_the_start) == [
        "front/a.out to from_a.in: through the middleware, not within the process, as front/a.out has a gate, and may "
        "be handed over"
    ]
    alone = changed(specification, PlanRequest(restart=("from_c",)))
    assert given_up(alone) == [
        "c.out to from_c_2.in: through the middleware, not within the process, in different processes"
    ]
    assert given_up(changed(specification, PlanRequest(restart=("from_a",)))) == [], "it went there before"
    assert given_up(changed(specification, PlanRequest(restart=("front/pipeline",)))) == []


def test_a_node_that_is_loaded_beside_others_may_hold_them_up(tmp_path: Path) -> None:
    specification = read(tmp_path)
    left = changed(specification, PlanRequest(remove=("b",)))
    again = PlanRequest(add=(specification.nodes["b"],))
    joined = requested_change(left.final, left.target, again, again.target(left.target))
    assert planner()(joined).remarks == (
        "b is loaded into front/pipeline: its constructor runs there, and may hold up front/a for as long as it takes",
    )


def test_a_replacement_may_stay_in_the_process_of_the_old_one(tmp_path: Path) -> None:
    specification = read(tmp_path)
    change = changed(specification, PlanRequest(restart=("b",), same_process=True))
    assert processes(change) == {"b_2": "front/pipeline", "front/a": "front/pipeline"}
    first, second, third = planner()(change).remarks
    assert first.startswith("b_2 starts in front/pipeline, beside b: with the code that is loaded there, and if it")
    assert second == (
        "b_2 is loaded into front/pipeline: its constructor runs there, and may hold up b, front/a for as long as it "
        "takes"
    )
    assert third.startswith("b is unloaded from front/pipeline: its destructor runs there, and may hold up front/a for")
    alone = changed(specification, PlanRequest(restart=("b",)))
    with pytest.raises(PlanRefused, match="b_2 has a process for itself: nothing else can be started in that"):
        changed(specification, PlanRequest(restart=("b",), same_process=True), alone)
    with pytest.raises(PlanRefused, match="no node of a container is replaced"):
        changed(specification, PlanRequest(remove=("b",), same_process=True))
    beside = TEXT.replace("node b", "topic /c : std_msgs/msg/String @ 10 Hz\nnode c : Talker { out -> /c }\nnode b")
    both = changed(read(tmp_path, beside), PlanRequest(restart=("b", "c"), same_process=True))
    assert processes(both) == {"b_2": "front/pipeline", "c_2": "", "front/a": "front/pipeline"}
    with pytest.raises(PlanRefused, match="no node of a container is replaced"):
        changed(read(tmp_path, beside), PlanRequest(restart=("c",), same_process=True))
    other = TEXT.replace("node b : Talker", OTHER + "node b : Other")
    with pytest.raises(PlanRefused, match="b_2 cannot start in front/pipeline, the process of b: its class or its"):
        changed(specification, PlanRequest(to=read(tmp_path, other), same_process=True))


def test_what_the_simulator_runs_in_the_place_of_a_composable_node_has_the_other_checks(tmp_path: Path) -> None:
    stand_in = ('component "demo::Talker" package "demo"', '"python3 -m midstride.simulation.stand_in Talker"')
    assert errors(tmp_path, stand_in) == []
    ((code, message, _),) = errors(tmp_path, stand_in, ("{ out -> /b }", "{ out -> /a, /b }"))
    assert (code, message.partition(";")[0]) == ("E027", "b.out is attached to 2 topics")


def test_what_does_not_fit_twice_moves_one_node_after_another(tmp_path: Path) -> None:
    holding = TEXT.replace("  output out", "  holds memory 50\n  output out")
    for capacity, degraded in ((150, ()), (149, ("b.talk",))):
        specification = read(tmp_path, f"{holding}resource memory = {capacity}\n")
        plan = planner()(changed(specification, PlanRequest(restart=("front/pipeline",))))
        assert max(each.held["memory"] for each in plan.configurations()) <= capacity
        assert tuple(map(str, plan.degraded)) == degraded


OTHER = 'component Other like Talker { run component "demo::Other" package "demo" gate preload }\n'


def test_what_is_added_joins_the_process_that_runs(tmp_path: Path) -> None:
    specification = read(tmp_path)
    moved = changed(specification, PlanRequest(restart=("front/pipeline",)))
    without = changed(specification, PlanRequest(remove=("b",)), moved)
    target = without.target
    node = specification.nodes["b"]
    again = requested_change(without.final, target, request := PlanRequest(add=(node,)), request.target(target))
    assert processes(again)["b"] == "front/pipeline_2"

"""The meaning of the language: the sample of its definition, and each construct as a value of the model."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.lang import Loaded, load, load_text, render
from midstride.lang.printer import format_text
from midstride.model.component import InputAlternatives, NodeEndpoint, ParameterSpec, StopTimes
from midstride.model.contract import Interval, OneOf, Predicate, QoS
from midstride.model.specification import Keep, Limit, Order, Specification, initial
from midstride.model.specification_checks import check
from midstride.plan.change_builder import change_between
from midstride.plan.specification_diff import differences

from .known import Known

SEEDS = Path(__file__).parent / "seeds"


def meant(text: str, files: dict[str, str] | None = None) -> Specification:
    loaded = loading(text, files)
    assert loaded.specification is not None, render(loaded.diagnostics)
    return loaded.specification


def loading(text: str, files: dict[str, str] | None = None) -> Loaded:
    def read(path: Path) -> str:
        if files is None or str(path) not in files:
            raise FileNotFoundError(2, "No such file or directory")
        return files[str(path)]

    return load_text(text, "t.stride", read=read, messages=Known())


def test_the_sample_is_resolved() -> None:
    loaded = load(SEEDS / "patrol.stride")
    assert loaded.diagnostics == ()
    patrol = loaded.specification
    assert patrol is not None
    assert [source.path for source in loaded.files] == [SEEDS / "patrol.stride", SEEDS / "sensors.stride"]
    assert patrol.name == "patrol"
    scan = Predicate("sensor_msgs/msg/LaserScan", 10, QoS(reliability="best_effort", depth=5))
    camera = Predicate(
        "sensor_msgs/msg/Image", 15, fields=(("width", Interval(640)), ("encoding", OneOf.of(["rgb8", "bgr8"])))
    )
    assert patrol.connectors["/scan"].guarantee == scan
    assert patrol.connectors["/cmd_vel"].max_publishers == 1
    assert {name: resource.capacity for name, resource in patrol.resources.items()} == {
        "gpu_memory": 8192,
        "/dev/video0": 1,
    }
    assert [(offer.name, offer.topic) for offer in patrol.environment] == [
        ("camera_device", None),
        ("localization", "/odom"),
    ]
    detector = patrol.components["ObstacleDetector"]
    assert detector.run == "python3 -m patrol.detector"
    assert detector.resource_usage == Map({"/dev/video0": 1.0, "gpu_memory": 2048.0})
    assert detector.parameters == Map({"threshold": ParameterSpec(0.4, True), "model": ParameterSpec("small.onnx")})
    detect = detector.functionalities["detect"]
    assert detect.weight == 3
    assert [mode.name for mode in detect.modes] == ["normal", "lidar_only", "degraded"]
    assert detect.modes[0].assumptions == (InputAlternatives(("scan",)), camera)
    assert detect.modes[0].guarantees == Map({"out": Predicate("sensor_msgs/msg/Range", 10)})
    stereo = patrol.components["StereoDetector"]
    assert stereo.run == "python3 -m patrol.stereo"
    assert (stereo.inputs, stereo.functionalities, stereo.resource_usage) == (
        detector.inputs,
        detector.functionalities,
        detector.resource_usage,
    )
    assert patrol.components["MotorController"].allows == (NodeEndpoint("service", "~/reset"),)
    assert patrol.nodes["controller"].attachments == Map({"obstacles": ("/obstacles",), "cmd": ("/cmd_vel",)})
    assert [str(constraint) for constraint in patrol.constraints] == [
        "keep controller.control at normal",
        "limit detector.detect below baseline 2 s",
        "order detector before controller",
    ]
    assert patrol.timing["attach"] == 0.05
    assert set(initial(patrol).modes.values()) == {0}


def test_the_sample_in_json_is_the_same_system() -> None:
    patrol = load(SEEDS / "patrol.stride").require()
    again = decode_specification(encode_specification(patrol))
    assert again == patrol


BODY = """
component Talker {
  run "python3 -m talker" takes 1500 ms
  output out
  functionality talk { produces out   mode normal { guarantee out : std_msgs/String @ 10 Hz }   mode silent { } }
}
component Listener {
  input in : std_msgs/msg/String @ 5 Hz
  functionality listen { uses in   mode normal { assume in }   mode deaf { } }
}
"""


def test_how_a_program_starts_and_ends_is_stated() -> None:
    words = "takes 40 s activate 8 s stop drain 3 s patience 20 s sigterm 10 s sigkill 500 ms gate lifecycle preload"
    text = "system s\n" + BODY.replace("takes 1500 ms", words).replace("output out", "output out as chat lazy")
    talker = meant(text).components["Talker"]
    assert (talker.startup_seconds, talker.activate_seconds, talker.gate) == (40.0, 8.0, "lifecycle preload")
    assert (talker.stop, talker.topics) == (StopTimes(10.0, 0.5, 3.0, 20.0), Map(out="chat"))
    assert talker.lazy == {"out"}
    # What is not stated is as in ROS launch; an output is one part, which `like` replaces whole.
    child = 'component Child like Talker { run "child" stop sigkill 1 s gate preload   output out }\n'
    found = meant(text + child).components["Child"]
    assert (found.stop, found.activate_seconds, found.lazy) == (StopTimes(5.0, 1.0), None, frozenset())
    assert meant(text + "component Same like Talker").components["Same"].lazy == {"out"}


def test_namespaces_resolve_as_in_ros() -> None:
    found = meant(
        "system s\n"
        + BODY
        + """
        topic /shared : std_msgs/msg/String
        namespace robot1 {
          topic chatter : std_msgs/msg/String @ 5 Hz
          namespace arm/left { topic talker/own : std_msgs/msg/String  node talker : Talker { out -> ~/own } }
          node talker : Talker { out -> chatter, /shared }
          node listener : Listener { in <- chatter }
          keep listener.listen at normal
          limit /robot1/arm/left/talker.talk below baseline 2 s
          order talker before arm/left/talker
        }
        """
    )
    assert set(found.connectors) == {"/shared", "/robot1/chatter", "/robot1/arm/left/talker/own"}
    assert found.nodes["robot1/talker"].attachments["out"] == ("/robot1/chatter", "/shared")
    assert found.nodes["robot1/arm/left/talker"].attachments["out"] == ("/robot1/arm/left/talker/own",)
    assert found.nodes["robot1/talker"].role == "robot1/talker"
    assert [str(constraint) for constraint in found.constraints] == [
        "keep robot1/listener.listen at normal",
        "limit robot1/arm/left/talker.talk below baseline 2 s",
        "order robot1/talker before robot1/arm/left/talker",
    ]
    assert isinstance(found.constraints[0], Keep)
    assert isinstance(found.constraints[1], Limit)
    assert isinstance(found.constraints[2], Order)


def test_a_fragment_included_in_two_namespaces_is_instantiated_twice() -> None:
    robot = BODY + "topic chatter : std_msgs/msg/String @ 5 Hz\nnode talker : Talker { out -> chatter }\n"
    text = 'system s\nnamespace a { include "robot.stride" }\nnamespace b { include "robot.stride" }\n'
    found = meant(text, {"robot.stride": robot})
    assert set(found.nodes) == {"a/talker", "b/talker"}
    assert set(found.connectors) == {"/a/chatter", "/b/chatter"}
    assert set(found.components) == {"Talker", "Listener"}


def test_includes_are_relative_to_the_file_and_read_once() -> None:
    files = {
        "parts/a.stride": 'include "b.stride"\ninclude "../parts/b.stride"\n',
        "parts/b.stride": "contract Text = std_msgs/msg/String\n",
    }
    found = meant('system s\ninclude "parts/a.stride"\ninclude "parts/b.stride"\ntopic /t : Text\n', files)
    assert found.connectors["/t"].guarantee == Predicate("std_msgs/msg/String")


def test_like_inherits_and_overrides_part_by_part() -> None:
    found = meant(
        """system s
        resource memory = 10
        component Base {
          run "base" takes 3 s
          holds memory 4
          parameters { a = 1, changeable b = "x" }
          allows service ~/reset
          input in : std_msgs/msg/String
          output out
          functionality f { uses in  produces out  mode on { guarantee out : std_msgs/msg/String }  mode off { } }
          functionality g { mode on { }  mode off { } }
        }
        component Child like Base {
          run "child"
          holds nothing
          parameters { a = 2, c = true }
          input more : std_msgs/msg/String
          allows topic /tf
          functionality g weight 2 { uses more  mode on { assume more }  mode half { }  mode off { } }
        }
        component Same like Base
        component Grandchild like Child { run "grandchild" }
        """
    )
    base, child = found.components["Base"], found.components["Child"]
    assert (child.run, child.startup_seconds, child.resource_usage) == ("child", None, Map())
    assert child.parameters == Map({"a": ParameterSpec(2), "b": ParameterSpec("x", True), "c": ParameterSpec(True)})
    assert child.input_order == ("in", "more")
    assert child.functionality_order == ("f", "g")
    assert child.functionalities["f"] == base.functionalities["f"]
    assert [mode.name for mode in child.functionalities["g"].modes] == ["on", "half", "off"]
    assert child.allows == (NodeEndpoint("service", "~/reset"), NodeEndpoint("topic", "/tf"))
    assert found.components["Same"].same_body(base)
    assert found.components["Grandchild"].functionalities == child.functionalities


def test_contracts_refine_contracts() -> None:
    found = meant(
        """system s
        contract Any = sensor_msgs/Image where width >= 100, width < 1000, encoding in {rgb8, "bgr8"}
        contract Fast = Any @ 0.1 kHz qos(reliability = best_effort, deadline = 100 ms) where width in [50, 640]
        contract Slow = Fast @ 5 Hz qos(reliability = reliable, liveliness_lease_duration = 1 s)
        topic /fast : Fast
        topic /slow : Slow where header.frame_id = "base_link", is_bigendian = 0
        """
    )
    fast, slow = found.connectors["/fast"].guarantee, found.connectors["/slow"].guarantee
    assert (fast.type, fast.rate) == ("sensor_msgs/msg/Image", 100)
    assert fast.constraint("width") == Interval(100, 640)
    assert fast.qos == QoS(reliability="best_effort", deadline=0.1)
    assert slow.qos == QoS(reliability="reliable", deadline=0.1, lease=1.0)
    assert slow.rate == 5
    assert slow.constraint("header.frame_id") == OneOf.of(["base_link"])
    assert slow.constraint("encoding") == OneOf.of(["rgb8", "bgr8"])


def test_assumptions_by_name_alternatives_and_predicates() -> None:
    found = meant(
        """system s
        contract Near = sensor_msgs/msg/Range @ 5 Hz
        component C {
          input left : Near, input right : Near
          functionality f {
            uses left, right
            mode a { assume left  assume left or right  assume Near  assume Near @ 2 Hz  assume sensor_msgs/Range }
            mode b { }
          }
        }
        """
    )
    near = Predicate("sensor_msgs/msg/Range", 5)
    assert found.components["C"].functionalities["f"].modes[0].assumptions == (
        InputAlternatives(("left",)),
        InputAlternatives(("left", "right")),
        near,
        Predicate("sensor_msgs/msg/Range", 2),
        Predicate("sensor_msgs/msg/Range"),
    )


def test_keywords_can_be_fields_and_parameters() -> None:
    found = meant(
        """system s
        component C { parameters { mode = "fast", node.input = 1, changeable = false, at = [1, 2.5] }
          input in : std_msgs/String
          functionality or { uses in   mode where { assume in }   mode qos { } } }
        """
    )
    assert {name: p.value for name, p in found.components["C"].parameters.items()} == {
        "mode": "fast",
        "node.input": 1,
        "changeable": False,
        "at": [1.0, 2.5],
    }
    assert found.components["C"].functionalities["or"].modes[0].assumptions == (InputAlternatives(("in",)),)


@pytest.mark.parametrize("end", ["\r\n", "\r", "\n"])
def test_line_ends_and_byte_order_mark_change_nothing(end: str) -> None:
    text = "system s\n# a comment\n" + BODY
    assert meant("\ufeff" + text.replace("\n", end)) == meant(text)


NAV2 = """
/**:
  ros__parameters: {use_sim_time: true}
talker:
  ros__parameters:
    volume: 3
    names: [a, 'b']
    plugin: {name: "x", gains: [1.0, 2.5]}
robot1:
  talker:
    ros__parameters: {volume: 4}
"""


def test_use_sim_time_may_be_set_for_any_node() -> None:
    """Every node of ROS 2 has it, so no component declares it; a replacement keeps it."""
    text = "system s\n" + BODY + "topic /t : std_msgs/msg/String\ncomponent Other like Talker\n"
    text += "node talker : Talker { out -> /t   parameters { use_sim_time = true } }\n"
    found = meant(text)
    assert found.instance("talker").parameters == Map(use_sim_time=True)
    assert found.with_replaced("talker", "Other").instance("talker").parameters == Map(use_sim_time=True)
    assert decode_specification(encode_specification(found)) == found
    wrong = found.with_node(replace(found.nodes["talker"], parameters=Map(use_sim_time="yes")))
    assert [problem.code for problem in check(wrong)] == ["E025"]


def test_parameter_files_are_matched_by_role() -> None:
    text = (
        "system s\n"
        + BODY.replace("  output out\n", "  parameters { volume = 1, use_sim_time = false }\n  output out\n")
        + """topic /t : std_msgs/msg/String
        parameters "nav2.yaml"
        node talker : Talker { out -> /t   parameters { volume = 5 } }
        component Singer like Talker
        namespace robot1 { node talker : Singer { out -> /t } }
        """
    )
    found = meant(text, {"nav2.yaml": NAV2})
    assert found.instance("talker").parameters == Map(
        {"volume": 5, "use_sim_time": True, "names": ["a", "b"], "plugin.name": "x", "plugin.gains": [1.0, 2.5]}
    )
    assert found.instance("robot1/talker").parameters["volume"] == 4
    # Parameters that only the file sets are added to the component, and to those that are like it.
    assert found.components["Singer"].parameters["plugin.name"] == ParameterSpec("x")
    assert decode_specification(encode_specification(found)) == found


@pytest.mark.parametrize(
    ("text", "message", "help", "position"),
    [
        (
            "n: {ros__parameters: 5}\n",
            "section `n` has no parameters",
            "write `n: ros__parameters: name: value`",
            (1, 22),
        ),
        ('n: {ros__parameters: {"": 5}}\n', "a name is empty, in section `n`", None, (1, 23)),
        (
            "n:\n  x: 2\n",
            "`x` of section `n` is not under `ros__parameters`",
            "write `n: ros__parameters: x: …`",
            (2, 6),
        ),
        ("n:\n", "section `n` has no `ros__parameters`", "write the parameters under `n: ros__parameters:`", (1, 3)),
    ],
)
def test_an_invalid_parameter_file_is_reported_once_at_its_place(
    text: str, message: str, help: str | None, position: tuple[int, int]
) -> None:
    loaded = load_text('system s\ncomponent C { }\nnode n : C { parameters "p.yaml" }\n', read=lambda path: text)
    (found,) = loaded.diagnostics
    assert found.span is not None and found.span.source.name == "p.yaml"
    assert (found.code, found.message, found.help) == ("E150", message, help)
    assert found.position == position


def test_an_empty_parameter_file_has_no_section_to_name() -> None:
    head = 'system s\ncomponent C { }\nnode n : C { parameters "p.yaml" }\n'
    (found,) = load_text(head, read=lambda path: "").diagnostics
    assert (found.code, found.help) == ("W160", "write `n: ros__parameters: …`")


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("y", True),
        ("N", False),
        ("yes", True),
        ("OFF", False),
        ("'y'", "y"),
        ("yEs", "yEs"),
        ("010", 8),
        ("-017", -15),
        ("0X1f", 31),
        ("0", 0),
        ("+7", 7),
        ("08", 8.0),
        ("1e3", 1000.0),
        ("0o10", "0o10"),
    ],
)
def test_the_values_of_a_parameter_file_are_those_that_ros_reads(written: str, value: object) -> None:
    """As rcl's parser does: its words for booleans, then strtol with the base of the prefix, then strtod."""
    text = f"n: {{ros__parameters: {{p: {written}}}}}\n"
    head = "system s\ncomponent C { functionality f { mode a { } mode b { } } }\n"
    found = load_text(head + 'node n : C { parameters "p.yaml" }\n', read=lambda path: text).require()
    read = found.nodes["n"].parameters["p"]
    assert (read, type(read)) == (value, type(value))


@pytest.mark.parametrize(
    ("written", "value"), [("inf", math.inf), ("-Infinity", -math.inf), ("NaN", math.nan), (".inf", math.inf)]
)
def test_a_number_that_is_not_finite_is_a_value_in_parameter_files_and_in_json(written: str, value: float) -> None:
    text = f"n: {{ros__parameters: {{p: {written}, q: [1.0, {written}]}}}}\n"
    head = "system s\ncomponent C { functionality f { mode a { } mode b { } } }\n"
    found = load_text(head + 'node n : C { parameters "p.yaml" }\n', read=lambda path: text).require()
    assert found.nodes["n"].parameters == Map(p=value, q=[1.0, value])
    document = encode_specification(found)
    assert document["nodes"]["n"]["parameters"]["p"] == {"float": str(value)}
    assert decode_specification(json.loads(json.dumps(document))) == found
    assert differences(found, decode_specification(document)) == []


def test_a_number_that_is_not_finite_is_a_value_in_the_language() -> None:
    text = (
        "system s\ncomponent C {\n"
        '  parameters { most = inf, least = -inf, none = nan, all = [-inf, 1.5, nan], word = "nan" }\n'
        "  functionality f { mode a { } mode b { } }\n}\nnode n : C\n"
    )
    found = load_text(text).require()
    values = {name: each.value for name, each in found.components["C"].parameters.items()}
    wanted = {"most": math.inf, "least": -math.inf, "none": math.nan, "all": [-math.inf, 1.5, math.nan], "word": "nan"}
    assert values == wanted
    formatted = format_text(text).text
    assert formatted is not None and load_text(formatted).require() == found
    # NaN is equal to itself: else each `apply` would find a change.
    again = load_text(text).require()
    assert (
        again == found and differences(found, again) == [] and not change_between(initial(found), found, again).coming
    )


@pytest.mark.parametrize("character", ["\x1b", "\x00", "\ud800", "\uffff"])
def test_a_character_that_no_yaml_contains_is_an_error_at_its_place(character: str) -> None:
    text = f"n:\n  # größer {character}\n  ros__parameters: {{p: 1}}\n"
    loaded = load_text('system s\ncomponent C { }\nnode n : C { parameters "p.yaml" }\n', read=lambda path: text)
    (found,) = [d for d in loaded.diagnostics if d.code == "E150"]
    assert found.position == (2, 12) and ascii(character) in found.message


def test_tags_change_nothing_but_that_a_value_is_a_string() -> None:
    text = "!!map\nn: !!map {ros__parameters: {p: !!seq [!!str 1, !!str 'b'], !!str q: 1, r: !!str true}}\n"
    head = "system s\ncomponent C { functionality f { mode a { } mode b { } } }\n"
    values = load_text(head + 'node n : C { parameters "p.yaml" }\n', read=lambda path: text).require()
    assert dict(values.nodes["n"].parameters) == {"p": ["1", "b"], "q": 1, "r": "true"}


def test_parameters_can_have_any_name_that_ros_allows() -> None:
    """The diagnostics of Autoware have such names."""
    text = (
        "system s\n"
        + BODY
        + 'topic /t : std_msgs/msg/String\nparameters "p.yaml"\nnode talker : Talker { out -> /t }\n'
    )
    found = meant(text, {"p.yaml": 'talker: {ros__parameters: {required: {"localization: ekf": 1, "1st": 2}}}\n'})
    assert found.instance("talker").parameters == Map({"required.localization: ekf": 1, "required.1st": 2})
    assert decode_specification(encode_specification(found)) == found


def test_parameters_set_for_some_nodes_are_reported_once() -> None:
    text = "system s\n" + BODY + 'topic /t : std_msgs/msg/String\nparameters "p.yaml"\n'
    text += "".join(f"node {name} : Talker {{ out -> /t }}\n" for name in "abc")
    found = loading(text, {"p.yaml": "a: {ros__parameters: {x: 1, y: 2, z: 3}}\nb: {ros__parameters: {y: 1}}\n"})
    assert [diagnostic.message for diagnostic in found.diagnostics] == [
        "parameter `x` (and 1 more) is set for a but not for b, and Talker declares no value for them",
        "parameter `y` is set for a but not for c, and Talker declares no value for it",
    ]


def test_files_named_json_are_read_as_json(tmp_path: Path) -> None:
    import json

    document = encode_specification(load(SEEDS / "patrol.stride").require())
    path = tmp_path / "patrol.json"
    path.write_text(json.dumps(document, indent=2))
    assert load(path).require() == load(SEEDS / "patrol.stride").require()
    document["topics"]["/scan"]["rate"] = "fast"
    path.write_text(json.dumps(document, indent=2))
    (fault,) = load(path).diagnostics
    line = path.read_text().splitlines()[fault.position[0] - 1]
    assert (fault.code, line.strip()) == ("E001", '"rate": "fast",')

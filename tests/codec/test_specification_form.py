"""The JSON form: what it looks like, that it comes back, and that every fault is told at once, with its path."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from midstride.codec.component_form import decode_component, encode_component
from midstride.codec.reading import parse_json
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import SpecificationError
from midstride.model.component import Connector, InputAlternatives, StopTimes
from midstride.model.contract import Interval, OneOf, Predicate
from midstride.model.diagnostics import Problem
from midstride.model.specification import Order

DOCUMENT: dict[str, Any] = {
    "system": "patrol",
    "topics": {
        "/obstacles": {"type": "sensor_msgs/msg/Range", "rate": 5},
        "/scan": {"type": "sensor_msgs/msg/LaserScan", "rate": 10, "qos": {"reliability": "best_effort", "depth": 5}},
        "/stop": {"type": "std_msgs/msg/Bool", "max_publishers": 1},
    },
    "resources": {"/dev/video0": {"capacity": 1}, "gpu_memory": {"capacity": 8192}},
    "environment": {
        "camera_device": {"guarantee": {"type": "sensor_msgs/msg/Image", "rate": 30, "where": {"width": {"=": 1280}}}},
        "recording": {"guarantee": {"type": "sensor_msgs/msg/LaserScan", "rate": 10}, "topic": "/scan"},
    },
    "components": {
        "Detector": {
            "run": "python3 -m patrol.detector --name 'the detector'",
            "takes_seconds": 2.5,
            "stop_seconds": {"sigterm": 10, "sigkill": 0.5, "drain": 3, "patience": 20},
            "holds": {"/dev/video0": 1, "gpu_memory": 2048},
            "parameters": {
                "model": {"value": "small.onnx"},
                "threshold": {"value": 0.5, "changeable": True},
                "zones": {"value": [1, 2]},
            },
            "allows": [{"kind": "service", "name": "~/reset"}],
            "inputs": {
                "scan": {"type": "sensor_msgs/msg/LaserScan", "qos": {"reliability": "best_effort"}},
                "other": {"type": "sensor_msgs/msg/LaserScan", "rate": 1},
            },
            "outputs": ["out", "alarm"],
            "functionalities": {
                "watch": {
                    "produces": ["alarm"],
                    "modes": {"normal": {"guarantees": {"alarm": {"type": "std_msgs/msg/Bool"}}}, "degraded": {}},
                },
                "detect": {
                    "weight": 3,
                    "uses": ["scan", "other"],
                    "produces": ["out"],
                    "modes": {
                        "normal": {
                            "assumes": [
                                "scan",
                                {"any_of": ["other", "scan"]},
                                {
                                    "type": "sensor_msgs/msg/Image",
                                    "where": {
                                        "encoding": {"in": ["bgr8", "rgb8"]},
                                        "header.frame_id": {"=": "base link"},
                                        "height": {">": 0, "<=": 1080},
                                        "width": {">=": 640},
                                    },
                                },
                            ],
                            "guarantees": {"out": {"type": "sensor_msgs/msg/Range", "rate": 10}},
                        },
                        "blind": {"guarantees": {"out": {"type": "sensor_msgs/msg/Range", "rate": 5}}},
                        "degraded": {},
                    },
                },
            },
        }
    },
    "nodes": {
        "detector": {
            "component": "Detector",
            "attachments": {"out": ["/obstacles"], "alarm": ["/stop"], "scan": ["/scan"]},
            "parameters": {"threshold": 0.25},
        },
        "robot1/detector": {"component": "Detector"},
    },
    "constraints": [
        {"keep": "detector.detect", "at": "blind"},
        {"limit": "robot1/detector.detect", "below_baseline_seconds": 2},
        {"order": "detector", "before": "robot1/detector"},
    ],
    "timing_seconds": {"attach": 0.05, "create": 0.5},
}


def test_an_assumption_without_an_input_may_have_a_bound() -> None:
    document = copy.deepcopy(DOCUMENT)
    assumed = {"type": "nav_msgs/srv/GetMap", "within_seconds": 0.1}
    modes = document["components"]["Detector"]["functionalities"]["detect"]["modes"]
    modes["normal"]["assumes"].append(assumed)
    assumption = (
        decode_specification(document).components["Detector"].functionalities["detect"].modes[0].assumptions[-1]
    )
    assert isinstance(assumption, Predicate) and assumption.within == 0.1


def test_the_form_says_what_it_shows() -> None:
    specification = decode_specification(DOCUMENT)
    detector = specification.components["Detector"]
    assert detector.input_order == ("scan", "other")
    assert detector.functionality_order == ("watch", "detect")
    detect = detector.functionalities["detect"]
    assert [mode.name for mode in detect.modes] == ["normal", "blind", "degraded"]
    assert detect.modes[0].assumptions[:2] == (InputAlternatives(("scan",)), InputAlternatives(("other", "scan")))
    image = detect.modes[0].assumptions[2]
    assert not isinstance(image, InputAlternatives)
    assert image.constraint("height") == Interval(0, 1080, low_open=True)
    assert image.constraint("encoding") == OneOf.of(["rgb8", "bgr8"])
    assert specification.connectors["/stop"].max_publishers == 1
    assert specification.environment[1].topic == "/scan"
    assert specification.constraints[2] == Order("detector", "robot1/detector")
    assert dict(specification.instance("detector").parameters) == {
        "model": "small.onnx",
        "threshold": 0.25,
        "zones": [1, 2],
    }
    assert specification.nodes["robot1/detector"].role == "robot1/detector"
    assert detector.startup_seconds == 2.5
    assert detector.stop == StopTimes(10.0, 0.5, 3.0, 20.0)
    assert dict(specification.timing) == {"attach": 0.05, "create": 0.5}


def test_a_specification_comes_back_word_for_word() -> None:
    document = encode_specification(decode_specification(DOCUMENT))
    assert document == DOCUMENT
    assert json.dumps(document["components"]["Detector"]) == json.dumps(DOCUMENT["components"]["Detector"])


def test_a_component_by_itself_names_itself() -> None:
    detector = decode_specification(DOCUMENT).components["Detector"]
    document = encode_component(detector)
    assert document["name"] == "Detector"
    assert decode_component(json.loads(json.dumps(document))) == detector


def test_what_is_not_canonical_means_the_same() -> None:
    specification = decode_specification(
        {
            "system": "s",
            "topics": {"/t": {"type": "std_msgs/String", "rate": 10.0, "where": {"x": {">=": 1, "<=": 1}}}},
            "components": {},
            "nodes": {},
        }
    )
    assert encode_specification(specification) == {
        "system": "s",
        "topics": {"/t": {"type": "std_msgs/msg/String", "rate": 10, "where": {"x": {"=": 1}}}},
    }


def test_two_contracts_on_one_topic_while_it_changes() -> None:
    """A connector's name may differ from its topic; the form says both."""
    specification = decode_specification({"system": "s", "topics": {"/t#2": {"type": "a/B", "topic": "/t"}}})
    assert specification.connectors["/t#2"] == Connector("/t#2", specification.connectors["/t#2"].guarantee, topic="/t")
    assert encode_specification(specification)["topics"] == {"/t#2": {"type": "a/msg/B", "topic": "/t"}}


# -- faults ----------------------------------------------------------------------------------------------------


def problems_of(document: object) -> list[Problem]:
    with pytest.raises(SpecificationError) as error:
        decode_specification(document)
    return [problem for problem in error.value.problems if isinstance(problem, Problem)]


ABSENT = object()
D = "/components/Detector"
F = f"{D}/functionalities/detect"
M = f"{F}/modes/normal"

# Where what is put (ABSENT: it is taken out), the code of the one problem that makes, and a part of what is said.
FAULTS: list[tuple[str, object, str, str]] = [
    ("/system", 7, "E001", "the name of the system is expected, this is a number (7)"),
    ("/system", "two words", "E006", "`two_words`"),
    ("/sistem", "x", "E002", "did you mean `system`?"),
    ("/nodes", [], "E001", "an object of nodes is expected, this is a list"),
    ("/topics/~1scan/type", "LaserScan", "E006", "write it as `std_msgs/msg/String`"),
    ("/topics/~1scan/rat", 1, "E002", "did you mean `rate`?"),
    ("/topics/~1scan/rate", "10", "E001", 'a rate in Hz is expected, this is a text ("10")'),
    ("/topics/~1scan/rate", True, "E001", "this is a boolean (true)"),
    ("/topics/~1scan/rate", None, "E001", "this is null"),
    ("/topics/~1scan/rate", -1, "E004", "must be more than 0, it is -1"),
    ("/topics/~1scan/rate", 0, "E004", "must be more than 0"),
    ("/topics/~1scan/rate", float("nan"), "E004", "nan is none"),
    ("/topics/~1scan/rate", float("inf"), "E004", "inf is none"),
    ("/topics/~1scan/rate", 10**400, "E004", "an integer of that size"),
    ("/topics/~1scan/qos", "sensor", "E001", "a QoS profile is expected"),
    ("/topics/~1scan/qos/depth", 2.5, "E001", "a whole number"),
    ("/topics/~1scan/qos/reliability", "best", "E005", "`best_effort`?"),
    ("/topics/~1scan/qos/deadline", 1, "E002", "`deadline_seconds`?"),
    ("/topics/~1scan/where", {"width": 3}, "E001", "a field constraint is expected"),
    ("/topics/~1scan/where/width", {"=>": 3}, "E002", "no key `=>`"),
    ("/topics/~1scan/where/width", {"=": None}, "E001", "this is null"),
    ("/topics/~1scan/where/a b", {"=": 1}, "E006", "`header.frame_id`"),
    ("/topics/~1stop/max_publishers", -1, "E004", "at least 0"),
    ("/topics/image raw", {"type": "a/B"}, "E006", "starts with `/`"),
    ("/resources/gpu_memory/capacity", 0, "E004", "more than 0"),
    ("/environment/recording/topic", "/scam", "E008", "did you mean `/scan`?"),
    (f"{D}/run", "run 'it", "E009", "no closing quotation"),
    (f"{D}/run", "  ", "E009", "the command is empty"),
    (f"{D}/holds/gpu_memory", -5, "E004", "more than 0"),
    (f"{D}/holds/gpu", 5, "E008", "did you mean `gpu_memory`?"),
    (f"{D}/outputs/1", 3, "E001", "a text is expected"),
    (f"{D}/inputs/9", {"type": "a/B"}, "E006", "is not a valid port name"),
    (f"{D}/allows/0/kind", "servise", "E005", "`service`?"),
    (f"{D}/parameters/zones/value", [1, 2.5], "E001", "integers and reals"),
    (f"{D}/parameters/model/changable", True, "E002", "`changeable`?"),
    (f"{F}/weight", -1, "E004", "at least 0"),
    (f"{F}/uses/0", "scam", "E008", "did you mean `scan`?"),
    (f"{F}/produces/0", "oot", "E008", "did you mean `out`?"),
    (f"{F}/modes/half way", {}, "E006", "`half_way`"),
    (f"{M}/assumes/0", "scam", "E008", "did you mean `scan`?"),
    (f"{M}/assumes/0", 1, "E001", "an assumption"),
    (f"{M}/assumes/1/any_of", [], "E001", "empty"),
    (f"{M}/guarantees/out/rate", "x", "E001", "a rate"),
    (f"{M}/guarantees/alarm", {"type": "a/B"}, "E008", "add alarm to what detect `produces`"),
    ("/nodes/detector/component", "Detecter", "E008", "did you mean `Detector`?"),
    ("/nodes/detector/attachments/oot", ["/scan"], "E008", "did you mean `out`?"),
    ("/nodes/detector/attachments/out/0", "/obstacle", "E008", "`/obstacles`?"),
    ("/nodes/detector/attachments/out", "/obstacles", "E001", "write [ … ]"),
    ("/nodes/detector/parameters/treshold", 1.0, "E008", "`threshold`?"),
    ("/nodes/my node", {"component": "Detector"}, "E006", "is not a valid node name"),
    ("/constraints/0/at", "blond", "E008", "did you mean `blind`?"),
    ("/constraints/0/keep", "detector.detekt", "E008", "did you mean `detect`?"),
    ("/constraints/0/keep", "detector", "E008", "write it as `node.functionality`"),
    ("/constraints/1/below_baseline_seconds", -2, "E004", "at least 0"),
    ("/constraints/1/limit", "detektor.detect", "E008", "did you mean `detector`?"),
    ("/constraints/2", {"ordre": "a"}, "E001", "did you mean `order`?"),
    ("/timing_seconds/crate", 1, "E002", "did you mean `create`?"),
    ("/timing_seconds/create", -1, "E004", "at least 0"),
    ("/system", "", "E006", "the name of the system cannot be empty"),
    (f"{F}/modes/", {}, "E006", "is not a valid mode name"),
    ("/nodes/detector/respawn", {"delay": 1}, "E002", "did you mean `delay_seconds`?"),
    ("/nodes/detector/respawn", {"fallback": "Detecter"}, "E008", "did you mean `Detector`?"),
    ("/nodes/detector/respawn", {"max_retries": 1.5}, "E001", "a number of restarts"),
    ("/nodes/detector/respawn", {"window_seconds": 0}, "E004", "more than 0"),
    ("/nodes/~1extra", {"component": "Detector"}, "E006", "`/extra` is not a valid node name"),
]
# The same, where the problem is told elsewhere.
ELSEWHERE: list[tuple[str, object, str, str, str]] = [
    ("/system", ABSENT, "E003", "/", "needs the key `system`"),
    ("/topics/~1scan/type", ABSENT, "E003", "/topics/~1scan", "needs the key `type`"),
    ("/environment/recording/guarantee", ABSENT, "E003", "/environment/recording", "needs the key `guarantee`"),
    ("/constraints/2/before", ABSENT, "E003", "/constraints/2", "needs the key `before`"),
    (f"{F}/modes", ABSENT, "E003", F, "needs the key `modes`"),
    (f"{F}/uses", ["scan"], "E008", f"{M}/assumes/1", "add other"),
    (f"{D}/outputs", ["out", "alarm", "out"], "E007", f"{D}/outputs/2", "listed twice"),
    (f"{D}/outputs", ["out", "alarm", "scan"], "E007", f"{D}/outputs/2", "an input and an output"),
]


def spoil(document: dict[str, Any], path: str, value: object) -> None:
    keys = [key.replace("~1", "/") for key in path.split("/")[1:]]
    here: Any = document
    for key in keys[:-1]:
        here = here.setdefault(key, {}) if isinstance(here, dict) else here[int(key)]
    last: Any = keys[-1] if isinstance(here, dict) else int(keys[-1])
    if value is ABSENT:
        del here[last]
    else:
        here[last] = value


@pytest.mark.parametrize(
    ("place", "value", "code", "path", "said"),
    [(path, value, code, path, said) for path, value, code, said in FAULTS] + ELSEWHERE,
)
def test_each_fault_is_told_once_and_alone(place: str, value: object, code: str, path: str, said: str) -> None:
    document = copy.deepcopy(DOCUMENT)
    spoil(document, place, value)
    problems = problems_of(document)
    inside = [p for p in problems if p.path == path or p.path.startswith(f"{path}/")]
    assert [problem.code for problem in problems] == [code], [str(problem) for problem in problems]
    assert inside == problems
    assert said in str(problems[0])


def test_every_fault_is_told_at_once() -> None:
    document = copy.deepcopy(DOCUMENT)
    chosen = [FAULTS[index] for index in (1, 4, 9, 15, 16, 24, 25, 28, 33, 38, 42, 46, 49, 51, 53, 56)]
    for path, value, *_ in chosen:
        spoil(document, path, value)
    told = [(problem.path, problem.code) for problem in problems_of(document)]
    assert sorted(told) == sorted((path, code) for path, _, code, _ in chosen)


def test_a_misspelt_section_makes_no_other_faults() -> None:
    document = copy.deepcopy(DOCUMENT)
    document["componets"] = document.pop("components")
    assert [problem.path for problem in problems_of(document)] == ["/componets"]


@pytest.mark.parametrize("value", [None, 3, "x", [], [{}], True])
def test_what_is_no_object_at_all(value: object) -> None:
    (problem,) = [problem for problem in problems_of(value) if problem.code == "E001"]
    assert problem.path == "/"


def test_text_is_parsed_with_its_place() -> None:
    with pytest.raises(SpecificationError, match="not JSON: Expecting value at line 2, column 10"):
        parse_json('{"system":\n "demo", }'.replace('"demo", }', "        }"))
    with pytest.raises(SpecificationError, match="nested too deep"):
        parse_json("[" * 100_000)
    with pytest.raises(SpecificationError, match="not JSON"):
        parse_json("1" * 10_000)


def test_a_key_written_twice_in_text_is_a_fault() -> None:
    text = '{"system": "s", "topics": {"/t": {"type": "a/B"}, "/t": {"type": "a/C"}}}'
    (problem,) = problems_of(parse_json(text))
    assert (problem.code, problem.path) == ("E007", "/topics/~1t")


def test_nan_in_text_is_a_fault() -> None:
    (problem,) = problems_of(parse_json('{"system": "s", "topics": {"/t": {"type": "a/B", "rate": NaN}}}'))
    assert (problem.code, problem.path) == ("E004", "/topics/~1t/rate")


def test_a_component_from_a_node_is_checked_as_well() -> None:
    with pytest.raises(SpecificationError) as error:
        decode_component({"outputs": ["out", "out"], "imputs": {}})
    assert sorted(problem.code for problem in error.value.problems) == ["E002", "E003", "E007"]


def test_a_program_that_ends_has_no_gate_to_state() -> None:
    document = {"name": "Setup", "run": "./setup", "takes_seconds": 2, "once": True}
    component = decode_component(document)
    assert (component.once, component.gate) == (True, "none")
    assert encode_component(component) == document
    assert decode_component({**document, "gate": "none"}) == component
    assert not component.same_body(decode_component({**document, "once": False, "gate": "none"}))

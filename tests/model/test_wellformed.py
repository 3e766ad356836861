"""The design-time check: each rule told once, with its place, and nothing that merely follows from it."""

from __future__ import annotations

import copy
import re
from typing import Any

import pytest
from immutables import Map

from midstride.codec.specification_form import decode_specification
from midstride.lang.catalogue import CATALOGUE
from midstride.model.component import ComponentSpec, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import Interval, Predicate, QoS
from midstride.model.diagnostics import Problem, suggestion
from midstride.model.specification import Specification
from midstride.model.specification_checks import check, check_component, errors
from tests.codec.test_specification_form import FAULTS, spoil
from tests.model.build import at, component, mode, named, source

STRING = "std_msgs/msg/String"
FAST = {"type": STRING, "rate": 10}
SLOW = {"type": STRING, "rate": 1}

DEMO: dict[str, Any] = {
    "system": "demo",
    "topics": {"/chatter": {"type": STRING, "rate": 5}},
    "resources": {"gpu": {"capacity": 1}},
    "components": {
        "Talker": {
            "holds": {"gpu": 0.5},
            "parameters": {"volume": {"value": 0.5, "changeable": True}},
            "outputs": ["out"],
            "functionalities": {
                "talk": {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": FAST}}, "degraded": {}}}
            },
        },
        "Listener": {
            "inputs": {"in": SLOW},
            "functionalities": {"listen": {"uses": ["in"], "modes": {"normal": {"assumes": ["in"]}, "degraded": {}}}},
        },
    },
    "nodes": {
        "talker": {"component": "Talker", "attachments": {"out": ["/chatter"]}},
        "listener": {"component": "Listener", "attachments": {"in": ["/chatter"]}},
    },
}
TALK = "/components/Talker/functionalities/talk"
LISTEN = "/components/Listener/functionalities/listen"


def checked(*changes: tuple[str, object]) -> list[Problem]:
    document = copy.deepcopy(DEMO)
    for path, value in changes:
        spoil(document, path, value)
    return list(check(decode_specification(document)))


def test_the_demo_is_well_formed() -> None:
    assert checked() == []


MODES = f"{TALK}/modes"
RUN, RESPAWN = "/components/Talker/run", "/nodes/talker/respawn"
LOUD = {
    "run": "l",
    "outputs": ["out"],
    "functionalities": {
        "shout": {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": FAST}}, "degraded": {}}}
    },
}
CASES: list[tuple[str, list[tuple[str, object]], str, str]] = [  # code, changes, path, message
    (
        "E010",
        [(f"{LISTEN}/modes/degraded", {"assumes": ["in"]})],
        f"{LISTEN}/modes/degraded",
        "M1: mode degraded, the last of listen, must assume nothing, but assumes in",
    ),
    (
        "E011",
        [
            (f"{MODES}/normal/guarantees/out", {"type": STRING, "rate": 5}),
            (f"{MODES}/degraded", {"guarantees": {"out": FAST}}),
        ],
        f"{MODES}/normal/guarantees/out",
        f"M2: mode degraded of talk guarantees out : {STRING} @ 10 Hz, which the better mode normal does not"
        " (rate: 5 Hz is offered, at least 10 Hz is needed)",
    ),
    (
        "E012",
        [(f"{MODES}/degraded", {"guarantees": {"out": {"type": "std_msgs/msg/Int32", "rate": 1}}})],
        f"{MODES}/degraded/guarantees/out",
        f"M3: output out is one endpoint, but has type {STRING} in mode normal and std_msgs/msg/Int32 in mode degraded",
    ),
    (
        "E012",
        [(f"{MODES}/degraded", {"guarantees": {"out": {"type": STRING, "qos": {"depth": 1}}}})],
        f"{MODES}/degraded/guarantees/out",
        "M3: output out is one endpoint, but has the default QoS in mode normal and qos(depth = 1) in mode degraded",
    ),
    (
        "E013",
        [("/components/Talker/outputs", ["out", "spare"])],
        "/components/Talker/outputs/1",
        "no functionality produces output spare",
    ),
    (
        "E014",
        [("/components/Talker/functionalities/shout", {"produces": ["out"], "modes": {"normal": {}, "degraded": {}}})],
        "/components/Talker/outputs/0",
        "output out is owned by 2 functionalities: talk, shout",
    ),
    (
        "E015",
        [(f"{TALK}/modes", {"normal": {"guarantees": {"out": FAST}}})],
        f"{TALK}/modes",
        "talk has only one mode, so there is nothing to degrade to",
    ),
    (
        "E017",
        [("/environment", {"clock": {"guarantee": {"type": "std_srvs/srv/Trigger", "rate": 5}}})],
        "/environment/clock/guarantee/rate",
        "std_srvs/srv/Trigger is the type of a service, which has no rate",
    ),
    (
        "E017",
        [("/environment", {"clock": {"guarantee": {"type": STRING, "within_seconds": 1}}})],
        "/environment/clock/guarantee/within_seconds",
        f"{STRING} is the type of a topic, which answers no request within a bound",
    ),
    (
        "E016",
        [("/components/Listener/inputs/in/where", {"size": {">": 5, "<=": 5}})],
        "/components/Listener/inputs/in/where/size",
        "no value of field size meets all its constraints (in (5, 5])",
    ),
    (
        "E016",
        [("/environment", {"camera": {"guarantee": {"type": STRING, "where": {"size": {"in": []}}}}})],
        "/environment/camera/guarantee/where/size",
        "no value of field size meets all its constraints (in {})",
    ),
    (
        "E020",
        [("/topics/~1chatter/rate", 20)],
        "/nodes/talker/attachments/out/0",
        "talker.out in mode normal does not satisfy /chatter: rate: 10 Hz is offered, at least 20 Hz is needed",
    ),
    (
        "E020",
        [("/components/Listener/inputs/in/qos", {"durability": "transient_local"})],
        "/nodes/listener/attachments/in/0",
        "/chatter does not satisfy what listener.in assumes:"
        " durability: volatile is offered, transient_local is needed",
    ),
    (
        "E021",
        [("/nodes/talker/attachments/out", ["/chatter", "/chatter"])],
        "/nodes/talker/attachments/out/1",
        "talker.out is attached to /chatter twice",
    ),
    (
        "E022",
        [
            ("/topics/~1chatter/max_publishers", 1),
            ("/environment", {"recording": {"guarantee": SLOW, "topic": "/chatter"}}),
        ],
        "/topics/~1chatter/max_publishers",
        "/chatter has 2 publishers (talker.out, environment recording), at most 1 allowed",
    ),
    (
        "E023",
        [
            ("/nodes/talker_b", {"component": "Talker", "attachments": {"out": ["/chatter"]}}),
            ("/components/Talker/holds/gpu", 0.6),
        ],
        "/resources/gpu",
        "nodes hold 1.2 of gpu (talker 0.6, talker_b 0.6), but its capacity is 1",
    ),
    (
        "E024",
        [("/constraints", [{"order": "talker", "before": "listener"}, {"order": "listener", "before": "talker"}])],
        "/constraints/1",
        "`order listener before talker` contradicts `order talker before listener`",
    ),
    (
        "E024",
        [("/constraints", [{"order": "talker", "before": "talker"}])],
        "/constraints/0",
        "`order talker before talker`: talker cannot come before itself",
    ),
    (
        "E025",
        [("/nodes/talker/parameters", {"volume": "loud"})],
        "/nodes/talker/parameters/volume",
        "parameter volume of Talker takes a float, not a string",
    ),
    (
        "W030",
        [("/components/Talker/inputs", {"ear": SLOW})],
        "/nodes/talker/attachments/ear",
        "input talker.ear is attached to no topic",
    ),
    ("W031", [("/topics/~1quiet", SLOW)], "/topics/~1quiet", "/quiet has no publisher"),
    (
        "W031",
        [
            ("/topics/~1quiet", FAST),
            ("/environment", {"hum": {"guarantee": SLOW, "topic": "/quiet"}}),
        ],
        "/topics/~1quiet",
        "no publisher satisfies /quiet: environment hum: rate: 1 Hz is offered, at least 10 Hz is needed",
    ),
    (
        "E026",
        [(RUN, "t"), (RESPAWN, {"delay_seconds": 5, "max_delay_seconds": 2.5})],
        f"{RESPAWN}/max_delay_seconds",
        "the longest delay of talker, 2.5 s, is shorter than the first one, 5 s",
    ),
    (
        "E026",
        [(RESPAWN, {})],
        RESPAWN,
        "talker cannot be restarted: component Talker has no `run` command",
    ),
    (
        "E026",
        [(RUN, "t"), ("/components/Listener/run", "l"), (RESPAWN, {"fallback": "Listener"})],
        f"{RESPAWN}/fallback",
        "Listener cannot replace talker: it has no port out",
    ),
    (
        "E026",
        [
            (RUN, "t"),
            ("/components/Loud", LOUD),
            ("/constraints", [{"keep": "talker.talk", "at": "normal"}]),
            (RESPAWN, {"fallback": "Loud"}),
        ],
        f"{RESPAWN}/fallback",
        "Loud cannot replace talker: talker has no functionality `talk`, which `keep talker.talk at normal` names",
    ),
    (
        "E027",
        [("/components/Talker/topics", {"out": "chat"})],
        "/components/Talker/topics/out",
        "port out of Talker states what the program calls its topic, but Talker has no gate",
    ),
    (
        "E028",
        [("/components/Home", {"once": True})],
        "/components/Home/once",
        "Home is `once`, but has no `run` command",
    ),
    (
        "W035",
        [(RUN, "t"), (RESPAWN, {"fallback": "Talker"})],
        f"{RESPAWN}/fallback",
        "the fallback of talker is Talker, the component that it has",
    ),
    (
        "E018",
        [("/hosts", {"arm": {"ssh": "-p 22 arm"}})],
        "/hosts/arm/ssh",
        "`-p 22 arm` is no destination of `ssh`",
    ),
    (
        "E019",
        [("/hosts", {"arm": {}}), ("/resources", {"gpu": {"host": "arm"}})],
        "/resources/gpu",
        "resource `gpu` is said to belong to host arm",
    ),
]


@pytest.mark.parametrize(("code", "changes", "path", "message"), CASES)
def test_each_rule_is_told_once_and_alone(
    code: str, changes: list[tuple[str, object]], path: str, message: str
) -> None:
    problems = checked(*changes)
    assert [(problem.code, problem.path, problem.message) for problem in problems] == [(code, path, message)]
    assert problems[0].severity == ("error" if code.startswith("E") else "warning")
    assert bool(errors(problems)) == code.startswith("E")


def test_an_assumption_that_nothing_can_satisfy_and_what_follows() -> None:
    problems = checked((f"{LISTEN}/modes/normal/assumes", [{"type": STRING, "rate": 3}]))
    assert [(problem.code, problem.path, problem.message) for problem in problems] == [
        (
            "W032",
            f"{LISTEN}/modes/normal/assumes/0",
            f"mode normal of listen assumes {STRING} @ 3 Hz, which nothing can satisfy:"
            " input in: rate: 1 Hz is offered, at least 3 Hz is needed",
        ),
        (
            "W033",
            "/nodes/listener",
            f"listener.listen cannot start in mode normal: it assumes {STRING} @ 3 Hz: input listener.in does not"
            " satisfy it (rate: 1 Hz is offered, at least 3 Hz is needed) (it will start in mode degraded)",
        ),
    ]
    offered = ("/environment", {"line": {"guarantee": FAST}})
    assert checked((f"{LISTEN}/modes/normal/assumes", [{"type": STRING, "rate": 3}]), offered) == []


def test_the_chain_of_reasons_and_a_keep_that_does_not_hold() -> None:
    """Who falls at first, each with the chain down to what is lacking."""
    problems = checked(
        ("/nodes/talker/attachments", {}),
        ("/constraints", [{"keep": "listener.listen", "at": "normal"}]),
    )
    assert [(problem.code, problem.path) for problem in problems] == [
        ("W034", "/constraints/0"),
        ("W033", "/nodes/listener"),
        ("W030", "/nodes/talker/attachments/out"),
        ("W031", "/topics/~1chatter"),
    ]
    assert problems[1].message == (
        "listener.listen cannot start in mode normal: it assumes in: /chatter has no publisher"
        " (it will start in mode degraded)"
    )
    assert problems[0].message == (
        "`keep listener.listen at normal` does not hold at the start: listener.listen will start in mode degraded"
    )


def test_independent_errors_are_told_together_and_nothing_else() -> None:
    chosen = [CASES[index] for index in (0, 4, 10, 12, 15)]
    problems = checked(*(change for case in chosen for change in case[1]))
    assert sorted((problem.code, problem.path) for problem in problems) == sorted((case[0], case[2]) for case in chosen)


def test_m2_for_every_pair_of_the_chain() -> None:
    """Neighbours suffice: what a far mode lacks, some neighbour lacks."""
    modes = [mode("a", out=at(10)), mode("b"), mode("c", out=at(1)), mode("d")]
    (problem,) = check_component(component("Gap", {}, ["out"], modes))
    assert problem.code == "E011"
    assert problem.message.endswith("which the better mode b does not (nothing is guaranteed)")


def test_m2_and_m3_are_told_apart() -> None:
    """Modes that disagree on the type and, apart from it, on the rate: two faults."""
    modes = [mode("a", out=at(1)), mode("b", out=at(5, "demo_msgs/msg/Other"))]
    problems = check_component(component("Both", {}, ["out"], modes))
    assert [problem.code for problem in problems] == ["E011", "E012"]
    assert "type" not in problems[0].message


@pytest.mark.parametrize(
    ("better", "worse", "holds"),
    [
        (at(10), at(5), True),
        (at(5), at(5), True),
        (None, None, True),
        (at(5), None, True),
        (None, at(5), False),
        (at(5), at(10), False),
        (at(None), at(10), False),
        (at(10), at(None), True),
    ],
)
def test_m2_is_that_worse_is_nothing_or_better_satisfies_it(
    better: Predicate | None, worse: Predicate | None, holds: bool
) -> None:
    stated = (("better", better), ("worse", worse))
    modes = [mode(name, [], out=guarantee) if guarantee else mode(name) for name, guarantee in stated]
    problems = check_component(component("C", {}, ["out"], modes))
    assert [problem.code for problem in problems] == ([] if holds else ["E011"])


def test_components_made_by_hand_are_checked_as_well() -> None:
    """What a document could not say: numbers that are none, an assumption of nothing, names twice."""
    odd = ComponentSpec.of(
        "Odd",
        inputs={"in": Predicate(STRING, float("nan"), QoS(deadline=-1), (("x", Interval(float("nan"), 1)),))},
        functionalities=(
            FunctionalitySpec(
                "f", (Mode("m", (InputAlternatives(()), named("in", "in"))), Mode("m")), ("in",), weight=-1
            ),
        ),
        resource_usage={"gpu": 0},
        startup_seconds=-1,
    )
    found = {(problem.code, problem.path) for problem in check_component(odd)}
    assert found == {
        ("E004", "/inputs/in/rate"),
        ("E004", "/inputs/in/qos/deadline_seconds"),
        ("E004", "/inputs/in/where/x"),
        ("E001", "/functionalities/f/modes/m/assumes/0"),
        ("E007", "/functionalities/f/modes/m/assumes/1/any_of/1"),
        ("E007", "/functionalities/f/modes/m"),
        ("E004", "/functionalities/f/weight"),
        ("E004", "/holds/gpu"),
        ("E004", "/takes_seconds"),
    }


def test_two_functionalities_of_one_name() -> None:
    twice = source()
    (work,) = twice
    problems = check_component(ComponentSpec.of("Twice", outputs=("out",), functionalities=(work, work)))
    assert ("E007", "/functionalities/work") in {(problem.code, problem.path) for problem in problems}


def test_the_order_of_problems_is_stable_and_indices_count_as_numbers() -> None:
    orders = [{"order": "talker", "before": "talker"}] * 12
    problems = checked(("/constraints", orders))
    assert [problem.subject[1] for problem in problems] == [str(index) for index in range(12)]


def test_an_empty_specification_is_well_formed() -> None:
    assert check(Specification("nothing")) == ()


def test_every_code_of_the_catalogue_is_reached() -> None:
    reached = {fault[2] for fault in FAULTS} | {case[0] for case in CASES} | {"E003", "E007", "W032", "W033", "W034"}
    documented = {code: entry for code, entry in CATALOGUE.items() if int(code[1:]) < 100}
    assert reached == set(documented)
    assert all(entry.title and re.search(r"What to do: .+\.$", entry.explanation) for entry in documented.values())


def test_problems_are_told_with_a_json_pointer() -> None:
    problem = Problem("E008", ("topics", "/a~b", "type"), "what", "how")
    assert str(problem) == "/topics/~1a~0b/type: what (how) [E008]"


@pytest.mark.parametrize(
    ("wrong", "known", "told"),
    [
        ("tlaker", ["talker", "listener"], "did you mean `talker`?"),
        ("SCAN", ["/scan"], "did you mean `/scan`?"),
        ("best", ["reliable", "best_effort"], "did you mean `best_effort`?"),
        ("xyz", ["b", "a"], "known: a, b"),
        ("xyz", [*"abcdefgh"], "known: a, b, c, d, e, f, g, h"),
        ("xyz", [*"abcdefghi"], "known: a, b, c, d, e, f, g, h, …"),
        ("xyz", [], ""),
    ],
)
def test_suggestions(wrong: str, known: list[str], told: str) -> None:
    assert suggestion(wrong, known) == told


def test_maps_are_not_mistaken_for_order() -> None:
    """The same specification, built in another order, has the same problems in the same order."""
    problems = checked(("/topics/~1a", SLOW), ("/topics/~1b", SLOW), ("/topics/~1c", SLOW))
    assert [problem.path for problem in problems] == ["/topics/~1a", "/topics/~1b", "/topics/~1c"]
    assert isinstance(Specification("x").connectors, Map)

"""What ends with a node besides its ports, as plan and report name it: services, calls, topics that both write."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.lang.load import load_text
from midstride.model.action import Create, Remove
from midstride.model.component import ComponentSpec, Gate, NodeEndpoint
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import Predicate
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES, planner
from midstride.runtime.change.lost_endpoints import (
    _as_planned,
    lost_endpoints,
    offered,
    two_writers,
    unseen_endpoints,
    what_ended,
)
from midstride.runtime.change.planned_transfers import planned_transfers
from midstride.runtime.change.successor_names import names_after, names_now
from midstride.runtime.instance_life import LatestState
from midstride.runtime.manager import Manager
from midstride.runtime.process.launcher import LastKnown
from midstride.runtime.records.reports import StepTime
from midstride.verdicts.assessment import Assessments
from midstride.wire.state import Endpoint, UndeclaredTopic
from tests.acceptance.foreign_support import declared_talker
from tests.plan.cases import replacing
from tests.plan.test_estimates import replacement
from tests.runtime.systems import example, managed
from tests.wire.bare_state import bare_state

GOALS = [
    Endpoint(kind="ROS action", name="/dock", serves=True),
    Endpoint(kind="ROS action", name="/pick", serves=False),
    Endpoint(kind="service", name="/map", serves=False),
    Endpoint(kind="service", name="/reset", serves=True),
    Endpoint(kind="topic", name="/diagnostics"),
]


def test_plan_and_report_name_the_goals_of_a_component_with_the_api(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        monkeypatch.setattr(manager._client, "endpoints", lambda name: GOALS if name == "talker" else [])
        plan = await manager.plan(PlanRequest(restart=("talker",)))
        assert [each.words for each in plan.besides] == [
            "goals of others that are under way at ROS action /dock: they continue at talker, which runs beside its "
            "replacement until they have ended, for at most 60 s (`patience`); what is left then is cancelled",
            "requests and goals of talker that are under way at ROS action /pick and service /map: they continue when "
            "it ends, and it gets no answer",
        ]
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        assert isinstance(outcome.continuity, Assessments) and outcome.continuity.verdict == "not_measurable"
        assert [each.words for each in outcome.continuity.found] == [
            "requests and goals of talker that are under way at ROS action /pick and service /map: they continued, "
            "and it got no answer",
        ]

    managed("talker", tmp_path, body)


def test_a_roll_back_names_what_has_ended_with_the_new_instance_and_not_what_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        monkeypatch.setattr(manager._client, "endpoints", lambda name: GOALS if name.startswith("talker") else [])
        simulator.faults.fail_next("talker_2", "attach", "refused", times=99)
        outcome = await manager.change(PlanRequest(restart=("talker",)))
        assert outcome.outcome == "rolled_back" and isinstance(outcome.continuity, Assessments)
        assert [each.words for each in outcome.continuity.found if each.subject.startswith("talker")] == [
            "requests and goals of talker_2 that are under way at ROS action /pick and service /map: they continued, "
            "and it got no answer",
        ]

    managed("talker", tmp_path, body)


@pytest.mark.parametrize(("gate", "known"), [("preload", False), (None, False), ("relay", True), ("none", True)])
def test_with_one_that_was_not_accepted_nothing_ends_but_its_calls(gate: Any, known: bool) -> None:
    """Where a gate holds it back: another instance of its role has answered all the time."""
    component = ComponentSpec.of("Talker", gate=gate)
    serves = [Endpoint(kind="ROS action", name="/drive", serves=True)]
    state = bare_state("talker_2", node="/talker", serves=serves, calls=["service /map"], looked=True)

    def subjects(latest: LatestState | None) -> list[str]:
        found = what_ended("talker_2", component, LastKnown(latest), planned=False, spare=True)
        return [each.words.partition(":")[0] for each in found]

    calls = "requests and goals of talker_2 that are under way at service /map"
    assert subjects(LatestState(state, 0.0))[-1] == calls
    assert (len(subjects(LatestState(state, 0.0))) > 1) is known
    assert (subjects(None) != []) is known


def test_of_a_node_without_the_api_the_graph_says_it_once_it_has_been_asked() -> None:
    def said(**seen: Any) -> list[str]:
        state = bare_state("talker", node="/talker", **seen)
        component = ComponentSpec.of("Talker", gate="preload")
        known = LastKnown(LatestState(state, 0.0))
        found = what_ended("talker", component, known, planned=True)
        both = two_writers("talker", known, component, component)
        return [each.words for each in (*found, *both)]

    assert said() == []
    assert said(looked=False) == ["what others rely on of talker besides its ports: it had just been started"]
    found = said(
        serves=[Endpoint(kind="service", name="/save", serves=True)],
        calls=["ROS action /pick"],
        undeclared=[
            UndeclaredTopic(output=output, topic=topic, type="x")
            for output, topic in ((True, "/diag"), (True, "/talker/own"), (False, "/scan"))
        ],
    )
    assert [words.partition(":")[0] for words in found] == [
        "requests and goals of others",
        "requests and goals of talker that are under way at ROS action /pick",
        "which instance writes on /diag",
    ]


def test_a_plan_for_a_system_that_does_not_run_says_what_it_cannot_know() -> None:
    """Of which nodes only the graph shows what else they have; and what a node of the API may have is stated."""
    specification = example("talker")
    talker = replace(specification.components["Talker"], allows=(NodeEndpoint("service", "/save"),))
    listener = replace(specification.components["Listener"], gate="preload")
    components = specification.components.set("Talker", talker).set("Listener", listener)
    specification = replace(specification, components=components)
    request = PlanRequest(restart=("talker", "listener"))
    target = request.target(specification)
    change = change_between(initial(specification), specification, target, renewed=request.renewed(target))
    found = {each.words for each in unseen_endpoints(planner("minimal", None)(change))}
    assert found == {
        "what others rely on of talker besides its ports: it may have service /save, which nothing hands over",
        "what others rely on of listener besides its ports: its services, ROS actions and calls are known once it runs",
    }


GOES_ON = (
    "goals of others that are under way at ROS action /dock: they continue at mapper, which runs beside its "
    "replacement until they have ended, for at most 60 s (`patience`); what is left then is cancelled"
)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [("preload", "preload", ["/diagnostics"]), ("preload", "none", ["/tf", "/diagnostics"])],
)
def test_a_topic_that_is_handed_over_has_one_writer(old: Gate, new: Gate, named: list[str]) -> None:
    """It is, where both instances have the library, and it has a gate for that topic."""
    undeclared = [
        UndeclaredTopic(output=True, topic="/tf", type="x", handed_over=True),
        UndeclaredTopic(output=True, topic="/diagnostics", type="x"),
    ]
    known = LastKnown(LatestState(bare_state("talker", node="/talker", undeclared=undeclared), 0.0))
    before, after = (ComponentSpec.of("Talker", run="talker", gate=gate) for gate in (old, new))
    (said,) = two_writers("talker", known, before, after)
    assert [topic for topic in ("/tf", "/diagnostics") if topic in said.words] == named


@pytest.mark.parametrize(
    ("gate", "component", "keeps_name", "found"),
    [
        ("preload", "Mapper", False, [GOES_ON, "service /mapper/save ends with mapper"]),
        ("preload", "Other", False, [GOES_ON, "/mapper/save ends with mapper", "ROS action /dock are answered by"]),
        ("preload", "Mapper", True, [GOES_ON]),
        ("preload", "Other", True, [GOES_ON, "/mapper/save, service /reset and ROS action /dock are answered"]),
        (
            "none",
            "Mapper",
            False,
            [
                "mapper and its replacement answer service /reset while both run",
                "/mapper/save, service /reset and ROS action /dock end with mapper",
            ],
        ),
    ],
)
def test_a_service_that_the_successor_answers_does_not_end(
    gate: Gate, component: str, keeps_name: bool, found: list[str]
) -> None:
    """The name of the old node is gone with it, unless the successor has it. Its goals go on."""
    kinds = {"/mapper/save": "service", "/reset": "service", "/dock": "ROS action"}
    serves = [Endpoint(kind=kind, name=name, serves=True) for name, kind in kinds.items()]  # type: ignore[arg-type]
    state = bare_state("mapper", node="/mapper", serves=serves, keeps_name=keeps_name)
    old, new = (ComponentSpec.of(kind, run="mapper", gate=gate) for kind in ("Mapper", component))
    known = LastKnown(LatestState(state, 0.0), ())
    said = [each.words for each in what_ended("mapper", old, known, planned=True, beside=new)]
    assert len(said) == len(found)
    assert all(part in words for part, words in zip(found, said, strict=True)), said
    (words,) = (each.words for each in what_ended("mapper", old, known, planned=False))
    assert "service /mapper/save, service /reset and ROS action /dock ended with mapper" in words


def test_who_calls_the_lifecycle_services_of_what_ends_is_named() -> None:
    state = bare_state("mapper", node="/mapper", lifecycle_callers=["/one", "/two"])
    component = ComponentSpec.of("Mapper", run="mapper", gate="lifecycle preload")
    (found,) = what_ended("mapper", component, LastKnown(LatestState(state, 0.0), ()), planned=True)
    assert "each of its lifecycle services (called by /one and /two) ends with mapper" in found.words


def test_what_the_plan_has_started_itself_was_not_managed_by_another_one() -> None:
    before, now = (
        LatestState(bare_state("mapper", node="/mapper", starting=starting), at)
        for starting, at in ((["/mapper"], 0.0), (["/mapper", "/mapper_2"], 1.0))
    )
    known = _as_planned(LastKnown(now, ()), before)
    assert known.latest is not None and (known.latest.state.starting, known.latest.at) == (["/mapper"], 1.0)
    assert _as_planned(LastKnown(now, ()), None) == LastKnown(now, ()), "nothing was known before"


def test_both_write_on_a_private_topic_where_they_have_one_name() -> None:
    undeclared = [UndeclaredTopic(output=True, topic="/talker/own", type="x")]
    component = ComponentSpec.of("Talker", gate="preload")

    def shared(*, keeps_name: bool) -> list[str]:
        state = bare_state("talker", node="/talker", undeclared=undeclared, keeps_name=keeps_name)
        return [each.words for each in two_writers("talker", LastKnown(LatestState(state, 0.0)), component, component)]

    assert shared(keeps_name=False) == []
    (words,) = shared(keeps_name=True)
    assert words.startswith("which instance writes on /talker/own")


def test_between_the_api_and_a_node_without_it_both_answer_where_that_has_no_library() -> None:
    own, plain = ComponentSpec.of("Own", run="mapper"), ComponentSpec.of("Plain", run="mapper", gate="preload")
    relayed, bare = (ComponentSpec.of("Other", run="mapper", gate=gate) for gate in ("relay", "none"))
    known = LastKnown(None, GOALS[3:4])
    (found,) = what_ended("mapper", own, known, planned=True, beside=plain)
    assert "service /reset is answered by the replacement of mapper only if that offers it" in found.words
    for other in (relayed, bare):
        (found,) = what_ended("mapper", own, known, planned=True, beside=other)
        assert "mapper and its replacement answer service /reset while both run" in found.words
    assert not list(what_ended("mapper", own, known, planned=True, beside=own))
    state = bare_state("mapper", node="/mapper", serves=[Endpoint(kind="service", name="/reset", serves=True)])
    known = LastKnown(LatestState(state, 0.0), ())
    (found,) = what_ended("mapper", plain, known, planned=False, beside=own)
    assert "service /reset was answered by the replacement of mapper only if that offers it" in found.words
    found, _ = what_ended("mapper", bare, known, planned=False, beside=own)
    assert "mapper and its replacement answered service /reset while both run" in found.words
    (found,) = what_ended("mapper", relayed, LastKnown(None, ()), planned=True, beside=relayed)
    assert "each of the two answers the other services that both have" in found.words


def test_what_the_successor_was_seen_not_to_offer_is_said_without_an_if() -> None:
    old, new = (ComponentSpec.of(name, run="mapper", gate="preload") for name in ("Old", "New"))
    serves = [each for each in GOALS if each.serves]
    known = LastKnown(LatestState(bare_state("mapper", node="/mapper", serves=serves, keeps_name=True), 0.0))

    def said(offers: list[str] | None) -> list[str]:
        found = what_ended("mapper", old, known, planned=False, beside=new, offers=offers)
        return [each.words for each in found if each.words.startswith("requests of others")]

    (words,) = said(None)
    served = "service /reset and ROS action /dock were answered by the replacement of mapper"
    assert words.endswith(f"{served} only if that offers them")
    assert said(["service /reset"]) == [
        "requests of others: as far as the graph shows, the replacement of mapper does not offer ROS action /dock, so "
        "it is not answered since mapper has ended"
    ]
    assert said(["service /reset", "ROS action /dock"]) == []


def test_of_components_without_the_api_it_is_known_what_they_offer_once_the_graph_was_asked() -> None:
    plain, bare = (ComponentSpec.of(gate, run="mapper", gate=gate) for gate in ("preload", "none"))
    instances = [Instance(name, name, plain) for name in ("seen", "unseen", "never shown")]
    instances.append(Instance("bare", "bare", bare))
    runs = Configuration()
    for each in instances:
        runs = runs.with_instance(each)
    states = {
        each.name: LatestState(bare_state(each.name, serves=GOALS[3:4], looked=each.name != "unseen"), 0.0)
        for each in instances
    }
    states["never shown"] = LatestState(bare_state("never shown", shown=False), 0.0)  # within GRAPH_TIMEOUT
    assert offered(states, runs) == {"seen": ["service /reset"]}


def test_a_component_with_the_api_may_write_on_its_topics_beside_a_node_without_it() -> None:
    """A component without ports for them has said which topics it has, and not which of them it writes on."""
    own, plain = ComponentSpec.of("Own", run="mapper"), ComponentSpec.of("Plain", run="mapper", gate="preload")
    known = LastKnown(None, GOALS)
    (found,) = two_writers("mapper", known, own, plain)
    assert "no port of mapper states it, so both may write there while both instances run" in found.words
    assert "/diagnostics" in found.words and "/dock" not in found.words
    (found,) = two_writers("mapper", known, own, plain, 1.5)
    assert "so both could write there for up to 1.50 s" in found.words
    assert not list(two_writers("mapper", known, own, own))


def exchange(old: Gate, new: Gate, *, old_first: bool) -> Plan:
    """A plan that exchanges a node with a port, in 1.5 s for each of its two steps that matter here."""
    text = "system s\ntopic /map : std_msgs/msg/String @ 1 Hz\n"
    text += declared_talker("Mapper", "mapper", old, 1) + declared_talker("Other", "other", new, 1)
    specification = load_text(f"{text}node mapper : Mapper {{ out -> /map }}\n").require()
    plan = STRATEGIES["paper"](replacing(initial(specification), specification, "mapper", "Other"))
    steps = [replace(step, seconds=1.5) for step in plan.steps if isinstance(step.action, Create | Remove)]
    return replace(plan, steps=tuple(sorted(steps, key=lambda step: isinstance(step.action, Create) == old_first)))


@pytest.mark.parametrize(
    ("old", "new", "keeps_name", "order", "found"),
    [
        ("preload", "preload", True, "beside", []),
        ("lifecycle", "lifecycle", True, "beside", []),
        ("lifecycle", "lifecycle", False, "beside", ["/mapper_2, so none is answered from the end of mapper on"]),
        ("none", "none", False, "beside", ["/mapper_2, so none is answered from the end of mapper on"]),
        ("none", "none", False, "first", ["none is answered for about 3.00 s, and until its program has started up"]),
        ("preload", "preload", True, "first", ["so none is answered for about 3.00 s"]),
        ("relay", "relay", False, "first", ["/mapper_2, so none is answered from the end of mapper on"]),
    ],
)
def test_plan_and_report_say_the_name_of_the_replacement_and_how_long_none_answers(
    old: Gate, new: Gate, keeps_name: bool, order: str, found: list[str]
) -> None:
    node = "/mapper_relay" if old == "relay" else "/mapper"
    states = {"mapper": LatestState(bare_state("mapper", node=node, keeps_name=keeps_name), 0.0)}
    plan = exchange(old, new, old_first=order == "first")
    said = [each.words for each in names_after(plan, states)]
    assert len(said) == len(found)
    assert all(words.endswith(part) for part, words in zip(found, said, strict=True)), said
    times = {number: StepTime(step=number, began=number * 10.0, seconds=2.0) for number in (1, 2)}
    reported = [each.words for each in names_now(plan, states, times)]
    assert len(reported) == len(found)
    for words in reported:
        if "/mapper_2" in words:
            assert words.endswith("so none is answered since mapper has ended")
        else:
            assert "mapper had ended before mapper_2 was started, so none was answered for 12.0 s" in words
    assert not list(names_now(plan, states, {})), "it was not carried out"


def test_a_plan_says_for_how_long_the_goals_of_a_server_with_the_api_go_on() -> None:
    def said(gate: Gate | None, strategy: str = "minimal") -> list[str]:
        goals = replacement(strategy, Predicate("test_msgs/action/Fibonacci"), gate, new_gate=gate)
        return [each.words for each in lost_endpoints(goals, {}, {}) if "goals of others" in each.words]

    (words,) = said(None)
    assert words == (
        "goals of others that are under way at ROS action /A: they continue at a, which runs beside its replacement "
        "until they have ended, for at most 60 s (`patience`); what is left then is cancelled"
    )
    assert said("preload") == said(None, "stop") == []


def test_state_moves_between_two_with_an_agent_inside_or_two_without() -> None:
    def said(old: Gate | None, new: Gate | None) -> list[str]:
        latest = LatestState(bare_state("a", node="/a", keeps_state=True), 0.0)
        found = planned_transfers(replacement(gate=old, new_gate=new), {"a": latest})
        return [each.words for each in found]

    pairs: list[tuple[Gate | None, Gate | None]] = [
        ("relay", "relay"),
        ("preload", "preload"),
        ("lifecycle", "preload"),
    ]
    for old, new in [*pairs, (None, "relay"), ("relay", None)]:
        (words,) = said(old, new)
        assert words.startswith("while the state of a moves to ") and "requests to its services wait" in words
    assert said(None, None) == []
    paper = "; `--strategy paper` moves it"
    others: list[tuple[Gate | None, Gate | None, tuple[str, str]]] = [
        ("relay", "preload", ("has `gate relay`", "has `gate preload`")),
        ("preload", None, ("has `gate preload`", "uses Midstride's API")),
        (None, "none", ("uses Midstride's API", "has `gate none`")),
    ]
    for old, new, kinds in others:
        (words,) = said(old, new)
        assert words.startswith(f"the state of a is lost: a {kinds[0]}, and ") and words.endswith(paper)
        assert f" {kinds[1]}, so neither waits for the other's state" in words

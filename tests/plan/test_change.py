"""The change: what becomes of whom, under which name; and what is refused, with what to write instead."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.action import Handover
from midstride.model.best import best
from midstride.model.component import (
    Connector,
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    Mode,
    ParameterSpec,
)
from midstride.model.contract import Predicate
from midstride.model.specification import Keep, Limit, Node, Specification, initial, probation_seconds
from midstride.plan.change_builder import change_between, requested_change
from midstride.plan.estimate import Estimate
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES, planner
from tests.plan.cases import (
    NEED,
    SLOW,
    adding,
    component,
    functionality,
    removing,
    replacing,
    system,
    talker,
    work,
)


def refused(start: Specification, target: Specification) -> str:
    with pytest.raises(PlanRefused) as caught:
        change_between(initial(start), start, target)
    return str(caught.value)


# -- names ---------------------------------------------------------------------------------------------


def test_a_replacement_takes_the_first_name_that_nobody_has() -> None:
    start = talker()
    nodes = start.nodes.set("talker_2", Node("talker_2", "Talker")).set("talker_4", Node("talker_4", "Talker"))
    start = replace(start, nodes=nodes)
    change = replacing(initial(start), start, "talker", "NewTalker")
    assert [instance.name for instance in change.coming] == ["talker_3"]


def test_a_name_of_the_target_is_nobody_else_s() -> None:
    start = talker()
    target = start.with_replaced("talker", "NewTalker").with_node(Node("talker_2", "Talker"))
    change = change_between(initial(start), start, target)
    assert sorted((instance.role, instance.name) for instance in change.coming) == [
        ("talker", "talker_3"),
        ("talker_2", "talker_2"),
    ]


def test_a_first_instance_bears_its_role_s_name_unless_it_is_taken() -> None:
    start = talker()
    configuration = initial(start)
    change = replacing(configuration, start, "talker", "NewTalker")
    *_, last = STRATEGIES["minimal"](change).configurations()
    change = adding(change.in_target_context(last), change.target, Node("talker_2", "Talker"))
    assert [instance.name for instance in change.coming] == ["talker_2_2"]
    assert [instance.name for instance in adding(configuration, start, Node("other", "Talker")).coming] == ["other"]


# -- what differs ------------------------------------------------------------------------------------


def test_a_parameter_that_only_one_declares_asks_for_a_replacement() -> None:
    start = talker()
    more = replace(start.components["Talker"], parameters=Map({"gain": ParameterSpec(1.0, changeable=True)}))
    target = replace(start, components=start.components.set("Talker", more))
    assert change_between(initial(start), start, target).leaving == ("talker",)


def test_parameters_of_the_node_go_over_those_of_the_component() -> None:
    one = work("One", parameters={"gain": ParameterSpec(1.0, changeable=True)})
    start = system([one], {"n": ("One", {})})
    default = replace(one, parameters=Map({"gain": ParameterSpec(2.0, changeable=True)}))
    target = replace(start, components=start.components.set("One", default))
    assert change_between(initial(start), start, target).parameters == (("n", Map({"gain": 2.0})),)
    own = target.with_node(replace(target.nodes["n"], parameters=Map({"gain": 1.0})))
    assert change_between(initial(start), start, own).parameters == ()


def test_an_instance_of_no_role_leaves() -> None:
    start = talker()
    configuration = initial(start)
    stray = replace(configuration.instances["talker"], name="talker_7")
    change = change_between(configuration.with_instance(stray), start, start)
    assert change.leaving == ("talker_7",)
    assert change.coming == ()


def exactly(measured: dict[str, float]) -> dict[str, Estimate]:
    return {kind: Estimate.exactly(seconds) for kind, seconds in measured.items()}


@pytest.mark.parametrize("strategy", ["minimal", "paper"])
def test_of_two_instances_the_one_that_has_the_topics_is_replaced(strategy: str) -> None:
    """As after a roll-back that failed: the old one was fenced, and its successor has taken over."""
    start = talker()
    running = initial(start)
    attachments = running.attached_ports("talker")
    running = running.with_instance(start.instance("talker", "talker_2"))
    for port, connector in attachments:
        running = running.without_attachment(port, connector)
        running = running.with_attachment(port._replace(instance="talker_2"), connector)
    running = best(running)
    target = start.with_replaced("talker", "NewTalker")
    change = change_between(running, start, target)
    assert dict(change.replaced) == {"talker_2": "talker_3"} and set(change.leaving) == {"talker", "talker_2"}
    plan = STRATEGIES[strategy](change)
    for configuration in plan.configurations():
        assert len(configuration.publishers_on("/chatter")) <= 1


def test_one_that_has_no_topic_yet_beside_one_that_publishes_is_not_kept() -> None:
    """As after a change that was left incomplete: what it has created has not taken over."""
    start = talker()
    target = start.with_replaced("talker", "NewTalker")
    running = best(initial(start).with_instance(target.instance("talker", "talker_2")))
    change = change_between(running, start, target)
    assert dict(change.replaced) == {"talker": "talker_3"} and set(change.leaving) == {"talker", "talker_2"}
    plan = STRATEGIES["minimal"](change)
    assert any(isinstance(step.action, Handover) for step in plan.steps)
    for configuration in plan.configurations():
        assert len(configuration.publishers_on("/chatter")) == 1


def test_durations_are_declared_else_measured_else_the_default() -> None:
    start = replace(talker(), timing=Map({"detach": 0.3}))
    slow = replace(start.components["NewTalker"], startup_seconds=4.0)
    start = replace(start, components=start.components.set("NewTalker", slow))
    target = start.with_replaced("talker", "NewTalker")
    measured = {"create NewTalker": 9.0, "detach": 9.0, "attach": 0.7, "create Listener": 2.5, "create": 3.5}
    change = change_between(initial(start), start, target, exactly(measured))
    (coming,) = change.coming
    assert change.seconds("create", coming) == 4.0
    assert change.seconds("detach") == 0.3
    assert change.seconds("attach") == 0.7
    assert change.seconds("create", change.instance("listener")) == 2.5
    assert change.seconds("create", change.instance("talker")) == 3.5
    assert change.seconds("remove") == 0.2


def test_a_hand_over_takes_its_probation_and_the_watch_after_it() -> None:
    """All outputs are on probation at once. What was measured of earlier hand-overs does not include it."""
    rates = {"a": 10.0, "b": 2.0, "c": None}
    modes = (Mode("normal", (), Map({port: replace(NEED, rate=rate) for port, rate in rates.items()})), Mode("off"))
    parts = [component(name, FunctionalitySpec("work", modes, (), tuple(rates), 1.0)) for name in ("Old", "New")]
    topics = {f"/{port}": replace(NEED, rate=rate) for port, rate in rates.items()}
    start = system(parts, {"many": ("Old", {port: f"/{port}" for port in rates})}, topics=topics)
    watched = {"probation": 3.0, "watch_after": 5.0, "probation_timeout": 9.0}
    cases: list[tuple[dict[str, float], dict[str, float], float]] = [
        ({}, {}, 0.1 + 5 / 2),  # five periods of b; of a, ten would be 1 s
        ({"probation": 0.0}, {}, 0.1),
        (watched, {}, 0.1 + 3 + 5),
        (watched, {"handover": 0.4}, 0.4 + 3 + 5),
    ]
    for timing, measured, seconds in cases:
        target = replace(start.with_replaced("many", "New"), timing=Map(timing))
        plan = planner("minimal")(change_between(initial(start), start, target, exactly(measured)))
        [found] = [step.seconds for step in plan.steps if isinstance(step.action, Handover)]
        assert found == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("timing", "rate", "seconds"),
    [
        ({}, 100.0, 0.2),
        ({}, 20.0, 0.5),
        ({}, 4.0, 2.0),
        ({}, 1.0, 5.0),
        ({}, None, 0.0),
        ({"probation": 0.0}, 1.0, 0.0),
        ({"probation": 3.0}, 100.0, 3.0),
        ({"probation": 3.0}, 1.0, 5.0),
        ({"probation": 3.0}, None, 0.0),
    ],
)
def test_a_rate_is_judged_over_some_of_its_periods(
    timing: dict[str, float], rate: float | None, seconds: float
) -> None:
    assert probation_seconds(timing, rate) == pytest.approx(seconds)


# -- the same component again ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "request_",
    [PlanRequest(restart=("talker",)), PlanRequest(replace=(("talker", "Talker"),))],
    ids=["restart", "replace"],
)
@pytest.mark.parametrize("strategy", sorted(STRATEGIES))
def test_a_node_gets_a_new_instance_of_the_component_that_it_has(request_: PlanRequest, strategy: str) -> None:
    """Its program may have changed."""
    start = talker()
    request_ = replace(request_, strategy=strategy)
    target = request_.target(start)
    assert target == start
    roles = ["listener", "talker"] if strategy == "stop" else ["talker"]
    whole = change_between(initial(start), start, target, renewed=request_.renewed(target))
    for change in (whole, requested_change(initial(start), start, request_, target)):
        assert list(change.leaving) == roles
        assert [(new.name, new.role) for new in change.coming] == [(f"{role}_2", role) for role in roles]
        assert [new.component for new in change.coming] == [start.component_of(role) for role in roles]
        assert dict(change.replaced) == {role: f"{role}_2" for role in roles}
        assert planner(strategy)(change).steps


def test_restarted_nodes_are_handed_over_without_a_loss() -> None:
    start = talker()
    request = PlanRequest(restart=("talker", "listener"))
    target = request.target(start)
    change = change_between(initial(start), start, target, renewed=request.renewed(target))
    plan = planner("minimal")(change)
    assert plan.disruption == 0
    assert any(isinstance(step.action, Handover) for step in plan.steps)
    assert request.describe() == "restart talker, restart listener"


# -- what is refused -----------------------------------------------------------------------------------


def test_unknown_names_are_suggested() -> None:
    start = talker()
    configuration = initial(start)
    with pytest.raises(PlanRefused, match=r"no node `talkr`; did you mean `talker`\?"):
        replacing(configuration, start, "talkr", "NewTalker")
    with pytest.raises(PlanRefused, match=r"no component `NewTalk`; did you mean `NewTalker`\?"):
        replacing(configuration, start, "talker", "NewTalk")
    with pytest.raises(PlanRefused, match=r"no node `speaker`"):
        removing(configuration, start, "speaker")
    with pytest.raises(PlanRefused, match=r"no topic `/chater` \(did you mean `/chatter`\?\)"):
        adding(configuration, start, Node("more", "Talker", Map({"out": ("/chater",)})))
    with pytest.raises(PlanRefused, match=r"no strategy `minimum`; did you mean `minimal`\?"):
        planner("minimum")
    assert planner() is STRATEGIES["minimal"]


LAME = component("Lame", FunctionalitySpec("f", (Mode("only"),)))


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (PlanRequest(add=(Node("b ad", "Talker"),)), "`b ad` is not a valid node name"),
        (PlanRequest(add=(Node("n" * 256, "Talker"),)), "is not a valid node name"),
        (
            PlanRequest(add=(Node("more", "Talker", Map({"out": ("/chatter", "/chatter")})),)),
            "more.out is attached to /chatter twice",
        ),
        (PlanRequest(remove=("talker", "talker")), "node talker is named twice"),
        (PlanRequest(restart=("talkr",)), "no node `talkr`; did you mean `talker`?"),
        (PlanRequest(restart=("talker",), replace=(("talker", "NewTalker"),)), "node talker is named twice"),
        (PlanRequest(to=talker(), remove=("talker",)), "either a whole specification or single changes"),
        (PlanRequest(), "the request is empty: name nodes to replace, restart, add or remove"),
        (PlanRequest(remove=("talker",), replace=(("talker", "NewTalker"),)), "node talker is named twice"),
        (
            PlanRequest(remove=("talker",), components=(LAME,)),
            "component Lame: /functionalities/f/modes: f has only one mode",
        ),
        (PlanRequest(to=replace(talker(), components=Map(Lame=LAME))), "/components/Lame/functionalities/f/modes: "),
        (
            PlanRequest(remove=("talker",), components=(work("Heavy", resource_usage={"gpu": 1.0}),)),
            "component Heavy holds `gpu`, a resource that the system does not declare; use `apply`",
        ),
    ],
)
def test_what_is_asked_for_must_be_well_formed(request_: PlanRequest, words: str) -> None:
    """The command line and the API say by single changes what a file may not say either."""
    with pytest.raises(PlanRefused) as caught:
        request_.target(talker())
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("constraint", "missing"),
    [
        (Keep(FunctionalityRef("talker", "talk"), "normal"), "talker has no functionality `talk`"),
        (Limit(FunctionalityRef("talker", "talk"), 2.0), "talker has no functionality `talk`"),
        (Keep(FunctionalityRef("talker", "work"), "quiet"), "talker.work has no mode `quiet`"),
    ],
)
def test_a_replacement_has_what_the_constraints_on_its_node_name(constraint: Keep | Limit, missing: str) -> None:
    """Else the running specification, which a later manager reads again, would name what it does not declare."""
    start = talker()
    quiet = component("Talker", FunctionalitySpec("work", (Mode("quiet"), Mode("off")), outputs=("out",)))
    now = quiet if isinstance(constraint, Keep) and constraint.mode == "quiet" else start.components["Talker"]
    components = start.components.set("Talker", now).set("Other", work("Other", outputs=("out",)))
    start = replace(start, components=components, constraints=(constraint,))
    request = PlanRequest(replace=(("talker", "Other"),))
    with pytest.raises(PlanRefused) as caught:
        request.target(start)
    assert f"Other cannot replace talker: {missing}, which `{constraint}` names; use `apply`" in str(caught.value)
    elsewhere = Keep(FunctionalityRef("listener", "listen"), "normal")
    assert request.target(replace(start, constraints=(elsewhere,))).nodes["talker"].component == "Other"


@pytest.mark.parametrize(
    ("node", "words"),
    [
        (Node("talker", "Talkr"), "/nodes/talker/component: there is no component `Talkr` (did you mean `Talker`?)"),
        (
            Node("talker", "Talker", Map({"uot": ("/chatter",)})),
            "Talker has no port `uot` (did you mean `out`?)",
        ),
        (
            Node("talker", "Talker", Map({"out": ("/chat",)})),
            "/nodes/talker/attachments/out/0: there is no topic `/chat` (did you mean `/chatter`?)",
        ),
        (Node("talker", "Talker", Map(), Map({"gain": 1})), "Talker has no parameter `gain`"),
    ],
)
def test_a_target_that_names_what_is_not_there(node: Node, words: str) -> None:
    assert words in refused(talker(), talker().with_node(node))


def test_contracts_that_do_not_fit() -> None:
    start = talker()
    talk = FunctionalitySpec("talk", (Mode("normal", (), Map({"out": SLOW})), Mode("degraded")), (), ("out",))
    start = replace(start, components=start.components.set("Weak", component("Weak", talk)))
    configuration = initial(start)
    with pytest.raises(PlanRefused) as caught:
        replacing(configuration, start, "talker", "Weak")
    assert "talker_2.out cannot be attached to /chatter" in str(caught.value)
    assert "5 Hz is offered, at least 10 Hz is needed" in str(caught.value)


def test_a_cap_that_either_end_exceeds() -> None:
    parts = [work("Source", outputs=["out"])]
    two = {"a": ("Source", {"out": "/x"}), "b": ("Source", {"out": "/x"})}
    one = {"a": ("Source", {"out": "/x"})}
    assert refused(system(parts, two), system(parts, one, caps={"/x": 1})) == (
        "the running system exceeds a limit: /x: 2 publishers (a.out, b.out), at most 1 allowed; "
        "apply first what keeps the new limit, with the limit as it is now, and then lower the limit"
    )
    words = refused(system(parts, one, caps={"/x": 1}), system(parts, two, caps={"/x": 1}))
    assert words.startswith("the target exceeds a limit: /x: 2 publishers")
    start = system(parts, one, caps={"/x": 1})
    with pytest.raises(PlanRefused, match="the target exceeds a limit: /x: 2 publishers"):
        adding(initial(start), start, Node("b", "Source", Map({"out": ("/x",)})))


def test_a_capacity_that_either_end_exceeds() -> None:
    parts = [work("Big", resource_usage={"memory": 6.0}), work("Small", resource_usage={"memory": 1.0})]
    start = system(parts, {"a": ("Big", {})}, resources={"memory": 8.0})
    lower = system(parts, {"a": ("Small", {})}, resources={"memory": 5.0})
    assert "6 held by a, but the capacity is 5; apply first what keeps the new limit" in refused(start, lower)
    between = replace(lower, resources=start.resources)
    assert change_between(initial(start), start, between).coming
    assert not change_between(initial(between), between, lower).coming
    with pytest.raises(
        PlanRefused, match="the target exceeds a limit: resource memory: 12 held by a, b, but the capacity is 8"
    ):
        adding(initial(start), start, Node("b", "Big"))


def test_an_environment_that_the_running_system_cannot_do_without() -> None:
    see = component("Eye", functionality("see", assumes=[Predicate("sensor_msgs/msg/Image", 15.0)]))
    lamp = EnvironmentGuarantee("camera", Predicate("sensor_msgs/msg/Image", 30.0))
    start = system([see], {"eye": ("Eye", {})}, environment=[lamp])
    words = refused(start, replace(start, environment=()))
    assert words.startswith("the running system is not valid in the target's environment: eye.see in mode normal")


# -- what it costs ---------------------------------------------------------------------------------------


def cells(number: int) -> Specification:
    """Cells that have nothing to do with each other: the cone of a change is one cell."""
    parts = [work("Source", outputs=["out"]), work("Filter", ["in"], ["out"]), work("Other", ["in"], ["out"])]
    nodes: dict[str, tuple[str, dict[str, str]]] = {}
    for n in range(number):
        nodes[f"source{n}"] = ("Source", {"out": f"/raw{n}"})
        nodes[f"filter{n}"] = ("Filter", {"in": f"/raw{n}", "out": f"/clean{n}"})
        nodes[f"sink{n}"] = ("Sink", {"in": f"/clean{n}"})
    return system([*parts, work("Sink", ["in"])], nodes)


def calls_to_plan(specification: Specification, strategy: str) -> int:
    """How many calls, C functions included, a whole replacement takes: a cost that no busy machine falsifies."""
    configuration = initial(specification)
    count = 0

    def note(_: object, event: str, __: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    request = PlanRequest(replace=(("filter0", "Other"),))
    sys.setprofile(note)
    try:
        target = request.target(specification)
        plan = STRATEGIES[strategy](requested_change(configuration, specification, request, target))
    finally:
        sys.setprofile(None)
    assert len(plan.steps) >= 7
    return count


@pytest.mark.parametrize("strategy", sorted(set(STRATEGIES) - {"stop"}))
def test_planning_costs_what_the_change_costs(strategy: str) -> None:
    small, large = cells(5), cells(1500)
    calls_to_plan(small, strategy)
    assert calls_to_plan(large, strategy) <= 1.05 * calls_to_plan(small, strategy)


def test_connectors_of_the_target_alone_are_there_throughout() -> None:
    start = talker()
    target = replace(start, connectors=start.connectors.set("/more", Connector("/more", NEED)))
    target = target.with_node(Node("talker", "Talker", Map({"out": ("/chatter", "/more")})))
    change = change_between(initial(start), start, target)
    assert "/more" in change.start.context.connectors
    assert "/more" not in change.origin.context.connectors
    assert change.in_target_context(change.final).context == target.context

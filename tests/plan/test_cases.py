"""Planning, case by case: each by the name it goes by, with what every strategy must make of it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.codec.form import encode
from midstride.model.action import Create, Handover
from midstride.model.component import (
    EnvironmentGuarantee,
    FunctionalityRef,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterSpec,
)
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.strategies.quiesce import reachable
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.cases import (
    NEED,
    SLOW,
    TYPE,
    adding,
    changed,
    component,
    fallen,
    functionality,
    removing,
    replaced,
    replacing,
    sound,
    system,
    talker,
    told,
    work,
)

EVERY = sorted(STRATEGIES)
# Those that touch only what the change concerns.
LOCAL = [name for name in EVERY if name != "stop"]


# -- the paper's talker and listener -------------------------------------------------------------------


def test_talker_by_the_paper_is_its_seven_steps() -> None:
    plan = sound(replaced(talker(), "talker", "NewTalker", "paper"))
    assert told(plan) == [
        "degrade listener.listen from normal to degraded",
        "detach talker.out from /chatter",
        "remove talker",
        "create talker_2 (NewTalker)",
        "upgrade talker_2.talk from degraded to normal",
        "attach talker_2.out to /chatter",
        "upgrade listener.listen from degraded to normal",
    ]
    # While talker is removed (0.5 s) and talker_2 created (1 s), listen is one level below, and talk, which nobody
    # serves, two: as many as it has modes.
    assert plan.disruption == pytest.approx(1.5 * (1 + 2))
    assert fallen(plan) == ["listener.listen", "talker.talk"]
    assert not plan.proved_minimal
    assert plan.lower_bound == 0.0
    assert plan.seconds == pytest.approx(1.73)


def test_talker_minimal_lets_nothing_fall() -> None:
    plan = sound(replaced(talker(), "talker", "NewTalker", "minimal"))
    assert told(plan) == [
        "create talker_2 (NewTalker)",
        "upgrade talker_2.talk from degraded to normal",
        "hand over /chatter from talker.out to talker_2.out",
        "remove talker",
    ]
    assert (plan.disruption, plan.degraded, plan.proved_minimal) == (0.0, (), True)


def test_talker_by_quiescence_lowers_all_that_it_reaches_first() -> None:
    plan = sound(replaced(talker(), "talker", "NewTalker", "quiesce"))
    assert told(plan)[:2] == [
        "degrade listener.listen from normal to degraded",
        "degrade talker.talk from normal to degraded",
    ]
    assert plan.disruption == pytest.approx(1.5 * (1 + 2))


def test_quiescence_reaches_everything_downstream() -> None:
    """Three levels down the chain, and from a new publisher, which does not run yet."""
    parts = [work("Sensor", outputs=["out"]), work("NewSensor", outputs=["out"])]
    parts += [work("Filter", ["in"], ["out"]), work("Sink", ["in"])]
    nodes = {
        "sensor": ("Sensor", {"out": "/raw"}),
        "one": ("Filter", {"in": "/raw", "out": "/one"}),
        "two": ("Filter", {"in": "/one", "out": "/two"}),
        "sink": ("Sink", {"in": "/two"}),
        "logger": ("Sink", {"in": "/raw"}),
    }
    start = system(parts, nodes)
    running = initial(start)
    change = replacing(running, start, "sensor", "NewSensor")
    assert [str(ref) for ref in reachable(change)] == [
        "logger.work",
        "one.work",
        "sensor.work",
        "sink.work",
        "two.work",
    ]
    second = adding(running, start, Node("second", "Sensor", Map({"out": ("/two",)})))
    assert [str(ref) for ref in reachable(second)] == ["sink.work"]


def test_a_fall_says_why_and_for_how_long() -> None:
    plan = replaced(talker(), "talker", "NewTalker", "paper")
    listener, talk = plan.degradations
    assert (str(listener.functionality), listener.since, listener.until) == ("listener.listen", 1, 7)
    assert listener.seconds == pytest.approx(1.73)
    assert "/chatter has no publisher" in listener.because
    assert "step 2 (`detach talker.out from /chatter`)" in listener.because
    assert (str(talk.functionality), talk.since, talk.until) == ("talker.talk", 2, 6)
    assert "no instance of talker serves it" in talk.because


def test_talker_replaced_again_and_again_never_takes_the_bare_name_back() -> None:
    specification = talker()
    configuration, names = initial(specification), []
    for to in ("NewTalker", "Talker", "NewTalker"):
        change = replacing(configuration, specification, "talker", to)
        plan = sound(STRATEGIES["minimal"](change))
        names += [instance.name for instance in change.coming]
        *_, last = plan.configurations()
        configuration, specification = change.in_target_context(last), change.target
    assert names == ["talker_2", "talker_3", "talker_2"]


# -- the paper's figures 1 to 3 ------------------------------------------------------------------------


def obstacle() -> Specification:
    camera = EnvironmentGuarantee("camera", Predicate("sensor_msgs/msg/Image", 30.0))
    detect = functionality("detect", outputs=["out"], assumes=[Predicate("sensor_msgs/msg/Image", 15.0)])
    control = functionality("control", ["in"], ["cmd"], weight=10, degraded={"cmd": NEED})
    nodes = {
        "detector": ("Detector", {"out": "/obstacles"}),
        "controller": ("Controller", {"in": "/obstacles", "cmd": "/cmd_vel"}),
    }
    detectors = [component(name, detect) for name in ("Detector", "StereoDetector")]
    return system([*detectors, component("Controller", control)], nodes, caps={"/cmd_vel": 1}, environment=[camera])


def test_obstacle_the_motor_notices_nothing_of_a_replacement() -> None:
    plan = sound(replaced(obstacle(), "detector", "StereoDetector", "minimal"))
    assert (plan.disruption, plan.degraded) == (0.0, ())


def test_obstacle_removing_the_detector_stops_the_motor_first() -> None:
    start = obstacle()
    plan = sound(STRATEGIES["minimal"](removing(initial(start), start, "detector")))
    assert told(plan) == [
        "degrade controller.control from normal to degraded",
        "detach detector.out from /obstacles",
        "remove detector",
    ]
    # What the target cannot do either is no loss: the baseline is the worse of both ends.
    assert (plan.disruption, plan.degraded) == (0.0, ())


def test_obstacle_a_detector_again_starts_it() -> None:
    start = obstacle().without_node("detector")
    node = Node("detector", "Detector", Map({"out": ("/obstacles",)}))
    plan = sound(STRATEGIES["minimal"](adding(initial(start), start, node)))
    assert told(plan)[0] == "create detector (Detector)"
    assert told(plan)[-1] == "upgrade controller.control from degraded to normal"


@pytest.mark.parametrize("strategy", EVERY)
def test_obstacle_a_capped_topic_changes_hands_in_one_step(strategy: str) -> None:
    start = obstacle()
    other = replace(start.components["Controller"], name="Other", run="python3 other.py")
    start = replace(start, components=start.components.set("Other", other))
    plan = sound(replaced(start, "controller", "Other", strategy))
    handovers = [step.action for step in plan.steps if isinstance(step.action, Handover)]
    assert len(handovers) == (1 if strategy == "minimal" else 0)
    assert (plan.disruption == 0.0) == (strategy == "minimal")
    for configuration in plan.configurations():
        assert len(configuration.publishers_on("/cmd_vel")) <= 1


# -- chains, diamonds, alternatives --------------------------------------------------------------------


def chain() -> Specification:
    components = [work("Source", outputs=["out"]), work("Filter", ["in"], ["out"]), work("Median", ["in"], ["out"])]
    nodes = {
        "source": ("Source", {"out": "/raw"}),
        "filter": ("Filter", {"in": "/raw", "out": "/clean"}),
        "sink": ("Sink", {"in": "/clean"}),
    }
    return system([*components, work("Sink", ["in"])], nodes)


def test_filter_in_a_chain_minimal() -> None:
    plan = sound(replaced(chain(), "filter", "Median", "minimal"))
    assert told(plan) == [
        "create filter_2 (Median)",
        "attach filter_2.in to /raw",
        "upgrade filter_2.work from degraded to normal",
        "hand over /clean from filter.out to filter_2.out",
        "degrade filter.work from normal to degraded",
        "detach filter.in from /raw",
        "remove filter",
    ]
    assert plan.proved_minimal


def test_filter_in_a_chain_by_the_paper_detaches_outputs_first() -> None:
    plan = sound(replaced(chain(), "filter", "Median", "paper"))
    assert told(plan) == [
        "degrade sink.work from normal to degraded",
        "detach filter.out from /clean",
        "degrade filter.work from normal to degraded",
        "detach filter.in from /raw",
        "remove filter",
        "create filter_2 (Median)",
        "attach filter_2.in to /raw",
        "upgrade filter_2.work from degraded to normal",
        "attach filter_2.out to /clean",
        "upgrade sink.work from degraded to normal",
    ]


def diamond() -> Specification:
    """source -> left, right -> sink: the sink is reached twice."""
    parts = [work(name, ["in"], ["out"]) for name in ("Left", "Right")]
    sources = [work(name, outputs=["out"]) for name in ("Source", "Other")]
    nodes = {
        "source": ("Source", {"out": "/raw"}),
        "left": ("Left", {"in": "/raw", "out": "/left"}),
        "right": ("Right", {"in": "/raw", "out": "/right"}),
        "sink": ("Sink", {"one": "/left", "two": "/right"}),
    }
    return system([*sources, *parts, work("Sink", ["one", "two"])], nodes)


def test_diamond_by_the_paper_lowers_the_one_reached_twice_once_and_first() -> None:
    plan = sound(replaced(diamond(), "source", "Other", "paper"))
    assert told(plan)[:4] == [
        "degrade sink.work from normal to degraded",
        "degrade right.work from normal to degraded",
        "degrade left.work from normal to degraded",
        "detach source.out from /raw",
    ]
    assert told(plan)[-3:] == [
        "upgrade left.work from degraded to normal",
        "upgrade right.work from degraded to normal",
        "upgrade sink.work from degraded to normal",
    ]


def test_diamond_minimal() -> None:
    assert sound(replaced(diamond(), "source", "Other", "minimal")).degraded == ()


def two_eyes(*, alternatives: bool) -> Specification:
    eyes = [work(name, outputs=["out"]) for name in ("Eye", "NewEye")]
    assumes = [InputAlternatives(("left", "right"))] if alternatives else None
    see = component("Stereo", functionality("see", ["left", "right"], assumes=assumes))
    nodes = {
        "left": ("Eye", {"out": "/left"}),
        "right": ("Eye", {"out": "/right"}),
        "stereo": ("Stereo", {"left": "/left", "right": "/right"}),
    }
    return system([*eyes, see], nodes)


def test_stereo_the_right_eye_does_not_make_good_for_the_left() -> None:
    plan = sound(replaced(two_eyes(alternatives=False), "left", "NewEye", "paper"))
    assert "stereo.see" in fallen(plan)
    assert sound(replaced(two_eyes(alternatives=False), "left", "NewEye", "minimal")).degraded == ()


def test_redundant_eyes_do() -> None:
    plan = sound(replaced(two_eyes(alternatives=True), "left", "NewEye", "paper"))
    assert fallen(plan) == ["left.work"]


@pytest.mark.parametrize("strategy", LOCAL)
def test_an_input_on_two_topics_stands_on_the_other(strategy: str) -> None:
    eyes = [work(name, outputs=["out"]) for name in ("Eye", "NewEye")]
    nodes: dict[str, tuple[str, dict[str, str | tuple[str, ...]]]] = {
        "a": ("Eye", {"out": "/a"}),
        "b": ("Eye", {"out": "/b"}),
        "user": ("User", {"in": ("/a", "/b")}),
    }
    plan = sound(replaced(system([*eyes, work("User", ["in"])], nodes), "a", "NewEye", strategy))
    assert ("user.work" in fallen(plan)) == (strategy == "quiesce")


# -- cycles ----------------------------------------------------------------------------------------------


def cycle() -> Specification:
    """Two that feed each other, each silent when degraded, and one that listens to the first."""
    components = [work(name, ["in"], ["out"]) for name in ("Ping", "Pong", "NewPing")]
    nodes = {
        "ping": ("Ping", {"in": "/pong", "out": "/ping"}),
        "pong": ("Pong", {"in": "/ping", "out": "/pong"}),
        "sink": ("Sink", {"in": "/ping"}),
    }
    return system([*components, work("Sink", ["in"])], nodes)


def test_cycle_stands_at_the_start() -> None:
    assert set(initial(cycle()).modes.values()) == {0}


@pytest.mark.parametrize("strategy", EVERY)
def test_cycle_is_replaced_by_every_strategy(strategy: str) -> None:
    plan = sound(replaced(cycle(), "ping", "NewPing", strategy))
    groups = [step for step in plan.steps if len(step.modes) > 1]
    if strategy == "minimal":
        assert plan.degraded == ()
    else:
        assert told(plan)[:2] == [
            "degrade sink.work from normal to degraded",
            "degrade ping.work from normal to degraded, pong.work from normal to degraded",
        ]
        assert [len(step.modes) for step in groups] == [2, 2]


@pytest.mark.parametrize("strategy", EVERY)
def test_cycle_is_brought_up_from_nothing(strategy: str) -> None:
    start = replace(cycle(), nodes=Map())
    plan = sound(changed(start, cycle(), strategy))
    assert [len(step.modes) for step in plan.steps if step.modes] == [2, 1]


# -- rewiring, contracts, parameters -----------------------------------------------------------------


def test_rewiring_attaches_before_it_detaches() -> None:
    parts = [work("Source", outputs=["out"]), work("User", ["in"])]
    sources = {"a": ("Source", {"out": "/a"}), "b": ("Source", {"out": "/b"})}
    start = system(parts, {**sources, "user": ("User", {"in": "/a"})})
    target = system(parts, {**sources, "user": ("User", {"in": "/b"})})
    plan = sound(changed(start, target, "minimal"))
    assert told(plan) == ["attach user.in to /b", "detach user.in from /a"]
    by_paper = sound(changed(start, target, "paper"))
    assert told(by_paper) == [
        "degrade user.work from normal to degraded",
        "detach user.in from /a",
        "attach user.in to /b",
        "upgrade user.work from degraded to normal",
    ]


@pytest.mark.parametrize("strategy", EVERY)
def test_a_topic_whose_contract_differs_is_another_topic(strategy: str) -> None:
    parts = [work("Source", outputs=["out"]), work("User", ["in"], needs={"in": SLOW})]
    nodes = {"source": ("Source", {"out": "/x"}), "user": ("User", {"in": "/x"})}
    start, target = system(parts, nodes, topics={"/x": SLOW}), system(parts, nodes, topics={"/x": NEED})
    plan = sound(changed(start, target, strategy))
    new = plan.change.start.context.connectors["/x@2"]
    assert (new.name, new.topic, new.guarantee) == ("/x@2", "/x", NEED)
    assert plan.change.start.context.connectors["/x"].guarantee == SLOW
    if strategy == "minimal":
        assert told(plan) == [
            "attach source.out to /x@2",
            "attach user.in to /x@2",
            "detach source.out from /x",
            "detach user.in from /x",
        ]
    *_, last = plan.configurations()
    reached = plan.change.in_target_context(last)
    assert reached == initial(target)


def test_a_topic_that_nobody_uses_changes_its_contract_in_place() -> None:
    parts = [work("Source", outputs=["out"])]
    start = system(parts, {"source": ("Source", {})}, topics={"/x": SLOW})
    target = system(parts, {"source": ("Source", {"out": "/x"})}, topics={"/x": NEED})
    assert told(sound(changed(start, target, "minimal"))) == ["attach source.out to /x"]


def tuned(value: float, *, changeable: bool) -> Specification:
    parameter = ParameterSpec(0.4, changeable=changeable)
    one = work("Detector", outputs=["out"], parameters={"threshold": parameter})
    specification = system([one], {"detector": ("Detector", {"out": "/x"})})
    node = replace(specification.nodes["detector"], parameters=Map({"threshold": value}))
    return specification.with_node(node)


@pytest.mark.parametrize("strategy", LOCAL)
def test_a_changeable_parameter_is_set_in_place(strategy: str) -> None:
    plan = sound(changed(tuned(0.4, changeable=True), tuned(0.6, changeable=True), strategy))
    assert told(plan)[-1:] == ["set threshold = 0.6 on detector"]
    assert len(plan.steps) == 1


@pytest.mark.parametrize("strategy", EVERY)
def test_another_parameter_asks_for_a_replacement(strategy: str) -> None:
    plan = sound(changed(tuned(0.4, changeable=False), tuned(0.6, changeable=False), strategy))
    (created,) = [step.action for step in plan.steps if isinstance(step.action, Create)]
    assert created.instance.name == "detector_2"
    assert created.instance.parameters["threshold"] == 0.6


@pytest.mark.parametrize("strategy", LOCAL)
def test_another_name_of_the_same_body_changes_nothing(strategy: str) -> None:
    start = talker()
    same = replace(start.components["Talker"], name="Speaker")
    target = replace(start, components=start.components.set("Speaker", same)).with_replaced("talker", "Speaker")
    plan = changed(start, target, strategy)
    assert plan.steps == ()
    assert plan.change.in_target_context(plan.change.start).component("talker").name == "Speaker"


@pytest.mark.parametrize("strategy", EVERY)
def test_namespaced_roles(strategy: str) -> None:
    start = talker()
    nodes = {f"robot1/{role}": replace(node, role=f"robot1/{role}") for role, node in start.nodes.items()}
    plan = sound(replaced(replace(start, nodes=Map(nodes)), "robot1/talker", "NewTalker", strategy))
    assert any(step.describe() == "create robot1/talker_2 (NewTalker)" for step in plan.steps)
    assert plan.change.replaced == Map({"robot1/talker": "robot1/talker_2"})


# -- from nothing, and after a crash ---------------------------------------------------------------------


@pytest.mark.parametrize("strategy", EVERY)
def test_a_whole_system_is_brought_up_under_its_own_names(strategy: str) -> None:
    specification = diamond()
    empty = replace(initial(specification), instances=Map(), connectors_of=Map(), modes=Map())
    empty = replace(empty, publishers=Map(), subscribers=Map(), held=Map(), instances_by_role=Map())
    plan = sound(STRATEGIES[strategy](change_between(empty, specification, specification)))
    *_, last = plan.configurations()
    assert last == initial(specification)
    assert (plan.disruption, plan.degraded) == (0.0, ())


@pytest.mark.parametrize("strategy", LOCAL)
def test_what_has_crashed_comes_again(strategy: str) -> None:
    specification = chain()
    configuration = initial(specification).without_instance("filter")
    configuration = configuration.with_modes({FunctionalityRef("sink", "work"): 1})
    plan = sound(STRATEGIES[strategy](change_between(configuration, specification, specification)))
    *_, last = plan.configurations()
    assert last == initial(specification)
    assert plan.degraded == ()


def test_what_stands_lower_than_it_could_is_raised() -> None:
    specification = chain()
    low = {FunctionalityRef("sink", "work"): 1, FunctionalityRef("filter", "work"): 1}
    plan = sound(
        STRATEGIES["minimal"](change_between(initial(specification).with_modes(low), specification, specification))
    )
    assert told(plan) == ["upgrade filter.work from degraded to normal", "upgrade sink.work from degraded to normal"]
    assert fallen(plan) == ["filter.work", "sink.work"]


def test_a_topic_is_handed_over_although_something_is_degraded_at_the_start() -> None:
    """Attaching the new publisher beside the old one would be quicker, and both would be heard."""
    specification = chain()
    low = {FunctionalityRef("sink", "work"): 1}
    target = specification.with_replaced("filter", "Median")
    plan = sound(STRATEGIES["minimal"](change_between(initial(specification).with_modes(low), specification, target)))
    kinds = [step.action.kind for step in plan.steps]
    assert kinds == ["upgrade", "create", "attach", "upgrade", "handover", "degrade", "detach", "remove"]


def test_what_the_new_environment_keeps_down_is_told_as_fallen() -> None:
    """A camera has failed, the eye has gone down by itself; the target gives it up and adds another source."""
    image = Predicate("sensor_msgs/msg/Image", 30.0)
    see = component("Eye", functionality("see", ["in"], assumes=[Predicate(image.type, 15.0)]), needs={"in": image})
    source = FunctionalitySpec("work", (Mode("normal", (), Map({"out": image})), Mode("degraded")), (), ("out",))
    start = system(
        [see, component("Source", source)],
        {"eye": ("Eye", {"in": "/image"})},
        environment=[EnvironmentGuarantee("camera", image)],
        topics={"/image": image},
    )
    target = replace(start.with_node(Node("source", "Source", Map({"out": ("/image",)}))), environment=())
    configuration = initial(start).with_modes({FunctionalityRef("eye", "see"): 1})
    plan = sound(STRATEGIES["minimal"](change_between(configuration, start, target)))
    assert fallen(plan) == ["eye.see"]
    assert plan.degradations[0].because == "it is already below when the plan begins"
    # While the source comes (1 s) the eye is a level below what it was when its camera still worked.
    assert plan.disruption == pytest.approx(1.0)


def test_more_environment_raises_who_waited_for_it() -> None:
    see = component("Eye", functionality("see", assumes=[Predicate(TYPE, 10.0)]))
    start = system([see], {"eye": ("Eye", {})})
    target = replace(start, environment=(EnvironmentGuarantee("lamp", NEED),))
    plan = sound(changed(start, target, "minimal"))
    assert told(plan) == ["upgrade eye.see from degraded to normal"]
    assert plan.degraded == ()


@pytest.mark.parametrize("strategy", EVERY)
def test_what_a_replacement_never_comes_up_to_is_told(strategy: str) -> None:
    """The new talker needs a lamp that nobody has: below no baseline on the way, and lower for good."""
    blind = component("Blind", functionality("talk", outputs=["out"], assumes=[Predicate(TYPE, 10.0)]))
    start = talker()
    start = replace(start, components=start.components.set("Blind", blind))
    plan = sound(replaced(start, "talker", "Blind", strategy))
    assert plan.disruption == 0.0 or strategy != "minimal"
    assert [encode(shift) for shift in plan.level_shifts] == [
        {"functionality": "listener.listen", "from": "normal", "to": "degraded", "levels": 1},
        {"functionality": "talker.talk", "from": "normal", "to": "degraded", "levels": 1},
    ]
    assert replaced(talker(), "talker", "NewTalker", strategy).level_shifts == ()

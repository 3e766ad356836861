"""Named cases: what the model says of systems small enough to see through."""

from __future__ import annotations

import pytest
from immutables import Map

from midstride.model.action import Attach, Create, Degrade, Detach, Upgrade
from midstride.model.best import best, rebalanced
from midstride.model.component import Assumption, Connector, EnvironmentGuarantee
from midstride.model.configuration import Configuration, Instance, SystemContext, configure
from midstride.model.diagnosis import reasons_against
from midstride.model.rules import Evaluator, publishers_count, violations
from tests.model.build import (
    at,
    component,
    filter_,
    mode,
    modes_of,
    named,
    port,
    sink,
    source,
    system,
    work,
)


def without(configuration: Configuration, attachment: str) -> Configuration:
    """In ``best`` of what remains when the attachment is gone."""
    name, topic = attachment.split()
    return best(configuration.without_attachment(port(name), topic))


# -- alternatives and what are none ------------------------------------------------------------------------

PAIR = ["left_camera.out /left", "right_camera.out /right"]


def pair_of_cameras(assumes: list[Assumption]) -> Configuration:
    """Two alike cameras and one that uses both, with ``assumes`` in its normal mode."""
    user = component(
        "User",
        {"left": at(5), "right": at(5)},
        ["out"],
        [mode("normal", assumes, out=at(5)), mode("degraded")],
    )
    return best(
        system(
            {"left_camera": source("Left"), "right_camera": source("Right"), "user": user},
            [*PAIR, "user.left /left", "user.right /right", "user.out /out"],
        )
    )


def test_stereo_needs_both_by_name() -> None:
    configuration = pair_of_cameras([named("left"), named("right")])
    assert modes_of(configuration)["user"] == "normal"
    assert modes_of(without(configuration, PAIR[0]))["user"] == "degraded"  # the right one does not make good the left
    assert modes_of(without(configuration, PAIR[1]))["user"] == "degraded"


def test_predicates_cannot_tell_left_from_right() -> None:
    """The paper's form: alike inputs are alternatives, even where it is written twice."""
    configuration = pair_of_cameras([at(5), at(5)])
    assert modes_of(without(configuration, PAIR[0]))["user"] == "normal"
    assert modes_of(without(without(configuration, PAIR[0]), PAIR[1]))["user"] == "degraded"


@pytest.mark.parametrize("assumes", [[named("left", "right")], [at(5)]], ids=["named", "predicate"])
def test_front_and_rear_as_alternatives(assumes: list[Assumption]) -> None:
    configuration = pair_of_cameras(assumes)
    assert modes_of(without(configuration, PAIR[0]))["user"] == "normal"
    assert modes_of(without(configuration, PAIR[1]))["user"] == "normal"
    assert modes_of(without(without(configuration, PAIR[0]), PAIR[1]))["user"] == "degraded"


def test_front_and_rear_with_modes_between() -> None:
    """Driving needs both, crawling forwards the front one alone."""
    driver = component(
        "Driver",
        {"front": at(5), "rear": at(5)},
        [],
        [mode("drive", [named("front"), named("rear")]), mode("crawl", [named("front")]), mode("stop")],
    )
    attachments = ["f.out /front", "r.out /rear", "driver.front /front", "driver.rear /rear"]
    configuration = best(system({"f": source("F"), "r": source("R"), "driver": driver}, attachments))
    assert modes_of(configuration)["driver"] == "drive"
    assert modes_of(without(configuration, "r.out /rear"))["driver"] == "crawl"
    assert modes_of(without(configuration, "f.out /front"))["driver"] == "stop"


def test_a_predicate_counts_only_inputs_whose_own_assumption_satisfies_it() -> None:
    """The chain of the paper: connector to input assumption, input assumption to the functionality's."""
    picky = component("Picky", {"in": at(1)}, [], [mode("normal", [at(5)]), mode("degraded")])
    configuration = best(system({"source": source(), "picky": picky}, ["source.out /t", "picky.in /t"]))
    assert modes_of(configuration)["picky"] == "degraded"  # 10 Hz arrive, but the input promises no more than 1 Hz


# -- shapes --------------------------------------------------------------------------------------------------


def test_redundant_publishers() -> None:
    configuration = best(
        system({"a": source("A"), "b": source("B"), "sink": sink()}, ["a.out /t", "b.out /t", "sink.in /t"])
    )
    assert not Detach(port("a.out"), "/t").check(configuration)
    one = without(configuration, "a.out /t")
    assert modes_of(one)["sink"] == "normal"
    reasons = Detach(port("b.out"), "/t").check(one)
    assert [reason.precondition for reason in reasons] == ["satisfied"]
    assert "sink.work" in reasons[0].subjects


def test_redundant_topics_for_one_input() -> None:
    """An input attached to several topics is satisfied by any of them."""
    attachments = ["a.out /s", "b.out /t", "sink.in /s", "sink.in /t"]
    configuration = best(system({"a": source("A"), "b": source("B"), "sink": sink()}, attachments))
    assert modes_of(without(configuration, "a.out /s"))["sink"] == "normal"
    assert modes_of(without(without(configuration, "a.out /s"), "b.out /t"))["sink"] == "degraded"


def diamond(*, join: list[Assumption]) -> Configuration:
    joiner = component("Join", {"l": at(5), "r": at(5)}, [], [mode("normal", join), mode("degraded")])
    return best(
        system(
            {"top": source(), "left": filter_("Left"), "right": filter_("Right"), "bottom": joiner},
            [
                *("top.out /top", "left.in /top", "right.in /top", "left.out /l", "right.out /r"),
                *("bottom.l /l", "bottom.r /r"),
            ],
        )
    )


def test_diamond_falls_together_and_rises_together() -> None:
    configuration = diamond(join=[named("l"), named("r")])
    assert set(modes_of(configuration).values()) == {"normal"}
    dark = configuration.without_attachment(port("top.out"), "/top")
    changes = rebalanced(dark, dark.consumers("/top"))
    assert changes == {work("left"): 1, work("right"): 1, work("bottom"): 1}
    back = dark.with_modes(changes).with_attachment(port("top.out"), "/top")
    assert back.with_modes(rebalanced(back, back.consumers("/top"))) == configuration


def test_diamond_with_one_side_down() -> None:
    assert modes_of(without(diamond(join=[named("l"), named("r")]), "left.out /l"))["bottom"] == "degraded"
    assert modes_of(without(diamond(join=[named("l", "r")]), "left.out /l"))["bottom"] == "normal"


def ring() -> Configuration:
    """Two that live on each other alone."""
    attachments = ["a.in /ba", "a.out /ab", "b.in /ab", "b.out /ba"]
    return system({"a": filter_("A"), "b": filter_("B")}, attachments)


def test_cycle_stands_in_best_though_no_single_step_leads_there() -> None:
    low = ring()
    configuration = best(low)
    assert modes_of(configuration) == {"a": "normal", "b": "normal"}
    assert not violations(low)
    assert not violations(configuration)
    for ref in (work("a"), work("b")):
        assert Upgrade(Map({ref: 0})).check(low)
        assert Degrade(Map({ref: 1})).check(configuration)


def test_cycle_rises_and_falls_as_a_group() -> None:
    low = ring()
    both = Upgrade(Map({work("a"): 0, work("b"): 0}))
    assert both.apply(low) == best(low)
    (undo,) = both.undo(low)
    assert undo.apply(best(low)) == low


def test_cycle_falls_whole_when_it_is_cut() -> None:
    configuration = best(ring())
    cut = configuration.without_attachment(port("b.in"), "/ab")
    assert rebalanced(cut, [work("b")]) == {work("a"): 1, work("b"): 1}


def test_long_chain_tells_why() -> None:
    instances = {"detector": filter_("Detector"), "planner": filter_("Planner"), "motor": sink(), "camera": source()}
    upstream = ["detector.in /image", "detector.out /obstacles"]
    configuration = best(system(instances, [*upstream, "planner.in /obstacles", "planner.out /path", "motor.in /path"]))
    reasons = reasons_against(configuration, work("motor"))
    assert [reason.split()[0] for reason in reasons] == ["motor.work", "planner.work", "detector.work"]
    assert reasons[0] == (
        "motor.work cannot be in mode normal: it assumes in: no publisher satisfies /path"
        " (planner.out in mode degraded: nothing is guaranteed)"
    )
    assert reasons[-1] == ("detector.work cannot be in mode normal: it assumes in: /image has no publisher")
    assert reasons_against(configuration, work("camera")) == ()


# -- the environment, caps, resources ----------------------------------------------------------------------------


def test_environment_on_a_topic_satisfies_that_topic_and_nothing_else() -> None:
    outside = EnvironmentGuarantee("recording", at(10), "/t")
    by_predicate = component("ByPredicate", {}, [], [mode("normal", [at(5)]), mode("degraded")])
    instances = {"sink": sink(), "other": sink("Other"), "predicate": by_predicate}
    configuration = best(system(instances, ["sink.in /t", "other.in /u"], environment=[outside]))
    assert modes_of(configuration) == {"sink": "normal", "other": "degraded", "predicate": "degraded"}


def test_environment_without_a_topic_satisfies_predicates_alone() -> None:
    device = EnvironmentGuarantee("camera_device", at(10))
    by_predicate = component("ByPredicate", {}, [], [mode("normal", [at(5)]), mode("degraded")])
    configuration = best(system({"sink": sink(), "predicate": by_predicate}, ["sink.in /t"], environment=[device]))
    assert modes_of(configuration) == {"sink": "degraded", "predicate": "normal"}


def test_a_weak_environment_satisfies_nothing_but_counts_against_the_cap() -> None:
    weak = EnvironmentGuarantee("slow", at(1), "/t")
    configuration = system({"source": source(), "sink": sink()}, ["sink.in /t"], environment=[weak], caps={"/t": 1})
    assert not Evaluator(configuration).connector_satisfied("/t")
    (reason,) = Attach(port("source.out"), "/t").check(configuration)
    assert reason.precondition == "cap"
    assert "2 publishers (environment slow, source.out), at most 1 allowed" in reason.because


def test_caps_count_silent_outputs() -> None:
    configuration = system({"a": source("A"), "b": source("B")}, ["a.out /t"], caps={"/t": 1})
    assert modes_of(configuration)["a"] == "degraded"  # it publishes nothing at all
    (reason,) = Attach(port("b.out"), "/t").check(configuration)
    assert reason.precondition == "cap"
    assert reason.subjects == ("b.out", "/t")


def test_a_cap_that_the_environment_alone_exceeds_is_a_violation() -> None:
    crowd = [EnvironmentGuarantee(name, at(10), "/t") for name in ("one", "two")]
    configuration = system({}, [], topics={"/t": at(5)}, environment=crowd, caps={"/t": 1})
    assert [violation.kind for violation in violations(configuration)] == ["cap"]


def test_resources_are_summed_as_they_are_written() -> None:
    third = source("Third", resource_usage={"gpu": 0.1})
    configuration = system(
        {"a": source("A", resource_usage={"gpu": 0.1}), "b": source("B", resource_usage={"gpu": 0.1})},
        [],
        resources={"gpu": 0.3},
    )
    full = Create(Instance("c", "c", third)).apply(configuration)  # 0.1 + 0.1 + 0.1 is 0.3 here, though not in floats
    (reason,) = Create(Instance("d", "d", third)).check(full)
    assert reason.precondition == "capacity"
    assert "0.4 held by a, b, c, d, but the capacity is 0.3" in reason.because


def test_a_resource_that_is_not_declared_has_capacity_one() -> None:
    device = source("Device", resource_usage={"/dev/video0": 1.0})
    configuration = system({"a": device}, [])
    assert not violations(configuration)
    (reason,) = Create(Instance("b", "b", device)).check(configuration)
    assert reason.precondition == "capacity"


# -- what only an unusual structure shows ----------------------------------------------------------------


def test_an_attachment_to_no_topic_is_not_valid() -> None:
    configuration = system({"talker": source()}, []).with_attachment(port("talker.out"), "/nowhere")
    assert [(each.kind, each.names) for each in violations(configuration)] == [
        ("attachment", ("talker.out", "/nowhere"))
    ]


def test_a_functionality_downstream_of_a_gain_rises_only_as_far_as_its_other_input_allows() -> None:
    join = component("Join", {"a": at(5), "b": at(5)}, [], [mode("normal", [named("a"), named("b")]), mode("degraded")])
    attachments = ["raw.out /raw", "filter.out /clean", "join.a /clean", "join.b /missing"]
    before = best(system({"raw": source(), "filter": filter_(), "join": join}, attachments))
    after = before.with_attachment(port("filter.in"), "/raw")
    assert rebalanced(after, [work("filter")]) == {work("filter"): 0}


def test_the_environment_publishes_on_the_topic_whatever_the_connector_is_called() -> None:
    """While a topic's contract changes, its second connector has another name, and the same topic."""
    context = SystemContext(
        Map({"/x@2": Connector("/x@2", at(5), topic="/x")}), (EnvironmentGuarantee("outside", at(10), "/x"),)
    )
    configuration = configure(context, [Instance("sink", "sink", sink())], [(port("sink.in"), "/x@2")])
    assert modes_of(best(configuration)) == {"sink": "normal"}
    assert publishers_count(configuration, "/x@2") == 1

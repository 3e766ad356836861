"""Each action: what it asks, what it does, and what it says when it is refused (docs/semantics.md section 4)."""

from __future__ import annotations

import pytest
from immutables import Map

from midstride.errors import ActionRefused
from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Swap,
    Upgrade,
)
from midstride.model.best import best
from midstride.model.component import ComponentSpec, ParameterSpec
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import violations
from tests.model.build import at, component, filter_, mode, named, port, sink, source, system, work


def talker_and_listener(*, rate: float = 10.0) -> Configuration:
    instances = {"talker": source("Talker", rate), "listener": sink("Listener")}
    return best(system(instances, ["talker.out /chatter", "listener.in /chatter"]))


def refused(action: Action, configuration: Configuration) -> list[tuple[str, tuple[str, ...]]]:
    """The failed preconditions with their subjects; the message holds every reason, and nothing has changed."""
    with pytest.raises(ActionRefused) as error:
        action.apply(configuration)
    assert str(error.value) == f"cannot {action.describe(configuration)}: " + "; ".join(
        str(reason) for reason in action.check(configuration)
    )
    return [(reason.precondition, reason.subjects) for reason in action.check(configuration)]


def because(action: Action, configuration: Configuration) -> str:
    return "; ".join(reason.because for reason in action.check(configuration))


def test_create() -> None:
    configuration = talker_and_listener()
    create = Create(Instance("talker_2", "talker", source("NewTalker")))
    after = create.apply(configuration)
    assert after.modes[work("talker_2")] == 1
    assert after.attached_ports("talker_2") == []
    assert [instance.name for instance in after.instances_of("talker")] == ["talker", "talker_2"]
    assert refused(create, after) == [("not live", ("talker_2",))]


def test_the_effect_of_a_create_that_is_refused_replaces_what_has_the_name() -> None:
    """A verification goes on after a step that is not allowed, whatever role the new instance has."""
    after = Create(Instance("talker", "other", source("NewTalker"))).effect(talker_and_listener())
    assert after.attached_ports("talker") == []
    assert not after.publishers_on("/chatter") and not after.instances_of("talker")
    assert [instance.component.name for instance in after.instances_of("other")] == ["NewTalker"]


def test_remove_asks_for_isolation_and_undoes_with_its_modes() -> None:
    configuration = talker_and_listener()
    assert refused(Remove("talker"), configuration) == [("isolated", ("talker.out", "/chatter"))]
    assert refused(Remove("nobody"), configuration) == [("live", ("nobody",))]
    alone = best(system({"talker": source("Talker")}, []))
    undo = Remove("talker").undo(alone)
    configuration, words = Remove("talker").apply(alone), []
    for step in undo:
        words.append(step.describe(configuration))
        configuration = step.apply(configuration)
    assert words == ["create talker (Talker)", "upgrade talker.work from degraded to normal"]
    assert configuration == alone


def test_attach_an_output_is_judged_by_its_normal_mode() -> None:
    """Else no cycle could be brought up: it is in its last mode when it is attached."""
    configuration = system({"talker": source()}, [], topics={"/chatter": at(5)})
    assert configuration.modes[work("talker")] == 1
    assert Attach(port("talker.out"), "/chatter").apply(configuration).is_attached(port("talker.out"), "/chatter")


def test_attach_says_clause_by_clause_what_does_not_fit() -> None:
    configuration = system({"talker": source(rate=1.0), "listener": sink(needs=7.0)}, [], topics={"/chatter": at(5)})
    assert refused(Attach(port("talker.out"), "/chatter"), configuration) == [("contract", ("talker.out", "/chatter"))]
    told = because(Attach(port("talker.out"), "/chatter"), configuration)
    assert (
        told == "talker.out in mode normal does not satisfy /chatter (rate: 1 Hz is offered, at least 5 Hz is needed)"
    )
    told = because(Attach(port("listener.in"), "/chatter"), configuration)
    assert told == "/chatter does not satisfy what listener.in assumes (rate: 5 Hz is offered, at least 7 Hz is needed)"


def test_attach_names_what_is_unknown() -> None:
    configuration = talker_and_listener()
    assert refused(Attach(port("nobody.out"), "/chatter"), configuration) == [("live", ("nobody",))]
    assert refused(Attach(port("talker.mouth"), "/chatter"), configuration) == [("port", ("talker.mouth",))]
    assert refused(Attach(port("talker.out"), "/nowhere"), configuration) == [("topic", ("/nowhere",))]
    assert refused(Attach(port("talker.out"), "/chatter"), configuration) == [
        ("not attached", ("talker.out", "/chatter"))
    ]


def test_detach_names_who_would_be_left_unsatisfied() -> None:
    configuration = talker_and_listener()
    assert refused(Detach(port("talker.out"), "/chatter"), configuration) == [
        ("satisfied", ("listener.work", "listener.in", "/chatter", "talker.out"))
    ]
    assert because(Detach(port("talker.out"), "/chatter"), configuration) == (
        "listener.work in mode normal would be unsatisfied: it assumes in: /chatter has no publisher"
    )
    assert "input listener.in is not attached" in because(Detach(port("listener.in"), "/chatter"), configuration)
    assert refused(Detach(port("listener.in"), "/nowhere"), configuration)[0][0] == "topic"
    low = Degrade(Map({work("listener"): 1})).apply(configuration)
    gone = Detach(port("talker.out"), "/chatter").apply(low)
    assert refused(Detach(port("talker.out"), "/chatter"), gone)[0][0] == "attached"


def test_degrade_protects_those_outside_the_group() -> None:
    configuration = talker_and_listener()
    assert refused(Degrade(Map({work("talker"): 1})), configuration) == [
        ("satisfied", ("listener.work", "listener.in", "/chatter", "talker.out"))
    ]
    assert because(Degrade(Map({work("talker"): 1})), configuration) == (
        "listener.work in mode normal would be unsatisfied: it assumes in: no publisher satisfies /chatter"
        " (talker.out in mode degraded: nothing is guaranteed)"
    )
    both = Degrade(Map({work("talker"): 1, work("listener"): 1}))
    assert not violations(both.apply(configuration))


def test_degrade_does_not_answer_for_what_was_unsatisfied_before() -> None:
    """After a crash several degrade one by one: the step of one must not wait for the steps of the others."""
    modes = [mode("normal", out=at(10)), mode("slow", out=at(1)), mode("degraded")]
    instances = {"talker": component("Talker", {}, ["out"], modes), "listener": sink("Listener")}
    slow = {"talker.work": 1, "listener.work": 0}
    configuration = system(instances, ["talker.out /chatter", "listener.in /chatter"], modes=slow)
    assert violations(configuration)
    assert Degrade(Map({work("talker"): 2})).check(configuration) == ()


def test_degrade_to_a_mode_whose_own_assumptions_do_not_hold() -> None:
    """Each of F must be satisfied in its new mode, better than the last or not."""
    choosy = component(
        "Choosy",
        {"fast": at(5), "slow": at(5)},
        [],
        [mode("fast", [named("fast")]), mode("slow", [named("slow")]), mode("stop")],
    )
    configuration = best(system({"source": source(), "choosy": choosy}, ["source.out /t", "choosy.fast /t"]))
    assert refused(Degrade(Map({work("choosy"): 1})), configuration)[0][0] == "satisfied"
    assert not violations(Degrade(Map({work("choosy"): 2})).apply(configuration))


def test_mode_changes_must_be_strict_and_known() -> None:
    configuration = talker_and_listener()
    assert refused(Degrade(Map()), configuration) == [("named", ())]
    assert refused(Upgrade(Map({work("talker"): 0})), configuration) == [("mode", ("talker.work",))]
    assert refused(Degrade(Map({work("talker"): 2})), configuration) == [("mode", ("talker.work",))]
    assert refused(Degrade(Map({work("talker"): -1})), configuration) == [("mode", ("talker.work",))]
    assert refused(Degrade(Map({work("nobody"): 1})), configuration) == [("live", ("nobody.work",))]


def test_upgrade_asks_only_for_its_own_assumptions() -> None:
    instances = {"talker": source(), "listener": sink()}
    configuration = system(instances, ["talker.out /chatter", "listener.in /chatter"])
    assert refused(Upgrade(Map({work("listener"): 0})), configuration)[0][0] == "satisfied"
    up = Upgrade(Map({work("talker"): 0})).apply(configuration)
    assert not violations(Upgrade(Map({work("listener"): 0})).apply(up))


# -- hand-over -------------------------------------------------------------------------------------------------


def two_talkers(new: ComponentSpec, *, raised: bool = True, caps: dict[str, int] | None = None) -> Configuration:
    instances = {"talker": source("Talker"), "talker_2": new, "listener": sink("Listener")}
    configuration = system(instances, ["talker.out /chatter", "listener.in /chatter"], caps=caps)
    high = best(configuration)
    return high if raised else high.with_modes({work("talker_2"): 1})


SWAP = Swap("/chatter", port("talker.out"), port("talker_2.out"))


def test_handover_swaps_in_one_step_under_a_cap() -> None:
    configuration = two_talkers(source("New"), caps={"/chatter": 1})
    after = Handover((SWAP,)).apply(configuration)
    assert list(after.publishers_on("/chatter")) == [port("talker_2.out")]
    assert not violations(after)
    assert Handover((SWAP,)).undo(configuration) == (
        Handover((Swap("/chatter", port("talker_2.out"), port("talker.out")),)),
    )


def test_handover_is_judged_by_the_current_mode_of_the_new() -> None:
    configuration = two_talkers(source("New"), raised=False)
    assert refused(Handover((SWAP,)), configuration) == [("contract", ("talker.out", "talker_2.out", "/chatter"))]
    assert "talker_2.out in its current mode does not satisfy /chatter" in because(Handover((SWAP,)), configuration)


def test_handover_is_judged_before_any_swap() -> None:
    configuration = two_talkers(source("New"))
    back = Swap("/chatter", port("talker_2.out"), port("talker.out"))
    assert {kind for kind, _ in refused(Handover((SWAP, back)), configuration)} == {
        "old attached",
        "new not attached",
        "once",
    }
    assert [kind for kind, _ in refused(Handover((SWAP, SWAP)), configuration)] == ["once", "once"]
    assert refused(Handover(()), configuration) == [("named", ())]


def test_handover_asks_for_outputs() -> None:
    configuration = two_talkers(source("New"))
    wrong = Swap("/chatter", port("listener.in"), port("talker_2.out"))
    assert refused(Handover((wrong,)), configuration) == [("output", ("listener.in",))]


def test_handover_from_an_output_that_no_longer_meets_its_topic_is_undone_by_other_means() -> None:
    configuration = two_talkers(source("New")).with_modes({work("talker"): 1, work("listener"): 1})
    undo = Handover((SWAP,)).undo(configuration)
    assert [step.kind for step in undo] == ["detach", "attach"]
    after = Handover((SWAP,)).apply(configuration)
    for step in undo:
        after = step.apply(after)
    assert after == configuration


def test_all_outputs_of_a_role_swap_together() -> None:
    twin = component("Twin", {}, ["a", "b"], [mode("normal", a=at(10), b=at(10)), mode("degraded")])
    configuration = best(system({"old": twin, "new": twin}, ["old.a /a", "old.b /b"]))
    swaps = tuple(Swap(f"/{name}", port(f"old.{name}"), port(f"new.{name}")) for name in "ab")
    after = Handover(swaps).apply(configuration)
    assert after.attached_ports("old") == []
    assert after.attached_ports("new") == [(port("new.a"), "/a"), (port("new.b"), "/b")]


# -- parameters ------------------------------------------------------------------------------------------------


def test_set_touches_changeable_parameters_alone() -> None:
    kind = component(
        "Tuned",
        {},
        [],
        [mode("normal"), mode("degraded")],
        parameters={"gain": ParameterSpec(0.5, changeable=True), "model": ParameterSpec("small")},
    )
    configuration = system({"tuned": kind}, [])
    assert refused(SetParameters("tuned", Map({"model": "large"})), configuration) == [("changeable", ("tuned.model",))]
    assert refused(SetParameters("tuned", Map({"colour": 1})), configuration) == [("parameter", ("tuned.colour",))]
    assert refused(SetParameters("tuned", Map({"gain": "much"})), configuration) == [("type", ("tuned.gain",))]
    set_ = SetParameters("tuned", Map({"gain": 2}))  # a whole number serves as a real one
    after = set_.apply(configuration)
    assert after.instances["tuned"].parameters["gain"] == 2
    (undo,) = set_.undo(configuration)
    assert undo.apply(after) == configuration


def test_actions_are_values() -> None:
    assert Attach(port("a.out"), "/t") == Attach(port("a.out"), "/t")
    assert len({Detach(port("a.out"), "/t"), Detach(port("a.out"), "/t"), Remove("a"), Remove("a")}) == 2
    assert Upgrade(Map({work("a"): 0})).describe() == "upgrade a.work to mode 0"
    assert str(Handover((SWAP,))) == "hand over /chatter from talker.out to talker_2.out"


def test_a_filter_in_the_middle_falls_before_what_it_feeds_on() -> None:
    """The order the paper's algorithm finds: downstream first."""
    configuration = best(
        system(
            {"talker": source(), "filter": filter_(), "listener": sink()},
            ["talker.out /raw", "filter.in /raw", "filter.out /clean", "listener.in /clean"],
        )
    )
    for name in ("listener", "filter", "talker"):
        configuration = Degrade(Map({work(name): 1})).apply(configuration)
        assert not violations(configuration)

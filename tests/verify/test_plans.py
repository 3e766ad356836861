"""Plans as Alloy judges them: right plans hold, and every planted fault is caught and named."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from midstride.model.action import Action, Create, Degrade, Detach, Handover
from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration
from midstride.model.specification import Node, initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.strategies.registry import planner
from midstride.verify.checking import AlloyOptions, verify_plan
from midstride.verify.run import Alloy, find
from midstride.verify.verdict import Answer, Finding, Verdict
from tests.planting import plant
from tests.verify.systems import ROVER, TALKER, Document, loop, plan, specification

pytestmark = pytest.mark.alloy

Spoil = Callable[[Document], object]


@pytest.fixture(scope="module")
def alloy() -> Alloy:
    return find()


def judged(document: Document, alloy: Alloy) -> Verdict:
    return verify_plan(document, options=AlloyOptions(alloy))


# -- what is right -------------------------------------------------------------------------------------------


def test_the_seven_step_plan_of_the_talker_holds(alloy: Alloy) -> None:
    found = plan(specification(TALKER), talker="NewTalker")
    verdict = judged(encode_plan(found), alloy)
    assert str(verdict) == "HOLDS: the plan of 7 steps (exact: 8 configurations, 34 atoms; Alloy 6.2.0)"
    assert verdict.steps == tuple(step.describe() for step in found.steps)
    assert (verdict.findings, verdict.failed, verdict.because) == ((), None, None)


@pytest.mark.full
def test_a_long_plan_of_a_real_system_holds(alloy: Alloy) -> None:
    found = loop(("controller", "vehicle_cmd_gate"))
    assert len(found.steps) >= 30
    verdict = verify_plan(found, options=AlloyOptions(alloy))
    assert verdict.holds, verdict


def test_a_hand_over_within_a_cap_and_a_capacity_holds(alloy: Alloy) -> None:
    found = plan(specification(ROVER), "minimal", planner="SmallPlanner", left="NewCamera")
    assert any(isinstance(step.action, Handover) for step in found.steps)
    assert judged(encode_plan(found), alloy).holds


def test_a_plan_with_programs_that_end_holds(alloy: Alloy) -> None:
    """They are live without ports and functionalities, from their step on."""
    start = specification(TALKER)
    setup = ComponentSpec.of("Setup", run="./setup", once=True, gate="none")
    start = replace(start, components=start.components.set("Setup", setup)).with_node(Node("setup", "Setup"))
    target = start.with_replaced("talker", "NewTalker").with_node(Node("other", "Setup"))
    change = change_between(initial(start), start, target, renewed=("setup",))
    found = planner("minimal")(change)
    created = [step.action.instance.name for step in found.steps if isinstance(step.action, Create)]
    assert sorted(created) == ["other", "setup_2", "talker_2"]
    assert judged(encode_plan(found), alloy).holds


# -- faults in plans -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Planted:
    """A fault in a plan: where it is, and the expected finding."""

    fault: str
    of: str
    spoil: Spoil
    step: int | None
    kind: str
    words: tuple[str, ...]
    subject: str
    assumption: str | None = None
    takes_long: bool = False


def plans() -> dict[str, Document]:
    rover = specification(ROVER)
    return {
        "talker": encode_plan(plan(specification(TALKER), talker="NewTalker")),
        "large planner": encode_plan(plan(rover, planner="LargePlanner")),
        "small planner": encode_plan(plan(rover, planner="SmallPlanner")),
        "camera": encode_plan(plan(rover, "minimal", left="NewCamera")),
        "no cameras": encode_plan(plan(rover, "minimal", left=None, right=None)),
    }


def drop(*numbers: int) -> Spoil:
    """Without the steps of these numbers."""
    return lambda plan: plan.update(steps=[step for n, step in enumerate(plan["steps"], 1) if n not in numbers])


def order(*numbers: int) -> Spoil:
    """These steps first, in this order, then the others."""

    def spoil(plan: Document) -> None:
        steps = plan["steps"]
        rest = [n for n in range(1, len(steps) + 1) if n not in numbers]
        plan["steps"] = [steps[n - 1] for n in (*numbers, *rest)]

    return spoil


def edit(number: int, **changes: object) -> Spoil:
    """Another word in a step."""
    return lambda plan: plan["steps"][number - 1].update(changes)


PLANTED = [
    Planted(
        "a step is missing: the degrade before a detach",
        "talker", drop(1),
        1, "precondition", ("step 1, detach talker.out from /chatter", "/chatter has no publisher"),
        "listener.listen in mode normal", "in",
    ),
    Planted(
        "two steps are swapped: removed before it is isolated",
        "large planner", order(1, 2, 3, 5, 4),
        4, "precondition", ("step 4, remove planner", "it is still attached to /image"), "planner.in",
    ),
    Planted(
        "a hand-over to an output in a degraded mode",
        "camera", drop(2),
        2, "precondition", ("hand over /image", "the new output does not satisfy the topic", "left_2.out"), "handover",
    ),
    Planted(
        "a cap is exceeded: attached before the other one is detached",
        "small planner", order(6, 7, 8, 9),
        4, "precondition", ("attach planner_2.cmd to /cmd", "the cap on publishers would be exceeded"), "attach",
    ),
    Planted(
        "a capacity is exceeded: created before the other one is removed",
        "large planner", order(6),
        1, "precondition", ("create planner_2", "a resource would be exceeded", "gpu"), "create",
    ),
    Planted(
        "the plan ends elsewhere: the target is another",
        "large planner", lambda plan: plan["target"]["nodes"]["planner"].update(component="SmallPlanner"),
        None, "end", ("planner should be one SmallPlanner", "planner_2"), "target",
    ),
    Planted(
        "an attachment of the target is missing",
        "camera", lambda plan: plan["target"]["nodes"]["motor"].pop("attachments"),
        None, "end", ("should not be attached to /cmd",), "motor.in",
    ),
    Planted(
        "a foreign name: there is no such topic",
        "large planner", edit(9, topic="/cmmd"),
        9, "name", ("attach planner_2.cmd to /cmmd", "there is no topic /cmmd"), "attach",
    ),
    Planted(
        "a foreign name: the step that creates it is missing",
        "large planner", drop(6),
        None, "document", ("step 7: there is no planner_2.plan with a mode normal",), "its document",
    ),
    Planted(
        "a name that is taken",
        "camera", lambda plan: (edit(1, instance="right")(plan), drop(2, 3)(plan)),
        1, "name", ("right already exists, with component Camera",), "create",
    ),
    Planted(
        "an effect other than the action's: it says that another mode is left",
        "large planner", edit(1, modes={"motor.drive": {"from": "degraded", "to": "degraded"}}),
        1, "name", ("it assumes that motor.drive is in mode degraded, but it is in mode normal",), "degrade",
    ),
    Planted(
        "the redundant second is detached as well",
        "no cameras", drop(1, 2),
        2, "precondition", ("step 2, detach right.out from /image", "/image has no publisher"),
        "planner.plan in mode normal", "in",
    ),
    Planted(
        "contracts that do not fit",
        "large planner", edit(7, topic="/cmd"),
        7, "precondition", ("attach planner_2.in to /cmd", "the contracts do not fit"), "attach", takes_long=True,
    ),
    Planted(
        "one port twice in one hand-over",
        "camera", lambda plan: plan["steps"][2]["swaps"].append(plan["steps"][2]["swaps"][0]),
        3, "precondition", ("a port occurs twice on one topic",), "handover", takes_long=True,
    ),
    Planted(
        "an input in a hand-over",
        "camera", lambda plan: plan["steps"][2]["swaps"][0].update(new="planner.in"),
        3, "name", ("hand over /image from left.out to planner.in", "planner.in is an input, not an output"),
        "handover",
    ),
    Planted(
        "the last step is missing: not everything is raised again",
        "talker", drop(7),
        None, "end", ("it could be in mode normal",), "listener.listen",
    ),
    Planted(
        "the start is not valid",
        "large planner", lambda plan: plan.update(start_modes={"planner.plan": "degraded"}),
        None, "document", ("motor.drive in mode normal", "planner.cmd in mode degraded: nothing is guaranteed"),
        "its document",
    ),
]  # fmt: skip


@pytest.mark.parametrize(
    "planted",
    [
        pytest.param(each, id=each.fault, marks=pytest.mark.long if each.takes_long else pytest.mark.full)
        for each in PLANTED
    ],
)
def test_a_fault_in_a_plan_is_caught_and_named(planted: Planted, alloy: Alloy) -> None:
    document = copy.deepcopy(plans()[planted.of])
    planted.spoil(document)
    verdict = judged(document, alloy)
    text = "\n".join(map(str, verdict.findings))
    assert (verdict.answer, verdict.failed) == (Answer.VIOLATED, planted.step), verdict
    assert {finding.kind for finding in verdict.findings} == {planted.kind}
    assert [word for word in planted.words if word not in text] == [], text
    finding = verdict.findings[0]
    assert finding.subject == planted.subject
    assert finding.assumption == planted.assumption
    assert "please report" not in text
    if planted.assumption is not None:
        leads_to_what_is_short(finding)


def leads_to_what_is_short(finding: Finding) -> None:
    """The chain begins at the functionality, and leads by what is not satisfied to a topic."""
    link = finding.chain
    assert link is not None and finding.subject.startswith(link.name)
    things = []
    while link is not None:
        assert not link.satisfied
        things.append(link.kind)
        link = next((cause for cause in link.causes if not cause.satisfied), None)
    assert things[:4] == ["functionality", "assumption", "input", "topic"]


# -- faults in actions ---------------------------------------------------------------------------------------


def born_normal(self: Create, configuration: Configuration) -> Configuration:
    configuration = configuration.with_instance(self.instance)
    return configuration.with_modes(dict.fromkeys(self.instance.functionality_refs(), 0))


def keeps_the_old(self: Handover, configuration: Configuration) -> Configuration:
    for swap in self.swaps:
        configuration = configuration.with_attachment(swap.new, swap.connector)
    return configuration


def does_nothing(self: Action, configuration: Configuration) -> Configuration:
    return configuration


@pytest.mark.parametrize(
    ("of", "action", "effect", "step"),
    [
        pytest.param("camera", Create, born_normal, 1, id="a create that begins in the normal mode"),
        pytest.param(
            *("camera", Handover, keeps_the_old, 3),
            id="a hand-over that leaves the old one attached",
            marks=pytest.mark.full,
        ),
        pytest.param(
            *("large planner", Degrade, does_nothing, 1), id="a degrade that changes nothing", marks=pytest.mark.full
        ),
    ],
)
def test_a_fault_in_an_actions_effect_is_caught(
    of: str,
    action: type[Action],
    effect: Callable[[Action, Configuration], Configuration],
    step: int,
    alloy: Alloy,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    document = plans()[of]
    plant(monkeypatch, action, "effect", effect)
    verdict = judged(document, alloy)
    assert verdict.failed == step
    assert [(f.kind, f.because) for f in verdict.findings] == [("effect", "its effect is not that of the action")]


def test_a_fault_in_an_actions_precondition_is_caught(alloy: Alloy, monkeypatch: pytest.MonkeyPatch) -> None:
    document = plans()["talker"]
    drop(1)(document)
    plant(monkeypatch, Detach, "check", lambda self, configuration: ())
    verdict = judged(document, alloy)
    assert (verdict.failed, verdict.findings[0].subject) == (1, "listener.listen in mode normal")

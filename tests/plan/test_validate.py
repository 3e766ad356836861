"""The replay finds what is wrong with a plan: every way of spoiling one is found, by what it breaks."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from immutables import Map

from midstride.errors import MidstrideError
from midstride.model.component import FunctionalityRef
from midstride.model.specification import Keep, Limit, Node, Order, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.cases import component, functionality, replaced, system, talker, work
from tests.replay.plan_replay import ReplayFinding, ReplayResult, replay

Document = dict[str, Any]


def document(strategy: str = "paper", specification: Specification | None = None) -> Document:
    return encode_plan(replaced(specification or talker(), "talker", "NewTalker", strategy))


def replayed(document: Document) -> ReplayResult:
    return replay(decode_plan(document))


def findings(spoilt: Document) -> str:
    """Why a plan is refused: as it is read, or as it is replayed."""
    try:
        verdict = replayed(spoilt)
    except MidstrideError as error:
        return str(error)
    assert verdict.outcome == "violated"
    assert not verdict.holds
    assert all(isinstance(finding, ReplayFinding) for finding in verdict.findings)
    return str(verdict)


def test_what_is_not_spoilt_holds() -> None:
    for strategy in sorted(STRATEGIES):
        verdict = replayed(document(strategy))
        assert (verdict.outcome, verdict.findings) == ("holds", ())
        assert "steps replayed" in str(verdict)


def drop(index: int) -> Callable[[Document], None]:
    return lambda spoilt: spoilt["steps"].pop(index)


def put(key: str, value: object) -> Callable[[Document], None]:
    return lambda spoilt: spoilt.update({key: value})


def put_in(index: int, key: str, value: object) -> Callable[[Document], None]:
    return lambda spoilt: spoilt["steps"][index].update({key: value})


def swap(one: int, other: int) -> Callable[[Document], None]:
    def spoil(spoilt: Document) -> None:
        steps = spoilt["steps"]
        steps[one], steps[other] = steps[other], steps[one]

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (drop(0), "step 1: detach talker.out from /chatter: listener.listen in mode normal would be unsatisfied"),
        (drop(1), "step 2: remove talker: talker.out is still attached to /chatter"),
        (drop(2), "talker has 2 instances at the end (talker, talker_2)"),
        (drop(4), "step 6: upgrade listener.listen"),
        (drop(5), "step 6: upgrade listener.listen"),
        (drop(6), "listener.listen is in mode degraded at the end, but could be in normal"),
        (swap(0, 1), "step 1"),
        (swap(1, 2), "step 2: remove talker: talker.out is still attached"),
        (put("disruption", 1.0), "its disruption is 4.5, not 1"),
        (put("seconds", 1.0), "its steps take 1.73 s, not 1 s"),
        (put("makespan", 60.0), "its makespan, 60 s, is longer than its steps one after another"),
        (put("degraded", []), "it takes listener.listen, talker.talk below the baseline, not nothing"),
        (put("proved_minimal", True), "it is not proved minimal: its disruption is above the lower bound, 0"),
        (put("lower_bound", 5.0), "its lower bound, 5, is above its disruption"),
        (put_in(3, "component", "Listener"), "step 5: there is no talker_2.talk with a mode normal"),
        (
            put_in(3, "component", "Talker"),
            "step 4: create talker_2 (Talker): talker_2 differs from the declaration of talker in the target",
        ),
        (put_in(3, "component", "Speaker"), "step 4: it creates a Speaker, a component that neither"),
        (put_in(3, "role", "stranger"), "the target has no node stranger"),
        (put_in(3, "action", "conjure"), "/steps/3/action: `conjure` is not one of"),
        (put("steps", None), "/steps: a list of steps is expected, this is null"),
        (lambda spoilt: spoilt.pop("target"), "/: a plan needs the key `target`"),
        (lambda spoilt: spoilt["steps"][1].pop("seconds"), "/steps/1: a step needs the key `seconds`"),
        (lambda spoilt: spoilt["steps"].insert(0, "create"), '/steps/0: a step is expected, this is a text ("create")'),
        (lambda spoilt: spoilt["start"].update(nodes={"talker": {"component": "None"}}), "there is no component"),
        (lambda spoilt: spoilt["target"].update(nods={}), "/target/nods: a specification has no key `nods`"),
        (put("start_modes", {"talker.talk": "flying"}), "there is no talker.talk with a mode flying"),
    ],
)
def test_what_is_spoilt_is_found(spoil: Callable[[Document], None], words: str) -> None:
    spoilt = copy.deepcopy(document())
    spoil(spoilt)
    assert words in findings(spoilt)


def rename(text: str, old: str, new: str) -> str:
    import json

    return json.loads(json.dumps(text).replace(old, new))  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("listener", "listener is already live"),
        ("speaker", "speaker is not a valid name for an instance of talker"),
    ],
)
def test_a_name_that_no_instance_may_have(name: str, words: str) -> None:
    spoilt = document()
    del spoilt["steps"][4:]
    spoilt["steps"] = rename(spoilt["steps"], "talker_2", name)
    assert words in findings(spoilt)


def test_the_name_of_a_node_is_not_free_for_an_instance_of_another_role() -> None:
    start = talker()
    target = start.with_replaced("talker", "NewTalker").with_node(
        Node("talker_2", "Listener", Map({"in": ("/chatter",)}))
    )
    plan = STRATEGIES["minimal"](change_between(initial(start), start, target))
    spoilt = encode_plan(plan)
    assert replayed(spoilt).holds
    # The new talker takes the name of the new node, and the new node another one, so that no name occurs twice.
    spoilt["steps"] = rename(spoilt["steps"], '"talker_2', '"listener_9')
    spoilt["steps"] = rename(spoilt["steps"], '"talker_3', '"talker_2')
    assert "talker_2 is not a valid name for an instance of talker" in findings(spoilt)


def test_a_plan_from_an_invalid_configuration() -> None:
    """A document of such a plan is refused earlier, since its start and target do not make a change."""
    plan = replaced(talker(), "talker", "NewTalker", "minimal")
    silent = plan.change.start.with_modes({FunctionalityRef("talker", "talk"): 1})
    result = replay(dataclasses.replace(plan, change=dataclasses.replace(plan.change, start=silent)))
    assert "the start is not valid: listener.listen in mode normal: assumes in: no publisher satisfies" in str(result)


def test_another_name_that_it_may_have() -> None:
    spoilt = document()
    spoilt["steps"] = rename(spoilt["steps"], "talker_2", "talker_9")
    assert replayed(spoilt).holds


def test_the_bare_name_is_for_the_first_alone() -> None:
    spoilt = document("minimal")
    spoilt["steps"] = [
        {
            "action": "create",
            "instance": "talker",
            "role": "talker",
            "component": "NewTalker",
            "parameters": {},
            "seconds": 1.0,
        }
    ]
    assert "talker is already live" in findings(spoilt)


def test_an_attachment_too_many_and_one_too_few() -> None:
    spoilt = document()
    spoilt["steps"].append({"action": "detach", "port": "talker_2.out", "topic": "/chatter", "seconds": 0.1})
    assert "listener.listen" in findings(spoilt)
    del spoilt["steps"][6]
    assert "talker_2.out is attached to nothing at the end, not to /chatter" in findings(spoilt)


def test_a_port_left_on_the_old_contract_of_a_topic_as_well() -> None:
    start = talker().without_node("listener")
    chatter = start.connectors["/chatter"]
    slower = dataclasses.replace(chatter, guarantee=dataclasses.replace(chatter.guarantee, rate=5.0))
    target = dataclasses.replace(start, connectors=start.connectors.set("/chatter", slower))
    spoilt = encode_plan(STRATEGIES["minimal"](change_between(initial(start), start, target)))
    assert replayed(spoilt).holds
    (detach,) = [step for step in spoilt["steps"] if step["action"] == "detach"]
    spoilt["steps"].remove(detach)
    assert "talker.out is still attached to /chatter with its old contract at the end" in findings(spoilt)


@pytest.mark.parametrize(
    ("constraint", "words"),
    [
        (
            Keep(FunctionalityRef("listener", "listen"), "normal"),
            "`keep listener.listen at normal` does not hold after",
        ),
        (Limit(FunctionalityRef("talker", "talk"), 0.5), "`limit talker.talk below baseline 0.5 s` is exceeded"),
    ],
)
def test_a_constraint_that_is_not_met(constraint: Keep | Limit, words: str) -> None:
    spoilt = document()
    limit = {"limit": "talker.talk", "below_baseline_seconds": 0.5}
    keep = {"keep": "listener.listen", "at": "normal"}
    spoilt["target"]["constraints"] = [keep if isinstance(constraint, Keep) else limit]
    assert words in findings(spoilt)


def test_an_order_that_is_not_kept() -> None:
    parts = [
        component(f"{kind}{name}", functionality("f", outputs=["out"])) for name in "AB" for kind in ("Old", "New")
    ]
    start = system(parts, {"a": ("OldA", {"out": "/a"}), "b": ("OldB", {"out": "/b"})})
    target = start.with_replaced("a", "NewA").with_replaced("b", "NewB")
    plan = STRATEGIES["minimal"](change_between(initial(start), start, target))
    spoilt = encode_plan(plan)
    spoilt["target"]["constraints"] = [{"order": "b", "before": "a"}]
    assert f"`{Order('b', 'a')}` is broken by step" in findings(spoilt)


def test_parameters_that_were_not_set() -> None:
    from dataclasses import replace

    from midstride.model.component import ParameterSpec

    one = work("One", parameters={"gain": ParameterSpec(1.0, changeable=True)})
    start = system([one], {"n": ("One", {})})
    target = start.with_node(replace(start.nodes["n"], parameters=Map({"gain": 2.0})))
    spoilt = encode_plan(STRATEGIES["minimal"](change_between(initial(start), start, target)))
    spoilt["steps"], spoilt["seconds"] = [], 0.0
    assert "the parameters of n at the end differ from the target" in findings(spoilt)

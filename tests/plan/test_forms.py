"""The JSON forms of plans and of requests for changes."""

from __future__ import annotations

from typing import get_args

import msgspec
import pytest

from midstride.codec.form import encode
from midstride.codec.specification_form import SpecificationForm
from midstride.errors import SpecificationError
from midstride.model.specification import Node
from midstride.plan.forms.plan_forms import PlanForm, PlanPreview, decode_plan, encode_plan
from midstride.plan.forms.request_form import ChangeRequest, NewNode, Strategy, decode_request
from midstride.plan.forms.step_forms import AnyStep
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.cases import replaced, talker


def test_a_plan_is_written_in_the_order_of_its_documentation() -> None:
    document = encode_plan(replaced(talker(), "talker", "NewTalker", "paper"))
    assert list(document)[3:5] == ["lower_bound", "proof_space"]
    costs = ["duration", "degraded", "degradations", "level_shifts", "continuity"]
    assert list(document)[7:] == [*costs, "start", "target", "steps"]
    assert all(([*step][:1], [*step][-1:]) == (["action"], ["seconds"]) for step in document["steps"])
    assert document["steps"][3] == {
        "action": "create",
        "instance": "talker_2",
        "role": "talker",
        "component": "NewTalker",
        "parameters": {},
        "seconds": 1.0,
    }


def test_what_a_later_version_adds_to_a_plan_is_passed_over() -> None:
    plan = replaced(talker(), "talker", "NewTalker", "minimal")
    document = encode_plan(plan)
    document["revision"] = 7
    document["steps"][0]["energy"] = 0.5
    assert decode_plan(document).steps == plan.steps


def test_every_fault_of_a_plan_is_found_at_once() -> None:
    document = encode_plan(replaced(talker(), "talker", "NewTalker", "paper"))
    document["start"]["topcs"] = {}
    step = next(step for step in document["steps"] if step["action"] == "attach")
    step["port"] = 7
    document["disruption"] = float("nan")
    with pytest.raises(SpecificationError) as error:
        decode_plan(document)
    assert sorted(problem.path for problem in error.value.problems) == [
        "/disruption",
        "/start/topcs",
        f"/steps/{document['steps'].index(step)}/port",
    ]


@pytest.mark.parametrize("key", ["start", "target"])
def test_a_functionality_without_modes_is_a_fault_of_a_plan(key: str) -> None:
    document = encode_plan(replaced(talker(), "talker", "NewTalker", "paper"))
    document[key]["components"]["Talker"]["functionalities"]["talk"]["modes"] = {}
    with pytest.raises(SpecificationError) as refused:
        decode_plan(document)
    assert any(f"/{key}/components/Talker/functionalities/talk/modes:" in str(p) for p in refused.value.problems)


def test_a_preview_is_the_plan_without_its_specifications() -> None:
    plan = replaced(talker(), "talker", "NewTalker", "paper")
    document = encode_plan(plan)
    assert encode(PlanPreview.of(plan)) == {key: document[key] for key in document if key not in ("start", "target")}
    assert msgspec.json.decode(msgspec.json.encode(document), type=PlanForm) == PlanForm.of(plan)


def test_there_is_a_form_for_every_kind_of_step() -> None:
    kinds = {step.__struct_config__.tag for step in get_args(AnyStep)}
    assert kinds == {"create", "remove", "attach", "detach", "degrade", "upgrade", "handover", "set"}


def test_a_request_names_every_strategy() -> None:
    assert set(get_args(Strategy)) == set(STRATEGIES)


def test_a_request_comes_back() -> None:
    node = talker().nodes["talker"]
    document = {
        "replace": [["talker", "NewTalker"]],
        "add": [encode(NewNode(role="second", component="Talker", attachments={"out": ["/chatter"]}))],
        "remove": ["listener"],
        "to": encode(SpecificationForm.of(talker())),
        "components": [{"name": "Idle"}],
        "strategy": "paper",
    }
    request = decode_request(document)
    assert request.replace == (("talker", "NewTalker"),)
    assert request.add == (Node("second", "Talker", node.attachments),)
    assert (request.remove, request.to, request.strategy) == (("listener",), talker(), "paper")
    assert request.components[0].name == "Idle"
    assert decode_request({}) == ChangeRequest().request() == PlanRequest()


@pytest.mark.parametrize(
    ("document", "faults"),
    [
        ({"replce": []}, ["E002 /replce"]),
        ({"strategy": "fast"}, ["E005 /strategy"]),
        ({"replace": [["talker"]], "remove": "talker"}, ["E001 /remove", "E003 /replace/0/1"]),
        ({"add": [{"role": "second"}, 7]}, ["E001 /add/1", "E003 /add/0"]),
        ({"add": [{"role": "a", "component": "B", "parameters": {"p": [1, "x"]}}]}, ["E001 /add/0/parameters/p"]),
        ({"to": {"system": "s", "topcs": {}}, "components": [{"name": "a b"}]},
         ["E002 /to/topcs", "E006 /components/0"]),
        ({"to": {"system": "s", "nodes": {"n": {"component": "C"}}}}, ["E008 /to/nodes/n/component"]),
    ],
)  # fmt: skip
def test_every_fault_of_a_request_is_found_at_its_path(document: object, faults: list[str]) -> None:
    with pytest.raises(SpecificationError) as error:
        decode_request(document)
    assert sorted(f"{problem.code} {problem.path}" for problem in error.value.problems) == faults

"""Dumps as text, and single configurations as Alloy judges them."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
from immutables import Map

from midstride.codec.configuration_form import ConfigurationForm, decode_configuration
from midstride.codec.form import encode
from midstride.lang import load_text
from midstride.model.component import ComponentSpec, FunctionalityRef, InputAlternatives, PortRef, Resource
from midstride.model.configuration import Configuration
from midstride.model.rules import capacity_violation
from midstride.model.specification import Node, Specification, initial, structure
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.verify.alloy_atoms import Names
from midstride.verify.chain import chain
from midstride.verify.checking import AlloyOptions, verify_configuration, verify_plan, verify_specification
from midstride.verify.diagram import chain_lines, to_dot, to_mermaid
from midstride.verify.export import dump_configuration, dump_plan
from midstride.verify.library import bundled
from midstride.verify.verdict import Answer, Finding, Verdict
from tests.verify.systems import EXAMPLES, MAPPING, ROVER, TALKER, plan, specification

GOLDEN = Path(__file__).parents[1] / "golden" / "alloy"

# -- the text ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["talker", "rover", "mapping"])
def test_the_text_of_a_plan_is_readable_and_stays_as_it_is(name: str) -> None:
    """`MIDSTRIDE_GOLDEN=write` writes it anew. The specification it carries along is not part of it."""
    match name:
        case "talker":
            found = plan(specification(TALKER), talker="NewTalker")
        case "rover":
            found = plan(specification(ROVER), "minimal", left="NewCamera")
        case _:
            found = plan(specification(MAPPING), "minimal", map_server="QuickServer")
    text = dump_plan(found, name).text.partition("/* ==== the specification")[0]
    golden = GOLDEN / f"{name}.als"
    if os.environ.get("MIDSTRIDE_GOLDEN") == "write":
        golden.write_text(text, encoding="utf-8")
    assert text == golden.read_text(encoding="utf-8")


def test_a_plan_that_creates_what_is_live_is_exported_for_alloy_to_refuse() -> None:
    document = encode_plan(plan(specification(TALKER), talker="NewTalker"))
    create = {"action": "create", "instance": "talker", "role": "other", "component": "Talker", "parameters": {}}
    document["steps"].insert(0, {**create, "seconds": 1.0})
    text = dump_plan(decode_plan(document), "twice").text
    assert "pred step1_may { can_create_within[S0, talker] }" in text


@pytest.mark.parametrize(("amount", "too_much"), [(0.5, False), (0.5000000005, True)])
def test_exceeded_resources_are_those_of_the_model(amount: float, too_much: bool) -> None:
    """Amounts are compared as they are written: half a part in a thousand million counts."""
    holders = [ComponentSpec.of(name, resource_usage={"gpu": held}) for name, held in (("A", 0.5), ("B", amount))]
    configuration = structure(
        Specification(
            "full",
            components=Map({holder.name: holder for holder in holders}),
            nodes=Map({holder.name: Node(holder.name, holder.name) for holder in holders}),
            resources=Map({"gpu": Resource("gpu", 1.0)}),
        )
    )
    assert ("too much gpu together: A, B" in dump_configuration(configuration, "full").text) == too_much
    assert (capacity_violation(configuration, "gpu") is not None) == too_much


def test_a_dump_includes_the_specification_and_opens_no_module() -> None:
    text = dump_configuration(initial(specification(TALKER)), "talker").text
    assert "pred valid_sys[s: System]" in text
    assert not re.search(r"^(module|open) ", text, re.MULTILINE)


def test_no_atom_has_a_name_of_alloy_or_of_the_specification() -> None:
    declared = set(re.findall(r"^(?:abstract |one )?(?:sig|pred|fun) (\w+)", bundled(), re.MULTILINE))
    fields = set(re.findall(r"^fun (\w+):", dump_configuration(initial(specification(TALKER)), "talker").text, re.M))
    names = Names()
    for word in sorted(declared | fields | {"univ", "Int", "some", "fun", "sum", "Findings", "Step", "Clause"}):
        assert names.assign(word, word) == f"{word}_2"


@pytest.mark.parametrize("text", ["", "größe", "a b", "/a/b", "2nd", "a__b", "'", "can_bus", "step1_may"])
def test_every_name_becomes_an_identifier_of_its_own(text: str) -> None:
    names = Names()
    given = [names.assign(text, number) for number in range(3)]
    assert len(set(given)) == 3
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in given)
    assert [names.meanings[name] for name in given] == [0, 1, 2]


@pytest.mark.parametrize("name", ["talker", "filter", "obstacle"])
def test_a_configuration_comes_back_from_its_document(name: str) -> None:
    configuration = initial(specification(EXAMPLES / name / f"{name}.stride"))
    configuration = configuration.with_modes(
        {ref: configuration.functionality(ref).last_mode for ref in list(configuration.modes)[:1]}
    )
    assert decode_configuration(encode(ConfigurationForm.of(configuration))) == configuration


# -- configurations ------------------------------------------------------------------------------------------


def broken(configuration: Configuration, how: str) -> Configuration:
    match how:
        case "mode":
            return configuration.with_modes({FunctionalityRef("planner", "plan"): 1})
        case "cap":
            return configuration.with_attachment(PortRef("left", "out"), "/cmd")
        case "capacity":
            rover = specification(ROVER)
            large = replace(rover.instance("planner", "planner_2"), component=rover.components["LargePlanner"])
            return configuration.with_instance(large)
        case "attachment":
            return configuration.with_attachment(PortRef("left", "out"), "/nowhere")
    raise ValueError(how)


@pytest.mark.alloy
@pytest.mark.parametrize(
    ("how", "kind", "words"),
    [
        (
            "mode",
            "assumption",
            "motor.drive in mode normal: assumes in: no publisher satisfies /cmd (planner.cmd in mode deg",
        ),
        pytest.param("cap", "cap", "/cmd", marks=pytest.mark.full),
        pytest.param(
            *("capacity", "capacity", "planner, planner_2: together they exceed a resource"), marks=pytest.mark.full
        ),
        ("attachment", "attachment", "left.out is attached to /nowhere, but there is no /nowhere in this system"),
    ],
)
def test_violations_are_named(how: str, kind: str, words: str) -> None:
    verdict = verify_configuration(broken(initial(specification(ROVER)), how))
    assert verdict.answer is Answer.VIOLATED
    assert [finding.kind for finding in verdict.findings] == [kind]
    assert words in str(verdict.findings[0])
    assert encode(verdict)["verdict"] == "violated"


HOSTILE = """
system hostile
topic /univ : std_msgs/msg/String @ 10 Hz { publishers <= 2 }
topic /S0   : std_msgs/msg/String
component sig {
  output Output
  functionality fun { produces Output  mode some { guarantee Output : std_msgs/msg/String @ 10 Hz }  mode no { } }
}
component one {
  input in : std_msgs/msg/String @ 5 Hz
  functionality set { uses in  mode all { assume in }  mode none { } }
}
node S0       : sig { Output -> /univ }
node s        : sig { Output -> /univ }
node Findings : one { in <- /univ }
node t        : one { in <- /univ }
"""


@pytest.mark.alloy
def test_names_that_alloy_reserves_can_be_used() -> None:
    hostile = load_text(HOSTILE, "hostile.stride").require()
    found = plan(hostile, S0=None, t=None)
    assert found.steps
    verdict = verify_plan(found)
    assert verdict.holds, verdict


# -- what is too large ---------------------------------------------------------------------------------------


def many(count: int) -> Specification:
    talker = specification(TALKER)
    nodes = {f"talker{n}": Node(f"talker{n}", "Talker", Map({"out": ("/chatter",)})) for n in range(count)}
    return replace(talker, nodes=Map(nodes))


def holding(count: int) -> Specification:
    large = many(count)
    known = large.components["Talker"]
    talker = ComponentSpec.of(
        known.name,
        inputs=known.inputs,
        outputs=known.outputs,
        functionalities=tuple(known),
        resource_usage={"gpu": 1.0},
    )
    return replace(large, components=large.components.set("Talker", talker))


@pytest.mark.parametrize(
    ("large", "words"),
    [
        (many(400), r"\d+ atoms, more than the \d+ that Alloy can handle"),
        (holding(17), "17 components hold gpu, more than the 16"),
    ],
    ids=["atoms", "holders"],
)
def test_a_system_too_large_for_alloy_is_unknown(large: Specification, words: str) -> None:
    verdict = verify_specification(large, options=AlloyOptions(Path("nowhere.jar")))
    assert verdict.answer is Answer.UNKNOWN
    assert re.search(words, str(verdict))


# -- the picture ---------------------------------------------------------------------------------------------


def test_the_chain_is_shown_and_drawn() -> None:
    configuration = broken(initial(specification(ROVER)), "mode")
    causes = chain(configuration, FunctionalityRef("motor", "drive"), InputAlternatives(("in",)))
    finding = Finding("assumption", None, "the configuration", "motor.drive", "it assumes in", "in", causes)
    verdict = Verdict(Answer.VIOLATED, "the configuration", "exact", "Alloy", findings=(finding,))
    assert list(chain_lines(causes)) == [
        "motor.drive (in mode normal): not satisfied",
        "  assumes in: not satisfied",
        "    motor.in (geometry_msgs/msg/Twist @ 10 Hz): not satisfied",
        "      /cmd (geometry_msgs/msg/Twist @ 10 Hz): not satisfied",
        "        planner.cmd (in mode degraded: nothing): not satisfied",
    ]
    dot, mermaid = to_dot(verdict), to_mermaid(verdict)
    for name in ("motor.drive", "assumes in", "motor.in", "/cmd", "planner.cmd"):
        assert name in dot
        assert name in mermaid
    assert (dot.count(" -> "), mermaid.count(" --> ")) == (5, 5)


def test_no_findings_are_drawn_as_nothing() -> None:
    assert "->" not in to_dot(Verdict(Answer.HOLDS, 'a "plan"', "exact", "Alloy"))

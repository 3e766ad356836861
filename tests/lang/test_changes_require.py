"""`changes require` in the text, in JSON, in the editor, in a difference, and what is wrong with it."""

from __future__ import annotations

import json

import jsonschema
import pytest

from midstride.codec.schema import specification_schema
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import SpecificationError
from midstride.lang import format_text, load_text
from midstride.lang.completion import complete
from midstride.lang.message_types import installed
from midstride.lang.source import Source
from midstride.model.contract import Interval, OneOf, Predicate
from midstride.model.specification import ChangeRequirement, Specification
from midstride.plan.specification_diff import differences

TEXT = """system s

changes require /estop/released : std_msgs/msg/Bool where data = true
changes and recovery require speed : std_msgs/msg/Float64 where data <= 0.1 max_age 500 ms

namespace arm {
  changes require brake : Released
}

contract Released = std_msgs/msg/Bool where data = true
"""
RELEASED = Predicate("std_msgs/msg/Bool", fields=(("data", OneOf.of([True])),))
REQUIREMENTS = (
    ChangeRequirement("/estop/released", RELEASED),
    ChangeRequirement(
        "/speed", Predicate("std_msgs/msg/Float64", fields=(("data", Interval(high=0.1)),)), 0.5, recovery=True
    ),
    ChangeRequirement("/arm/brake", RELEASED),
)


def loaded(text: str = TEXT) -> Specification:
    return load_text(text).require()


def test_requirements_are_read_with_their_namespaces() -> None:
    assert loaded().requirements == REQUIREMENTS
    assert [str(each) for each in REQUIREMENTS] == [
        "changes require /estop/released : std_msgs/msg/Bool where data = true",
        "changes and recovery require /speed : std_msgs/msg/Float64 where data <= 0.1 max_age 0.5 s",
        "changes require /arm/brake : std_msgs/msg/Bool where data = true",
    ]
    # What is said of one is the statement that states it.
    assert loaded("system s\n" + "\n".join(map(str, REQUIREMENTS)) + "\n").requirements == REQUIREMENTS


def test_the_formatter_keeps_them_and_aligns_adjacent_ones() -> None:
    assert format_text(format_text(TEXT).text or "").text == format_text(TEXT).text
    rough = "system s\nchanges   require a:std_msgs/msg/Bool where data=true max_age 2s\nchanges require long : R\n"
    formatted = format_text(rough).text
    assert formatted == (
        "system s\nchanges require a    : std_msgs/msg/Bool where data = true max_age 2 s\nchanges require long : R\n"
    )


def test_the_json_form_has_them() -> None:
    document = encode_specification(loaded())
    assert document["changes_require"][1] == {
        "topic": "/speed",
        "assumption": {"type": "std_msgs/msg/Float64", "where": {"data": {"<=": 0.1}}},
        "max_age_seconds": 0.5,
        "recovery": True,
    }
    assert decode_specification(json.loads(json.dumps(document))) == loaded()
    jsonschema.validate(document, specification_schema())
    assert "changes_require" not in encode_specification(loaded("system s\n"))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"topic": "estop"}, "/changes_require/0/topic: `estop` is not a valid topic name"),
        ({"max_age_seconds": 0}, "/changes_require/0/max_age_seconds: a number of seconds must be more than 0"),
        ({"max_age": 1}, "did you mean `max_age_seconds`?"),
        ({"recovery": "yes"}, "/changes_require/0/recovery: true or false is expected"),
    ],
)
def test_faults_in_json_are_at_their_paths(changed: dict[str, object], words: str) -> None:
    document = encode_specification(loaded())
    document["changes_require"][0] |= changed
    with pytest.raises(SpecificationError) as raised:
        decode_specification(document)
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("statement", "code", "words"),
    [
        ("changes require a : std_msgs/msg/Bool", "E004", "no field is constrained, so every message meets it"),
        ("changes require a : std_msgs/msg/Bool @ 5 Hz where data = true", "E004", "so its rate is not judged"),
        ("changes require a : std_msgs/msg/Bool qos(depth = 1) where data = true", "E004", "publishers of every QoS"),
        ("changes require a : std_msgs/msg/Bool where data = true max_age 0 s", "E004", "the age of a message"),
        ("changes require a : std_msgs/msg/Bool where data = true max_age 2", "E127", "needs a unit"),
        ("changes require a : std_msgs/msg/Bool where dat = true", "E137", "has no field `dat`"),
        ("changes require a : std_msgs/msg/Bool where data = 1", "E138", "compares it with a number"),
        ("changes require ~/a : std_msgs/msg/Bool where data = true", "E139", "private to a node"),
        ("changes require a : nothing", "E135", "what changes require cannot be `nothing`"),
        ("changes require a : Missing", "E008", "there is no contract `Missing`"),
        ("changes requires a : std_msgs/msg/Bool where data = true", "E120", "expected `require` after `changes`"),
        ("changes and restarts require a : R", "E120", "expected `recovery` after `changes and`"),
        ("changes require a = R", "E120", "after topic `a`"),
        ("component C { changes require a : R }", "E123", "is not closed: expected `}` before `changes`"),
    ],
)
def test_what_is_wrong_is_said_at_its_place(statement: str, code: str, words: str) -> None:
    found = load_text(f"system s\n{statement}\n", messages=installed())
    [diagnostic, *_] = [each for each in found.diagnostics if each.severity == "error"]
    assert (diagnostic.code, words in diagnostic.message) == (code, True), diagnostic.message
    assert found.specification is None and diagnostic.span is not None
    assert diagnostic.span.source.position(diagnostic.span.start)[0] == 2


def test_a_difference_names_them() -> None:
    before, after = loaded(), loaded(TEXT.replace("max_age 500 ms", "max_age 1 s"))
    assert [str(each) for each in differences(before, after)] == [
        f"`{REQUIREMENTS[1]}`: removed",
        f"`{REQUIREMENTS[1]}`: added".replace("0.5 s", "1 s"),
    ]


def test_the_editor_knows_the_keyword() -> None:
    resolved = load_text("system s\n").resolved
    assert resolved is not None
    assert "changes" in {each.word for each in complete(Source("", "system s\n"), len("system s\n"), resolved)}

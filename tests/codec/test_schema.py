"""The JSON Schema says what the JSON form is, in both directions."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import jsonschema  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midstride.codec.schema import specification_schema
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import SpecificationError
from midstride.lang import load
from midstride.model.specification import Specification
from tests.strategies.systems import specifications

ROOT = Path(__file__).parents[2] / "examples"
EXAMPLES = [ROOT / name / f"{name}.stride" for name in ("talker", "filter", "obstacle", "autoware_control")]
SAMPLE = Path(__file__).parents[1] / "lang" / "seeds" / "patrol.stride"
VALIDATOR = jsonschema.Draft202012Validator(specification_schema())

# Faults of form, which a schema can tell; the others are of names and meaning.
FORM = {"E001", "E002", "E003", "E004", "E005", "E006"}


def keeps_the_form(document: Any) -> bool:
    try:
        decode_specification(document)
    except SpecificationError as error:
        return not FORM & {problem.code for problem in error.problems}
    return True


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(specification_schema())


@pytest.mark.parametrize("path", [*EXAMPLES, SAMPLE], ids=lambda path: path.stem)
def test_what_is_exported_is_valid(path: Path) -> None:
    VALIDATOR.validate(encode_specification(load(path).require()))


@given(specifications())
def test_whatever_is_written_is_valid(specification: Specification) -> None:
    VALIDATOR.validate(encode_specification(specification))


def places(document: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path]
    if isinstance(document, dict):
        for key in document:
            found += places(document[key], (*path, key))
    elif isinstance(document, list):
        for index, item in enumerate(document):
            found += places(item, (*path, index))
    return found


@given(specifications(), st.data())
def test_what_is_damaged_is_told_by_both_or_by_neither(specification: Specification, data: st.DataObject) -> None:
    """A value replaced, a key taken out, an unknown one put in: schema and reader agree on the form."""
    document = copy.deepcopy(encode_specification(specification))
    path = data.draw(st.sampled_from(places(document)[1:] or [("system",)]))
    holder = document
    for key in path[:-1]:
        holder = holder[key]
    match data.draw(st.sampled_from(["value", "out", "in"])):
        case "value":
            values = [None, True, -1, 0, 1, 0.5, "", "x", "a b", "std_msgs/msg/String", [], [1, "a"], {}, {"type": 1}]
            holder[path[-1]] = data.draw(st.sampled_from(values))
        case "out":
            del holder[path[-1]]
        case "in" if isinstance(holder, dict):
            holder["nonsense "] = {}
    assert VALIDATOR.is_valid(document) == keeps_the_form(document), document

"""Whatever is in a file, reading it ends in a value or in documented errors, each at a place in a file and printable.

Files with control characters, surrogates, extremes of numbers and deep nesting, from scratch and in the middle of the
real examples: Stride, specifications in JSON, ROS parameter files, and the JSON forms of plans and requests. The
examples are the same at every run of `make test-all`, of which `make test` tries some; `make test-long` looks for new
ones. `test_fuzz` mutates bytes.
"""

from __future__ import annotations

import copy
import json
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from midstride.codec.configuration_form import ConfigurationForm, decode_configuration
from midstride.codec.form import encode
from midstride.codec.reading import parse_json
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import MidstrideError, SpecificationError
from midstride.lang import format_text, load_text, render
from midstride.lang.diagnostic_text import Diagnostic
from midstride.lang.source import Source
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.forms.request_form import decode_request
from midstride.plan.strategies.registry import planner
from tests import drawn
from tests.examples import json_text

from .known import Known

EXAMPLES = Path(__file__).parents[2] / "examples"
STRIDE = {path.name: path.read_text(encoding="utf-8") for path in sorted(EXAMPLES.glob("*/*.stride"))}
SPECIFICATIONS = [json_text(name) for name in ("filter", "obstacle", "talker")]
REQUESTS = [
    act["request"] for path in sorted(EXAMPLES.glob("*/demo.json")) for act in json.loads(path.read_text())["acts"]
]
PARAMETERS = """/**:
  ros__parameters: {use_sim_time: true, gain: 2.5, names: [a, "b"], at: 0x1F}
talker:
  ros__parameters:
    volume: &volume 3
    plugin:
      name: 'x'  # a comment
      gains: [1.0, 2.5e3, -.5]
    other: *volume
/robot1/*:
  listener: {ros__parameters: {text: |
    two
    lines
  }}
"""
# A system whose node reads the file of parameters.
WITH_PARAMETERS = (
    'system s\ncomponent C { functionality f { mode a { } mode b { } } }\nnode talker : C\nparameters "p.yaml"\n'
)

CONTROL = [
    "\x00",
    "\x07",
    "\x1b[2J",
    "\x1b]0;t\x07",
    "\x7f",
    "\x85",
    "\x9b31m",
    "\r",
    "\r\n",
    "\v\f",
    "\u2028",
    "\u202e",
    "\u2066",
]
STRANGE_TEXT = [
    "\ud800",
    "\udfff",
    "\ufeff",
    "\uffff",
    "\U0010ffff",
    "\u0301" * 50,
    "é",
    "日本",
    "👩\u200d👩",
    "\u00ad",
]
NUMBERS = ["1e308", "-1e308", "1e309", "1e-400", "5e-324", "-0", "1e18", "1.1e18", "9" * 19, "9" * 400, "-" + "9" * 30]
NUMBERS += ["NaN", "Infinity", "-Infinity", ".inf", ".nan", "0x" + "f" * 40, "0.1e1000000", "1e18 kHz", "0 Hz", "-1 s"]
NESTING = ["[", "{", "(", "[[", '{"a":', "a: {", "namespace a {", "- ", "? ", "&a [*a, ", "!x ", "component C { "]
WORDS = [
    '"',
    "'",
    "\\",
    "\\ud800",
    '"\\u001b"',
    "#",
    "//",
    "null",
    "true",
    "nothing",
    "ros__parameters",
    ": ",
    ",\n",
    "<-",
    "->",
]
PIECES = st.one_of(
    st.sampled_from([*CONTROL, *STRANGE_TEXT, *NUMBERS, *WORDS, *NESTING]),
    st.builds(lambda piece, times: piece * times, st.sampled_from(NESTING), st.sampled_from([5, 40, 200, 2000])),
    st.text(st.characters(exclude_categories=()), max_size=5),
)


def mutate(text: str, at: int, length: int, piece: str, kind: str) -> str:
    """``text``, changed at ``at`` thousandths of it."""
    start = len(text) * at // 1000
    end = min(len(text), start + length)
    if kind == "word":  # a whole word instead of a part of it
        while start and text[start - 1].isalnum():
            start -= 1
        while end < len(text) and text[end].isalnum():
            end += 1
    if kind == "repeat":
        piece = text[start:end] * 2
    return text[:start] + piece + text[end:]


EDITS = st.lists(
    st.tuples(
        st.integers(0, 1000), st.sampled_from([0, 0, 1, 5, 50]), PIECES, st.sampled_from(["", "word", "word", "repeat"])
    ),
    min_size=1,
    max_size=3,
)


@st.composite
def mutants(draw: st.DrawFn, *texts: str) -> str:
    text = draw(st.sampled_from(texts))
    for edit in draw(EDITS):
        text = mutate(text, *edit)
    return text


SCRATCH = st.lists(PIECES, max_size=8).map(" ".join)


def assert_printable(text: str) -> None:
    hidden = {c for c in text if unicodedata.category(c) in {"Cc", "Cs", "Cf", "Zl", "Zp"}}
    assert hidden <= {"\n", "\u200c", "\u200d"}, hidden


def assert_located(diagnostic: Diagnostic, sources: dict[str, Source]) -> None:
    """It is at a place in a file that was read, or says that there are too many."""
    if diagnostic.code == "E199":
        return
    for span in (diagnostic.span, *(note.span for note in diagnostic.notes)):
        assert span is not None, diagnostic
        assert sources[span.source.name] is span.source
        assert 0 <= span.start <= span.end <= len(span.source.text), diagnostic
        line, column = span.source.position(span.start)
        assert 1 <= line <= span.source.text.count("\n") + 1 and column <= len(span.source.line(line)) + 1


def assert_handled(name: str, text: str, files: dict[str, str]) -> bool:
    """Read ``text`` as the file ``name``; whether it is a specification."""

    def read(path: Path) -> str:
        if str(path) not in files:
            raise FileNotFoundError(2, "No such file or directory")
        return files[str(path)]

    loaded = load_text(text, name, read=read, messages=Known())
    assert (loaded.specification is None) == loaded.has_errors
    sources = {source.name: source for source in loaded.files}
    for diagnostic in loaded.diagnostics:
        assert diagnostic.message
        assert_located(diagnostic, sources)
        assert_printable(str(diagnostic))
        json.dumps(diagnostic.to_json())
    assert_printable(render(loaded.diagnostics))
    if loaded.specification is not None:
        document = encode_specification(loaded.specification)
        assert encode_specification(decode_specification(document)) == document
    return loaded.specification is not None


def stride_is_handled(text: str) -> None:
    assert_handled("hostile.stride", text, {**STRIDE, "y.stride": text})
    for diagnostic in format_text(text, "hostile.stride").diagnostics:
        assert_printable(diagnostic.render())


def json_is_handled(text: str) -> None:
    assert_handled("hostile.json", text, {})


def parameters_are_handled(text: str) -> None:
    assert_handled("s.stride", WITH_PARAMETERS, {"p.yaml": text})


TEXTS: dict[str, tuple[st.SearchStrategy[str], Callable[[str], None]]] = {
    "stride": (mutants(*STRIDE.values()), stride_is_handled),
    "stride from scratch": (SCRATCH.map("system s\n".__add__), stride_is_handled),
    "json": (mutants(*SPECIFICATIONS), json_is_handled),
    "json from scratch": (SCRATCH, json_is_handled),
    "parameters": (mutants(PARAMETERS), parameters_are_handled),
    "parameters from scratch": (SCRATCH.map("a: ".__add__), parameters_are_handled),
}

# -- values of JSON documents ------------------------------------------------------------------------------


def nested(kind: str, depth: int) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = [value] if kind == "list" else {"a": value}
    return value


VALUES = st.one_of(
    st.sampled_from(
        [None, True, 0, -1, 1e308, 5e-324, float("nan"), float("inf"), -float("inf"), 2**63, 10**400, 1.1e18]
    ),
    st.sampled_from(["", *CONTROL, *STRANGE_TEXT, "a/B\n", "x" * 300, "~", "/", "a//b", ".", "__a"]),
    st.builds(nested, st.sampled_from(["list", "object"]), st.sampled_from([1, 2, 40, 400])),
    st.sampled_from([[], {}, [[]], ["x", 1], [1.0, 10**400], [True, 1], {"x": 1}, {"": {}}, {"\x1b": None}]),
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all parts of a document but the whole, and but those in what is nested deep."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return (
        []
        if len(path) > 20
        else [found for key, part in items for found in ((*path, key), *places(part, (*path, key)))]
    )


def spoilt(document: Any, data: st.DataObject) -> Any:
    """``document`` with one to three parts, or names of parts, replaced."""
    document = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        if not (paths := places(document)):
            break
        *path, last = data.draw(st.sampled_from(paths))
        holder = document
        for key in path:
            holder = holder[key]
        if isinstance(holder, dict) and data.draw(st.booleans()):
            holder[data.draw(st.sampled_from(["", "x", *CONTROL, *STRANGE_TEXT]))] = holder.pop(last)
        else:
            holder[last] = copy.deepcopy(data.draw(VALUES))
    return document


def specification_is_handled(document: Any) -> None:
    """As a text it has its errors at places; as a value it has the same ones, at paths."""
    handled = assert_handled("hostile.json", json.dumps(document, indent=1), {})
    try:
        decode_specification(document)
    except SpecificationError as error:
        assert not handled
        for problem in error.problems:
            assert_printable(str(problem))


def form_is_handled(decode: Callable[[object], object]) -> Callable[[Any], None]:
    def check(document: Any) -> None:
        for text in (None, json.dumps(document)):
            try:
                decode(document if text is None else parse_json(text))
            except MidstrideError as error:
                assert_printable(str(error))

    return check


def _plan() -> Any:
    specification = decode_specification(json.loads(SPECIFICATIONS[-1]))
    target = decode_request(REQUESTS[-1]).target(specification)
    return encode_plan(planner("minimal")(change_between(initial(specification), specification, target)))


DOCUMENTS: dict[str, tuple[list[Any], Callable[[Any], None]]] = {
    "specification": ([json.loads(text) for text in SPECIFICATIONS], specification_is_handled),
    "request": (REQUESTS, form_is_handled(decode_request)),
    "plan": ([_plan()], form_is_handled(decode_plan)),
    "configuration": (
        [encode(ConfigurationForm.of(initial(decode_specification(json.loads(text))))) for text in SPECIFICATIONS],
        form_is_handled(decode_configuration),
    ),
}

_CHECKS = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]


def run_texts(kind: str, examples: int, derandomize: bool) -> None:
    strategy, check = TEXTS[kind]
    limits = settings(max_examples=examples, derandomize=derandomize, database=None, suppress_health_check=_CHECKS)
    limits(given(strategy)(check))()


def run_documents(kind: str, examples: int, derandomize: bool) -> None:
    documents, check = DOCUMENTS[kind]

    @settings(max_examples=examples, derandomize=derandomize, database=None, suppress_health_check=_CHECKS)
    @given(st.sampled_from(documents), st.data())
    def run(document: Any, data: st.DataObject) -> None:
        check(spoilt(document, data))

    run()


@pytest.mark.parametrize("kind", TEXTS)
def test_no_text_is_too_hostile(kind: str) -> None:
    run_texts(kind, drawn.examples(200), derandomize=True)


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_no_document_is_too_hostile(kind: str) -> None:
    run_documents(kind, drawn.examples(200), derandomize=True)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", TEXTS)
def test_no_text_is_too_hostile_at_length(kind: str) -> None:
    run_texts(kind, 10_000, derandomize=False)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", DOCUMENTS)
def test_no_document_is_too_hostile_at_length(kind: str) -> None:
    run_documents(kind, 10_000, derandomize=False)

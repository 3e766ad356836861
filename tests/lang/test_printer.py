"""The formatter: the sample is canonical; formatting keeps comments, order and meaning, and is idempotent."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from midstride.lang import format_text, load_text, render
from midstride.lang.diagnostic_text import Reporter
from midstride.lang.lexer import tokenize
from midstride.lang.source import Source

SEEDS = Path(__file__).parent / "seeds"
NAMES = ("patrol.stride", "sensors.stride", "mapping.stride", "fleet.stride", "hosts.stride")
SAMPLES = [(SEEDS / name).read_text(encoding="utf-8") for name in NAMES]


def formatted(text: str) -> str:
    found = format_text(text)
    assert found.text is not None, render(found.diagnostics)
    return found.text


def words(text: str) -> tuple[list[str], list[str]]:
    """The tokens of a text without commas, and its comments: what formatting must keep, in order."""
    tokens = tokenize(Source("t", text), Reporter())
    comments = [text[start:end].rstrip() for start, end in tokens.comments]
    return [word for word, kind in zip(tokens.texts, tokens.kinds, strict=True) if kind != ","], comments


@pytest.mark.parametrize("sample", SAMPLES[:3])
def test_the_sample_formats_to_itself(sample: str) -> None:
    assert formatted(sample) == sample


UGLY = """

system   s  # name
component   C   # heading
{ # brace
# first
run "x"   takes 2s stop  sigterm 1s sigkill 500ms
  holds a 1 b 2,c
      parameters {changeable a=1 b=[1 2,3],


      c="x" }   # kept
 input in:std_msgs/String@10Hz  # one
 input   other : std_msgs/String  qos( depth=5,reliability=reliable )
 output out
 functionality f weight 2{uses in,other produces out
 mode normal{assume in or other guarantee out:std_msgs/String where data in{a b,"c"},x=1}
 mode off{}


 }
}


node n:C{in<-/a,/b other<-/c}
node longer : C { in <- /a }
keep n.f at normal
order n before longer   # why
timing { create 1s remove 10ms }
# end
"""

NEAT = """system s    # name
component C {   # heading
  # brace
  # first
  run "x" takes 2 s stop sigterm 1 s sigkill 500 ms
  holds a 1, b 2, c
  parameters {
    changeable a = 1, b = [1, 2, 3]

    c = "x"
  }             # kept
  input  in    : std_msgs/String @ 10 Hz  # one
  input  other : std_msgs/String qos(depth = 5, reliability = reliable)
  output out
  functionality f weight 2 {
    uses in, other   produces out
    mode normal { assume in or other   guarantee out : std_msgs/String where data in {a, b, "c"}, x = 1 }
    mode off { }
  }
}

node n      : C { in <- /a, /b   other <- /c }
node longer : C { in <- /a }
keep  n.f at normal
order n before longer   # why
timing { create 1 s   remove 10 ms }
# end
"""


def test_what_is_canonical() -> None:
    assert formatted(UGLY) == NEAT
    assert formatted(NEAT) == NEAT


@pytest.mark.parametrize("text", [*SAMPLES, UGLY])
@pytest.mark.parametrize("seed", range(30))
def test_white_space_changes_nothing(text: str, seed: int) -> None:
    """White space inserted between the words changes neither words, comments nor meaning of the formatted text."""
    rng = random.Random(seed)
    tokens = tokenize(Source("t", text), Reporter())
    starts = sorted({*tokens.starts, *(start for start, _ in tokens.comments)})
    pieces, last = [], 0
    for start in starts:
        pieces += [text[last:start], rng.choice(["", "", "", " ", "   ", "\t", "\n", "\n\n\n"])]
        last = start
    spaced = "".join(pieces) + text[last:]
    once = formatted(spaced)
    assert words(once) == words(spaced) == words(text)
    assert formatted(once) == once
    files = {"sensors.stride": SAMPLES[1]}
    before, after = (
        load_text(t, "t.stride", read=lambda path: files.get(str(path), "")).specification for t in (text, once)
    )
    assert before == after


def formatting_keeps(text: str) -> None:
    """Formatting is refused with an error, or it keeps the words and is idempotent."""
    found = format_text(text)
    if found.text is None:
        assert any(diagnostic.severity == "error" for diagnostic in found.diagnostics)
    else:
        assert formatted(found.text) == found.text
        assert words(found.text) == words(text)


@given(st.text(alphabet=st.sampled_from('aF{}()[]:=@,.<->/~"#\n\t 1\u00e9'), max_size=200))
def test_any_text_is_answered(text: str) -> None:
    loaded = load_text(text)
    assert (loaded.specification is None) == loaded.has_errors
    formatting_keeps(text)


@given(st.data())
def test_any_mixture_of_the_samples_lines_is_answered(data: st.DataObject) -> None:
    lines = [line for sample in SAMPLES for line in sample.split("\n")]
    text = "\n".join(data.draw(st.lists(st.sampled_from(lines), max_size=40)))
    loaded = load_text(text, "t.stride", read=lambda path: SAMPLES[1])
    assert (loaded.specification is None) == loaded.has_errors
    formatting_keeps(text)


def test_a_text_with_errors_is_not_formatted() -> None:
    found = format_text("system s\ntopic /a\n", "t.stride")
    assert found.text is None
    assert [(d.code, d.position) for d in found.diagnostics] == [("E120", (2, 9))]


def test_nothing_formats_to_nothing() -> None:
    assert formatted("") == ""
    assert formatted("\n \n") == ""
    assert formatted("# only a comment") == "# only a comment\n"

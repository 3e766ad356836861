"""The reader of parameter files against rcl's own parser, over files made by hand and files drawn from a seed."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from midstride.lang.parameter_files import SectionInFile, sections_of
from midstride.lang.source import Source
from midstride.lang.yaml_events import InvalidYaml
from tests.rcl_parser import rcl_parser, rcl_sections

needs_rcl = pytest.mark.skipif(rcl_parser() is None, reason="rcl's parser of parameter files cannot be loaded here")

# Each is one file, or several that are read one after the other.
BY_HAND: list[str | tuple[str, ...]] = [
    "",
    "---\n",
    "# nothing\n",
    "n:\n",
    "n: 5\n",
    "[n]\n",
    "n: [1]\n",
    "n:\n  x: 2\n",
    "ros__parameters: {a: 1}\n",
    "n: {ros__parameters: 5}\n",
    "n: {ros__parameters: }\n",
    "n: {ros__parameters: {}}\n",
    "n: {ros__parameters_too: {a: 1}}\n",
    "n: {ros__parameters: {a: }}\n",
    "n: {ros__parameters: {a: ~, b: null, c: ''}}\n",
    "n: {ros__parameters: {'': 1}}\n",
    "n: {ros__parameters: {a: {'': 1}}}\n",
    # keys twice
    "/**: {ros__parameters: {a: 10.0}}\n/**: {ros__parameters: {b: second}}\nn: {ros__parameters: {a: 40.0}}\n",
    "n: {ros__parameters: {a: 1, a: 2}}\n",
    "n: {ros__parameters: {a: 1, a: 2.5}}\n",
    "n: {ros__parameters: {a: 2.5, a: 1, a: text, a: true}}\n",
    "n: {ros__parameters: {a: [1], a: 5, a: [x, y]}}\n",
    "n: {ros__parameters: {a: {b: 1, b: 2.5}}}\n",
    "n: {ros__parameters: {a: {b: 1}, a.b: 2}}\n",
    "n: {ros__parameters: {a.b: 2, a: {b: 1}}}\n",
    "n: {ros__parameters: {a: 1, a: {b: 2}}}\n",
    "n: {ros__parameters: {a: {b: 1}, a: {c: 2}, a: 7}}\n",
    "n: {ros__parameters: {a: 1}, ros__parameters: {b: 2}}\n",
    "n: {ros__parameters: {a: 1}, m: {ros__parameters: {b: 2}}}\n",
    "m: {n: {ros__parameters: {a: 1}}}\nm: {n: {ros__parameters: {a: 2}}}\nm/n: {ros__parameters: {a: 3}}\n",
    # lists
    "n: {ros__parameters: {a: []}}\n",
    "n: {ros__parameters: {a: [1, 2.0]}}\n",
    "n: {ros__parameters: {a: [1, '2']}}\n",
    "n: {ros__parameters: {a: [1, x]}}\n",
    "n: {ros__parameters: {a: [true, no, Y]}}\n",
    "n: {ros__parameters: {a: [[1, 2]]}}\n",
    "n: {ros__parameters: {a: [[1, 2], [3]]}}\n",
    "n: {ros__parameters: {a: [1, ]}}\n",
    "n: {ros__parameters: {a: [1, [x]]}}\n",
    "n: {ros__parameters: {a: [.inf, 1.0, .nan]}}\n",
    "n:\n  ros__parameters:\n    map:\n    - inner: [x]\n",
    "n:\n  ros__parameters:\n    map:\n    - inner: [x]\n    - inner: [y]\n",
    "n:\n  ros__parameters:\n    map:\n    - {inner: x}\n",
    "n:\n  ros__parameters:\n    map:\n    - {inner: x, outer: y}\n    after: 3\n",
    "n:\n  ros__parameters:\n    map:\n    - inner: x\n      outer: y\n    after: 3\n",
    "n:\n  ros__parameters:\n    map:\n    - inner: {deep: [1]}\n    after: 3\n",
    "n: {ros__parameters: {[a]: 1}}\n",
    "n: {ros__parameters: {{a: 1}: 1}}\n",
    "? [n]\n: {ros__parameters: {a: 1}}\n",
    # maps
    "n: {ros__parameters: {a: {}}}\n",
    "n: {ros__parameters: {a: {}, b: 1}}\n",
    "n: {ros__parameters: {a: {}}}\nm: {ros__parameters: {b: 1}}\n",
    "n: {ros__parameters: {a: {b: {c: 1, d: 2}, e: 3}, f: 4}}\n",
    "n: {ros__parameters: {a.b: {c: 1}, d: 2}}\n",
    "n: {ros__parameters: {x: {a.b: {c: 1}, d: 2}, e: 3}}\n",
    "n: {ros__parameters: {'a.': {b: 1}}}\n",
    "n: {ros__parameters: {a: {b: {c: {d: {e: {f: {g: 1}}}}}}}}\n",
    "n: {ros__parameters: {{b: 1}}}\n",
    "n: {{ros__parameters: {b: 1}}}\n",
    # names
    "/**: {ros__parameters: {a: 1}}\n",
    "/*: {ros__parameters: {a: 1}}\n",
    "**: {ros__parameters: {a: 1}}\n",
    "'**': {ros__parameters: {a: 1}}\n",
    "'*': {ros__parameters: {a: 1}}\n",
    "/**/n: {ros__parameters: {a: 1}}\n",
    "/*/n: {ros__parameters: {a: 1}}\n",
    "/a/*/**/n: {ros__parameters: {a: 1}}\n",
    "/a/**: {ros__parameters: {a: 1}}\n",
    "a/b: {c: {ros__parameters: {a: 1}}}\n",
    "/a: {b: {ros__parameters: {a: 1}}}\n",
    "/: {b: {ros__parameters: {a: 1}}}\n",
    "a/: {b: {ros__parameters: {a: 1}}}\n",
    "a//b: {ros__parameters: {a: 1}}\n",
    "//b: {ros__parameters: {a: 1}}\n",
    "a/: {ros__parameters: {a: 1}}\n",
    "/: {ros__parameters: {a: 1}}\n",
    "1a: {ros__parameters: {a: 1}}\n",
    "a/1b/c: {ros__parameters: {a: 1}}\n",
    "a-b: {ros__parameters: {a: 1}}\n",
    "/a*: {ros__parameters: {a: 1}}\n",
    "/***: {ros__parameters: {a: 1}}\n",
    "gr\u00fcn: {ros__parameters: {a: 1}}\n",
    f"{'a' * 255}: {{ros__parameters: {{a: 1}}}}\n",
    f"{'a' * 256}: {{ros__parameters: {{a: 1}}}}\n",
    f"{'a' * 243}/b: {{ros__parameters: {{a: 1}}}}\n",
    f"{'a' * 244}/b: {{ros__parameters: {{a: 1}}}}\n",
    f"{'a' * 245}/b: {{ros__parameters: {{a: 1}}}}\n",
    f"{'a' * 246}/b: {{ros__parameters: {{a: 1}}}}\n",
    "/**:\n  ros__parameters:\n    plain: 1\n    required:\n      'part: state one': default\n      slash/name: 2\n"
    "      dash-name: 3\n      1st: 4\n      true: 5\n      'a b': 6\n",
    # tags, anchors, documents
    "!!map\nn: !!map {ros__parameters: {p: !!seq [!!str 1, !!str 'b'], !!str q: 1, r: !!str true}}\n",
    "n: {ros__parameters: {p: !!python/tuple [a, b], q: !sum [1, 2], r: !!float 2, s: !!int '5', t: !!binary YQ==}}\n",
    "n: {ros__parameters: {p: ! 5, q: ! '5', r: !!str .nan, s: !!str}}\n",
    "n: {ros__parameters: {p: &a 5, q: *a}}\n",
    "n: {ros__parameters: {p: &a 5, q: &b [1]}}\n",
    "--- \nn: {ros__parameters: {a: 1}}\n---\nn: {ros__parameters: {b: 2}}\n...\n",
    "%YAML 1.1\n---\nn: {ros__parameters: {a: 1}}\n",
    # text over several lines
    "n:\n  ros__parameters:\n    a: |\n      40\n    b: |-\n      40\n    c: >-\n      4\n      0\n    d: |\n",
    'n: {ros__parameters: {a: "x\\0y", b: "\\u00e4\\U0001f600", c: "line\\nline"}}\n',
    'n: {ros__parameters: {"x\\0y": 1}}\n',
    "n: {ros__parameters: {a: two words, b: 'it''s', c: a#b, d: a #b\n}}\n",
    "n:\n  ros__parameters:\n    a: 12:30\n    b: 1_000\n",
    # not YAML
    "n: [\n",
    "n: {ros__parameters: {a: 1}}\n}\n",
    "n:\n\tros__parameters: {a: 1}\n",
    # several files
    ("/**: {ros__parameters: {a: 1}}\nn: {ros__parameters: {a: 2}}\n", "/**: {ros__parameters: {a: 9, b: 9}}\n"),
    ("n: {ros__parameters: {a: 2}}\n", "/**: {ros__parameters: {a: 9}}\n", "n: {ros__parameters: {b: 3}}\n"),
    ("n: {ros__parameters: {a: 2}}\n", "n: {ros__parameters: {a: 2.5}}\n"),
    ("n: {ros__parameters: {a: 2}}\n", "n: {ros__parameters: {a: {b: 3}}}\n"),
    ("n: {ros__parameters: {a: [2]}}\n", "n: {ros__parameters: {a: []}}\n"),
]

# Without `12:30`, which only newer versions of libyaml read within brackets.
SCALARS = """
1 -1 +1 0 -0 00 010 -017 08 0x10 0X1f -0x10 0x 0b11 0o17 1_000 9223372036854775807 9223372036854775808
-9223372036854775808 -9223372036854775809 0xffffffffffffffff 0x7fffffffffffffff 99999999999999999999 1.0 1. .5 -.5e-3
+.5 1e3 1e-3 1E+3 1e 1e+ .e3 . - + -- 1.5.2 1e308 1e309 -1e400 1e-307 2.2250738585072014e-308 1e-320 4.9e-324 1e-400
0e-999999999 1e999999999 0x1p3 0x1.8 0x.8p1 0x1p 0xp1 0x1p-1074 0x1p-1075 0x1p-1080 0x3p-1074 0x1.0000001p-1073
0x1p1024 0x1p999999999 .inf .Inf .INF .iNf +.inf -.inf -.Inf .nan .NaN .NAN -.nan +.nan .Nan inf Inf INF -inf
+infinity Infinity infinit nan NaN -nan nan() nan(a_1) nan(a-1) y Y yes Yes YES yEs n N no true True TRUE tRUE on On
off false False f t ~ null Null text a.b /abs ~/rel 5x 0x1g 0.1 1,5 1e3.0 '1' '' "true" 3.141592653589793
123456789012345678901234567890 0.1e1 00.5 0x00 1d3 1f
""".split()


def ours(files: Sequence[str]) -> list[tuple[str, dict[str, Any]]] | str:
    """The sections that Midstride reads, or why it does not."""
    try:
        found = sections_of([Source("p.yaml", text) for text in files])
    except InvalidYaml as refused:
        return str(refused)
    return [(section.pattern, {name: each.value for name, each in section.values.items()}) for section in found]


def rcls(files: Sequence[str], folder: Path) -> list[tuple[str, dict[str, Any]]] | None:
    paths = []
    for number, text in enumerate(files):
        paths.append(folder / f"{number}.yaml")
        paths[-1].write_bytes(text.encode())
    return rcl_sections(paths)


def comparable(value: Any) -> Any:
    """With its type, NaN as one value, and no value as an empty list, which rcl has no value for either."""
    if value is None or value == []:
        return "no value"
    if isinstance(value, list):
        return [comparable(each) for each in value]
    return type(value).__name__, "nan" if value != value else (math.copysign(1, value), value) if value == 0 else value


def assert_same(files: Sequence[str], folder: Path) -> bool:
    """Whether rcl takes the files."""
    wanted, found = rcls(files, folder), ours(files)
    if wanted is None:
        assert isinstance(found, str), f"rcl refuses {files!r}, and this is read: {found}"
        return False
    assert not isinstance(found, str), f"rcl reads {wanted} from {files!r}, and this is refused: {found}"
    sections = [
        [(name, [(each, comparable(value)) for each, value in values.items()]) for name, values in each]
        for each in (found, wanted)
    ]
    assert sections[0] == sections[1], files
    return True


@needs_rcl
@pytest.mark.parametrize("files", BY_HAND, ids=range(len(BY_HAND)))
def test_a_file_by_hand_is_read_as_rcl_reads_it(files: str | tuple[str, ...], tmp_path: Path) -> None:
    assert_same((files,) if isinstance(files, str) else files, tmp_path)


@needs_rcl
def test_every_plain_scalar_is_read_as_rcl_reads_it(tmp_path: Path) -> None:
    for text in SCALARS:
        for form in ("n: {{ros__parameters: {{a: {0}}}}}\n", "n:\n  ros__parameters:\n    a: |-\n      {0}\n"):
            assert_same([form.format(text)], tmp_path)
        assert_same([f"n: {{ros__parameters: {{a: [{text}, {text}]}}}}\n"], tmp_path)


_TUPLE = "!!python/tuple "
WORDS = ["a", "b", "a.b", "n", "m", "/**", "/n", "ros__parameters", "1st", '"x y"', "''", "ros__parameters2", "**", "~"]
SECTIONS = ["n", "m", "/n", "/m/n", "/**", "/*", "/*/n", "m/n", "/**/n"]


def drawn_value(random: random.Random, depth: int) -> str:
    kind = random.random()
    if kind < 0.55 or depth > 4:
        return random.choice(SCALARS)
    if kind < 0.72:
        members = [random.choice(SCALARS)] * random.randrange(4) if random.random() < 0.7 else [
            drawn_value(random, depth + 1) for _ in range(random.randrange(4))
        ]  # fmt: skip
        return f"{random.choice(['', '', '', _TUPLE, '&x '])}[{', '.join(members)}]"
    return drawn_map(random, depth + 1)


def drawn_map(random: random.Random, depth: int) -> str:
    entries = [f"{random.choice(WORDS)}: {drawn_value(random, depth)}" for _ in range(random.randrange(4))]
    return "{" + ", ".join(entries) + "}"


def drawn_file(random: random.Random) -> str:
    """Often one that rcl takes: a few sections with maps of parameters; now and then changed at one place."""
    lines = []
    for _ in range(random.randrange(1, 4)):
        name = random.choice(SECTIONS)
        if random.random() < 0.85:
            lines.append(f"{name}: {{ros__parameters: {drawn_map(random, 0)}}}\n")
        elif random.random() < 0.5:
            lines.append(f"{name}: {{{random.choice(SECTIONS)}: {{ros__parameters: {drawn_map(random, 0)}}}}}\n")
        else:
            lines.append(f"{name}: {drawn_value(random, 0)}\n")
    text = "".join(lines)
    if random.random() < 0.2:
        at = random.randrange(len(text))
        changed = text[:at] + random.choice(["", "[", "]", "{", "}", ",", "*x", "!!str ", " ", "- "]) + text[at + 1 :]
        # Of what follows a tag at once, the versions of libyaml make different things.
        return changed if changed.count(_TUPLE) == text.count(_TUPLE) else text
    return text


@needs_rcl
@pytest.mark.parametrize("seed", range(8))
def test_drawn_files_are_read_as_rcl_reads_them(seed: int, tmp_path: Path) -> None:
    drawn = random.Random(seed)
    taken = sum(
        assert_same([drawn_file(drawn) for _ in range(drawn.choice([1, 1, 2, 3]))], tmp_path) for _ in range(400)
    )
    assert 40 < taken < 400  # of both kinds


def sections(text: str) -> list[SectionInFile]:
    return sections_of([Source("p.yaml", text)])


@pytest.mark.parametrize(
    ("pattern", "matching", "others"),
    [
        ("n", ["n"], ["m/n", "n/n", "nn"]),
        ("/n", ["n"], ["m/n"]),
        ("m/n", ["m/n"], ["n", "x/m/n"]),
        ("/**", ["n", "m/n", "a/b/c/n"], []),
        ("/*", ["n"], ["m/n"]),
        ("/*/n", ["m/n"], ["n", "a/b/n"]),
        ("/**/n", ["n", "m/n", "a/b/n"], ["nn", "m/nn"]),
        ("/m/**", ["m", "m/n", "m/a/n"], ["n", "mm/n"]),
    ],
)
def test_a_section_applies_to_the_nodes_that_it_names(pattern: str, matching: list[str], others: list[str]) -> None:
    (section,) = sections(f"'{pattern}': {{ros__parameters: {{a: 1}}}}\n")
    assert [role for role in (*matching, *others) if section.matches(role)] == matching


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("n:\n  ros__parameters:\n    rate:\n", "parameter `rate` of section `n` has no value"),
        ("/a/n: {ros__parameters: {p: {q: [1, x]}}}\n", "parameter `p.q` of section `/a/n`: a list cannot mix types"),
        ("n: {ros__parameters: {p: &x 5, q: *x}}\n", "ROS parameter files have no aliases: `*x`"),
        ("a-b: {ros__parameters: {p: 1}}\n", "`a-b` is no name of a section: `a-b` is no name of a node"),
        ("a//b: {ros__parameters: {p: 1}}\n", "`a//b` is no name of a section: a part is empty"),
        ("n: {ros__parameters: {p: {'': 1}}}\n", "a name is empty, at parameter `p` of section `n`"),
    ],
)
def test_what_rcl_refuses_is_named_with_section_and_parameter(text: str, message: str) -> None:
    assert ours([text]) == message


def test_a_file_that_costs_too_much_is_refused() -> None:
    deep = ours(["n: {ros__parameters: " + "{a: " * 200 + "1" + "}" * 201 + "}"])
    assert deep == "this is nested more than 100 deep"
    assert (
        ours(["n: {ros__parameters: {a: [" + "1, " * 60_000 + "1]}}"])
        == "this file has more than 50000 keys and values"
    )

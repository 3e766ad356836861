"""Errors: every independent one is reported once at its exact place, and nothing else; hostile input takes limited time
and space."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from midstride.lang import load, load_text, render
from midstride.lang.source_files import MAX_FILES

from .known import Known

SEEDS = Path(__file__).parent / "seeds"


def places(text: str) -> list[tuple[str, int, int]]:
    found = load_text(text, "t.stride", messages=Known()).diagnostics
    return [(diagnostic.code, *diagnostic.position) for diagnostic in found]


def marked(text: str) -> tuple[str, list[tuple[str, int, int]]]:
    """A text without its marks `‹E012›`, and their places."""
    expected, plain = [], []
    for number, line in enumerate(text.split("\n"), 1):
        while "‹" in line:
            at = line.index("‹")
            end = line.index("›")
            expected.append((line[at + 1 : end], number, at + 1))
            line = line[:at] + line[end + 1 :]
        plain.append(line)
    return "\n".join(plain), sorted(expected, key=lambda place: (place[1], place[2], place[0]))


# The marks are where diagnostics are expected: a syntax error, a unit, a name, M2, an attachment, and so on.
FIVE = """system five

topic /scan : sensor_msgs/msg/LaserScan @ 10 ‹E127›hz
topic /out : std_msgs/msg/String @ 10 Hz

component Sensor {
  output out
  functionality sense {
    produces out
    mode normal { guarantee ‹E011›out : sensor_msgs/msg/LaserScan @ 10 Hz }
    mode slow { guarantee out : sensor_msgs/msg/LaserScan @ 20 Hz }
    mode off { }
  }
}

component Filter {
  input scan : sensor_msgs/msg/LaserScan @ 5 Hz
  output out
  functionality filter {
    uses scan
    produces out
    mode normal { assume scan   guarantee out : std_msgs/msg/String @ 5 Hz }
    mode off { ‹E120›42 }
  }
}

node sensor : Sensor { out -> /scan }
node filter : Filter { scan <- ‹E008›/scann   out -> ‹E020›/out }
"""

OTHERS = [
    # a missing brace is one error, and does not hide others
    """system s
component A {
  functionality f {
    mode normal {‹E123›
    mode ‹E010›degraded { assume std_msgs/msg/String }
  }
}
""",
    # a name declared in a statement that cannot be parsed is not unknown
    """system s
topic /a ‹E120›= std_msgs/msg/String
contract K = ‹E120›{ }
component C { run ‹E120›5   output out   functionality f { produces out   mode a { guarantee out : K }   mode b { } } }
node n : C { out -> /a }
topic /b : K
keep n.f at a
""",
    # a misspelt keyword is reported once, and its statement is parsed
    """system s
‹E121›topc /a : std_msgs/msg/String { publishers <= 1 }
‹E121›componnent C { output out   ‹E121›functionalty f { produces out   ‹E121›mod a { guarantee out : std_msgs/String }
mode b { } } } node n : C { out -> /a }
node m : C { out -> ‹E008›/c }
""",
    # an unknown type is reported at each place, and no other error is derived from it
    """system s
topic /a : sensor_msgs/msg/‹›Imag @ 5 Hz
component C { input in : sensor_msgs/msg/Image   functionality f { uses in   mode a { assume in }   mode b { } } }
node n : C { in <- /a }
""".replace("sensor_msgs/msg/‹›Imag", "‹E130›sensor_msgs/msg/Imag"),
    # a missing part at the end of a line is reported after it
    """system s
topic /a :‹E120›
topic /b : std_msgs/msg/String @‹E120›
topic /c : std_msgs/msg/String @ ‹E127›5
contract K =‹E120›
include‹E120›
""",
    # missing or wrong commas, arrows and colons
    """system s
topic /a ‹E120›std_msgs/msg/String
component C { input in : std_msgs/String   functionality f { uses in   mode a { assume in }   mode b { } } }
node n ‹E120›C { ‹E144›in -> /a }
node m : C { in ‹E120›/a }
""",
    # inheritance from an unknown component: what may be inherited is not unknown
    """system s
topic /a : std_msgs/msg/String
component C like ‹E008›B { functionality f { uses in   mode a { assume in }   mode b { } } }
node n : C { in <- /a   out -> /a }
keep n.g at normal
""",
]


@pytest.mark.parametrize("text", [FIVE, *OTHERS])
def test_every_independent_error_is_reported_once_at_its_place(text: str) -> None:
    plain, expected = marked(text)
    found = [place for place in places(plain) if place[0].startswith("E")]
    assert found == expected, render(load_text(plain, messages=Known()).diagnostics)


def test_five_independent_errors_and_nothing_else_are_reported() -> None:
    plain, expected = marked(FIVE)
    assert places(plain) == expected
    assert len({code for code, _, _ in expected}) == 5


def test_a_damaged_line_of_the_sample_causes_few_errors_one_of_them_near_it() -> None:
    """No cascade: half of a line is missing, for each line of the sample in turn."""
    lines = (SEEDS / "patrol.stride").read_text(encoding="utf-8").split("\n")
    sensors = (SEEDS / "sensors.stride").read_text(encoding="utf-8")
    counts, near = [], 0
    for number, line in enumerate(lines):
        code = line.partition("#")[0].rstrip()
        if not code.strip() or code.strip() in {"}", "{"}:
            continue
        damaged = [
            *lines[:number],
            code[: len(code) - len(code.lstrip()) + len(code.lstrip()) // 2],
            *lines[number + 1 :],
        ]
        loaded = load_text("\n".join(damaged), "t.stride", read=lambda path: sensors)
        errors = [d for d in loaded.diagnostics if d.severity == "error"]
        assert len(errors) <= 3, (line, render(errors))
        counts.append(len(errors))
        near += any(abs(error.position[0] - (number + 1)) <= 1 for error in errors)
    assert (len(counts), counts.count(0)) == (49, 2)
    assert near >= 45


def test_a_near_miss_is_suggested() -> None:
    (fault,) = load_text("system s\ncontract Scan = std_msgs/msg/String\ntopic /a : Scam\n").diagnostics[:1]
    assert fault.help == "did you mean `Scan`?"


def test_carets_are_under_wide_and_combining_characters() -> None:
    text = 'system s\n# x\ncomponent C { run "日本\u0301" bad }\n'
    (fault,) = load_text(text).diagnostics
    shown = fault.render().split("\n")
    assert shown[4].index("^") - shown[3].index("component") == len('component C { run "') + 4 + len('" ')


def test_an_error_in_an_included_file_is_reported_there() -> None:
    def read(path: Path) -> str:
        return "topic /a : Nope\n"

    (fault,) = [
        d
        for d in load_text('system s\ninclude "x/a.stride"\n', "d/t.stride", read=read).diagnostics
        if d.code == "E008"
    ]
    assert (fault.file_name, *fault.position) == (os.path.join("d", "x", "a.stride"), 1, 12)


def test_the_json_form_of_a_diagnostic() -> None:
    (fault,) = load_text("system s\nsystem t\n", "t.stride").diagnostics
    assert fault.to_json() == {
        "code": "E128",
        "severity": "error",
        "file": "t.stride",
        "line": 2,
        "column": 8,
        "end_line": 2,
        "end_column": 9,
        "message": "a file can name only one system",
        "help": None,
        "follows": None,
        "notes": [{"message": "first named here", "file": "t.stride", "line": 1, "column": 8}],
    }


HOSTILE = {
    "deep namespaces": "system s\n" + "namespace a { " * 50_000,
    "deep braces": "system s\ncomponent C " + "{ " * 100_000,
    "deep closing": "}" * 100_000,
    "brackets": "system s\ncomponent C { parameters { a = " + "[" * 100_000,
    "a long name": "system s\ntopic /" + "a" * 1_000_000 + " : std_msgs/msg/String\n",
    "a long number": "system s\nresource r = " + "9" * 1_000_000 + "\n",
    "a long text": 'system s\ncomponent C { run "' + "x" * 1_000_000,
    "one long line": "system s " + "topic /a : std_msgs/msg/String " * 30_000,
    "only signs": "<-->>==@@::,,.." * 20_000,
    "not a word of it": "\u2603" * 300_000,
    "quotes": '"' * 200_000,
    "backslashes": 'system s\ninclude "' + "\\" * 200_000,
    "like upon like": "system s\n" + "".join(f"component C{n} like C{n + 1}\n" for n in range(20_000)),
    "contract upon contract": "system s\n" + "".join(f"contract C{n} = C{n + 1}\n" for n in range(20_000)),
    "dots": "system s\nkeep " + "a." * 100_000,
    "many constraints": "system s\ncontract C = std_msgs/msg/String where " + "a = 1, " * 30_000 + "a = 2",
    "unknown names": "system s\ncomponent C { output out }\n"
    + "".join(f"topic /t{n} : p/T\nnode n{n} : C {{ out -> /u{n} }}\n" for n in range(5_000)),
    "unknown contracts": "system s\n"
    + "".join(f"contract Contract{n} = p/T\ntopic /t{n} : Kontract{n}\n" for n in range(5_000)),
    "many outputs": "system s\ncomponent C {\n" + "".join(f"output a{n}\n" for n in range(20_000)) + "}\n",
    "many guarantees": "system s\n"
    + "".join(f"topic /t{n} : p/T\nenvironment {{ guarantee g{n} on /t{n} : p/T }}\n" for n in range(20_000)),
    "many orders": "system s\n" + "".join(f"order n{n} before n{n + 1}\n" for n in range(20_000, 0, -1)),
    "NUL": "system s\n" + "\0" * 100_000,
}


# Those that take seconds.
SLOW = (
    "many guarantees|like upon like|unknown contracts|many orders|one long line|unknown names|many constraints".split(
        "|"
    )
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.full] if name in SLOW else []) for name in HOSTILE]
)
def test_hostile_texts_take_limited_time_and_space(name: str) -> None:
    start = time.process_time()
    loaded = load_text(HOSTILE[name], "t.stride")
    text = render(loaded.diagnostics)
    assert loaded.specification is None
    assert loaded.diagnostics
    assert len(text) < 1_000_000 + 200 * len(HOSTILE[name]) // 1_000
    assert time.process_time() - start < 10


SPECIFICATION = """system s
topic /t : std_msgs/msg/String
component C { output out  functionality f { produces out  mode on { } } }
node n : C { out -> /t }
"""


@pytest.mark.parametrize("way", ["a path upwards", "an absolute path", "a link", "another kind of file"])
@pytest.mark.parametrize("statement", ["include", "parameters"])
def test_a_specification_reads_only_below_its_folder(statement: str, way: str, tmp_path: Path) -> None:
    """Its diagnostics would print what they quote: somebody else's file in a CI job must not choose what that is."""
    ending = ".stride" if statement == "include" else ".yaml"
    folder, secret = tmp_path / "robot", tmp_path / f"secret{ending}"
    folder.mkdir()
    secret.write_text("TOKEN=abcdef\n")
    (folder / ".env").write_text("TOKEN=abcdef\n")
    (folder / f"link{ending}").symlink_to(secret)
    name = {
        "a path upwards": f"../secret{ending}",
        "an absolute path": str(secret),
        "a link": f"link{ending}",
        "another kind of file": ".env",
    }[way]
    (folder / "robot.stride").write_text(f'{SPECIFICATION}{statement} "{name}"\n')
    loaded = load(folder / "robot.stride")
    assert "E107" in {diagnostic.code for diagnostic in loaded.diagnostics}
    assert "TOKEN" not in render(loaded.diagnostics)


def test_further_folders_can_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shared, folder = tmp_path / "shared", tmp_path / "robot"
    shared.mkdir()
    folder.mkdir()
    (shared / "a.stride").write_text("contract K = std_msgs/msg/String\n")
    (folder / "robot.stride").write_text('system s\ninclude "../shared/a.stride"\ntopic /t : K\n')
    assert load(folder / "robot.stride").has_errors
    monkeypatch.setenv("MIDSTRIDE_INCLUDE_PATH", f"/nowhere{os.pathsep}{shared}")
    assert not load(folder / "robot.stride").has_errors


def test_a_system_whose_files_are_installed_as_links_is_read(tmp_path: Path) -> None:
    source, installed = tmp_path / "src", tmp_path / "install"
    for each in (source, installed):
        each.mkdir()
    for name, text in (
        ("a.stride", "contract K = std_msgs/msg/String\n"),
        ("s.stride", 'system s\ninclude "a.stride"\n'),
    ):
        (source / name).write_text(text)
        (installed / name).symlink_to(source / name)
    assert not load(installed / "s.stride").has_errors


def test_an_include_bomb_is_limited(tmp_path: Path) -> None:
    for level in range(12):
        inside = "".join(f'namespace n{n} {{ include "f{level + 1}.stride" }}\n' for n in range(10))
        (tmp_path / f"f{level}.stride").write_text(inside if level < 11 else "contract K = std_msgs/msg/String\n")
    (tmp_path / "bomb.stride").write_text('system s\ninclude "f0.stride"\n')
    loaded = load(tmp_path / "bomb.stride")
    assert {d.code for d in loaded.diagnostics} == {"E104"}
    assert len(loaded.files) < MAX_FILES


def test_a_cycle_of_includes_through_a_link_ends(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path)
    (tmp_path / "a.stride").write_text('include "loop/a.stride"\n')
    (tmp_path / "s.stride").write_text('system s\ninclude "a.stride"\n')
    assert {d.code for d in load(tmp_path / "s.stride").diagnostics} == {"E103"}


def test_a_path_that_is_not_a_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stride")
    for path in (tmp_path / "pipe.stride", tmp_path, tmp_path / "missing.stride", Path("/dev/zero")):
        (fault,) = load(path).diagnostics
        assert fault.code == "E100"
        assert str(path) in str(fault)


def test_a_yaml_bomb_is_limited() -> None:
    bomb = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
        f"{chr(98 + n)}: &{chr(98 + n)} [{','.join(['*' + chr(97 + n)] * 10)}]\n" for n in range(9)
    )
    loaded = load_text('system s\ncomponent C { }\nnode n : C { parameters "p.yaml" }\n', read=lambda path: bomb)
    assert [d.code for d in loaded.diagnostics if d.severity == "error"] == ["E150"]

"""Control characters of files and components never reach the terminal: they are shown escaped."""

from __future__ import annotations

import json
import os
import unicodedata
from pathlib import Path
from typing import Any

import pytest

from midstride.cli import main
from midstride.cli.output import console, print_json, printable_output
from midstride.model.printable import on_one_line, printable
from tests.cli.conftest import EXAMPLES, Midstride
from tests.cli.terminal import Terminal

# Clears the screen, sets the title, the same with 8-bit controls, reverses what follows, and a lone surrogate.
HOSTILE = "\x1b[2J\x1b]0;title\x07\x9b31m\u202etxt\u2066\u200f\r\x7f"
SHOWN = r"\x1b[2J\x1b]0;title\x07\x9b31m\u202etxt\u2066\u200f\r\x7f"


def raw(text: str) -> list[str]:
    """The control characters in ``text``."""
    return [c for c in text if unicodedata.category(c) in {"Cc", "Cf", "Cs", "Zl", "Zp"} and c != "\n"]


def test_control_characters_are_escaped_and_nothing_else() -> None:
    assert printable(HOSTILE) == SHOWN
    assert printable("\ud800 \u2028 \U000e0041") == r"\ud800 \u2028 \U000e0041"
    kept = "a line\n\tWörter, 日本, 👩\u200d👩, می\u200cشود, \xa0"
    assert printable(kept) == kept
    assert on_one_line("one\n\ttwo") == r"one\n\ttwo"
    assert printable(printable(HOSTILE)) == SHOWN


FILES: dict[str, dict[str, str]] = {
    "a comment": {"x.stride": f"system s # {HOSTILE}\n# {HOSTILE}\ntopic topic /a # {HOSTILE}\n"},
    "a name": {"x.stride": f"system s\ntopic /a{HOSTILE} : std_msgs/msg/String\nnode n{HOSTILE} : C\n"},
    "a string": {"x.stride": f'system s\ninclude "{HOSTILE}.stride"\nresource "{HOSTILE}" = -1\n'},
    "a value": {"x.stride": f'system s\ntopic /a : std_msgs/msg/String where x = "{HOSTILE}", x = "y"\n'},
    "an included file": {"x.stride": 'system s\ninclude "y.stride"\n', "y.stride": f"topic {HOSTILE}\n"},
    "keys and words of JSON": {
        "x.json": json.dumps({"system": f"{HOSTILE}\n", HOSTILE: 1, "topics": {HOSTILE: {"type": HOSTILE}}})
    },
    "names in JSON": {
        "x.json": json.dumps({"system": "s", "nodes": {"n": {"component": f"C\n{HOSTILE}"}, f"{HOSTILE}": {}}})
    },
    "raw text in JSON": {"x.json": '{"system": "s", "nodes": {"' + HOSTILE.replace("\r", "") + '": {}}}'},
    "no JSON": {"x.json": f'{{"system": {HOSTILE}'},
    "the names of a parameter file": {
        "x.stride": 'system s\ncomponent C { parameters "p.yaml" }\nnode n : C\n',
        "p.yaml": json.dumps({f"n{HOSTILE}": {HOSTILE: {HOSTILE: 1}}, "n": {"ros__parameters": {HOSTILE: None}}}),
    },
    "the sections of a parameter file": {
        "x.stride": 'system s\ncomponent C { parameters "p.yaml" }\nnode n : C\n',
        "p.yaml": '"n\\e[2J\\u009b": {ros__parameters: {a: 1}}\n',
    },
}


@pytest.mark.parametrize("case", FILES)
@pytest.mark.parametrize("command", ["check", "fmt", "graph", "diff", "up"])
def test_what_is_quoted_of_a_file_is_printable(
    command: str, case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name, text in FILES[case].items():
        (tmp_path / name).write_text(text, encoding="utf-8", newline="")
    file = str(tmp_path / next(iter(FILES[case])))
    words = {"diff": ["diff", file, file], "up": ["up", file, "--backend", "sim"]}.get(command, [command, file])
    status = main(words)
    out, err = capsys.readouterr()
    assert raw(out) == raw(err) == []
    if command == "check":
        assert status == 1 and "\\x1b" in out
    main([*words, "--json"])
    out, err = capsys.readouterr()
    assert raw(out) == raw(err) == []
    json.loads(out)


def test_the_name_of_a_file_is_printable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One that is no UTF-8 included, which the encoding of the output could not represent."""
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/\x1b[2J\xff")
    os.mkdir(folder)
    file = Path(folder) / "x.stride"
    file.write_text("system   s\n")
    for words in (["check", str(file)], ["check", str(file) + "e"], ["fmt", str(file)], ["check", f"--{HOSTILE}"]):
        main(words)
        out, err = capsys.readouterr()
        assert raw(out) == raw(err) == [] and "\\x1b[2J" in out + err


def test_a_documentation_of_binary_input_is_printable(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "E115"]) == 0
    out, _ = capsys.readouterr()
    assert raw(out) == [] and "\\x00" in out


def test_colours_are_not_escaped(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    with printable_output():
        console().print(f"[bold]{HOSTILE}[/bold]")
    out, _ = capsys.readouterr()
    assert out == f"\x1b[1m{SHOWN}\x1b[0m\n".replace(r"\x07", "").replace(r"\r", "")  # Rich drops these two


def test_json_stays_the_same_document(capsys: pytest.CaptureFixture[str]) -> None:
    document = {"words": HOSTILE + "\ud800\U000e0041é", HOSTILE: [HOSTILE]}
    with printable_output():
        print_json(document)
    out, _ = capsys.readouterr()
    assert raw(out) == [] and "é" in out
    assert json.loads(out) == document


BROKEN = f"""
comp.logger.info({HOSTILE!r})
raise ValueError({HOSTILE!r} + " and the end")
"""


@pytest.mark.full
def test_what_a_component_says_is_printable(midstride: Midstride, tmp_path: Path) -> None:
    """Its error as a reason and in events, on a terminal and in a pipe; its log if it does not come up."""
    for file in (EXAMPLES / "talker").iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    listener = (EXAMPLES / "talker" / "listener.py").read_text()
    failing = BROKEN.strip().replace("\n", "\n    ")
    hears = '    comp.logger.info(f"I heard: {message.data}")'
    (tmp_path / "listener.py").write_text(listener.replace(hears, f"    {failing}"))
    specification = str(tmp_path / "talker.stride")
    up = midstride("up", specification, "--backend", "sim", "-d")
    assert up.status == 3 and "\\x1b[2J" in up.out  # it is up, and the listener has degraded
    assert raw(up.out) == raw(up.err) == []
    shown: dict[str, Any] = {}
    for words in (["status"], ["why", "listener.listen"], ["log"]):
        shown[words[0]] = midstride(*words)
        for text in (shown[words[0]].out, shown[words[0]].err, midstride(*words, "--json").out):
            assert raw(text) == [], words
    assert SHOWN in shown["why"].out
    assert "\\x1b[2J" in shown["status"].out and "\\u2066\\u200f" in shown["status"].out  # not cut short
    with Terminal(midstride, "status") as terminal:
        assert "\\x1b[2J" in (text := terminal.rest())
        assert "\x9b" not in text and "\u202e" not in text and "\x1b]" not in text
    assert midstride("down").status == 0
    (tmp_path / "talker.py").write_text(f"import sys\nsys.stderr.write({HOSTILE!r})\nraise RuntimeError({HOSTILE!r})\n")
    done = midstride("up", specification, "--backend", "sim", "-d")
    assert done.status == 3 and "\\x1b[2J" in done.out  # the listener is up, and the talker is not
    assert raw(done.out) == raw(done.err) == []

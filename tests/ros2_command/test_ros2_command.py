"""``ros2 midstride VERB``, with ros2cli where it can be imported, else with its documented interface."""

from __future__ import annotations

import importlib
import inspect
import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from midstride.cli import main
from midstride.cli.command_list import COMMANDS
from tests.ros2_command import ros2

ROOT = Path(__file__).parents[2]
TALKER = "examples/talker/talker.stride"
Run = Callable[..., tuple[object, str, str]]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The module of the command, with one of the two."""
    monkeypatch.chdir(ROOT)
    if not ros2.IS_HERE:
        monkeypatch.syspath_prepend(ros2.DOCUMENTED)
    yield importlib.import_module("midstride.cli.ros2_command")
    for name in [name for name in sys.modules if name.split(".")[0] == "ros2cli" or name.endswith(".ros2_command")]:
        del sys.modules[name]


@pytest.fixture
def run(command: Any, capsys: pytest.CaptureFixture[str]) -> Run:
    def typed(*words: str) -> tuple[object, str, str]:
        try:
            status = importlib.import_module("ros2cli.cli").main(argv=list(words))
        except SystemExit as ended:  # of argparse
            status = ended.code
        return (status, *capsys.readouterr())

    return typed


def test_each_command_is_a_verb_with_its_summary(run: Run) -> None:
    assert {entry.name for entry in entry_points(group="midstride.verb")} == set(COMMANDS)
    status, out, _ = run("midstride")
    assert status == 0
    shown = dict(line.split(maxsplit=1) for line in out.split("Commands:")[1].splitlines() if line.count(" ") > 3)
    assert {name: shown.get(name, "").lower() for name in COMMANDS} == {
        name: summary.lower() for name, (_, summary) in COMMANDS.items()
    }
    assert run("midstride", "-h") == (0, out, "")


@pytest.mark.parametrize(
    "line",
    [
        f"check {TALKER}",
        f"check -- {TALKER}",
        f"check {TALKER} --json",
        f"--json check {TALKER}",
        f"--include-path examples check {TALKER}",
        f"--include-path=examples --json check {TALKER}",
        f"plan --replace talker=NewTalker {TALKER} --strategy paper",
        f"impact {TALKER} talker",
        "explain E101",
        "check none.stride",
        "--version",
    ],
)
def test_a_verb_is_the_command(line: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    words = line.split()
    expected = (main(words), *capsys.readouterr())
    status, out, err = run("midstride", *words)
    assert (status, out, err.replace("ros2 midstride", "midstride")) == expected


@pytest.mark.parametrize(
    "line", ["replace -h", "replace --yes --help", "param set -h", "check --wrong", "replace", "param"]
)
def test_help_and_errors_name_the_program_that_was_typed(
    line: str, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    status = main(line.split())
    out, err = capsys.readouterr()
    found = run("midstride", *line.split())
    assert found[0] == status
    assert "ros2 midstride" in found[1] + found[2]
    # The program's name moves where the lines of the usage are folded.
    assert [" ".join(text.replace("ros2 midstride", "midstride").split()) for text in found[1:]] == [
        " ".join(text.split()) for text in (out, err)
    ]


def test_options_before_the_verb_are_not_kept_for_the_next_call(run: Run) -> None:
    assert run("midstride", "--json", "check", TALKER)[1].startswith("{")
    assert not run("midstride", "check", TALKER)[1].startswith("{")


def test_an_unknown_verb_is_refused(run: Run) -> None:
    status, _, err = run("midstride", "replce")
    assert status == 2
    assert "invalid choice: 'replce'" in err


def test_another_package_adds_a_verb(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    metadata = tmp_path / "other-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Name: other\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[midstride.verb]\ncount = other_verb:Count\n")
    (tmp_path / "other_verb.py").write_text(
        "from ros2cli.verb import VerbExtension\n\n\n"
        "class Count(VerbExtension):\n"
        '    """Count to a number."""\n\n'
        "    def add_arguments(self, parser, cli_name):\n"
        '        parser.add_argument("--to", type=int, default=2)\n\n'
        "    def main(self, *, args):\n"
        "        print(*range(args.to))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert run("midstride", "count", "--to", "3") == (0, "0 1 2\n", "")
    assert "Count to a number" in run("midstride")[1]


def test_a_verb_that_is_no_command_is_no_attribute(command: Any) -> None:
    with pytest.raises(AttributeError, match="has no attribute 'replce'"):
        _ = command.replce


@pytest.mark.skipif(not ros2.IS_HERE, reason="there is no ros2cli")
@pytest.mark.parametrize(
    ("module", "attribute"),
    [
        ("command", "CommandExtension.add_arguments"),
        ("command", "CommandExtension.main"),
        ("command", "add_subparsers_on_demand"),
        ("verb", "VerbExtension"),
    ],
)
def test_the_documented_interface_is_that_of_ros2cli(module: str, attribute: str) -> None:
    """Of the functions that the extensions call or are called by; on a machine with ros2cli alone."""
    source = ros2.DOCUMENTED / "ros2cli" / f"{module}.py"
    real, documented = importlib.import_module(f"ros2cli.{module}"), runpy.run_path(str(source))
    name, *rest = attribute.split(".")
    ours, theirs = documented[name], getattr(real, name)
    for each in rest:
        ours, theirs = getattr(ours, each), getattr(theirs, each)
    assert list(inspect.signature(ours).parameters) == list(inspect.signature(theirs).parameters)


# -- completion ---------------------------------------------------------------------------------------------


def completed(line: str, folder: Path) -> list[str]:
    """What argcomplete offers for a line, as Bash asks for it."""
    pytest.importorskip("argcomplete")
    answer = folder / "answer"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n\"'><=;|&(:",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line.encode())),
        "XDG_RUNTIME_DIR": str(folder),
    }
    command = [sys.executable, ros2.__file__]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return [word.strip() for word in answer.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("ros2 midstride re", ["remove", "replace", "report", "restart"]),
        ("ros2 midstride --inc", ["--include-path"]),
        ("ros2 midstride replace --stra", ["--strategy"]),
        ("ros2 midstride replace --yes --strategy pa", ["paper"]),
        ("ros2 midstride replace --yes --strategy=pa", ["paper"]),  # Bash has `--strategy=` already
        (f"ros2 midstride plan {TALKER} --replace talker=N", ["NewTalker"]),
        (f"ros2 midstride --json impact {TALKER} ", ["listener", "talker"]),
        (f"ros2 midstride impact {TALKER} --json l", ["listener"]),
        ("ros2 midstride param s", ["set"]),
        ("ros2 midstride check examples/talker/talker.s", ["examples/talker/talker.stride"]),
        ("ros2 midstride explain X", []),
    ],
)
def test_a_word_is_completed_as_click_does(line: str, expected: list[str], tmp_path: Path) -> None:
    assert completed(line, tmp_path) == expected

"""The Alloy specification: all of it comes out as it says, what is broken is found, nothing passes unasked."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from midstride.cli import main
from midstride.errors import AlloyFailed, AlloyMissing
from midstride.verify import library
from midstride.verify.alloy_checks import Checked, Task, check_specification, tasks
from midstride.verify.library import MODULES, AlloyCommand, commands
from midstride.verify.run import Alloy, SolverOutcome, find
from midstride.verify.verdict import Answer
from tests.planting import plant

SMALL = 3
PAPER = (Path(__file__).parents[2] / "docs" / "paper.md").read_text(encoding="utf-8")
ACTIONS = ("Create", "Remove", "Attach", "Detach", "Degrade", "Upgrade")


def only(module: str, **given: object) -> Checked:
    (checked,) = check_specification(find(), SMALL, modules=(module,), **given)  # type: ignore[arg-type]
    return checked


# -- what comes out --------------------------------------------------------------------------------------------


@pytest.mark.alloy
@pytest.mark.parametrize("module", MODULES)
@pytest.mark.full
def test_the_specification_has_its_stated_results_at_a_small_scope(module: str) -> None:
    checked = only(module)
    assert checked.answer is Answer.HOLDS, checked.because
    assert checked.task.commands == tuple(commands(module, SMALL))


@pytest.mark.alloy
@pytest.mark.long
@pytest.mark.timeout(6 * 3600)
def test_the_specification_has_its_stated_results_to_scope_5() -> None:
    found = list(check_specification(find(), 5))
    assert {str(checked.task): checked.because for checked in found if checked.answer is not Answer.HOLDS} == {}
    assert sorted(str(checked.task) for checked in found) == sorted(str(c) for m in MODULES for c in commands(m))


@pytest.mark.alloy
def test_the_analyzer_leaves_no_files_where_java_puts_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAVA_TOOL_OPTIONS", f"-Djava.io.tmpdir={tmp_path}")
    source = tmp_path.parent / f"{tmp_path.name}.als"
    source.write_text("sig A {} run Some { some A } for 1\n", encoding="utf-8")
    assert "sat4j" in find().solvers()
    assert find().solve(source)["Some"].satisfiable
    assert list(tmp_path.iterdir()) == []


# The paper's listings as printed do not parse (docs/paper.md), so no check runs on them.
PRINTED = "printed"
_CORRECTIONS = {"'": "_", "...": "", "env_guards": "env_guars", "mode_guards": "mode_guars"}


@pytest.mark.alloy
@pytest.mark.parametrize(
    ("left", "message"),
    [
        ("'", "Syntax error"),
        ("...", "Syntax error"),
        ("env_guards", 'The name "env_guards" cannot be found'),
        ("mode_guards", 'The name "mode_guards" cannot be found'),
    ],
)
@pytest.mark.full
def test_the_papers_listings_do_not_parse_for_four_reasons(tmp_path: Path, left: str, message: str) -> None:
    """Each is enough, with the other three corrected; docs/paper.md lists them."""
    text = library.source(PRINTED)
    assert left in text
    assert left in PAPER
    for printed, corrected in _CORRECTIONS.items():
        text = text if printed == left else text.replace(printed, corrected)
    source = tmp_path / "printed.als"
    source.write_text(text, encoding="utf-8")
    with pytest.raises(AlloyFailed, match=message):
        find().solve(source)


@pytest.mark.alloy
@pytest.mark.full
def test_the_papers_check_fails_if_the_rest_may_change(tmp_path: Path) -> None:
    text = library.source(PRINTED)
    for printed, corrected in _CORRECTIONS.items():
        text = text.replace(printed, corrected)
    source = tmp_path / "printed.als"
    source.write_text(text.replace("check SafeDetach for 5", "check SafeDetach for 3"), encoding="utf-8")
    assert find().solve(source)["SafeDetach"].satisfiable


def test_the_page_on_the_paper_lists_the_undesired_results() -> None:
    """docs/paper.md names every command of the completed listings with an undesired result."""
    section = PAPER.partition("## The paper's Alloy listings")[2].partition("\n## ")[0]
    unwished = [c.name for c in commands("completed") if c.expected is (c.kind == "check" or "TooMuch" in c.name)]
    assert len(unwished) == 9
    assert [name for name in unwished if f"`{name}`" not in section] == []
    assert all(not c.expected for c in commands("core") if c.kind == "check")


# -- what is stated --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", ["completed", "core", "actions"])
def test_every_action_has_its_assertion_its_check_and_its_run(module: str) -> None:
    stated = commands(module)
    assert {c.name for c in stated if c.kind == "check" and c.scope == 5} >= {f"Safe{action}" for action in ACTIONS}
    happen = {c.name for c in stated if c.kind == "run" and c.expected}
    assert all(any(name.startswith(action) for name in happen) for action in ACTIONS)


def test_every_generalised_action_has_its_assertion_its_check_and_its_run() -> None:
    for module, action in (("groups", "DegradeAll"), ("groups", "UpgradeAll"), ("handover", "Handover")):
        names = {(c.kind, c.name): c for c in commands(module)}
        assert names["check", f"Safe{action}"].scope == 5
        assert not names["check", f"Safe{action}"].expected
        assert names["run", action].expected


def test_every_command_states_its_expected_result() -> None:
    for module in MODULES:
        lines = library.source(module).splitlines()
        stated = [line for line in lines if line.startswith(("check ", "run "))]
        assert len(stated) == len(commands(module)), f"a command of {module} states no expectation"


def test_tasks_cover_every_command_at_any_scope() -> None:
    everything = {str(command) for module in MODULES for command in commands(module)}
    for scope in (3, 4, 5):
        assert {str(command) for task in tasks(scope) for command in task.commands} == everything
    scopes = {command.scope for task in tasks(4) for command in task.commands if command.kind == "check"}
    assert scopes == {4}


# -- what is broken is found -----------------------------------------------------------------------------------


@pytest.mark.alloy
@pytest.mark.full
def test_a_specification_without_a_conjunct_is_violated() -> None:
    whole = library.with_scope("handover", SMALL)
    forgotten = "    satisfy[s.cur_mode[assoc_outputs.new].mode_guars[new], conn.conn_guar]\n"
    assert whole.count(forgotten) == 1
    checked = only("handover", texts={"handover": whole.replace(forgotten, "    some univ\n")})
    assert checked.answer is Answer.VIOLATED
    assert checked.because is not None
    assert checked.because.startswith("handover.SafeHandover should have no counterexample, but has one: s = System$")


@pytest.mark.alloy
def test_a_contradictory_specification_is_violated() -> None:
    """Facts that contradict each other prove everything, and let nothing happen."""
    whole = library.with_scope("system", SMALL)
    checked = only("system", texts={"system": whole + "\nfact { some none }\n"})
    assert checked.answer is Answer.VIOLATED
    assert checked.because is not None
    assert "system.ValidSystem should have an instance at scope 4, but has none" in checked.because


@pytest.mark.alloy
def test_a_syntax_error_is_unknown() -> None:
    checked = only("system", texts={"system": "module system\nsig {"})
    assert checked.answer is Answer.UNKNOWN
    assert checked.because


@pytest.mark.alloy
def test_a_time_out_is_unknown() -> None:
    checked = only("system", limit=0.05)
    assert checked.answer is Answer.UNKNOWN
    assert checked.because == "no answer within 0.05 s"


def test_closing_the_generator_ends_the_processes(tmp_path: Path) -> None:
    """A `java` that never ends by itself."""
    java = tmp_path / "java"
    java.write_text('#!/bin/sh\necho $$ >> "${0%java}pids"\nexec sleep 600\n', encoding="utf-8")
    java.chmod(0o755)
    found = check_specification(Alloy(str(java), tmp_path / "no.jar", "no Alloy"), SMALL, jobs=2, limit=0.3)
    checked = next(found)
    assert checked.answer is Answer.UNKNOWN
    found.close()
    for pid in (tmp_path / "pids").read_text(encoding="ascii").split():
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid), 0)


# -- the command -----------------------------------------------------------------------------------------------


@pytest.fixture
def little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the proofs one goal, of the specification one module."""
    from midstride.verify.prove import GOALS

    goals = [goal for goal in GOALS if (goal.kind, goal.name) == ("fit", "attach input")]
    monkeypatch.setattr("midstride.verify.prove.run_proofs.GOALS", goals)
    monkeypatch.setattr(library, "MODULES", ("system",))


@pytest.mark.alloy
@pytest.mark.usefixtures("little")
@pytest.mark.full
def test_the_command_shows_each_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "--alloy", "--scope", "3"]) == 0
    out = capsys.readouterr().out
    assert "1 of 1 goals proved" in out
    assert "HOLDS      1/1  system " in out
    assert "1 of 1 as expected (2 commands, checks to scope 3)" in out


@pytest.mark.alloy
@pytest.mark.usefixtures("little")
def test_the_command_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "--alloy", "--scope", "3", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is True
    assert document["scope"] == 3
    (check,) = document["checks"]
    assert (check["check"], check["verdict"], check["commands"]) == ("system", "holds", ["ValidSystem", "FinerModes"])


@pytest.mark.usefixtures("little")
def test_the_command_fails_if_a_check_has_another_result(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def solve(*_: object, **__: object) -> dict[str, SolverOutcome]:
        return {"ValidSystem": SolverOutcome(True), "FinerModes": SolverOutcome(False)}

    plant(monkeypatch, Alloy, "solve", solve)
    monkeypatch.setattr("midstride.cli.commands.prove.find", lambda: Alloy("java", Path("no.jar"), "no Alloy"))
    assert main(["prove", "--alloy", "--scope", "3"]) == 1
    out = capsys.readouterr().out
    assert "VIOLATED   1/1  system " in out
    assert "system.FinerModes should have an instance at scope 4, but has none" in out
    assert "0 of 1 as expected" in out


@pytest.mark.usefixtures("little")
def test_a_command_that_alloy_skipped_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, Alloy, "solve", lambda *_, **__: {"ValidSystem": SolverOutcome(True)})
    (checked,) = check_specification(Alloy("java", Path("no.jar"), "no Alloy"), SMALL)
    assert checked.answer is Answer.UNKNOWN
    assert checked.because == "Alloy did not answer FinerModes"


def test_without_the_analyzer_the_command_fails_before_the_proofs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing() -> Alloy:
        raise AlloyMissing("the Alloy Analyzer 6.2.0 is not installed: `make alloy` fetches it")

    monkeypatch.setattr("midstride.cli.commands.prove.find", missing)
    assert main(["prove", "--alloy"]) == 1
    shown = capsys.readouterr()
    assert "make alloy" in shown.err
    assert "HOLDS" not in shown.out


def test_a_check_states_its_claim() -> None:
    def claim(kind: str, expected: bool) -> str:
        command = AlloyCommand("core", "X", "check" if kind == "check" else "run", expected, 5)
        return Checked(Task("core", (command,)), Answer.HOLDS, 0.0).statement

    assert claim("check", False) == "has no counterexample, to scope 5"
    assert claim("check", True) == "has a counterexample, at scope 5"
    assert claim("run", True) == "can happen, at scope 5"

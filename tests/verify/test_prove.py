"""The proofs without bounds: all of them hold, none of them of nothing, and what is broken is found."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from dataclasses import replace

import pytest

from midstride.cli import main
from midstride.verify.prove import GOALS, NAMES, Proof, prove_goal
from midstride.verify.prove import actions as act
from midstride.verify.prove.goals import Case, Goal
from midstride.verify.prove.run_proofs import script, weakenings
from midstride.verify.prove.terms import FALSE, TRUE, and_, implies, not_, or_
from midstride.verify.prove.theory import SATISFIED, Theory
from midstride.verify.verdict import Answer


def goal(kind: str, name: str) -> Goal:
    (found,) = (goal for goal in GOALS if (goal.kind, goal.name) == (kind, name))
    return found


def broken(kind: str, name: str, without: str) -> Goal:
    """The goal of an action that forgot a conjunct of its precondition."""
    whole = goal(kind, name)

    def build(t: Theory) -> Case:
        case = whole.build(t)
        assert without in case.asked
        return replace(case, asked={name: formula for name, formula in case.asked.items() if name != without})

    return replace(whole, build=build)


# -- what is proved ------------------------------------------------------------------------------------------


# `make test` proves one goal of each kind, `make test-all` every one.
_OF_A_KIND = {goal.kind: goal for goal in reversed(GOALS)}


@pytest.mark.parametrize(
    "one",
    [
        pytest.param(
            goal,
            id=f"{goal.kind} {goal.name}",
            marks=() if goal is _OF_A_KIND[goal.kind] else pytest.mark.full,
        )
        for goal in GOALS
    ],
)
def test_every_goal_is_proved_by_both_solvers_and_not_vacuously(one: Goal) -> None:
    proof = prove_goal(one)
    assert proof.answer is Answer.HOLDS, proof.because
    assert proof.possible is Answer.HOLDS
    unexpected = [weakened for weakened in proof.weakened if not weakened.as_expected]
    assert not unexpected
    assert all(bool(weakened.counterexample) is weakened.needed for weakened in proof.weakened)
    assert proof.ok
    assert set(proof.seconds) == set(NAMES)


def test_every_action_is_proved_and_every_conjunct_is_needed() -> None:
    """Each conjunct of each precondition is needed by validity, by the fit of contracts or by the undo."""
    needed: dict[str, dict[str, bool]] = {}
    for one in GOALS:
        if one.kind in ("F1", "fit", "F6"):
            for dropped, is_needed in weakenings(one):
                if len(dropped) == 1:
                    conjuncts = needed.setdefault(one.name, {})
                    conjuncts[dropped[0]] = conjuncts.get(dropped[0], False) or is_needed
    first = [one.name for one in GOALS if one.kind == "F1"]
    assert [name.split()[0] for name in first] == [
        "create", "remove", "attach", "attach", "detach", "detach", "degrade", "upgrade", "handover"
    ]  # fmt: skip
    idle = {(name, conjunct) for name in first for conjunct, is_needed in needed[name].items() if not is_needed}
    # A hand-over exchanges one for one, so its other conjuncts imply that caps hold; inputs do not count against a cap.
    assert idle == {("handover", act.CAPS), ("attach input", act.CAP)}


# -- what is broken is found, in words -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "without", "text"),
    [
        ("remove", act.ISOLATED, "is not live"),
        ("attach output", act.CAP, "publisher"),
        ("detach output", act.STAYS, "lacks"),
        ("create", act.CAPACITY, "its capacity is"),
    ],
)
def test_an_action_without_a_conjunct_is_violated(name: str, without: str, text: str) -> None:
    proof = prove_goal(broken("F1", name, without), ("z3",))
    assert proof.answer is Answer.VIOLATED
    assert not proof.ok
    assert proof.because is not None
    assert proof.because.startswith("before: ")
    assert f"then {name.split()[0]}" in proof.because
    assert text in proof.because


def test_the_papers_rule_for_attach_is_enough_for_attachments_to_fit() -> None:
    """An output judged by its current mode (the paper's precondition) fits by its normal mode as well: rule M2."""
    fit = goal("fit", "attach output")

    def build(t: Theory) -> Case:
        case = fit.build(t)
        current = t.satisfies(t.current(case.states[0], "the_port"), t.topic_guarantee("the_topic"))
        assert act.CONTRACT in case.asked
        return replace(case, asked=case.asked | {act.CONTRACT: current})

    assert prove_goal(replace(fit, build=build), ("z3",)).answer is Answer.HOLDS


def test_a_vacuous_goal_is_not_ok() -> None:
    """A contradiction among the premises proves everything: it is noticed that nothing can happen."""
    whole = goal("F1", "remove")

    def build(t: Theory) -> Case:
        case = whole.build(t)
        return replace(case, given=case.given | {"a contradiction": FALSE})

    proof = prove_goal(replace(whole, build=build), ("z3",))
    assert proof.answer is Answer.HOLDS
    assert proof.possible is not Answer.HOLDS
    assert not proof.ok


def test_an_unneeded_conjunct_that_is_declared_needed_is_noticed() -> None:
    proof = prove_goal(replace(goal("F1", "remove"), spare=frozenset()), ("z3",))
    assert proof.answer is Answer.HOLDS
    assert not proof.ok
    assert [weakened.dropped for weakened in proof.weakened if not weakened.as_expected] == [(act.LIVE,)]


# -- never a silent pass --------------------------------------------------------------------------------------


def without_solvers(monkeypatch: pytest.MonkeyPatch, *absent: str) -> None:
    whole = importlib.import_module

    def import_module(name: str, package: str | None = None) -> object:
        if name in absent:
            raise ImportError(name)
        return whole(name, package)

    monkeypatch.setattr("importlib.import_module", import_module)


def test_a_missing_solver_leaves_the_goal_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    without_solvers(monkeypatch, "cvc5")
    proof = prove_goal(goal("fit", "attach input"))
    assert proof.answer is Answer.UNKNOWN
    assert proof.because is not None
    assert "cvc5 is not installed" in proof.because
    assert prove_goal(goal("fit", "attach input"), ("z3",)).ok


def test_a_time_out_leaves_the_goal_unknown() -> None:
    proof = prove_goal(goal("F2", "better of two"), ("cvc5",), seconds=0.001)
    assert proof.answer is Answer.UNKNOWN
    assert proof.because is not None
    assert "does not decide" in proof.because
    assert not proof.ok


def say_little(monkeypatch: pytest.MonkeyPatch, *goals: Goal) -> None:
    monkeypatch.setattr("midstride.verify.prove.run_proofs.GOALS", goals)


def test_the_command_shows_each_goal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    say_little(monkeypatch, goal("fit", "attach input"))
    assert main(["prove"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("HOLDS     fit    attach input    z3 ")
    assert "without `the contracts fit`: then attach input" in out
    assert "1 of 1 goals proved by z3 " in out


def test_the_command_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    say_little(monkeypatch, goal("fit", "attach input"))
    assert main(["prove", "--json", "--solver", "z3"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is True
    assert list(document["solvers"]) == ["z3"]
    (only,) = document["goals"]
    assert (only["fact"], only["goal"], only["verdict"], only["ok"]) == ("fit", "attach input", "holds", True)
    assert {one["verdict"] for one in only["weakened"]} == {"holds", "violated"}


def test_the_command_without_solvers_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    without_solvers(monkeypatch, "z3", "cvc5")
    assert main(["prove"]) == 1
    out = capsys.readouterr().out
    assert out.count("UNKNOWN") == len(GOALS)
    assert "HOLDS" not in out
    assert "pip install z3-solver" in out and "pip install cvc5" in out
    assert f"0 of {len(GOALS)} goals proved" in out


# -- the terms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "text"),
    [
        (lambda: and_("a", TRUE, "b", "a"), "(and a b)"),
        (lambda: and_("a", FALSE), FALSE),
        (lambda: or_(), FALSE),
        (lambda: or_("a", FALSE), "a"),
        (lambda: not_(TRUE), FALSE),
        (lambda: implies("a", FALSE), "(not a)"),
        (lambda: implies("a", "b"), "(=> a b)"),
    ],
)
def test_terms_are_simplified(made: Callable[[], str], text: str) -> None:
    assert made() == text


def test_the_script_is_text_for_any_solver() -> None:
    text = script(goal("F1", "create"), SATISFIED)
    assert text.startswith("(set-logic ALL)\n(declare-sort Component 0)\n")
    assert "; M1\n(assert (forall " in text
    assert "; NOT: every functionality is satisfied\n" in text
    assert "; M1\n" not in script(goal("F1", "create"), SATISFIED, ("M1",))


def test_a_proof_is_a_document() -> None:
    proof = Proof(goal("F1", "create"), Answer.UNKNOWN, {"z3": 1.23456}, "because")
    document = proof.to_document()
    assert document["seconds"] == {"z3": 1.235}
    assert document["because"] == "because"
    assert document["ok"] is False

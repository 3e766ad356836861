"""``prove``: the safety theorems, for systems of any size, and the checks of the Alloy specification."""

from __future__ import annotations

from typing import Any

import click

from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.verify.alloy_checks import Checked, check_specification, parallel_jobs, tasks
from midstride.verify.prove import NAMES, Proof, prove, version_of
from midstride.verify.run import Alloy, find

_STYLES = {"holds": "green", "violated": "red", "unknown": "yellow"}


@click.command("prove")
@click.option(
    "--solver",
    type=click.Choice(["z3", "cvc5", "both"]),
    default="both",
    show_default=True,
    help="The solver; with both, each must prove every goal.",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=0.001),
    metavar="SECONDS",
    default=20.0,
    show_default=True,
    help="The time limit of one query (s).",
)
@click.option("--alloy", "with_alloy", is_flag=True, help="Check the Alloy specification as well.")
@click.option("--scope", type=click.IntRange(3, 5), metavar="N", default=5, show_default=True, help="Their scope.")
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="How many checks run at a time.  [default: by processors and memory]",
)
@click.option(
    "--check-timeout",
    type=click.FloatRange(min=1),
    metavar="SECONDS",
    default=1800.0,
    show_default=True,
    help="The time limit of one check by Alloy (s).",
)
@click.option("-v", "--verbose", is_flag=True, help="Show every weakened goal, with its full counterexample.")
@json_option
def prove_command(
    solver: str, timeout: float, with_alloy: bool, scope: int, jobs: int | None, check_timeout: float, verbose: bool
) -> int:
    """Prove that every action keeps a valid system valid, and that `best` finds the best modes, for systems
    of any size.

    A goal is proved if no system satisfies its negation. To show that the proof is not vacuous, the action must be
    possible, and dropping a conjunct of its precondition must yield a counterexample. Needs the solvers:
    pip install z3-solver cvc5.

    With --alloy, the Alloy specification is then checked as well, for all systems up to a scope. Needs Java and the
    Alloy Analyzer (`make alloy`). Scope 5 takes 20 to 40 minutes on two cores.
    """
    alloy = find() if with_alloy else None  # report a missing Analyzer before the proofs start
    ok, document = _proofs(solver, timeout, verbose)
    if alloy is not None:
        checks_ok, checks = _checks(alloy, scope, jobs, check_timeout)
        ok, document = ok and checks_ok, {**document, **checks}
    if wants_json():
        print_json({"ok": ok, **document})
    return int(not ok)


def _proofs(solver: str, timeout: float, verbose: bool) -> tuple[bool, dict[str, Any]]:
    names = NAMES if solver == "both" else tuple(name for name in NAMES if name == solver)
    proofs: list[Proof] = []
    for proof in prove(names, seconds=timeout):
        proofs.append(proof)
        if not wants_json():
            _show(proof, verbose)
    ok = all(proof.ok for proof in proofs)
    if not wants_json():
        solvers_used = " and ".join(f"{name} {version_of(name) or '(not installed)'}" for name in names)
        proved = sum(proof.ok for proof in proofs)
        weakened = [weakened for proof in proofs for weakened in proof.weakened]
        shown = sum(one.counterexample is not None for one in weakened)
        summary = f"{proved} of {len(proofs)} goals proved by {solvers_used}, for systems of any size"
        summary += f"; {shown} counterexamples with a conjunct dropped"
        console().print(summary, style="green" if ok else "red", markup=False)
    solvers = {name: version_of(name) for name in names}
    return ok, {"solvers": solvers, "goals": [proof.to_document() for proof in proofs]}


def _line(text: str, style: str) -> None:
    console().print(text, style=style, markup=False, soft_wrap=True)


def _show(proof: Proof, verbose: bool) -> None:
    """One row of the table, followed by problems and weakened goals."""
    seconds = "  ".join(f"{name} {took:5.2f} s" for name, took in proof.seconds.items())
    style = _STYLES[proof.answer.value]
    goal = proof.goal
    row = f"{proof.answer!s:8}  {goal.kind:5}  {goal.name:14}  {seconds}  {goal.claim}"
    _line(row, style)
    if proof.because is not None:
        _line(f"          {proof.because}", style)
    if proof.answer.value != "unknown" and proof.possible.value != "holds":
        _line("          not shown to be possible at all", "yellow")
    for weakened in proof.weakened:
        left_out = "`, `".join(weakened.dropped)
        if not weakened.as_expected:
            because = "no counterexample found" if weakened.needed else "needed after all"
            _line(f"          without `{left_out}`: {because}", "yellow")
        if weakened.counterexample is not None:
            # Without --verbose: the action and what fails, but not the configuration before.
            fails = weakened.counterexample if verbose else weakened.counterexample.partition(". ")[2]
            _line(f"          without `{left_out}`: {fails}", "dim")
        elif verbose and weakened.as_expected:
            _line(f"          without `{left_out}`: still holds", "dim")


def _checks(alloy: Alloy, scope: int, jobs: int | None, limit: float) -> tuple[bool, dict[str, Any]]:
    total, parallel = len(tasks(scope)), jobs or parallel_jobs()
    if not wants_json():
        heading = f"The Alloy specification, by {alloy.name}: {total} tasks, {parallel} at a time"
        console().print(heading, markup=False)
    done: list[Checked] = []
    for checked in check_specification(alloy, scope, jobs=parallel, limit=limit):
        done.append(checked)
        if not wants_json():
            _show_check(checked, len(done), total)
    passed = sum(checked.answer.value == "holds" for checked in done)
    ok = passed == total
    if not wants_json():
        commands = sum(len(checked.task.commands) for checked in done)
        summary = f"{passed} of {total} as expected ({commands} commands, checks to scope {scope})"
        console().print(summary, style="green" if ok else "red", markup=False)
    document = {"alloy": alloy.name, "scope": scope, "checks": [checked.to_document() for checked in done]}
    return ok, document


def _show_check(checked: Checked, number: int, total: int) -> None:
    style = _STYLES[checked.answer.value]
    row = f"{checked.answer!s:8}  {number:2}/{total}  {checked.task!s:32}  {checked.seconds:6.1f} s  {checked.claim}"
    _line(row, style)
    if checked.because is not None:
        _line(f"          {checked.because}", style)

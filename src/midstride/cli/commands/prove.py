"""``prove``: the safety theorems, for systems of any size, and the checks of the Alloy specification."""

from __future__ import annotations

from typing import Any

import click
from rich.console import Console

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
    out = Console(quiet=True) if wants_json() else console()
    ok, document = _proofs(out, solver, timeout, verbose)
    if alloy is not None:
        checks_ok, checks = _checks(out, alloy, scope, jobs, check_timeout)
        ok, document = ok and checks_ok, {**document, **checks}
    if wants_json():
        print_json({"ok": ok, **document})
    return int(not ok)


def _proofs(out: Console, solver: str, timeout: float, verbose: bool) -> tuple[bool, dict[str, Any]]:
    names = NAMES if solver == "both" else tuple(name for name in NAMES if name == solver)
    proofs: list[Proof] = []
    for proof in prove(names, seconds=timeout):
        proofs.append(proof)
        _show(out, proof, verbose)
    ok = all(proof.ok for proof in proofs)
    solvers = {name: version_of(name) for name in names}
    solvers_used = " and ".join(f"{name} {version or '(not installed)'}" for name, version in solvers.items())
    proved = sum(proof.ok for proof in proofs)
    weakened = [weakened for proof in proofs for weakened in proof.weakened]
    shown = sum(one.counterexample is not None for one in weakened)
    summary = f"{proved} of {len(proofs)} goals proved by {solvers_used}, for systems of any size"
    summary += f"; {shown} counterexamples with a conjunct dropped"
    _line(out, summary, "green" if ok else "red")
    return ok, {"solvers": solvers, "goals": [proof.to_document() for proof in proofs]}


def _line(out: Console, text: str, style: str = "default") -> None:
    out.print(text, style=style, markup=False, soft_wrap=True)


def _show(out: Console, proof: Proof, verbose: bool) -> None:
    """One row of the table, followed by problems and weakened goals."""
    seconds = "  ".join(f"{name} {took:5.2f} s" for name, took in proof.seconds.items())
    style = _STYLES[proof.answer.value]
    goal = proof.goal
    row = f"{proof.answer!s:8}  {goal.kind:5}  {goal.name:14}  {seconds}  {goal.statement}"
    _line(out, row, style)
    if proof.because is not None:
        _line(out, f"          {proof.because}", style)
    if proof.answer.value != "unknown" and proof.possible.value != "holds":
        _line(out, "          not shown to be possible at all", "yellow")
    for weakened in proof.weakened:
        left_out = "`, `".join(weakened.dropped)
        if not weakened.as_expected:
            because = "no counterexample found" if weakened.needed else "needed after all"
            _line(out, f"          without `{left_out}`: {because}", "yellow")
        if weakened.counterexample is not None:
            # Without --verbose: the action and what fails, but not the configuration before.
            fails = weakened.counterexample if verbose else weakened.counterexample.partition(". ")[2]
            _line(out, f"          without `{left_out}`: {fails}", "dim")
        elif verbose and weakened.as_expected:
            _line(out, f"          without `{left_out}`: still holds", "dim")


def _checks(out: Console, alloy: Alloy, scope: int, jobs: int | None, limit: float) -> tuple[bool, dict[str, Any]]:
    total, parallel = len(tasks(scope)), jobs or parallel_jobs()
    _line(out, f"The Alloy specification, by {alloy.name}: {total} tasks, {parallel} at a time")
    done: list[Checked] = []
    for checked in check_specification(alloy, scope, jobs=parallel, limit=limit):
        done.append(checked)
        style, because = _STYLES[checked.answer.value], checked.because
        place, took = f"{len(done):2}/{total}", f"{checked.seconds:6.1f} s"
        _line(out, f"{checked.answer!s:8}  {place}  {checked.task!s:32}  {took}  {checked.statement}", style)
        if because is not None:
            _line(out, f"          {because}", style)
    passed = sum(checked.answer.value == "holds" for checked in done)
    ok = passed == total
    commands = sum(len(checked.task.commands) for checked in done)
    summary = f"{passed} of {total} as expected ({commands} commands, checks to scope {scope})"
    _line(out, summary, "green" if ok else "red")
    document = {"alloy": alloy.name, "scope": scope, "checks": [checked.to_document() for checked in done]}
    return ok, document

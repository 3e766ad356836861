"""``prove``: the theorems behind the word "safe", for systems of any size; the checks of the Alloy specification."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from midstride.cli.app import json_option

if TYPE_CHECKING:
    from midstride.verify.prove import Proof
    from midstride.verify.run import Alloy
    from midstride.verify.specification import Checked

_STYLES = {"holds": "green", "violated": "red", "unknown": "yellow"}


@click.command("prove")
@click.option(
    "--solver",
    type=click.Choice(["z3", "cvc5", "both"]),
    default="both",
    show_default=True,
    help="Who proves; with both, each must.",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=0.001),
    default=20.0,
    show_default=True,
    help="Of one question to a solver, in s.",
)
@click.option("--alloy", "with_alloy", is_flag=True, help="Check the Alloy specification as well.")
@click.option("--scope", type=click.IntRange(3, 5), default=5, show_default=True, help="Of those checks.")
@click.option(
    "--jobs", type=click.IntRange(min=1), help="So many checks at once. [default: what the machine has room for]"
)
@click.option(
    "--check-timeout",
    type=click.FloatRange(min=1),
    default=1800.0,
    show_default=True,
    help="Of one check by Alloy, in s.",
)
@click.option("-v", "--verbose", is_flag=True, help="Show every weakened goal, with the whole counterexample.")
@json_option
def prove_command(
    solver: str, timeout: float, with_alloy: bool, scope: int, jobs: int | None, check_timeout: float, verbose: bool
) -> int:
    """Prove that every action keeps a valid system valid, and that `best` is best, for systems of any size.

    Each goal is asked as its negation, which no system may satisfy. That it is not proved of nothing is shown
    beside it: the action can happen, and with one conjunct of its precondition left out there is a counterexample.
    Needs the solvers: pip install z3-solver cvc5.

    With --alloy, the same is then asked of the Alloy specification, for all systems up to a scope. Needs Java and
    the Alloy Analyzer (`make alloy`). At scope 5 that takes 20 to 40 minutes of two cores.
    """
    from midstride.cli.output import print_json, wants_json
    from midstride.verify.run import find

    alloy = find() if with_alloy else None  # what is missing is said before the work begins
    ok, document = _proofs(solver, timeout, verbose)
    if alloy is not None:
        checks_ok, checks = _checks(alloy, scope, jobs, check_timeout)
        ok, document = ok and checks_ok, {**document, **checks}
    if wants_json():
        print_json({"ok": ok, **document})
    return int(not ok)


# -- by solvers ------------------------------------------------------------------------------------------------


def _proofs(solver: str, timeout: float, verbose: bool) -> tuple[bool, dict[str, Any]]:
    from midstride.cli.output import console, wants_json
    from midstride.verify.prove import NAMES, prove, version_of

    names = NAMES if solver == "both" else tuple(name for name in NAMES if name == solver)
    proofs: list[Proof] = []
    for proof in prove(names, seconds=timeout):
        proofs.append(proof)
        if not wants_json():
            _show(proof, verbose)
    ok = all(proof.ok for proof in proofs)
    if not wants_json():
        who = " and ".join(f"{name} {version_of(name) or '(not installed)'}" for name in names)
        held = sum(proof.ok for proof in proofs)
        weakened = [weakened for proof in proofs for weakened in proof.weakened]
        shown = sum(one.counterexample is not None for one in weakened)
        told = f"{held} of {len(proofs)} goals proved by {who}, for systems of any size"
        told += f"; {shown} counterexamples where a conjunct is left out"
        console().print(told, style="green" if ok else "red", markup=False)
    solvers = {name: version_of(name) for name in names}
    return ok, {"solvers": solvers, "goals": [proof.to_document() for proof in proofs]}


def _show(proof: Proof, verbose: bool) -> None:
    """One row of the table, as soon as it is known; under it what is not as it should be, and the weakened goals."""
    from midstride.cli.output import console

    out = console()
    seconds = "  ".join(f"{name} {took:5.2f} s" for name, took in proof.seconds.items())
    style = _STYLES[proof.answer.value]
    goal = proof.goal
    row = f"{proof.answer!s:8}  {goal.kind:5}  {goal.name:14}  {seconds}  {goal.claim}"
    out.print(row, style=style, markup=False, soft_wrap=True)
    if proof.because is not None:
        out.print(f"          {proof.because}", style=style, markup=False, soft_wrap=True)
    if proof.answer.value != "unknown" and proof.possible.value != "holds":
        out.print("          it is not shown that this can happen at all", style="yellow", markup=False)
    for weakened in proof.weakened:
        left_out = "`, `".join(weakened.dropped)
        if not weakened.as_expected:
            because = "no counterexample is found" if weakened.needed else "it is needed after all"
            out.print(f"          without `{left_out}`: {because}", style="yellow", markup=False, soft_wrap=True)
        if weakened.counterexample is not None:
            fails = weakened.counterexample if verbose else _in_short(weakened.counterexample)
            out.print(f"          without `{left_out}`: {fails}", style="dim", markup=False, soft_wrap=True)
        elif verbose and weakened.as_expected:
            out.print(f"          without `{left_out}`: holds still", style="dim", markup=False, soft_wrap=True)


def _in_short(counterexample: str) -> str:
    """What is done and what fails then: the configuration before is told by `--verbose`."""
    return counterexample.partition(". ")[2]


# -- by Alloy --------------------------------------------------------------------------------------------------


def _checks(alloy: Alloy, scope: int, jobs: int | None, limit: float) -> tuple[bool, dict[str, Any]]:
    from midstride.cli.output import console, wants_json
    from midstride.verify.specification import at_once, check_specification, tasks

    asked, at_a_time = len(tasks(scope)), jobs or at_once()
    if not wants_json():
        told = f"The Alloy specification, by {alloy.told}: {asked} questions, {at_a_time} at a time"
        console().print(told, markup=False)
    done: list[Checked] = []
    for checked in check_specification(alloy, scope, jobs=at_a_time, limit=limit):
        done.append(checked)
        if not wants_json():
            _show_check(checked, len(done), asked)
    held = sum(checked.answer.value == "holds" for checked in done)
    ok = held == asked
    if not wants_json():
        commands = sum(len(checked.task.commands) for checked in done)
        told = f"{held} of {asked} came out as they should ({commands} commands, checks to scope {scope})"
        console().print(told, style="green" if ok else "red", markup=False)
    document = {"alloy": alloy.told, "scope": scope, "checks": [checked.to_document() for checked in done]}
    return ok, document


def _show_check(checked: Checked, number: int, asked: int) -> None:
    from midstride.cli.output import console

    out, style = console(), _STYLES[checked.answer.value]
    row = f"{checked.answer!s:8}  {number:2}/{asked}  {checked.task!s:32}  {checked.seconds:6.1f} s  {checked.told}"
    out.print(row, style=style, markup=False, soft_wrap=True)
    if checked.because is not None:
        out.print(f"          {checked.because}", style=style, markup=False, soft_wrap=True)

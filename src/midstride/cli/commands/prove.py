"""``prove``: the theorems behind the word "safe", for systems of any size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from midstride.cli.app import json_option

if TYPE_CHECKING:
    from midstride.verify.prove import Proof


@click.command("prove")
@click.option(
    "--solver",
    type=click.Choice(["z3", "cvc5", "both"]),
    default="both",
    show_default=True,
    help="Who proves; with both, each must.",
)
@click.option(
    "--timeout", type=click.FloatRange(min=0.001), default=20.0, show_default=True, help="Of one question, in s."
)
@click.option("-v", "--verbose", is_flag=True, help="Show every weakened goal, with the whole counterexample.")
@json_option
def prove_command(solver: str, timeout: float, verbose: bool) -> int:
    """Prove that every action keeps a valid system valid, and that `best` is best, for systems of any size.

    Each goal is asked as its negation, which no system may satisfy. That it is not proved of nothing is shown
    beside it: the action can happen, and with one conjunct of its precondition left out there is a counterexample.
    Needs the solvers: pip install 'midstride[proof]'.
    """
    from midstride.cli.output import console, print_json, wants_json
    from midstride.verify.prove import NAMES, prove, version_of

    names = NAMES if solver == "both" else tuple(name for name in NAMES if name == solver)
    proofs: list[Proof] = []
    for proof in prove(names, seconds=timeout):
        proofs.append(proof)
        if not wants_json():
            _show(proof, verbose)
    ok = all(proof.ok for proof in proofs)
    if wants_json():
        document: dict[str, Any] = {
            "ok": ok,
            "solvers": {name: version_of(name) for name in names},
            "goals": [proof.to_document() for proof in proofs],
        }
        print_json(document)
        return int(not ok)
    who = " and ".join(f"{name} {version_of(name) or '(not installed)'}" for name in names)
    held = sum(proof.ok for proof in proofs)
    weakened = [weakened for proof in proofs for weakened in proof.weakened]
    shown = sum(one.counterexample is not None for one in weakened)
    told = f"{held} of {len(proofs)} goals proved by {who}, for systems of any size"
    told += f"; {shown} counterexamples where a conjunct is left out"
    console().print(told, style="green" if ok else "red", markup=False)
    return int(not ok)


def _show(proof: Proof, verbose: bool) -> None:
    """One row of the table, as soon as it is known; under it what is not as it should be, and the weakened goals."""
    from midstride.cli.output import console

    out = console()
    seconds = "  ".join(f"{name} {took:5.2f} s" for name, took in proof.seconds.items())
    style = {"holds": "green", "violated": "red", "unknown": "yellow"}[proof.answer.value]
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

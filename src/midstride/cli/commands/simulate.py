"""``simulate``: rehearse a change in virtual time, while faults strike that are drawn from a seed."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from click.core import ParameterSource

from midstride.cli.input_files import load
from midstride.cli.output import console, json_option, print_json, show, wants_json
from midstride.cli.planned_change import planned_change, planned_change_options
from midstride.cli.specification_argument import specification_argument
from midstride.codec.form import encode
from midstride.plan.forms.request_form import decode_request

# Its built-in systems (`midstride.simulation.scenario`), which is imported only where it is needed.
BUILT_IN: Final = ("rover", "composed", "docking", "spread", "leased")

if TYPE_CHECKING:
    from midstride.simulation.campaign import Summary
    from midstride.simulation.scenario import Scenario
    from midstride.simulation.seed_run import SeedRun


@click.command("simulate")
@specification_argument(required=False)
@planned_change_options
@click.option(
    "--seeds", type=click.IntRange(1), metavar="N", default=200, show_default=True, help="How many seeds to run."
)
@click.option("--first", type=click.IntRange(0), metavar="N", default=0, show_default=True, help="The first of them.")
@click.option(
    "--seed", type=click.IntRange(0), metavar="N", help="Run this seed only, twice, and show everything that happens."
)
@click.option(
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    default=len(os.sched_getaffinity(0)),
    help="How many run at a time.  [default: one per processor]",
)
@click.option(
    "--system",
    type=click.Choice(BUILT_IN),
    help="Without FILE: the built-in system to change.  [default: each in turn]",
)
@json_option
def simulate_command(
    file: Path | None, seeds: int, first: int, seed: int | None, jobs: int, system: str | None, **change: Any
) -> int:
    """Rehearse a change of the system of FILE: many times in virtual time, with at least two faults each time.

    \b
    midstride simulate talker.stride --replace talker=NewTalker
    midstride simulate talker.stride --replace talker=NewTalker --seed 17

    Components crash, hang and start slowly, messages are lost and delayed, the disk is full, and the manager is killed.
    Where the system has several hosts, the links between them are cut, slow and lossy, and their clocks differ. When
    the faults are over, the system must have converged to its specification. Programs are not run: a stand-in takes the
    place of each and writes what its modes guarantee. Without FILE, built-in systems are changed, to test Midstride
    itself: `rover`, `composed` with a container, `docking` with a service and a ROS action, `spread` on three hosts,
    `leased` with fallbacks on others of them.

    Exit status 1 if a run violates an invariant; the first one is shown.
    """
    from midstride.simulation.campaign import Summary, simulate_many

    for name in ("seeds", "first", "jobs") if seed is not None else ():
        if click.get_current_context().get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise click.UsageError(f"--seed runs this one only: leave --{name} out")
    if file is not None and system is not None:
        raise click.UsageError("--system names a built-in system: leave FILE or --system out")
    scenario = _scenario(file, change)
    if scenario is not None and not scenario.steps:
        return _show_nothing()
    if seed is not None:
        one, again = simulate_many((seed, seed), scenario, name=system)
        return _show_one(one, same=one.digest == again.digest)
    summary, begun = Summary(), time.perf_counter()
    for run in simulate_many(range(first, first + seeds), scenario, jobs, system):
        summary.add(run)
    return _show(summary, time.perf_counter() - begun)


def _scenario(file: Path | None, change: dict[str, Any]) -> Scenario | None:
    from midstride.simulation.scenario import rehearsed

    if file is None:
        if any(change[name] for name in ("to", "replaced", "restarted", "added", "removed", "moved")):
            raise click.UsageError("pass the FILE of the system to change")
        return None
    request = replace(decode_request(planned_change(**change)), to=None if change["to"] is None else load(change["to"]))
    return rehearsed(load(file), request)


def _show_nothing() -> int:
    from midstride.simulation.campaign import Summary
    from midstride.simulation.rehearsal import rehearsal_of

    words = "Nothing to do, and nothing was rehearsed: the system already matches the target."
    show(rehearsal_of(Summary()), [words])
    return 0


def _show_one(run: SeedRun, same: bool) -> int:
    from midstride.simulation.rehearsal import rehearsed_seed

    result = f"seed {run.seed}: {'; '.join(run.problems) or 'no invariant is violated'}"
    again = "again the same run" if same else "ANOTHER RUN the second time: the simulation is not deterministic"
    document = {**encode(rehearsed_seed(run)), "deterministic": same, "digest": run.digest, "timeline": run.timeline}
    show(document, [*run.timeline, result, f"digest {run.digest}, {again}"])
    return int(bool(run.problems) or not same)


def _show(summary: Summary, seconds: float) -> int:
    from midstride.simulation.rehearsal import BRANCHES, rehearsal_of

    result = rehearsal_of(summary)
    if wants_json():
        print_json(result)
        return int(bool(result.failed))
    from midstride.cli import render

    heads = ["fault", "struck", *(name.replace("_", " ") for name in BRANCHES)]
    table = render.table(heads[:1], heads[1:])
    for fault, counts in result.faults.items():
        table.add_row(fault, *map(str, counts.values()))
    console().print(table)
    rate = f"{summary.seeds} seeds in {seconds:.1f} s"
    if not summary.failed:
        click.echo(f"{rate}: no invariant is violated")
        return 0
    worst = summary.failed[0]
    click.echo("\n".join([f"\nSeed {worst.seed}:", *worst.timeline]))
    for run in summary.failed:
        click.echo(f"seed {run.seed}: {'; '.join(run.problems)}")
    click.echo(f"{rate}: {len(summary.failed)} violate an invariant; `--seed {worst.seed}` repeats the first")
    return 1

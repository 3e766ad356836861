"""``verify``: whether a specification, a plan or the running system is safe, according to Alloy."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from midstride.cli import graphviz
from midstride.cli.input_files import in_file, load, read_json, write
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.running_systems import find, system_option
from midstride.cli.specification_argument import specification_argument
from midstride.errors import PlanRefused, SpecificationError
from midstride.verify.checking import AlloyOptions, verify_configuration, verify_plan, verify_specification
from midstride.verify.diagram import chain_lines, to_dot, to_mermaid
from midstride.verify.verdict import Answer, Verdict

_FILE: Final = click.Path(path_type=Path)
_STYLES: Final = {"holds": "bold green", "violated": "bold red", "unknown": "bold yellow"}


@click.command("verify")
@specification_argument(required=False)
@click.option(
    "--plan", "plan_file", type=_FILE, metavar="PLAN.json", help="Verify every step of a plan; - is standard input."
)
@click.option("--live", is_flag=True, help="Verify the running system, as its components report it.")
@system_option
@click.option("-o", "--output", type=_FILE, metavar="X.als", help="Write the Alloy text to a file.")
@click.option("--picture", type=_FILE, metavar="X.svg|png|dot|mmd", help="Draw the violations.")
@click.option(
    "--alloy", type=_FILE, metavar="JAR", help="The Alloy Analyzer.  [default: the one that `make alloy` fetched]"
)
@click.option(
    "--limit",
    type=click.FloatRange(1, 86_400),
    metavar="SECONDS",
    default=300.0,
    show_default=True,
    help="The time limit.",
)
@json_option
def verify_command(
    file: Path | None,
    plan_file: Path | None,
    live: bool,
    system: str | None,
    output: Path | None,
    picture: Path | None,
    alloy: Path | None,
    limit: float,
) -> int:
    """Verify the system of FILE, every step of a plan, or the running system with the Alloy Analyzer.

    The verdict is HOLDS, VIOLATED (exit status 1) or UNKNOWN (exit status 1, with the reason). Needs Java, and Alloy
    6.2.0, which `make alloy` fetches.

    \b
    midstride verify talker.stride
    midstride plan talker.stride --replace talker=NewTalker --json | midstride verify talker.stride --plan -
    """
    if live and (file or plan_file):
        raise click.UsageError("--live cannot be combined with FILE or --plan")
    if not (live or file or plan_file):
        raise click.UsageError("nothing to verify: pass FILE, --plan PLAN.json or --live")
    if system is not None and not live:
        raise click.UsageError("--system needs --live")
    if picture is not None:
        graphviz.kind_of(picture)
    options = AlloyOptions(alloy, limit)
    if output is not None:
        options = replace(options, keep=partial(write, output))
    verdict = _verify_live(system, options) if live else _verify_files(file, plan_file, options)
    if picture is not None:
        if verdict.findings:
            graphviz.write(picture, lambda: to_dot(verdict), lambda: to_mermaid(verdict))
        else:
            click.echo(f"No violations to draw; {picture} was not written.", err=True)
    if wants_json():
        print_json(verdict)
    else:
        for text, style in lines(verdict):
            console().print(text, style=style, markup=False)
    return 0 if verdict.holds else 1


def _verify_files(file: Path | None, plan_file: Path | None, options: AlloyOptions) -> Verdict:
    specification = load(file) if file is not None else None
    if plan_file is not None:
        document = _plan(plan_file)
        try:
            return verify_plan(document, plan_file.name, start=specification, options=options)
        except SpecificationError as error:
            raise in_file(plan_file, error.problems) from None
    assert specification is not None
    return verify_specification(specification, options=options)


def _plan(path: Path) -> dict[str, Any]:
    """The JSON document of a plan. Raises SpecificationError for another document, PlanRefused for a refusal."""
    document = read_json(path)
    if not isinstance(document, dict):
        raise SpecificationError(f"{path} is not a plan; `midstride plan … --json` prints one")
    if "strategies" in document:
        raise SpecificationError(
            f"{path} compares several plans; `midstride plan … --json` without --compare prints one"
        )
    if document.get("outcome") == "refused":
        raise PlanRefused(f"{path} has no plan; it was refused: {document.get('because')}")
    return document


def _verify_live(system: str | None, options: AlloyOptions) -> Verdict:
    client, workspace = find(system)
    live = client.configuration()
    configuration = live.configuration.configuration()
    verdict = verify_configuration(configuration, workspace.name, f"{workspace.name} as it is running", options=options)
    if (silent := ", ".join(live.silent)) and verdict.answer is Answer.HOLDS:
        because = f"no answer from {silent}; it holds only if the last known state is still correct"
        return replace(verdict, answer=Answer.UNKNOWN, because=because)
    return verdict


def lines(verdict: Verdict) -> list[tuple[str, str]]:
    """The lines that show a verdict, each with its style."""
    shown = [(str(verdict), _STYLES[verdict.answer.value])]
    for finding in verdict.findings:
        shown.append((str(finding), ""))
        if finding.chain is not None:
            shown += [(f"    {line}", "dim") for line in chain_lines(finding.chain)]
    if verdict.seconds:
        shown.append((f"Verified in {verdict.seconds:.1f} s.", "dim"))
    return shown

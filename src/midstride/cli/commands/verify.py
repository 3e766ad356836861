"""``verify``: whether a specification, a plan or the running system is safe, as Alloy judges it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from midstride.cli.app import json_option
from midstride.cli.systems import system_option

if TYPE_CHECKING:
    from midstride.verify.checking import Asking
    from midstride.verify.verdict import Verdict

_FILE: Final = click.Path(path_type=Path)
_STYLES: Final = {"holds": "bold green", "violated": "bold red", "unknown": "bold yellow"}


@click.command("verify")
@click.argument("file", type=_FILE, required=False)
@click.option("--plan", "plan_file", type=_FILE, metavar="PLAN.json", help="Every step of a plan; - is standard input.")
@click.option("--live", is_flag=True, help="The running system, as its components themselves tell it.")
@system_option
@click.option("-o", "--output", type=_FILE, metavar="X.als", help="Keep the Alloy text that was judged.")
@click.option("--picture", type=_FILE, metavar="X.svg|png|dot|mmd", help="Draw what is violated.")
@click.option("--alloy", type=_FILE, metavar="JAR", help="The Alloy Analyzer to ask.  [default: the fetched one]")
@click.option(
    "--limit", type=click.FloatRange(1, 86_400), default=300.0, show_default=True, help="How long it may take (s)."
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
    """Have the Alloy Analyzer judge the system of FILE, every step of a plan, or what is running.

    The verdict is HOLDS, VIOLATED (exit status 1) or UNKNOWN (exit status 1, with the reason). It needs Java, and Alloy
    6.2.0, which `make alloy` fetches.

    \b
    midstride verify talker.stride
    midstride plan talker.stride --replace talker=NewTalker --json | midstride verify talker.stride --plan -
    """
    from midstride.cli import graphviz
    from midstride.cli.output import console, print_json, wants_json
    from midstride.verify.checking import Asking
    from midstride.verify.diagram import to_dot, to_mermaid

    if live and (file or plan_file):
        raise click.UsageError("--live judges what is running: it goes without FILE and --plan")
    if not (live or file or plan_file):
        raise click.UsageError("say what is to be judged: FILE, --plan PLAN.json, or --live")
    if system is not None and not live:
        raise click.UsageError("--system says which running system --live means: it goes with --live alone")
    if picture is not None:
        graphviz.kind_of(picture)
    asking = Asking(alloy, limit, _keeper(output))
    verdict = _live(system, asking) if live else _designed(file, plan_file, asking)
    if picture is not None:
        if verdict.findings:
            graphviz.write(picture, lambda: to_dot(verdict), lambda: to_mermaid(verdict))
        else:
            click.echo(f"There is nothing to draw: {picture} is not written.", err=True)
    if wants_json():
        from midstride.verify.verdict import VerdictForm

        print_json(VerdictForm.of(verdict))
    else:
        for text, style in lines(verdict):
            console().print(text, style=style, markup=False)
    return 0 if verdict.holds else 1


def _designed(file: Path | None, plan_file: Path | None, asking: Asking) -> Verdict:
    from midstride.cli.files import load
    from midstride.verify.checking import verify_plan, verify_specification

    specification = load(file) if file is not None else None
    if plan_file is not None:
        return verify_plan(_plan(plan_file), plan_file.name, start=specification, asking=asking)
    assert specification is not None
    return verify_specification(specification, asking=asking)


def _plan(path: Path) -> dict[str, Any]:
    """The document of a plan. Raises SpecificationError where it is none, PlanRefused where its planner refused."""
    from midstride.cli.files import read_json
    from midstride.errors import PlanRefused, SpecificationError

    document = read_json(path)
    if not isinstance(document, dict):
        raise SpecificationError(f"{path} is not a plan: `midstride plan … --json` prints one")
    if document.get("outcome") == "refused":
        raise PlanRefused(f"there is no plan in {path}, it was refused: {document.get('because')}")
    return document


def _live(system: str | None, asking: Asking) -> Verdict:
    from dataclasses import replace

    from midstride.cli.systems import find
    from midstride.codec.configuration import decode_configuration
    from midstride.verify.checking import verify_configuration
    from midstride.verify.verdict import Answer

    client, workspace = find(system)
    document = client.get("/configuration")
    configuration = decode_configuration(document["configuration"])
    verdict = verify_configuration(configuration, workspace.name, f"{workspace.name} as it runs", asking=asking)
    if (silent := ", ".join(document["silent"])) and verdict.answer is Answer.HOLDS:
        because = f"it holds only if what the manager believes of {silent} is true: no answer came from there"
        return replace(verdict, answer=Answer.UNKNOWN, because=because)
    return verdict


def _keeper(output: Path | None) -> Callable[[str], None]:
    from midstride.errors import MidstrideError

    def keep(text: str) -> None:
        if output is None:
            return
        try:
            output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise MidstrideError(f"{output} cannot be written: {error.strerror}") from None

    return keep


def lines(verdict: Verdict) -> list[tuple[str, str]]:
    """A verdict for people, line by line, each with its style."""
    from midstride.verify.diagram import chain_lines

    told = [(str(verdict), _STYLES[verdict.answer.value])]
    for finding in verdict.findings:
        told.append((str(finding), ""))
        if finding.chain is not None:
            told += [(f"    {line}", "dim") for line in chain_lines(finding.chain)]
    if verdict.seconds:
        told.append((f"Judged in {verdict.seconds:.1f} s.", "dim"))
    return told

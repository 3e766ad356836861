"""``report``: a change of the history as one HTML file."""

from __future__ import annotations

from pathlib import Path

import click

from midstride.cli import records
from midstride.cli.input_files import write
from midstride.cli.output import console, json_option, print_json, wants_json
from midstride.cli.running_systems import system_option


@click.command("report")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    default=Path("change.html"),
    show_default=True,
    help="The file to write.",
)
@click.option(
    "--change",
    "number",
    type=click.IntRange(1, 2**31 - 1),
    metavar="N",
    help="The number of the change; by default that of the latest.",
)
@system_option
@json_option
def report_command(output: Path, number: int | None, system: str | None) -> int:
    """Write change N, as `midstride history` numbers them, as one HTML file.

    It has the graph before and after, the plan, what happened when, and the figures of each subscriber, and needs
    neither the manager nor a network. With --json, prints the same as data, and writes no file.
    """
    if wants_json():
        print_json(records.change(system, number))
        return 0
    write(output, records.report(system, number))
    console().print(f"The report is in {output}.", markup=False, soft_wrap=True)
    return 0

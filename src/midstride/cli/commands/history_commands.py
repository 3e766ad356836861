"""``history`` and ``rollback``: what was changed, and the way back to an earlier specification."""

from __future__ import annotations

import click

from midstride.cli import change_options, records
from midstride.cli.commands.change_commands import RequestOptions, change, request_options
from midstride.cli.output import PAGE_WIDTH, console, json_option, print_json, wants_json
from midstride.cli.running_systems import find, system_option
from midstride.codec.form import encode

# How many changes `history` shows.
LATEST = 20


@click.command("history")
@click.option(
    "-n",
    "latest",
    type=click.IntRange(1, 2**31 - 1),
    metavar="N",
    default=LATEST,
    show_default=True,
    help="How many changes to show.",
)
@system_option
@json_option
def history_command(latest: int, system: str | None) -> int:
    """Show the latest N changes: when, by whom, how they ended, what they cost; and crashes between them.

    Also the changes of earlier managers, and before the last `down`. A system that is down shows what it has left.
    """
    found, in_progress = records.history(system, latest)
    if wants_json():
        print_json(found)
    else:
        from midstride.cli import render

        out = console()
        out.print(render.history(found, in_progress=in_progress), width=min(out.width, PAGE_WIDTH))
    return 0


@click.command("rollback")
@click.argument("version", type=click.IntRange(1, 2**31 - 1), required=False, metavar="[N]")
@click.option("--dry-run", is_flag=True, help="Show the plan, and change nothing.")
@change_options.declared_parameters_option
@request_options
def rollback_command(
    version: int | None,
    dry_run: bool,
    declared_parameters: bool,
    options: RequestOptions,
) -> int:
    """Change the running system back to version N of its specification, as `midstride history` numbers them.

    By default to the version before the latest change of the specification. Parameter values that were set at run time
    are kept, as by `apply`, and programs start with the code that they have now.
    """
    client, _ = find(options.system)
    found = client.earlier_specification(version)
    request = {"to": encode(found.specification), "declared_parameters": declared_parameters}
    return change(options, request, f"rollback to version {found.version}", dry_run)

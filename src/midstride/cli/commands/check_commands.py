"""``check``, ``fmt`` and ``explain``: the language at design time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click

from midstride.cli import shell_completion
from midstride.cli.input_files import require_file
from midstride.cli.output import json_option, show
from midstride.cli.specification_argument import SpecificationPath
from midstride.errors import MidstrideError
from midstride.lang import Loaded, format_text, load, render
from midstride.lang.catalogue import CATALOGUE, explain
from midstride.lang.diagnostic_text import Diagnostic
from midstride.lang.message_types import installed
from midstride.lang.source_files import Unreadable, read_text
from midstride.package_files import owner
from midstride.whole_file import write_whole


@click.command("check")
@click.argument("files", nargs=-1, required=True, type=SpecificationPath(), metavar="FILE...")
@click.option("--strict", is_flag=True, help="Treat warnings as errors.")
@click.option("--no-types", is_flag=True, help="Do not check message types and fields against the installed packages.")
@click.option("--hosts", is_flag=True, help="Also log in on their hosts by SSH, and check what a system needs there.")
@json_option
def check_command(files: tuple[Path, ...], strict: bool, no_types: bool, hosts: bool) -> int:
    """Check specifications: syntax, names, contracts, and whether every functionality can work.

    Every independent error is reported once, at its place; `midstride explain CODE` explains it.

    With --hosts, also whether Midstride, ROS 2 and the programs are on each host; see docs/how-to/several-computers.md.
    """
    messages = None if no_types else installed()
    found: list[Diagnostic] = []
    loaded: dict[Path, Loaded] = {}
    for file in files:
        require_file(file)
        loaded[file] = load(file, messages=messages)
        found += loaded[file].diagnostics
    found = list({str(diagnostic): diagnostic for diagnostic in found}.values())  # files may share an include
    bad = any(strict or diagnostic.severity == "error" for diagnostic in found)
    lines = [render(found) if found else f"{', '.join(map(str, files))}: no problems found"]
    document: dict[str, Any] = {"ok": not bad, "diagnostics": [diagnostic.to_json() for diagnostic in found]}
    if hosts and not bad:
        from midstride.cli import checked_hosts

        checked = checked_hosts.check([each.require() for each in loaded.values()])
        bad = any(each.faults for each in checked)
        document |= {"ok": not bad, "hosts": [checked_hosts.document(each) for each in checked]}
        lines += checked_hosts.lines(checked)
    show(document, lines)
    return int(bad)


@click.command("fmt")
@click.argument("files", nargs=-1, required=True, type=SpecificationPath(), metavar="FILE...")
@click.option("--check", is_flag=True, help="Change nothing; exit status 1 if a file is not formatted.")
@json_option
def fmt_command(files: tuple[Path, ...], check: bool) -> int:
    """Format Stride files, in place. Comments and order are kept."""
    changed: list[Path] = []
    found: list[Diagnostic] = []
    for file in files:
        if file.suffix == ".json":
            raise click.UsageError(f"{file} is JSON; fmt is for files in the Stride language")
        require_file(file)
        if not check and owner(str(file), os.environ) == owner(str(file.resolve()), os.environ) is not None:
            raise MidstrideError(f"{file} is an installed copy, which the next build replaces: format its source")
        try:
            text = read_text(file)
        except Unreadable as error:
            message = f"cannot read `{file}`: {error}"
            found.append(Diagnostic(error.code, message, help=error.help, file=str(file)))
            continue
        formatted = format_text(text, str(file))
        found += formatted.diagnostics
        if formatted.text is not None and formatted.text.encode() != file.read_bytes():
            changed.append(file)
            if not check:
                write_whole(file, formatted.text.encode())
    bad = bool(found) or (check and bool(changed))
    lines = [render(found)] if found else []
    lines += [f"{file}: {'not formatted' if check else 'formatted'}" for file in changed]
    diagnostics = [diagnostic.to_json() for diagnostic in found]
    show({"ok": not bad, "changed": [str(file) for file in changed], "diagnostics": diagnostics}, lines)
    return int(bad)


@click.command("explain")
@click.argument("code", shell_complete=shell_completion.codes)
@json_option
def explain_command(code: str) -> int:
    """Explain the CODE of a diagnostic, with an example: `midstride explain E012`."""
    try:
        text = explain(code)
    except KeyError as error:
        raise click.UsageError(str(error.args[0])) from None
    entry = CATALOGUE[code.upper()]
    explanation = " ".join(entry.explanation.split())
    document = {"code": entry.code, "severity": entry.severity, "title": entry.title, "explanation": explanation}
    show(document, [text])
    return 0

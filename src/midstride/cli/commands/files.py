"""``check`` and ``export``: specifications in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from midstride.cli.app import json_option
from midstride.cli.output import print_json, wants_json
from midstride.cli.systems import find, system_option
from midstride.errors import SpecificationError
from midstride.model.problems import Problem


@click.command("check")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE...")
@click.option("--strict", is_flag=True, help="Warnings count as errors.")
@json_option
def check_command(files: tuple[Path, ...], strict: bool) -> int:
    """Check specifications: form, names, contracts, and whether every functionality can work."""
    found = [(file, problem) for file in files for problem in _problems(file)]
    bad = any(strict or problem.severity == "error" for _, problem in found)
    if wants_json():
        print_json({"ok": not bad, "diagnostics": [_diagnostic(file, problem) for file, problem in found]})
        return int(bad)
    for file, problem in found:
        click.echo(f"{file}: {problem.severity}: {problem}")
    if not found:
        click.echo(f"{', '.join(map(str, files))}: nothing to complain of.")
    return int(bad)


def _problems(file: Path) -> list[Problem]:
    from midstride.cli.files import parse
    from midstride.model.wellformed import check

    try:
        return list(check(parse(file)))
    except SpecificationError as error:
        return [fault if isinstance(fault, Problem) else Problem("E001", (), str(fault)) for fault in error.problems]


def _diagnostic(file: Path, problem: Problem) -> dict[str, Any]:
    """The form of interfaces.md. A place in a JSON document is a path (RFC 6901), not a line."""
    return {
        "code": problem.code,
        "severity": problem.severity,
        "file": str(file),
        "path": problem.path,
        "line": None,
        "column": None,
        "message": problem.message,
        "help": problem.help or None,
    }


@click.command("export")
@click.argument("file", required=False, type=click.Path(path_type=Path))
@system_option
@json_option
def export_command(file: Path | None, system: str | None) -> int:
    """Print the specification in FILE, or the one that the running system has, as JSON."""
    if file is not None:
        from midstride.cli.files import read
        from midstride.model.document import specification_to_document

        print_json(specification_to_document(read(file)))
        return 0
    client, _ = find(system)
    print_json(client.get("/specification"))
    return 0

"""``import``: a specification from a ROS 2 launch file."""

from __future__ import annotations

import os
from pathlib import Path

import click

from midstride.cli.input_files import require_file, require_new, write
from midstride.cli.output import json_option, print_json, stride_output, wants_json
from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.model.wording import counted


@click.command("import")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.argument("arguments", nargs=-1, metavar="[NAME:=VALUE]...")
@stride_output("Write the specification to this file, instead of printing it.")
@click.option(
    "--run-python", is_flag=True, help="Carry out launch files in Python, which are programs, by ROS's own `launch`."
)
@json_option
def import_command(file: Path, arguments: tuple[str, ...], output: Path | None, run_python: bool) -> int:
    """Write a specification of what a launch file in XML or YAML starts, without ROS.

    What cannot be taken over is listed with its place. Packages are looked up in AMENT_PREFIX_PATH, and in source
    trees below DIR, if that is given before the command: `midstride --include-path DIR import FILE`.
    """
    require_file(file)
    require_new(output)
    folder = output.parent if output is not None else Path()
    imported = import_launch_file(file, _arguments(arguments), os.environ, folder, run_python)
    if output is not None:
        write(output, imported.text)
    if wants_json():
        print_json(
            {
                "file": None if output is None else str(output),
                "specification": imported.text if output is None else None,
                "nodes": imported.nodes,
                "launch_files": imported.files,
                "findings": [finding.to_json() for finding in imported.findings],
                "counts": imported.findings.counts(),
            }
        )
        return 0
    if output is None:
        click.echo(imported.text, nl=False)
    for finding in imported.findings:
        click.echo(str(finding), err=True)
    click.echo(_summary(imported, output), err=True)
    if "package" in imported.findings.counts():
        unset = "" if os.environ.get("AMENT_PREFIX_PATH") else ", which is not set"
        remedy = "source your workspace, or name its sources: `midstride --include-path DIR import …`"
        click.echo(f"Packages are looked up in AMENT_PREFIX_PATH{unset}; {remedy}", err=True)
    return 0


def _arguments(words: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or not name:
            raise click.UsageError(f"`{word}` is not an argument of a launch file; write NAME:=VALUE")
        found[name] = value
    return found


def _summary(imported: Imported, output: Path | None) -> str:
    counts = ", ".join(f"{count} {kind}" for kind, count in imported.findings.counts().items())
    where = f" in {output}" if output is not None else ""
    left = f"{counted(len(imported.findings), 'finding')} ({counts})" if counts else "no findings"
    return f"{counted(imported.nodes, 'node')}{where} from {counted(imported.files, 'launch file')}; {left}"

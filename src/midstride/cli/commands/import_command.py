"""``import``: a specification from a launch file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal

import click

from midstride.cli.input_files import require_file, require_new, write
from midstride.cli.output import json_option, print_json, stride_output, wants_json
from midstride.cli.specification_argument import SpecificationPath
from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.launch_files.launched_containers import CONTAINERS, Containers
from midstride.model.lifecycle_management import MANAGEMENTS, Management
from midstride.model.wording import counted

# The exit status of an import that has left something out.
INCOMPLETE: Final = 3


@click.command("import")
@click.argument("file", type=SpecificationPath(), metavar="FILE")
@click.argument("arguments", nargs=-1, metavar="[NAME:=VALUE]...")
@stride_output("Write the specification to this file, instead of printing it.")
@click.option(
    "--run-python", is_flag=True, help="Carry out launch files in Python, which are programs, by ROS's own `launch`."
)
@click.option("--run-commands", is_flag=True, help="Carry out `$(command …)`, which runs programs, such as xacro.")
@click.option(
    "--lifecycle",
    type=click.Choice(MANAGEMENTS),
    default="manager",
    show_default=True,
    help="What manages the nodes of a lifecycle manager, such as Nav2's: it, or Midstride without it.",
)
@click.option(
    "--containers",
    type=click.Choice(CONTAINERS),
    default="keep",
    show_default=True,
    help="What becomes of composable nodes, which share the process of a container: they do; or one process each; or "
    "left out.",
)
@click.option(
    "--ros",
    type=click.Choice(["1", "2"]),
    help="Read FILE for ROS 1 or ROS 2, instead of by what only one of them has.",
)
@json_option
def import_command(
    file: Path,
    arguments: tuple[str, ...],
    output: Path | None,
    run_python: bool,
    run_commands: bool,
    lifecycle: Management,
    containers: Containers,
    ros: Literal["1", "2"] | None,
) -> int:
    """Write a specification of what a launch file of ROS 2 (XML, YAML) or ROS 1 (XML) starts, without ROS.

    What cannot be taken over is listed with its place. Packages are looked up in AMENT_PREFIX_PATH, those of ROS 1 in
    ROS_PACKAGE_PATH, and in source trees below DIR, if that is given before the command: `midstride --include-path
    DIR import FILE`.

    Exit status 3 if something was left out; what was only assumed does not count.
    """
    require_file(file)
    require_new(output)
    imported = import_launch_file(
        file,
        _arguments(arguments),
        os.environ,
        output,
        run_python,
        run_commands,
        lifecycle,
        containers,
        None if ros is None else 1 if ros == "1" else 2,
    )
    beside = {} if output is None else {output.with_name(name): text for name, text in imported.parameter_files.items()}
    for path in beside:
        require_new(path)
    if output is not None:
        write(output, imported.text)
    for path, text in beside.items():
        write(path, text)
    left_out = imported.findings.counts(left_out=True)
    if wants_json():
        print_json(
            {
                "file": None if output is None else str(output),
                "parameter_files": [str(path) for path in beside],
                "specification": imported.text if output is None else None,
                "nodes": imported.nodes,
                "launch_files": imported.files,
                "findings": [finding.to_json() for finding in imported.findings],
                "counts": imported.findings.counts(),
                "left_out": left_out,
            }
        )
        return INCOMPLETE if left_out else 0
    if output is None:
        click.echo(imported.text, nl=False)
    for finding in imported.findings:
        click.echo(str(finding), err=True)
    click.echo(_summary(imported, output), err=True)
    if "package" in imported.findings.counts():
        variable = "ROS_PACKAGE_PATH" if imported.ros == 1 else "AMENT_PREFIX_PATH"
        unset = "" if os.environ.get(variable) else ", which is not set"
        remedy = "source your workspace, or name its sources: `midstride --include-path DIR import …`"
        click.echo(f"Packages are looked up in {variable}{unset}; {remedy}", err=True)
    if left_out:
        click.echo(f"Left out: {_listed(left_out)}", err=True)
    return INCOMPLETE if left_out else 0


def _arguments(words: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or not name:
            raise click.UsageError(f"`{word}` is not an argument of a launch file; write NAME:=VALUE")
        found[name] = value
    return found


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def _summary(imported: Imported, output: Path | None) -> str:
    counts = imported.findings.counts()
    where = f" in {output}" if output is not None else ""
    left = f"{counted(len(imported.findings), 'finding')} ({_listed(counts)})" if counts else "no findings"
    return f"{counted(imported.nodes, 'node')}{where} from {counted(imported.files, 'launch file')}; {left}"

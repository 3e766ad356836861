"""``graph``, ``impact`` and ``diff``: what a specification shows before anything runs."""

from __future__ import annotations

from pathlib import Path

import click

from midstride.cli.app import json_option

_FILE = click.Path(path_type=Path)


@click.command("graph")
@click.argument("file", type=_FILE)
@click.option("-o", "--output", type=_FILE, metavar="X.svg|png|dot|mmd", help="Where to; its ending says what.")
@click.option("--annotate", is_flag=True, help="Write contracts and modes out.")
@click.option("--collapse/--expand", default=None, help="One box for each namespace or not.  [default: where readable]")
@json_option
def graph_command(file: Path, output: Path | None, annotate: bool, collapse: bool | None) -> int:
    """Draw the components of FILE and what connects them: dot on standard output, or a file of another kind.

    SVG and PNG need Graphviz; dot and Mermaid (mmd) do not.
    """
    from midstride.cli import graphviz
    from midstride.cli.files import load
    from midstride.cli.output import print_json, wants_json
    from midstride.generate.drawing import to_dot, to_mermaid
    from midstride.generate.view import view

    if output is not None:
        graphviz.kind_of(output)
    drawn = view(load(file), annotate=annotate, collapse=collapse)
    if output is None:
        text = to_dot(drawn)
        if wants_json():
            print_json({"dot": text})
        else:
            click.echo(text, nl=False)
        return 0
    graphviz.write(output, lambda: to_dot(drawn), lambda: to_mermaid(drawn))
    if wants_json():
        print_json({"file": str(output), "boxes": len(drawn.boxes), "topics": len(drawn.topics)})
    return 0


@click.command("impact")
@click.argument("file", type=_FILE)
@click.argument("nodes", nargs=-1, metavar="[NODE...]")
@json_option
def impact_command(file: Path, nodes: tuple[str, ...]) -> int:
    """Say for each node of FILE what falls, and how far, if it is removed or crashes; the worst come first."""
    from midstride.cli.files import load
    from midstride.cli.output import print_json, wants_json
    from midstride.plan.impact import ImpactForm, impacts

    found = impacts(load(file), nodes)
    if wants_json():
        print_json({"impacts": [ImpactForm.of(impact) for impact in found]})
        return 0
    for impact in found:
        mark = "single point of failure: " if impact.single_point_of_failure else ""
        heading = f"{mark}{impact.role} ({impact.component})"
        click.echo(f"{heading}: {f'loss {impact.loss:g}' if impact.falls else 'nothing else falls'}")
        for fall in impact.falls:
            levels = f"{fall.levels} mode{'' if fall.levels == 1 else 's'}"
            click.echo(f"  {fall.functionality}: {fall.before} -> {fall.after} ({levels}, weight {fall.weight:g})")
            for reason in fall.because[:1]:
                click.echo(f"    {reason}")
    return 0


@click.command("diff")
@click.argument("old", type=_FILE)
@click.argument("new", type=_FILE)
@json_option
def diff_command(old: Path, new: Path) -> int:
    """Say how the specification NEW differs from OLD. Exit status 0 if they mean the same, else 1."""
    from midstride.cli.files import load
    from midstride.cli.output import print_json, wants_json
    from midstride.plan.specification_diff import differences

    found = differences(load(old), load(new))
    if wants_json():
        print_json({"same": not found, "differences": found})
    elif found:
        click.echo("\n".join(str(difference) for difference in found))
    else:
        click.echo("They mean the same.")
    return int(bool(found))

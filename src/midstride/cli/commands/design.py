"""``graph``, ``impact``, ``diff`` and ``export``: a specification before anything runs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click

from midstride.cli import graphviz, shell_completion
from midstride.cli.changed_programs import changed_code, code_words, other_overlay
from midstride.cli.input_files import load, read
from midstride.cli.output import json_option, print_json, show, wants_json
from midstride.cli.running_systems import find, system_option
from midstride.cli.specification_argument import SpecificationPath, specification_argument
from midstride.codec.schema import specification_schema
from midstride.codec.specification_form import encode_specification
from midstride.generate.drawing import to_dot, to_mermaid
from midstride.generate.drawn_system import view
from midstride.model.wording import counted
from midstride.plan.impact import impacts
from midstride.plan.specification_diff import differences
from midstride.verdicts.assessment import listed

_FILE = click.Path(path_type=Path)


@click.command("graph")
@specification_argument()
@click.option(
    "-o", "--output", type=_FILE, metavar="X.svg|png|dot|mmd", help="Write a file; its suffix chooses the kind."
)
@click.option("--annotate", is_flag=True, help="Include contracts and modes.")
@click.option("--collapse/--expand", default=None, help="One box per namespace, or per node.  [default: by size]")
@json_option
def graph_command(file: Path, output: Path | None, annotate: bool, collapse: bool | None) -> int:
    """Draw the components of FILE and their connections: as dot on standard output, or to a file.

    SVG and PNG need Graphviz; dot and Mermaid (mmd) do not.
    """
    if output is not None:
        graphviz.kind_of(output)
    drawn = view(load(file), annotate=annotate, collapse=collapse)
    if output is None:
        text = to_dot(drawn)
        show({"dot": text}, [text.removesuffix("\n")])
        return 0
    graphviz.write(output, lambda: to_dot(drawn), lambda: to_mermaid(drawn))
    kinds = Counter("topics" if topic.kind == "topic" else "services" for topic in drawn.topics)
    counts = {"boxes": len(drawn.boxes), "topics": kinds["topics"], "services": kinds["services"]}
    show({"file": str(output), **counts}, [])
    return 0


@click.command("impact")
@click.argument("file", type=SpecificationPath())
@click.argument("nodes", nargs=-1, metavar="[NODE...]", shell_complete=shell_completion.nodes_and_containers)
@json_option
def impact_command(file: Path, nodes: tuple[str, ...]) -> int:
    """Show for each node of FILE what degrades, and how far, if it is removed or crashes; worst first.

    A node without which a functionality of another node is in its last mode is a single point of failure. A crash of a
    node in a container ends all nodes of it: then what its container has degrades. The name of a container stands for
    a crash of it, which ends all of its nodes.
    """
    specification = load(file)
    found = impacts(specification, nodes)
    if wants_json():
        print_json({"impacts": found})
        return 0
    components = {role: specification.components[node.component] for role, node in specification.nodes.items()}
    portless = {role for role, component in components.items() if not component.ports() and not component.once}
    for impact in found:
        of_container = impact.role in specification.containers
        is_known = not portless.issuperset(impact.together if of_container else {impact.role})
        none = "nothing else degrades" if is_known else "not known: no ports are stated"
        mark = "single point of failure: " if impact.single_point_of_failure else ""
        heading = f"{mark}{impact.role} ({impact.component})"
        click.echo(f"{heading}: {f'loss {impact.loss:g}' if impact.impacted else none}")
        if of_container:
            click.echo(f"  a crash ends {listed(impact.together)}")
        elif impact.together:
            container = specification.nodes[impact.role].container
            end = "ends" if len(impact.together) == 1 else "end"
            click.echo(f"  if it crashes, {listed(impact.together)} {end} as well: see {container}")
        for fall in impact.impacted:
            levels = counted(fall.levels, "mode")
            click.echo(f"  {fall.functionality}: {fall.before} -> {fall.after} ({levels}, weight {fall.weight:g})")
            for reason in fall.because[:1]:
                click.echo(f"    {reason}")
    if portless and portless != set(components):
        click.echo(f"Not known: what {listed(sorted(portless))} rely on: no ports are stated.")
    return 0


@click.command("diff")
@click.argument("old", type=SpecificationPath())
@click.argument("new", required=False, type=SpecificationPath())
@click.option("--keep-code", is_flag=True, help="Do not count code that has changed on disk as a difference.")
@system_option
@json_option
def diff_command(old: Path, new: Path | None, keep_code: bool, system: str | None) -> int:
    """Show how the specification NEW differs from OLD. Exit status 0 if they are equivalent, else 1.

    With one file: how it differs from what is running, with the nodes whose code has changed on disk.
    """
    if new is not None:
        if system is not None or keep_code:
            option = "--system" if system is not None else "--keep-code"
            raise click.UsageError(f"{option} is for the running system: leave NEW out")
        found = differences(load(old), load(new))
    else:
        target, (client, _) = load(old), find(system)
        programs = client.programs()
        changed = {} if keep_code else changed_code(programs, target.nodes)
        for line in other_overlay(programs):
            click.echo(line, err=True)
        renewed = {role: code_words(files) for role, files in changed.items()}
        found = differences(client.specification(), target, renewed)
    show({"same": not found, "differences": found}, found or ["No differences."])
    return int(bool(found))


@click.command("export")
@specification_argument(required=False)
@click.option("--schema", is_flag=True, help="Print the JSON Schema of specifications instead.")
@system_option
@json_option
def export_command(file: Path | None, schema: bool, system: str | None) -> int:
    """Print the specification in FILE, or that of the running system, as JSON."""
    if schema and (file is not None or system is not None):
        raise click.UsageError("--schema is that of every specification: leave FILE and --system out")
    if file is not None and system is not None:
        raise click.UsageError("--system is for the running system: leave FILE out")
    if schema:
        print_json(specification_schema())
    elif file is not None:
        print_json(encode_specification(read(file)))
    else:
        print_json(encode_specification(find(system)[0].specification()))
    return 0

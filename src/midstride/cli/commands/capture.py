"""``capture``: what a live ROS 2 graph proposes for a specification."""

from __future__ import annotations

from pathlib import Path

import click

from midstride.backends import ros2
from midstride.capture.insertion import insert, nodes_without_ports
from midstride.capture.observed import ObservedGraph
from midstride.capture.standalone import draft
from midstride.cli.files import require_file, require_new, write
from midstride.cli.output import json_option, print_json, wants_json
from midstride.errors import MidstrideError
from midstride.lang.files import read_text
from midstride.model.wording import counted


@click.command("capture")
@click.option("--seconds", type=click.FloatRange(min=0.5), default=10.0, show_default=True, help="How long to look.")
@click.option("--into", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Add to FILE.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.stride")
@click.option("--rates", is_flag=True, help="State the proposed rates in the guarantees, instead of as comments.")
@json_option
def capture_command(seconds: float, into: Path | None, output: Path | None, rates: bool) -> int:
    """Look at the running ROS 2 nodes, and propose their ports with types, QoS and rates.

    The time counts from when the nodes of FILE have been seen, or 10 s later.
    With `--into`, nodes of FILE that have no ports get them, and the rest stays as it is; otherwise a draft is
    printed, or written with `-o`.
    """
    if into is not None:
        require_file(into)
    if output != into:
        require_new(output)
    nodes = () if into is None else nodes_without_ports(read_text(into), str(into))
    graph = ros2.observe(seconds, nodes)
    if not graph.endpoints:
        raise MidstrideError(f"no node with topics was seen within {seconds:g} s (ROS_DOMAIN_ID and discovery range?)")
    added, left, target = graph.nodes(), dict[str, str](), output
    if into is not None:
        insertion = insert(read_text(into), str(into), graph, rates)
        text, added, left, target = insertion.text, insertion.added, insertion.left, output or into
    else:
        text = draft("captured", graph, rates)
    if target is not None:
        write(target, text)
    _report(text, target, graph, added, left)
    return 0


def _report(text: str, target: Path | None, graph: ObservedGraph, added: list[str], left: dict[str, str]) -> None:
    endpoints = [each for node in added for each in graph.of_node(node)]
    if wants_json():
        print_json(
            {
                "file": None if target is None else str(target),
                "specification": text if target is None else None,
                "seconds": graph.seconds,
                "nodes": added,
                "ports": len(endpoints),
                "left": left,
            }
        )
        return
    if target is None:
        click.echo(text, nl=False)
    for node, reason in left.items():
        click.echo(f"{node}: nothing added: {reason}", err=True)
    for type_ in sorted(graph.unreadable):
        click.echo(f"{type_}: its package is not here, so rates are not measured", err=True)
    where = f" in {target}" if target is not None else ""
    click.echo(f"{counted(len(added), 'node')}{where} with {counted(len(endpoints), 'port')}", err=True)

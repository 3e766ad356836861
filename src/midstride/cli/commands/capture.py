"""``capture``: what a live ROS 2 graph proposes for a specification."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import nullcontext
from pathlib import Path
from typing import Final

import click

from midstride.backends import ros2
from midstride.backends.ros2.manager import probed_page
from midstride.capture.graph_draft import draft, drafted_nodes, drafted_services
from midstride.capture.insertion import insert, nodes_without_ports
from midstride.capture.observed import ObservedGraph
from midstride.capture.observed_processes import not_stated, observed_processes
from midstride.capture.probe import (
    MOST_ROUNDS,
    ROUNDS,
    Dependences,
    ProbedGates,
    ProbedPort,
    duration,
    probe,
    probed_inputs,
)
from midstride.capture.taken_over import note_managers, words_on
from midstride.cli.client import Client
from midstride.cli.input_files import require_file, require_new, write
from midstride.cli.output import NO, is_interactive, json_option, print_json, stride_output, wants_json
from midstride.cli.running_systems import find_workspace, system_option
from midstride.errors import ManagerError, MidstrideError
from midstride.foreign.page import GATES_FOLDER, PAGE
from midstride.lang.load import load
from midstride.lang.source_files import read_text
from midstride.model.instance_names import full_name
from midstride.model.lifecycle_management import MANAGEMENTS, Management
from midstride.model.wording import counted
from midstride.runtime.workspace import Workspace

# How many of the topics that were subscribed to are named.
_SHOWN: Final = 5


@click.command("capture")
@click.option(
    "--seconds", type=click.FloatRange(min=0.5), metavar="S", default=10.0, show_default=True, help="How long to look."
)
@click.option("--into", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Add the ports to FILE.")
@stride_output("Write the draft, or FILE with its ports, to this file.")
@click.option(
    "--rates", is_flag=True, help="State the proposed rates and bounds in the guarantees, instead of as comments."
)
@click.option(
    "--probe", "with_probe", is_flag=True, help="Close inputs of nodes with gates, to find what depends on them."
)
@click.option(
    "--probe-seconds",
    type=click.FloatRange(min=0.5),
    metavar="S",
    default=3.0,
    show_default=True,
    help="How long an input is closed at a time.",
)
@click.option(
    "--lifecycle",
    type=click.Choice(MANAGEMENTS),
    help="What manages lifecycle nodes from now on; by default, the manager that does, else Midstride.",
)
@click.option("--yes", "-y", is_flag=True, help="Probe without asking for confirmation.")
@system_option
@json_option
def capture_command(
    seconds: float,
    into: Path | None,
    output: Path | None,
    rates: bool,
    with_probe: bool,
    probe_seconds: float,
    lifecycle: Management | None,
    yes: bool,
    system: str | None,
) -> int:
    """Look at the running ROS 2 nodes, and propose their ports with types, QoS and rates.

    Services and ROS actions are proposed where nodes call each other; comments name the others. How fast they answer
    is seen of nodes that have a gate inside and run under `midstride up`; what these publish is counted in their
    processes, and to other topics this subscribes.
    The time counts from when the nodes of FILE have been seen, or 10 s later.
    With `--into`, nodes of FILE that have no ports get them, and the rest stays as it is; otherwise a draft is
    printed, or written with `-o`.
    With `--probe`, the inputs of nodes that have a gate and run under `midstride up` are closed one after another. This
    disturbs the running system: a node misses what it would receive, and what depends on that stops.
    A draft has the component containers that run, and says which nodes are in them, and which others share a process.
    Lifecycle nodes that nothing manages get `gate lifecycle preload`. Those of a lifecycle manager do with `--lifecycle
    midstride`, which leaves the manager out of FILE.
    """
    if with_probe and not (yes or is_interactive()):
        raise click.UsageError("not a terminal; pass --yes")
    if into is not None:
        require_file(into)
    if output != into:
        require_new(output)
    nodes = () if into is None else nodes_without_ports(read_text(into), str(into))
    own_names = {} if into is None else _own_names(into, system)
    nodes = [own_names.get(node, node) for node in nodes]
    findings: Dependences | None = {}
    folder = find_workspace(system).components / GATES_FOLDER if with_probe else None
    with nullcontext() if folder is None else probed_page.probing(folder) as gates:
        graph = ros2.observe(seconds, nodes, _gates(into, system))
        if not graph.endpoints and not graph.services:
            raise MidstrideError(
                f"no node with topics or services was seen within {seconds:g} s (ROS_DOMAIN_ID and discovery range?)"
            )
        if gates is not None:
            findings = _probed(gates, graph, graph.nodes() if into is None else nodes, probe_seconds, yes)
    if findings is None:
        return NO
    stated_names = {own: stated for stated, own in own_names.items()}
    graph = graph.renamed(stated_names)
    findings = {(stated_names.get(node, node), one, other): each for (node, one, other), each in findings.items()}
    apart: list[str] = []
    added, left, target = drafted_nodes(graph), dict[str, str](), output
    ports = sum(len(graph.of_node(node)) for node in added) + len(drafted_services(graph))
    if into is not None:
        if (stated := load(into).specification) is not None:
            note_managers(graph, stated)
            apart = [
                f"{each.words}, and {into} does not have them in one container" for each in not_stated(graph, stated)
            ]
        insertion = insert(read_text(into), str(into), graph, rates, findings, lifecycle)
        text, added, left, target = insertion.text, insertion.added, insertion.left, output or into
        ports = insertion.ports
        managed = insertion.lifecycle
    else:
        text = draft("captured", graph, rates, findings, lifecycle)
        managed = words_on(graph, lifecycle, added)
    if target is not None:
        write(target, text)
    _report(text, target, graph, added, ports, left, managed, apart, findings)
    return 0


def _own_names(file: Path, system: str | None) -> dict[str, str]:
    """By the full name that a node has in ``file``, the one that its program gives it, where the system runs."""
    if (stated := load(file).specification) is None:
        return {}
    unnamed = {role for role in stated.nodes if stated.component_of(role).unnamed}
    if not unnamed:
        return {}
    name = stated.name if system is None else system
    workspace = next((each for each in Workspace.all() if each.name == name), None)
    if workspace is None or not (client := Client(workspace.socket)).answers():
        return {}
    try:
        instances = client.status().instances
    except ManagerError:  # the nodes are looked for by their names in the file
        return {}
    return {full_name(each.role): each.node for each in instances if each.role in unnamed and each.node}


def _gates(file: Path | None, system: str | None) -> Path | None:
    """The folder of the gates inside the nodes of a system that runs: that of ``file``, or the only one."""
    name = system
    if name is None and file is not None and (stated := load(file).specification) is not None:
        name = stated.name
    found = [each for each in Workspace.all() if name in (None, each.name) and Client(each.socket).answers()]
    folder = found[0].components / GATES_FOLDER if len(found) == 1 else None
    return folder if folder is not None and (folder / PAGE).exists() else None


def _probed(
    gates: ProbedGates, graph: ObservedGraph, nodes: Collection[str], seconds: float, yes: bool
) -> Dependences | None:
    """Probe ``nodes``; None if the user does not want that."""
    ports = {port for port in gates.ports() if port in graph.endpoints and port.node in nodes}
    gated = {port.node for port in ports}
    if not gated:
        raise MidstrideError(
            "none of these nodes has a gate, and inputs can be closed there only: start them by `midstride up`, with "
            "`gate preload`"
        )
    for node in sorted({*nodes} & {*graph.nodes()} - gated):
        click.echo(f"{node}: not probed: it has no gate", err=True)
    for node in sorted(gated):
        left = [each.topic for each in graph.of_node(node) if (node, each.topic, each.output) not in ports]
        if left:
            click.echo(f"{node}: not probed on {', '.join(dict.fromkeys(left))}: its gate has no port there", err=True)
    if not (inputs := probed_inputs(ports)):
        click.echo("Nothing to probe: no node with a gate has both inputs and outputs.", err=True)
        return {}
    click.echo(
        f"Probing closes {counted(len(inputs), 'input')} of running nodes, one after another, {ROUNDS} "
        f"times for {seconds:g} s each ({duration(len(inputs), seconds):.0f} s in all), or up to {MOST_ROUNDS} "
        "times where that does not decide. The nodes miss these messages, and what depends on them stops meanwhile.",
        err=True,
    )
    if not yes and not click.confirm("Proceed?", err=True):
        click.echo("Nothing was closed, and nothing was written.", err=True)
        return None

    def progress(port: ProbedPort, number: int) -> None:
        click.echo(f"  round {number + 1}: {port.topic} is closed at {port.node}", err=True)

    return probe(gates, ports, seconds, progress)


def _subscribed_in_words(graph: ObservedGraph) -> str:
    topics = sorted(graph.subscribed)
    shown = ", ".join(topics[:_SHOWN]) + (f" and {len(topics) - _SHOWN} more" if len(topics) > _SHOWN else "")
    return (
        f"subscribed to {counted(len(topics), 'topic')} to measure rates, as the library of the gate does not see each "
        f"message of a publisher there: {shown}; a publisher that uses intra-process communication serializes each "
        "message for that"
    )


def _report(
    text: str,
    target: Path | None,
    graph: ObservedGraph,
    added: list[str],
    ports: int,
    left: dict[str, str],
    managed: list[str],
    apart: list[str],
    findings: Dependences,
) -> None:
    if wants_json():
        print_json(
            {
                "file": None if target is None else str(target),
                "specification": text if target is None else None,
                "seconds": graph.seconds,
                "subscribed": sorted(graph.subscribed),
                "nodes": added,
                "ports": ports,
                "left": left,
                "lifecycle": managed,
                "not_together": apart,
                "processes": [{"container": each.container, "nodes": each.nodes} for each in observed_processes(graph)],
                "probed": [
                    {"node": node, "input": one, "output": other, "verdict": each.verdict, "evidence": each.because}
                    for (node, one, other), each in sorted(findings.items())
                ],
            }
        )
        return
    if target is None:
        click.echo(text, nl=False)
    for node, reason in left.items():
        click.echo(f"{node}: nothing added: {reason}", err=True)
    for words in [*managed, *apart]:
        click.echo(words, err=True)
    for type_ in sorted(graph.unreadable):
        click.echo(f"{type_}: its package is not here, so rates are not measured", err=True)
    if graph.subscribed:
        click.echo(_subscribed_in_words(graph), err=True)
    where = f" in {target}" if target is not None else ""
    click.echo(f"{counted(len(added), 'node')}{where} with {counted(ports, 'port')}", err=True)

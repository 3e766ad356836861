"""`midstride capture --probe` on a system of 22 nodes in plain rclpy that was made up, and what it finds of it.

MIDSTRIDE_CAPTURE_SEED says which of them (3), and MIDSTRIDE_CAPTURE_SECONDS for how long an input is closed at a time
(3). The figures are printed: `pytest -s`.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

from midstride.lang.load import load
from tests.capture import made_up_node
from tests.capture.made_up_node import is_latched, is_reliable, type_of
from tests.capture.probed import MadeUp, made_up
from tests.capture.test_capture import ports
from tests.cli.conftest import Midstride

SEED = int(os.environ.get("MIDSTRIDE_CAPTURE_SEED", "3"))
SECONDS = os.environ.get("MIDSTRIDE_CAPTURE_SECONDS", "3")
pytestmark = [pytest.mark.ros2, pytest.mark.long, pytest.mark.timeout(1500)]


def planted_ports(system: MadeUp) -> set[tuple[str, str, str, bool, bool, bool]]:
    """As :func:`tests.capture.test_capture.ports`."""
    return {
        (port.node, port.topic, type_of(port.topic), port.output, is_reliable(port.topic), is_latched(port.topic))
        for port in system.ports()
    }


def steady_rates(system: MadeUp) -> dict[str, float]:
    """The rates (Hz) of the topics that are written regularly, and so is all that they need."""
    outputs = {output.topic: output for _, outputs in system.nodes.values() for output in outputs}
    rates = system.rates(None, 0.0)

    def steady(topic: str) -> bool:
        output = outputs[topic]
        if output.kind in ("each", "all"):
            return all(map(steady, output.needs))
        return output.regular and output.kind != "bursts"

    return {topic: rates[topic] for topic in outputs if steady(topic)}


def test_a_system_of_many_nodes_is_captured(midstride: Midstride, tmp_path: Path) -> None:
    system, program = made_up(SEED), made_up_node.__file__
    launch, file = tmp_path / "robot.launch.xml", tmp_path / "robot.stride"
    nodes = [
        f'<executable cmd="{sys.executable} {program} {SEED} {node}" name="{node.strip("/")}"/>'
        for node in system.nodes
    ]
    launch.write_text(f"<launch>{''.join(nodes)}</launch>", encoding="utf-8")
    imported = midstride("import", str(launch), "-o", str(file))
    assert imported.status == 0, imported.err
    up = midstride("up", str(file), "-d", "--backend", "ros2", timeout=300)
    assert up.status == 0, up.err
    try:
        words = ("capture", "--into", str(file), "--seconds", "30", "--probe", "--probe-seconds", SECONDS, "--yes")
        found = midstride("--json", *words, timeout=1200)
    finally:
        assert midstride("down", timeout=120).status == 0
    assert found.status == 0, found.err
    text = file.read_text(encoding="utf-8")

    assert ports(load(file).require()) == planted_ports(system)
    measured = {f"/{name}": float(rate) for name, rate in re.findall(r"guarantee (\w+) .*# measured (\S+) Hz", text)}
    off = {topic: measured[topic] / rate - 1 for topic, rate in steady_rates(system).items()}
    worst = max(off, key=lambda topic: abs(off[topic]))
    print(f"\n{len(nodes)} nodes, {len(planted_ports(system))} ports: exact", file=sys.stderr)
    print(f"{len(off)} steady rates: off by {abs(off[worst]):.1%} at most ({worst})", file=sys.stderr)

    true = system.edges()
    verdicts = {(each["node"], each["input"], each["output"]): each["verdict"] for each in found.json["probed"]}
    depends = {edge for edge, verdict in verdicts.items() if verdict == "depends"}
    undecided = {edge for edge in true if verdicts.get(edge) == "undecided"}
    print(
        f"{len(true)} dependences: {len(true & depends)} found, {len(depends - true)} false, "
        f"{len(true - depends)} missed, {len(undecided)} of them not decided",
        file=sys.stderr,
    )
    for edge in sorted(true ^ depends):
        print(edge, next(e["evidence"] for e in found.json["probed"] if (e["node"], e["input"], e["output"]) == edge))
    assert all(abs(share) <= 0.05 for share in off.values()), off
    assert len(true & depends) >= 0.95 * len(depends)
    assert len(true & depends) >= 0.95 * len(true)

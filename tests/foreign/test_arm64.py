"""The gate on another processor: nodes for arm64, in an emulator, with the page that this machine's manager writes."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

from midstride.foreign import build
from midstride.foreign.page_layout import OPEN, PortFlag
from midstride.node.handover.baton import BatonStep
from tests.foreign.conftest import fake_programs
from tests.foreign.lab import Lab, until

COMPILER = "aarch64-linux-gnu-gcc"
LIBRARIES = "/usr/aarch64-linux-gnu"
PERIOD = 5_000_000  # ns
pytestmark = [pytest.mark.arm64, pytest.mark.full]


class Emulated(Lab):
    def start_process(self, given: Mapping[str, str], *arguments: str) -> subprocess.Popen[bytes]:
        options = [word for name, value in given.items() for word in ("-E", f"{name}={value}")]
        return subprocess.Popen(["qemu-aarch64", "-L", LIBRARIES, *options, self.programs / "node", *arguments])


def goes_on(lab: Lab, node: int) -> None:
    before = lab.written_by(node)
    until(lambda: lab.written_by(node) > before + 3, f"node {node} does not publish")


def test_two_nodes_hand_over_to_each_other_and_one_takes_over_from_the_dead(tmp_path: Path, gate_library: Path) -> None:
    fake_programs(tmp_path, [COMPILER])
    lab = Emulated(tmp_path, tmp_path, gate_library)
    lab.library = build.library({**os.environ, "CC": COMPILER, "XDG_CACHE_HOME": str(tmp_path)})
    try:
        flags = PortFlag.RATED | PortFlag.OFFERS
        old = lab.node(PERIOD, flags)
        baton = lab.port(old).baton
        lab.port(old).gate = OPEN
        new = lab.node(PERIOD, flags, baton=baton)
        for _ in range(20):
            lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
            goes_on(lab, new)
            old, new = new, old
        lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
        lab.kill(old)
        goes_on(lab, new)
        assert lab.overlaps() == 0
    finally:
        lab.close()

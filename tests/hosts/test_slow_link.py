"""The link that delays frames and loses some does just that, as `ping` sees it, and keeps up."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.hosts.slow_link import Slow
from tests.hosts.two_hosts import NETWORK, two_hosts

PINGS = 100

pytestmark = [pytest.mark.hosts, pytest.mark.full]


def test_a_slow_link_delays_frames_and_loses_some(tmp_path: Path) -> None:
    with two_hosts(tmp_path, Slow(delay=0.005, jitter=0.002, loss=0.02)) as hosts:
        words = hosts.inside("ping", "-q", "-i", "0.005", "-c", PINGS, f"{NETWORK}.2")
        said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
        passed = hosts.stop_slow_link()
    received = int(said.split(" received")[0].rpartition(" ")[2])
    assert 0 < PINGS - received <= passed.lost < 0.2 * PINGS, said
    least, mean, _ = (float(each) for each in said.rpartition(" = ")[2].split("/")[:3])
    assert least >= 6.0 and 10.0 <= mean < 20.0, said
    assert passed.frames > 1.9 * received

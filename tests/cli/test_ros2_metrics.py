"""The metrics of a system on ROS 2: as its status says, over TCP, and in a file that a killed manager leaves behind."""

from __future__ import annotations

import os
import signal
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.cli.conftest import EXAMPLES, Midstride, alive
from tests.server.support import free_port

TALKER = str(EXAMPLES / "talker" / "talker.stride")

pytestmark = [pytest.mark.ros2, pytest.mark.long]

Samples = dict[str, list[tuple[dict[str, str], float]]]


def samples(text: str) -> Samples:
    found: Samples = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            found.setdefault(sample.name, []).append((sample.labels, sample.value))
    return found


def value(found: Samples, name: str, **labels: str) -> float | None:
    values = [value for those, value in found.get(name, []) if labels.items() <= those.items()]
    return values[0] if len(values) == 1 else None


def until(file: Path, holds: Callable[[Samples], bool]) -> Samples:
    """The samples of the file, once they hold."""
    deadline = time.monotonic() + 30
    while True:
        found = samples(file.read_text()) if file.exists() else {}
        if holds(found):
            return found
        assert time.monotonic() < deadline, found
        time.sleep(0.1)


def test_a_system_is_measured_and_a_killed_manager_leaves_its_file(midstride: Midstride, tmp_path: Path) -> None:
    file, port = tmp_path / "talker.prom", free_port()
    up = ("up", TALKER, "-d", "--metrics-file", str(file))
    assert midstride(*up, "--http", str(port)).status == 0
    assert midstride("replace", "talker", "NewTalker", "--yes").status == 0
    replaced = until(file, lambda found: "midstride_last_change_missed_messages" in found)
    assert value(replaced, "midstride_last_change_missed_messages") == 0
    assert value(replaced, "midstride_changes_total", outcome="done") == 2, "the bring-up is one"
    rate = {"node": "talker", "direction": "out", "topic": "/chatter"}
    measured = until(file, lambda found: value(found, "midstride_port_rate_hertz", **rate) is not None)
    assert value(measured, "midstride_port_rate_hertz", **rate) == pytest.approx(10, rel=0.5)
    assert value(measured, "midstride_node_missing", node="talker") == 0
    assert value(measured, "midstride_system_exit_status") == midstride("status").status == 0

    address = f"http://127.0.0.1:{port}/metrics"
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(address)
    with refused.value:
        assert refused.value.code == 401
    token = (midstride.runtime / "midstride" / "talker" / "token").read_text()
    request = urllib.request.Request(address, headers={"Authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain; version=")
        told = samples(answer.read().decode())
    assert told.keys() == measured.keys()

    manager, components = midstride.manager("talker"), midstride.components("talker")
    os.kill(manager, signal.SIGKILL)
    while alive(manager):
        time.sleep(0.01)
    left, written = file.read_text(), file.stat().st_mtime
    taken = value(samples(left), "midstride_snapshot_timestamp_seconds")
    assert taken is not None and taken == pytest.approx(written, abs=5)
    time.sleep(6)  # longer than a manager leaves the file as it is
    assert (file.read_text(), file.stat().st_mtime) == (left, written), "nobody writes"
    assert time.time() - taken > 5, "what the alert rules look at"
    assert value(samples(left), "midstride_system_exit_status") == 0, "all else is as it was"
    assert midstride("status").status == 1 and all(map(alive, components))

    assert midstride(*up).status == 0
    again = until(file, lambda found: (value(found, "midstride_snapshot_timestamp_seconds") or 0) > taken)
    assert value(again, "midstride_changes_total", outcome="done") in (0, 1), "counters begin with the manager"
    for entry in midstride("status", "--json").json["instances"]:
        if entry["role"] == "talker":
            os.kill(entry["pid"], signal.SIGKILL)
    crashed = until(file, lambda found: value(found, "midstride_crashes_total", node="talker") == 1)
    assert value(crashed, "midstride_node_missing", node="talker") == 1
    assert value(crashed, "midstride_system_exit_status") == midstride("status").status != 0
    assert midstride("down").status == 0
    assert not file.exists()

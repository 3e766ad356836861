"""The metrics: as the status says it, nothing where something is not known, and a file that goes with its manager."""

from __future__ import annotations

import asyncio
import os
import stat
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Specification
from midstride.runtime.manager import Manager
from midstride.runtime.records.counts import EventCounts
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.metrics import metrics_source
from midstride.server.metrics.exposition import Snapshot, exposition
from midstride.server.metrics.metric_catalogue import METRICS, SYSTEM
from midstride.server.metrics.metrics_source import MetricsFile, snapshot
from midstride.server.serve import serve
from midstride.verdicts.assessment import Assessment, Assessments
from midstride.verdicts.conditions import EXIT_STATUS
from tests.runtime.systems import example, managed, replace
from tests.server.scripted import ScriptedManager
from tests.server.support import run, serving


class Metrics(dict[tuple[str, frozenset[tuple[str, str]]], float]):
    """Samples by name and labels; :meth:`of` has those of one metric, by the values of its labels."""

    @classmethod
    def read(cls, text: bytes) -> Metrics:
        found = cls()
        for family in text_string_to_metric_families(text.decode()):
            for sample in family.samples:
                key = sample.name, frozenset(sample.labels.items())
                assert key not in found, f"twice: {key}"
                found[key] = sample.value
        return found

    def of(self, name: str, **labels: str) -> list[float]:
        return [
            value for (found, those), value in self.items() if found == name and labels.items() <= dict(those).items()
        ]

    def one(self, name: str, **labels: str) -> float:
        [value] = self.of(name, **labels)
        return value


def at(manager: Manager, phase: str = "up") -> Snapshot:
    lifecycle = Lifecycle(manager)
    lifecycle.phase = phase  # type: ignore[assignment]
    return snapshot(lifecycle)


def metrics(manager: Manager, phase: str = "up") -> Metrics:
    return Metrics.read(exposition(at(manager, phase)))


def talking(
    folder: Path, body: Callable[[Manager, Simulator], Awaitable[None]], specification: Specification | None = None
) -> None:
    managed("talker", folder, body, specification=specification)


def test_a_system_that_is_well(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await asyncio.sleep(10)
        found, status = metrics(manager), await manager.status()
        assert found.of("midstride_system_condition", condition="up", system="talker") == [1]
        assert found.of("midstride_system_condition", condition="degraded") == [0]
        assert found.one("midstride_system_exit_status") == EXIT_STATUS[status.condition.state]
        assert found.one("midstride_system_faults") == len(status.condition.faults) == 0
        for instance in status.instances:
            assert found.one("midstride_instance_answering", node=instance.role, component=instance.component) == 1
            for port in instance.ports:
                where = {"node_instance": instance.name, "port": port.name, "topic": str(port.topic)}
                for metric, value in (
                    ("rate_hertz", port.rate),
                    ("contract_rate_hertz", port.declared),
                    ("contract_met", port.met),
                    ("jitter_seconds", port.jitter),
                ):
                    expected = [] if value is None else [pytest.approx(float(value), abs=1e-3)]
                    assert found.of(f"midstride_port_{metric}", **where) == expected
        assert found.one("midstride_port_contract_met", node="talker") == 1
        assert found.one("midstride_functionality_mode", node="listener", mode="normal") == 1
        assert found.one("midstride_functionality_mode", node="listener", mode="degraded") == 0
        assert found.one("midstride_functionality_level", node="listener") == 0
        assert found.one("midstride_crashes_total", node="talker") == 0

    talking(tmp_path, body)


def test_what_is_not_known_is_absent(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        just_up = metrics(manager)
        assert just_up.of("midstride_port_contract_met") == [], "no window is measured yet"
        assert just_up.of("midstride_port_contract_rate_hertz") != []
        await asyncio.sleep(10)
        known = at(manager)
        silent = [structs.replace(each, reachable=each.role != "talker") for each in known.status.instances]
        found = Metrics.read(exposition(changed(known, status=structs.replace(known.status, instances=silent))))
        assert found.one("midstride_instance_answering", node="talker") == 0
        for name in ("midstride_functionality_mode", "midstride_functionality_level", "midstride_port_rate_hertz"):
            assert found.of(name, node="talker") == []
            assert found.of(name, node="listener") != []
        for phase in ("starting", "failed"):
            found = metrics(manager, phase)
            assert found.one("midstride_manager_phase", phase=phase) == 1
            assert not [name for name, _ in found if name.startswith(("midstride_system_c", "midstride_node"))]
            assert found.of("midstride_system_exit_status") == found.of("midstride_functionality_mode") == []

    talking(tmp_path, body)


def test_a_crash_and_a_restart_are_counted_and_what_is_missing_is_said(tmp_path: Path) -> None:
    policy = RespawnPolicy(max_retries=1)
    specification = example("talker")
    specification = specification.with_node(changed(specification.nodes["talker"], respawn=policy))

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("talker")
        await asyncio.sleep(2)
        found = metrics(manager)
        assert (
            found.one("midstride_crashes_total", node="talker"),
            found.one("midstride_node_missing", node="talker"),
        ) == (
            1,
            0,
        )
        assert found.one("midstride_respawns_total", node="talker") == 1
        assert found.of("midstride_node_respawns_exhausted") == []
        simulator.faults.kill("talker")
        await asyncio.sleep(2)
        found = metrics(manager)
        assert found.one("midstride_crashes_total", node="talker") == 2
        assert found.one("midstride_crashes_total", node="listener") == 0
        assert found.one("midstride_respawns_total", node="talker") == 1
        assert found.one("midstride_node_missing", node="talker") == 1
        assert found.one("midstride_node_respawns_exhausted", node="talker") == 1
        assert found.one("midstride_system_condition", condition="degraded") == 1
        assert found.one("midstride_system_exit_status") == 3
        assert found.of("midstride_port_rate_hertz", node="talker") == []
        assert found.one("midstride_functionality_level", node="listener") > 0

    talking(tmp_path, body, specification)


def test_a_change_is_counted_with_its_gap(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        before = metrics(manager)
        assert before.one("midstride_changes_total", outcome="done") == 1, "bringing it up"
        assert before.of("midstride_last_change_gap_seconds") == []
        assert before.one("midstride_change_gap_seconds_count") == 0
        outcome = await manager.change(replace("talker", "NewTalker"))
        await manager.change(replace("talker", "NewTalker"), expected=-1)
        found, continuity = metrics(manager), outcome.continuity
        assert continuity is not None
        assert found.one("midstride_changes_total", outcome="done") == 2
        assert found.one("midstride_changes_total", outcome="refused") == 1
        assert found.one("midstride_changes_total", outcome="failed") == 0
        [swap] = outcome.swaps
        assert swap.gap is not None
        assert found.one("midstride_last_change_gap_seconds") == pytest.approx(swap.gap)
        assert found.one("midstride_last_change_missed_messages") == swap.missed == 0
        assert found.one("midstride_last_change_verdict", verdict=continuity.verdict) == 1
        assert found.one("midstride_change_gap_seconds_count") == 1
        assert found.one("midstride_change_gap_seconds_bucket", le="+Inf") == 1
        assert found.one("midstride_change_gap_seconds_bucket", le="0.01") == 0
        assert found.one("midstride_changes_gap_unknown_total") == 0

    talking(tmp_path, body)


def swapped(gap: float | None, missed: int | None) -> SwapReport:
    return SwapReport("/t", "listener", 0.1, gap, None, missed, None, None)


def test_a_gap_that_one_subscriber_does_not_know_is_no_gap_of_0() -> None:
    counts = EventCounts()
    counts.changed(Outcome(outcome="done", swaps=[swapped(0.1, 2), swapped(0.3, 1)]))
    counts.changed(Outcome(outcome="done", swaps=[swapped(0.2, 0), swapped(None, None)]))
    lost = Assessment("/t", "lost", "lost", 1.5)
    counts.changed(Outcome(outcome="rolled_back", continuity=Assessments("lost", "", [lost])))
    assert (sum(counts.gaps), counts.gap_seconds, counts.gap_unknown, counts.missed) == (1, 0.3, 1, 3)
    assert counts.outcomes == {"done": 2, "rolled_back": 1}
    assert counts.verdicts == {"lost": 1}
    last = counts.last_change
    assert last is not None
    assert (last.gap, last.missed, last.lost, last.verdict) == (None, None, 1.5, "lost")


def test_each_metric_of_the_catalogue_is_served_with_its_labels_and_no_other_is(tmp_path: Path) -> None:
    policy = RespawnPolicy(max_retries=1)
    specification = example("obstacle")
    role = next(iter(sorted(specification.nodes)))
    specification = specification.with_node(changed(specification.nodes[role], respawn=policy))

    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(10)
        counts = manager.watched.system.counts
        counts.changed(
            Outcome(
                outcome="done",
                swaps=[swapped(0.1, 0)],
                continuity=Assessments("lost", "", [Assessment("/t", "lost", "", 0.1)]),
            )
        )
        texts = [exposition(at(manager))]
        for _ in range(2):
            simulator.faults.kill(role)
            await asyncio.sleep(2)
        texts.append(exposition(at(manager)))
        served: dict[str, set[str]] = {}
        for text in texts:
            for family in text_string_to_metric_families(text.decode()):
                for sample in family.samples:
                    name = sample.name.removesuffix("_bucket").removesuffix("_count").removesuffix("_sum")
                    served.setdefault(name, set()).update(sample.labels.keys() - {"le"})
        unseen = {"midstride_port_field_samples_total", "midstride_port_field_violations_total"}
        expected = {metric.name: {SYSTEM, *metric.labels} for metric in METRICS}
        assert served == {name: labels for name, labels in expected.items() if name in served}
        assert expected.keys() - served.keys() <= unseen

    managed("obstacle", tmp_path, body, specification=specification)


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_names_keep_to_the_conventions(metric: Any) -> None:
    assert metric.name.startswith("midstride_")
    assert metric.name.endswith("_total") == (metric.kind == "counter")
    assert metric.help.endswith(".")
    assert not {"instance", "job", "le", SYSTEM} & {*metric.labels}, "Prometheus gives these itself"
    for unit in ("_ms", "_milliseconds", "_hz", "_percent"):
        assert unit not in metric.name


def test_the_socket_answers_at_the_path_that_prometheus_expects(workspace: Workspace) -> None:
    async def test() -> None:
        async with serving(ScriptedManager(), workspace) as (client, _):
            await client.get("/up")
            answer = await client.get("http://manager/metrics")
            assert answer.status_code == 200
            assert answer.headers["content-type"].startswith("text/plain; version=")
            found = Metrics.read(answer.content)
            assert found.one("midstride_manager_phase", phase="up") == 1
            assert found.one("midstride_instance_answering", node="talker") == 0

    run(test)


async def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


async def with_file(
    workspace: Workspace, file: Path, body: Callable[[asyncio.Task[int], ScriptedManager], Awaitable[None]]
) -> None:
    manager = ScriptedManager()
    server = asyncio.ensure_future(serve(manager.as_manager, workspace, backend="scripted", metrics_file=file))
    try:
        await until(
            lambda: file.exists() and b'phase="up",system="talker"} 1' in file.read_bytes().replace(b", ", b",")
        )
        await body(server, manager)
    finally:
        server.cancel()
        await asyncio.gather(server, return_exceptions=True)


def test_the_file_is_kept_up_to_date_whole_and_goes_with_the_manager(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics_source, "EVERY", 0.02)
    file = tmp_path / "robot.prom"

    async def body(server: asyncio.Task[int], manager: ScriptedManager) -> None:
        assert stat.S_IMODE(file.stat().st_mode) == 0o644, "node_exporter is another user"
        first = Metrics.read(file.read_bytes()).one("midstride_snapshot_timestamp_seconds")
        assert abs(time.time() - first) < 10
        with file.open("rb") as reading:
            opened = os.fstat(reading.fileno()).st_ino
            await until(lambda: file.stat().st_ino != opened)
            assert reading.read().endswith(b"\n"), "who reads meanwhile has a whole file"
        later = Metrics.read(file.read_bytes()).one("midstride_snapshot_timestamp_seconds")
        assert later > first

    async def test() -> None:
        await with_file(workspace, file, body)
        assert [*tmp_path.iterdir()] == []

    run(test)


def test_a_file_that_no_collector_would_read_is_refused_before_anything_starts(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path / "robot.txt", "only reads files that end in `.prom`"),
        (tmp_path / "absent" / "robot.prom", "cannot write to .*absent: No such file or directory"),
    ):
        with pytest.raises(ManagerError, match=words):
            MetricsFile.require(path)
    assert [*tmp_path.iterdir()] == []


def test_a_disk_that_is_full_is_said_once_and_the_manager_goes_on(
    workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics_source, "EVERY", 0.01)
    file = tmp_path / "robot.prom"

    async def body(server: asyncio.Task[int], manager: ScriptedManager) -> None:
        tries = 0

        def full(*_: object, mode: int) -> None:
            nonlocal tries
            tries += 1
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(metrics_source, "write_whole", full)
        await until(lambda: tries > 3)
        said = [event.words for event in manager.events.since() if event.kind == "note"]
        assert said == [f"the metrics cannot be written to {file}: No space left on device"]
        assert not server.done()

    run(lambda: with_file(workspace, file, body))

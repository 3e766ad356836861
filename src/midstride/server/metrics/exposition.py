"""The status of a system and the counts of its manager as the text that Prometheus reads.

A sample that is not known is left out: a monitor must be able to tell 0 from unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, Final, get_args

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

from midstride.runtime.records.counts import GAP_BOUNDS, EventCounts
from midstride.runtime.records.reports import OutcomeKind
from midstride.runtime.records.status_forms import InstanceStatus, Phase, SilenceKind, Status
from midstride.server.metrics import metric_catalogue as catalogue
from midstride.server.metrics.metric_catalogue import METRICS, SYSTEM, Metric
from midstride.verdicts.assessment import Continuity
from midstride.verdicts.conditions import EXIT_STATUS

CONTENT_TYPE: Final[str] = CONTENT_TYPE_LATEST
_FAMILIES: Final = {"gauge": GaugeMetricFamily, "counter": CounterMetricFamily, "histogram": HistogramMetricFamily}


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that the metrics are made of, as it was ``at`` (UNIX time). ``nodes`` are those of the specification."""

    at: float
    version: str
    phase: Phase
    nodes: frozenset[str]
    status: Status
    counts: EventCounts


@dataclass(slots=True, eq=False)
class _Samples:
    """The samples of one system, by metric."""

    system: str
    families: dict[Metric, Any] = field(default_factory=dict)

    def family(self, metric: Metric) -> Any:
        if metric not in self.families:
            self.families[metric] = _FAMILIES[metric.kind](metric.name, metric.help, labels=[SYSTEM, *metric.labels])
        return self.families[metric]

    def add(self, metric: Metric, value: float | None, **labels: str) -> None:
        """Add a sample; none where its ``value`` is not known."""
        if value is not None:
            self.family(metric).add_metric([self.system, *(labels[name] for name in metric.labels)], float(value))

    def one_of(self, metric: Metric, label: str, known: tuple[str, ...], current: str, **labels: str) -> None:
        """Add 1 for the ``current`` of the ``known`` values of a label, and 0 for the others."""
        for value in known:
            self.add(metric, value == current, **labels, **{label: value})

    def collect(self) -> Iterator[Any]:
        return (self.families[metric] for metric in METRICS if metric in self.families)


def exposition(snapshot: Snapshot) -> bytes:
    """The text of ``snapshot``."""
    samples = _Samples(snapshot.status.system)
    _of_manager(samples, snapshot)
    _of_changes(samples, snapshot.counts)
    if snapshot.phase in {"up", "down"}:
        _of_system(samples, snapshot)
    registry = CollectorRegistry()
    registry.register(samples)
    text: bytes = generate_latest(registry)
    return text


def _of_manager(samples: _Samples, snapshot: Snapshot) -> None:
    status, counts = snapshot.status, snapshot.counts
    samples.add(
        catalogue.MANAGER_INFO,
        1,
        version=snapshot.version,
        backend=status.backend,
        middleware=status.middleware.name,
    )
    samples.add(catalogue.START, counts.since)
    samples.add(catalogue.SNAPSHOT, snapshot.at)
    samples.one_of(catalogue.PHASE, "phase", get_args(Phase), snapshot.phase)
    samples.add(catalogue.LOCKED, status.lock is not None)
    for node in sorted(snapshot.nodes | counts.crashes.keys() | counts.respawns.keys()):
        samples.add(catalogue.CRASHES, counts.crashes[node], node=node)
        samples.add(catalogue.RESPAWNS, counts.respawns[node], node=node)


def _of_changes(samples: _Samples, counts: EventCounts) -> None:
    for outcome in get_args(OutcomeKind):
        samples.add(catalogue.CHANGES, counts.outcomes[outcome], outcome=outcome)
    for verdict in get_args(Continuity):
        samples.add(catalogue.VERDICTS, counts.verdicts[verdict], verdict=verdict)
    bounds = [*(f"{bound:g}" for bound in GAP_BOUNDS), "+Inf"]
    buckets = list(zip(bounds, accumulate(counts.gaps), strict=True))
    samples.family(catalogue.GAP).add_metric([samples.system], buckets, counts.gap_seconds)
    samples.add(catalogue.GAP_UNKNOWN, counts.gap_unknown)
    samples.add(catalogue.MISSED, counts.missed)
    if (last := counts.last_change) is None:
        return
    samples.add(catalogue.LAST_TIME, last.at)
    samples.add(catalogue.LAST_SECONDS, last.seconds)
    samples.add(catalogue.LAST_GAP, last.gap)
    samples.add(catalogue.LAST_MISSED, last.missed)
    samples.add(catalogue.LAST_LOST, last.lost)
    if last.verdict is not None:
        samples.one_of(catalogue.LAST_VERDICT, "verdict", get_args(Continuity), last.verdict)


def _of_system(samples: _Samples, snapshot: Snapshot) -> None:
    status = snapshot.status
    condition = status.condition
    samples.one_of(catalogue.CONDITION, "condition", tuple(EXIT_STATUS), condition.state)
    samples.add(catalogue.EXIT_STATUS, EXIT_STATUS[condition.state])
    samples.add(catalogue.FAULTS, len(condition.faults))
    samples.add(catalogue.NOT_MEASURABLE, len(condition.unknown))
    samples.add(catalogue.VALID, status.valid)
    present = {instance.role for instance in status.instances}
    for node in sorted(snapshot.nodes):
        samples.add(catalogue.MISSING, node not in present, node=node)
    exhausted = {
        each.role: not each.respawn.restarting
        for each in status.crashed
        if each.role is not None and each.respawn is not None
    }
    for node, value in sorted(exhausted.items()):
        samples.add(catalogue.GIVEN_UP, value, node=node)
    for kind in get_args(SilenceKind):
        samples.add(catalogue.SILENCES, sum(silence.kind == kind for silence in status.silences), kind=kind)
    for instance in status.instances:
        if not instance.done:
            _of_instance(samples, instance)


def _of_instance(samples: _Samples, instance: InstanceStatus) -> None:
    named = {"node": instance.role, "node_instance": instance.name}
    samples.add(catalogue.ANSWERING, instance.reachable, **named, component=instance.component)
    if not instance.reachable:  # what its entry has is the manager's model
        return
    for each in instance.functionalities:
        of_it = {**named, "functionality": each.name}
        samples.one_of(catalogue.MODE, "mode", tuple(each.modes), each.mode, **of_it)
        samples.add(catalogue.LEVEL, each.modes.index(each.mode) if each.mode in each.modes else None, **of_it)
    for port in instance.ports:
        if port.topic is None:
            continue
        at: Mapping[str, str] = {**named, "port": port.name, "direction": port.direction, "topic": port.topic}
        samples.add(catalogue.RATE, port.rate, **at)
        samples.add(catalogue.CONTRACT_RATE, port.declared, **at)
        samples.add(catalogue.CONTRACT_MET, port.met, **at)
        samples.add(catalogue.AGE, port.age, **at)
        samples.add(catalogue.JITTER, port.jitter, **at)
        samples.add(catalogue.LONGEST, port.longest, **at)
        for sampled in port.fields or ():
            samples.add(catalogue.CHECKED, sampled.checked, **at, field=sampled.field)
            samples.add(catalogue.VIOLATIONS, sampled.violations, **at, field=sampled.field)

"""Every metric: its name, its kind, its labels, its meaning, and when it is absent (docs/reference/metrics.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

MetricKind: TypeAlias = Literal["gauge", "counter", "histogram"]

# `instance` is a label that Prometheus gives to each target itself: one of that name would be renamed on arrival.
_INSTANCE: Final = ("node", "node_instance")
_PORT: Final = (*_INSTANCE, "port", "direction", "topic")


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric. Each has the label `system` besides ``labels``.

    ``absent``: where or while it has no sample, as what is not known is never 0; empty: it always has one.
    """

    name: str
    kind: MetricKind
    labels: tuple[str, ...]
    help: str
    absent: str = ""


_NOT_UP: Final = "while the system is being brought up, and where that has failed"
_NO_ANSWER: Final = "where the instance has not reported its state in the last 2 s"
_UNMEASURED: Final = "where nothing measures it, no whole window is measured yet, or the instance does not answer"
_NO_CHANGE: Final = "where this manager has carried out no change"

MANAGER_INFO: Final = Metric(
    "midstride_manager_info",
    "gauge",
    ("version", "backend", "middleware"),
    "1: the version of Midstride that the manager runs, its back end, and the middleware.",
)
START: Final = Metric(
    "midstride_manager_start_time_seconds",
    "gauge",
    (),
    "When the manager started, in unix time. Counters begin at 0 then.",
)
SNAPSHOT: Final = Metric(
    "midstride_snapshot_timestamp_seconds",
    "gauge",
    (),
    "When these figures were taken, in unix time. In a file they are worth nothing once this is old.",
)
PHASE: Final = Metric(
    "midstride_manager_phase",
    "gauge",
    ("phase",),
    "1 for the phase that the manager is in, 0 for the others: starting, up, failed, down.",
)
LOCKED: Final = Metric("midstride_system_locked", "gauge", (), "1 while the system is locked, else 0.")
CONDITION: Final = Metric(
    "midstride_system_condition",
    "gauge",
    ("condition",),
    "1 for the condition that the headline of `midstride status` begins with, 0 for the others: up, degraded, down.",
    _NOT_UP,
)
EXIT_STATUS: Final = Metric(
    "midstride_system_exit_status",
    "gauge",
    (),
    "The exit status of `midstride status`: 0 up, 3 degraded, 1 down.",
    _NOT_UP,
)
FAULTS: Final = Metric(
    "midstride_system_faults",
    "gauge",
    (),
    "How many things are missing or worse than they should be; `midstride status` names them.",
    _NOT_UP,
)
NOT_MEASURABLE: Final = Metric(
    "midstride_system_not_measurable",
    "gauge",
    (),
    "How many statements about what the system does cannot be made, as nothing measures it.",
    _NOT_UP,
)
VALID: Final = Metric(
    "midstride_configuration_valid",
    "gauge",
    (),
    "1 where the configuration is valid and its components report what the manager's model has, else 0.",
    _NOT_UP,
)
MISSING: Final = Metric(
    "midstride_node_missing",
    "gauge",
    ("node",),
    "1 where a node of the specification has no instance, else 0.",
    _NOT_UP,
)
GIVEN_UP: Final = Metric(
    "midstride_node_respawns_exhausted",
    "gauge",
    ("node",),
    "1 where a crashed node is not restarted again by its policy, 0 where it will be.",
    "where the node has not crashed, or has no restart policy",
)
CRASHES: Final = Metric(
    "midstride_crashes_total",
    "counter",
    ("node",),
    "Processes of the node that have exited unexpectedly since the manager started.",
)
RESPAWNS: Final = Metric(
    "midstride_respawns_total",
    "counter",
    ("node",),
    "Restarts of the node by its policy that were begun since the manager started.",
)
ANSWERING: Final = Metric(
    "midstride_instance_answering",
    "gauge",
    (*_INSTANCE, "component"),
    "1 where the instance has reported its state in the last 2 s, else 0.",
    "where the instance is a program that has ended as it should",
)
MODE: Final = Metric(
    "midstride_functionality_mode",
    "gauge",
    (*_INSTANCE, "functionality", "mode"),
    "1 for the mode that the functionality is in, 0 for its others.",
    _NO_ANSWER,
)
LEVEL: Final = Metric(
    "midstride_functionality_level",
    "gauge",
    (*_INSTANCE, "functionality"),
    "The place of the current mode among the modes of the functionality: 0 is the best one.",
    _NO_ANSWER,
)
RATE: Final = Metric(
    "midstride_port_rate_hertz", "gauge", _PORT, "The rate of messages at the port, as measured.", _UNMEASURED
)
CONTRACT_RATE: Final = Metric(
    "midstride_port_contract_rate_hertz",
    "gauge",
    _PORT,
    "The rate that the port guarantees (out) or relies on (in) in the current modes.",
    "where no rate is stated",
)
CONTRACT_MET: Final = Metric(
    "midstride_port_contract_met",
    "gauge",
    _PORT,
    "1 where the rate is at least 90 % of the stated one over a whole window, else 0.",
    f"where no rate is stated, and {_UNMEASURED}",
)
AGE: Final = Metric(
    "midstride_port_message_age_seconds",
    "gauge",
    _PORT,
    "The time since the last message at the port.",
    f"where there was none, and {_UNMEASURED}",
)
JITTER: Final = Metric(
    "midstride_port_jitter_seconds",
    "gauge",
    _PORT,
    "The standard deviation of the times between messages at the port.",
    _UNMEASURED,
)
LONGEST: Final = Metric(
    "midstride_port_longest_gap_seconds",
    "gauge",
    _PORT,
    "The longest time between messages at the port in its window, or since the last one.",
    _UNMEASURED,
)
CHECKED: Final = Metric(
    "midstride_port_field_samples_total",
    "counter",
    (*_PORT, "field"),
    "Messages of which a field that the contract constrains was looked at.",
    "where no field is constrained, or nothing looks at it",
)
VIOLATIONS: Final = Metric(
    "midstride_port_field_violations_total",
    "counter",
    (*_PORT, "field"),
    "Those of them that were outside the constraint.",
    "where no field is constrained, or nothing looks at it",
)
SILENCES: Final = Metric(
    "midstride_silences",
    "gauge",
    ("kind",),
    "Silences that last: unreachable, not_answering, not_discovering, not_publishing, not_receiving, not_responding.",
    _NOT_UP,
)
CHANGES: Final = Metric(
    "midstride_changes_total",
    "counter",
    ("outcome",),
    "Changes since the manager started, `up` and restarts by policy included, by how they ended: done, incomplete, "
    "refused, rolled_back, failed.",
)
VERDICTS: Final = Metric(
    "midstride_changes_assessed_total",
    "counter",
    ("verdict",),
    "Changes since the manager started that were not refused, by the weakest that may be said of them: kept, lost, "
    "not_measurable.",
)
GAP: Final = Metric(
    "midstride_change_gap_seconds",
    "histogram",
    (),
    "The longest time without a message at a subscriber of a topic whose publisher was replaced: one observation for "
    "each change of which it is known at every subscriber.",
)
GAP_UNKNOWN: Final = Metric(
    "midstride_changes_gap_unknown_total",
    "counter",
    (),
    "Changes with subscribers of which that time is not known, so that the histogram lacks them.",
)
MISSED: Final = Metric(
    "midstride_missed_messages_total",
    "counter",
    (),
    "Messages that subscribers have missed in changes, as far as that is known.",
)
LAST_TIME: Final = Metric(
    "midstride_last_change_timestamp_seconds",
    "gauge",
    (),
    "When the last change was reported, in unix time. A refused one does not count.",
    _NO_CHANGE,
)
LAST_SECONDS: Final = Metric(
    "midstride_last_change_duration_seconds", "gauge", (), "How long its steps took together.", _NO_CHANGE
)
LAST_GAP: Final = Metric(
    "midstride_last_change_gap_seconds",
    "gauge",
    (),
    "The longest time without a message at its subscribers.",
    "where one of them does not know it, or there is none",
)
LAST_MISSED: Final = Metric(
    "midstride_last_change_missed_messages",
    "gauge",
    (),
    "The messages that its subscribers have missed.",
    "where one of them does not know it, or there is none",
)
LAST_LOST: Final = Metric(
    "midstride_last_change_lost_seconds",
    "gauge",
    (),
    "The longest time for which something was lost in it.",
    "where nothing was lost, or it is not known for how long",
)
LAST_VERDICT: Final = Metric(
    "midstride_last_change_verdict",
    "gauge",
    ("verdict",),
    "1 for the weakest that may be said of it, 0 for the others: kept, lost, not_measurable.",
    _NO_CHANGE,
)

METRICS: Final = tuple(each for each in list(globals().values()) if isinstance(each, Metric))
SYSTEM: Final = "system"

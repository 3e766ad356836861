"""The alert rules of docs/how-to/monitoring.md: each expression parses, and names metrics and labels that there are."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import promql_parser
import pytest
import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

from midstride.server.metrics.metric_catalogue import METRICS, SYSTEM

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "monitoring.md").read_text(encoding="utf-8")
SCRAPING, RULES = (yaml.safe_load(text) for text in re.findall(r"```yaml[^\n]*\n(.*?)```", PAGE, re.DOTALL))
ALERTS = [rule for group in RULES["groups"] for rule in group["rules"]]
SUFFIXES = {"counter": [""], "gauge": [""], "histogram": ["_bucket", "_count", "_sum"]}
LABELS = {f"{each.name}{suffix}": {SYSTEM, *each.labels} for each in METRICS for suffix in SUFFIXES[each.kind]}


def faults_of(expression: str) -> list[str]:
    """What is wrong with an expression. Raises ValueError if it does not parse."""
    promql_parser.parse(expression)
    text = re.sub(r'"[^"]*"', '""', expression)
    faults = [f"no metric {name}" for name in re.findall(r"\bmidstride_\w+", text) if name not in LABELS]
    for name, matchers in re.findall(r"\b(midstride_\w+)\{([^}]*)\}", text):
        used = {matcher.partition("=")[0].strip(" !") for matcher in matchers.split(",")}
        faults += [f"{name} has no label {label}" for label in used - LABELS.get(name, set())]
    every = {"instance", "job"}.union(*LABELS.values())  # Prometheus gives these two to each sample
    for labels in re.findall(r"\b(?:on|by|ignoring|without)\s*\(([^)]*)\)", text):
        faults += [f"no label {label}" for label in {each.strip() for each in labels.split(",")} - every]
    return faults


@pytest.mark.parametrize("rule", ALERTS, ids=lambda rule: rule["alert"])
def test_each_rule_is_about_what_there_is(rule: dict[str, Any]) -> None:
    assert faults_of(rule["expr"]) == []
    assert rule.keys() <= {"alert", "expr", "for", "labels", "annotations"}
    assert re.fullmatch(r"\d+[sm]", rule.get("for", "1s"))
    shown = set(re.findall(r"\$labels\.(\w+)", rule["annotations"]["summary"]))
    [first, *_] = re.findall(r"\bmidstride_\w+", rule["expr"])
    assert shown <= LABELS[first]


@pytest.mark.parametrize("rule", ALERTS, ids=lambda rule: rule["alert"])
def test_each_rule_is_about_something_that_has_happened_or_looks_at_the_age_of_the_metrics(
    rule: dict[str, Any],
) -> None:
    """What a killed manager left behind goes on saying what was so then."""
    assert "[" in rule["expr"] or "midstride_snapshot_timestamp_seconds" in rule["expr"]


def fired(tmp_path: Path, series: dict[str, str], at: str) -> str:
    """What `promtool` says of the rules where none may fire at a time."""
    (tmp_path / "rules.yml").write_text(yaml.safe_dump(RULES))
    test = {
        "interval": "15s",
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "alert_rule_test": [{"eval_time": at, "alertname": rule["alert"], "exp_alerts": []} for rule in ALERTS],
    }
    (tmp_path / "test.yml").write_text(yaml.safe_dump({"rule_files": ["rules.yml"], "tests": [test]}))
    done = subprocess.run(
        ["promtool", "test", "rules", "test.yml"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr


def names(said: str) -> list[str]:
    """The alerts that fired, as `promtool` says."""
    return re.findall(r"alertname: (\w+), time", said)


@pytest.mark.promtool
def test_the_rules_fire_while_a_manager_writes_and_only_one_does_once_it_was_killed(tmp_path: Path) -> None:
    """A node is missing, and an output too slow, as the manager is killed after 5 min; another robot goes on."""
    killed = {
        'midstride_snapshot_timestamp_seconds{instance="a",job="node",system="talker"}': "0+15x20 300x60",
        'midstride_snapshot_timestamp_seconds{instance="b",job="node",system="talker"}': "0+15x80",
        'midstride_system_exit_status{instance="a",job="node",system="talker"}': "3x80",
        'midstride_node_missing{instance="a",job="node",system="talker",node="talker"}': "1x80",
        'midstride_node_missing{instance="b",job="node",system="talker",node="talker"}': "0x80",
        'midstride_port_contract_met{instance="a",job="node",system="talker",direction="out",port="out"}': "0x80",
        'midstride_crashes_total{instance="a",job="node",system="talker",node="talker"}': "0x12 3x67",
    }
    state = ["MidstrideContractBroken", "MidstrideDegraded", "MidstrideNodeMissing"]
    assert sorted(names(fired(tmp_path, killed, "4m"))) == sorted([*state, "MidstrideCrashLoop"])
    assert names(fired(tmp_path, killed, "18m")) == ["MidstrideManagerGone"]
    well = {name: values for name, values in killed.items() if 'instance="b"' in name}
    assert "SUCCESS" in fired(tmp_path, well, "4m")


def test_the_expressions_in_the_text_are_right_too() -> None:
    found = re.findall(r"`(\w+ by [^`]*)`", PAGE)
    assert found
    assert [fault for expression in found for fault in faults_of(expression)] == []


@pytest.mark.parametrize(
    ("expression", "fault"),
    [
        ("midstride_node_gone == 1", "no metric midstride_node_gone"),
        ('midstride_node_missing{component="Talker"} == 1', "midstride_node_missing has no label component"),
        ("sum by (robot) (midstride_silences)", "no label robot"),
    ],
)
def test_a_rule_about_something_else_is_found(expression: str, fault: str) -> None:
    assert faults_of(expression) == [fault]


def test_what_is_no_expression_is_found() -> None:
    with pytest.raises(ValueError, match="invalid promql"):
        faults_of("midstride_node_missing == == 1")


def test_the_scrape_configuration_reads_the_token_of_the_manager() -> None:
    jobs = {job["job_name"]: job for job in SCRAPING["scrape_configs"]}
    assert jobs["midstride"]["authorization"]["credentials_file"].endswith("/midstride/talker/token")
    assert "metrics_path" not in jobs["midstride"], "the path is the one that Prometheus uses by default"

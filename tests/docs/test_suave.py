"""The example suave: its metrics are those of SUAVE, and a mission reacts in time, the same for the same seed."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "suave"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    names = ("campaign", "metrics", "missions")
    monkeypatch.syspath_prepend(str(FOLDER))
    import campaign  # type: ignore[import-not-found]
    import metrics  # type: ignore[import-not-found]
    import missions  # type: ignore[import-not-found]

    yield SimpleNamespace(campaign=campaign, metrics=metrics, missions=missions)
    for name in names:
        sys.modules.pop(name, None)


def test_reactions_are_counted_from_the_diagnostics_to_their_result(example: SimpleNamespace) -> None:
    found = example.metrics.Metrics()
    found.began = 1.0
    found.on_diagnostic("water_visibility", "2.5", 10.0)  # 2 m are expected, and it is at 3 m
    found.on_diagnostic("water_visibility", "2.4", 11.0)
    found.on_altitude(3.0, 11.5)  # wrong still
    found.on_altitude(2.0, 12.0)
    found.on_diagnostic("water_visibility", "2.3", 13.0)
    found.on_transition("active", 13.5)  # nothing has failed
    found.on_diagnostic("c_thruster_1", "FALSE", 20.0)
    found.on_diagnostic("c_thruster_3", "FALSE", 21.0)  # one failure at a time is measured
    found.on_transition("inactive", 21.5)
    found.on_transition("active", 22.0)
    found.found, found.inspected = 55.9, 12.5
    assert found.row(251.2) == {
        "mission duration (s)": 250,
        "pipeline found": True,
        "time searching pipeline (s)": 54,
        "distance inspected (m)": 12.5,
        "mean reaction time (s)": 2.0,
        "reactions": 2,
        "longest reaction (s)": 2.0,
    }
    assert [example.metrics.expected_altitude(each) for each in (3.25, 3.2, 1.25, 1.2)] == [3.0, 2.0, 1.0, None]


def test_a_mission_reacts_within_a_twentieth_of_a_second_and_is_the_same_each_time(example: SimpleNamespace) -> None:
    """A thruster fails after 5 s, and the visibility falls and rises between the three altitudes."""
    short = example.missions.Scenario(7, 2.8, lowest=1.25, highest=3.75, shift=25.0, failure=5.0, time_limit=40.0)
    row = example.missions.simulate(short)
    assert row["reactions"] >= 3 and 0 < row["longest reaction (s)"] <= 0.05
    shorter = example.missions.Scenario(7, 2.8, failure=5.0, time_limit=8.0)
    assert example.missions.simulate(shorter) == example.missions.simulate(shorter)


def test_the_table_has_the_published_rows_and_its_own(example: SimpleNamespace) -> None:
    row = {"time searching pipeline (s)": 50, "distance inspected (m)": 55.0, "mean reaction time (s)": 0.004}
    rows = {2: {"midstride": [{**row, "reactions": 3, "longest reaction (s)": 0.006}] * 2}}
    lines = example.campaign.table(rows).splitlines()
    assert lines[0] == "Experiment 2: the visibility changes"
    assert "| hand-written tree | 30 | 110 (51 to 114) | 38.1 (36.7 to 57.5) | 0.082 (0.069 to 0.092) |" in lines
    assert "| **Midstride** | 2 | 50 (50 to 50) | 55.0 (55.0 to 55.0) | 0.004 (0.004 to 0.004) |" in lines
    assert lines[-1] == "Midstride: 6 reactions, the longest took 0.0060 s."


def test_missions_that_are_in_the_file_are_not_flown_again(
    example: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"time searching pipeline (s)": 50, "distance inspected (m)": 55.0, "mean reaction time (s)": 0.03}
    flown = {"system": "tree", "experiment": 2, "number": 0, **row, "reactions": 3, "longest reaction (s)": 0.04}
    out = tmp_path / "rows.jsonl"
    out.write_text(json.dumps(flown) + "\n")
    short = example.missions.Scenario(7, 2.8, failure=1.0, time_limit=3.0)
    monkeypatch.setattr(example.campaign, "scenario", lambda experiment, number: short)
    example.campaign.main(["--systems", "tree", "--experiments", "2", "--runs", "2", "--out", str(out)])
    first, second = map(json.loads, out.read_text().splitlines())
    assert first == flown
    assert (second["system"], second["experiment"], second["number"]) == ("tree", 2, 1)
    assert second["mission duration (s)"] == 3
    assert "| hand-written tree, here | 2 | " in capsys.readouterr().out

"""The program benchmarks/swap: intervals, conditions, files, tables and plots, and one way on real ROS 2."""

from __future__ import annotations

import csv
import itertools
import math
import os
import statistics
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.swap import report
from benchmarks.swap.all_ways import WAYS
from benchmarks.swap.cells import LOADS, MOST, RATES, SIZES, Cell, Condition, conditions, in_order
from benchmarks.swap.intervals import bootstrap, clopper_pearson, quantile
from benchmarks.swap.judging import Row
from benchmarks.swap.measure import Measured, Window
from benchmarks.swap.pictures import strips
from benchmarks.swap.streams import Recording, Stream, SwapFailed
from benchmarks.swap.summary import of_cell

ROOT = Path(__file__).resolve().parents[1]
TITLES = {way.name: way.title for way in WAYS}


def obvious_share(hits: int, of: int) -> tuple[Fraction, Fraction]:
    """The least and the greatest probability, in steps of a thousandth, under which neither tail is below 2.5 %."""

    def tail(p: Fraction, counts: range) -> Fraction:
        terms = (math.comb(of, each) * p**each * (1 - p) ** (of - each) for each in counts)
        return sum(terms, Fraction(0))

    likely = [
        p
        for p in (Fraction(each, 1000) for each in range(1001))
        if tail(p, range(hits, of + 1)) >= Fraction(25, 1000) and tail(p, range(hits + 1)) >= Fraction(25, 1000)
    ]
    return min(likely), max(likely)


@pytest.mark.parametrize(("hits", "of"), [(0, 1), (1, 1), (0, 20), (1, 20), (7, 20), (19, 20), (20, 20), (3, 9)])
def test_the_interval_of_a_share_is_that_of_all_probabilities_that_are_not_unlikely(hits: int, of: int) -> None:
    low, high = (Fraction(each).limit_denominator(10**9) for each in clopper_pearson(hits, of))
    least, most = obvious_share(hits, of)
    assert least - Fraction(1, 1000) <= low <= least
    assert most <= high <= most + Fraction(1, 1000)


def test_the_interval_of_a_share_is_that_of_tables() -> None:
    assert clopper_pearson(0, 20) == pytest.approx((0, 0.16843), abs=1e-5)
    assert clopper_pearson(4, 20) == pytest.approx((0.05733, 0.43661), abs=1e-5)


@pytest.mark.parametrize("values", [(1.0,), (1.0, 2.0, 9.0), (1.0, 1.5, 2.0, 4.0, 30.0)])
def test_the_bootstrap_is_near_that_of_all_drawings(values: tuple[float, ...]) -> None:
    every = sorted(statistics.median(drawn) for drawn in itertools.product(values, repeat=len(values)))
    low, high = bootstrap(values, seed=3, samples=4000)
    assert quantile(every, 0.015) <= low <= quantile(every, 0.035)
    assert quantile(every, 0.965) <= high <= quantile(every, 0.985)
    assert bootstrap(values, seed=3, samples=4000) == (low, high)


@given(st.lists(st.integers(0, 9), min_size=1, max_size=12), st.integers(0, 100))
def test_a_quantile_is_the_least_value_that_enough_do_not_exceed(values: list[int], percent: int) -> None:
    ordered = sorted(values)
    enough = [each for each in ordered if 100 * sum(other <= each for other in ordered) >= percent * len(ordered)]
    assert quantile(ordered, percent / 100) == min(enough)


def test_conditions_differ_from_the_base_in_one_thing() -> None:
    found = conditions()
    assert found[0] == Condition(Stream(50, 100), "idle")
    assert len(found) == len({*found}) == 1 + (len(RATES) - 1) + (len(SIZES) - 1) + (len(LOADS) - 1)
    every = conditions(every=True)
    assert {*found} < {*every}
    assert all(each.stream.rate * each.stream.size <= MOST for each in every)
    assert Condition(Stream(1000, 10_000), "busy") in every
    assert Condition(Stream(1000, 1_500_000), "idle") not in every


def test_the_order_is_by_condition_and_the_seed() -> None:
    chosen = conditions()
    cells = in_order(chosen, WAYS, 1)
    assert len({each.file for each in cells}) == len(cells) == len(chosen) * len(WAYS)
    assert [condition for condition, _ in itertools.groupby(cells, key=lambda cell: cell.condition)] == chosen
    assert cells == in_order(chosen, WAYS, 1) != in_order(chosen, WAYS, 2)


def test_each_way_has_a_name_and_a_title_of_its_own() -> None:
    assert len(TITLES) == len({*TITLES.values()}) == len(WAYS)


def cell(way: str = "kill", silent: int = 12, load: str = "idle", rate: float = 50.0) -> Measured:
    """Two swaps, in each of which nothing is heard for so many periods, and two rows that belong to neither."""
    step = round(1e9 / rate)
    rows: list[Row] = []
    windows = []
    for swap in range(2):
        begun = (1000 * swap + 100) * step
        old = [Row(begun + at * step, begun + at * step, at + 50, f"old{swap}") for at in range(-30, 1)]
        new = [Row(begun + (silent + at) * step, begun + (silent + at) * step, at, f"new{swap}") for at in range(40)]
        rows += [*old, *new, Row(begun + 500 * step, begun + 500 * step, 1, "later")]
        windows.append(Window(begun, begun + (silent + 30) * step, "no room" if swap else None))
    machine: dict[str, Any] = {"processors": 2, "processor": "a processor", "memory_gib": 8.0, "kernel": "6", "ros": {}}
    about = {
        "machine": {**machine, "python": "3.11", "midstride": "0", "commit": None},
        "started": "2026-01-01T00:00:00Z",
        "busy_processes": 2 if load == "busy" else 0,
        "load_average": [0.5, 1.0],
        "idle_share": 0.5,
        "seed": 1,
    }
    return Measured(Cell(way, Condition(Stream(rate, 100), load)), about, tuple(windows), tuple(rows))


def test_a_file_has_the_rows_of_the_windows_and_the_same_figures(tmp_path: Path) -> None:
    made = cell()
    made.write(tmp_path / made.cell.file)
    found = Measured.read(tmp_path / made.cell.file)
    assert (found.cell, found.windows, found.about) == (made.cell, made.windows, made.about)
    assert found.figures() == made.figures()
    assert {*found.rows} < {*made.rows}
    assert not any(row.talker == "later" for row in found.rows)
    assert [path.name for path in tmp_path.iterdir()] == ["kill-50hz-100b-idle.jsonl"]


def test_a_summary_has_all_swaps() -> None:
    found = of_cell(cell(silent=12))
    assert found.gaps == pytest.approx((12, 12))
    assert found.median == pytest.approx(12) and found.interval == pytest.approx((12, 12))
    assert (found.missing_swaps, found.counts["missed"], found.taken_back) == (2, 22, 1)


def test_what_has_been_measured_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, pictures = tmp_path / "page.md", tmp_path / "pictures"
    pictures.mkdir()
    page.write_text(f"before\n{report.BEGIN}\nold figures\n{report.END}\nafter\n")
    made = [cell("kill"), cell("none", 1), cell("kill", 15, "busy"), cell("kill", 3, rate=10.0)]
    for each in made:
        each.write(tmp_path / each.cell.file)
    report.write(tmp_path, WAYS, pictures, page)
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old figures" not in text
    printed = capsys.readouterr().out
    assert printed.count("### ") == 3 and text.count("### ") == 1
    base = printed[printed.index("### 50 Hz, 100 B, idle") : printed.index("### 10 Hz, 100 B, idle")]
    assert base in text
    assert base.index("| no swap | 2 | 1 [1, 1] |") < base.index("| kill one, start the other | 2 | 12 [12, 12] |")
    assert "started for this: 2. Load average 0.5 to 1.0" in printed[printed.index("### 50 Hz, 100 B, busy") :]
    with (pictures / "swaps.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(made)
    assert {row["taken_back"] for row in rows} == {"", "no room"}
    for name in ("swap-rates.svg", "swap-loads.svg"):
        assert f"](pictures/{name})" in text
        assert (pictures / name).read_text() == (tmp_path / name).read_text()
        ElementTree.parse(pictures / name)
    again = page.read_text()
    report.write(tmp_path, WAYS, pictures, page)
    assert page.read_text() == again


def test_a_page_without_a_place_and_a_file_of_something_else_are_said(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    with pytest.raises(SystemExit, match="has no lines"):
        report.put("figures", page)
    (tmp_path / "other.jsonl").write_text("{}\n")
    with pytest.raises(SystemExit, match=r"other\.jsonl is not a file of this program"):
        report.read(tmp_path)


def test_a_plot_has_a_dot_for_each_swap_at_its_gap() -> None:
    drawn = ElementTree.fromstring(strips("a & b", {"one": {"kill": of_cell(cell())}}, TITLES))
    dots = [each for each in drawn.iter() if each.get("class") == "dot"]
    median = next(each for each in drawn.iter() if each.get("class") == "median")
    assert len(dots) == 2 and {each.get("cx") for each in dots} == {median.get("cx")}
    grid = {each.text: float(each.attrib["x"]) for each in drawn.iter() if each.get("class") == "small"}
    assert grid["10"] < float(median.attrib["cx"]) < grid["100"]


def test_rows_are_read_while_they_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rows.jsonl"
    recorded = Recording(path)
    assert recorded.follow() == []
    path.write_text('[1, 0, 1, "a"]\n[2, 1,')
    assert recorded.follow() == [Row(1, 0, 1, "a")]
    with path.open("a") as file:
        file.write(' 2, "a"]\n')
    assert recorded.follow() == [Row(1, 0, 1, "a"), Row(2, 1, 2, "a")]
    recorded.until(lambda rows: rows[-1].number == 2, "it is there")
    monkeypatch.setattr("benchmarks.swap.streams.PATIENCE", 0.0)
    with pytest.raises(SwapFailed, match="no third row within 0 s"):
        recorded.until(lambda rows: len(rows) == 3, "no third row")


def program(out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "benchmarks" / "swap"), "--out", str(out), *words]
    env = {**os.environ, "ROS_DOMAIN_ID": "98"}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.ros2
@pytest.mark.long
def test_a_way_is_measured_once_and_reported(tmp_path: Path) -> None:
    asked = ("--ways", "kill", "none", "--rates", "50", "--sizes", "100", "--loads", "idle", "--swaps", "2")
    listed = program(tmp_path, *asked, "--list")
    assert listed.stdout.startswith("2 cells, 2 of them to measure, about 1 minutes\n")
    assert [*tmp_path.iterdir()] == []
    none = program(tmp_path, *asked, "--minutes", "0")
    assert (none.returncode, none.stderr) == (0, "")
    assert "2 cells were not begun" in none.stdout
    done = program(tmp_path, *asked)
    assert (done.returncode, done.stderr) == (0, "")
    found = {each.cell.way: of_cell(each) for each in report.read(tmp_path)}
    assert {name: len(each.gaps) for name, each in found.items()} == {"kill": 2, "none": 2}
    assert found["kill"].missing_swaps == 2 and min(found["kill"].gaps) > 3
    assert found["none"].counts["twice"] == found["none"].counts["overlapping"] == 0
    again = program(tmp_path, *asked)
    assert again.stdout.startswith("2 cells, 0 of them to measure")
    assert "| kill one, start the other | 2 |" in again.stdout

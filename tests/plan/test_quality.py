"""The benchmark of what the strategies disrupt, on a few changes."""

from __future__ import annotations

from benchmarks.quality import Case, examples, is_least, measured, robots, summary, table
from midstride.plan.strategies.registry import STRATEGIES
from tests.plan.test_core import two_resources


def test_the_table_has_a_line_for_each_group() -> None:
    cases = [*list(examples())[:2], *robots(8)]
    rows = [measured(case) for case in cases]
    assert all(is_least(row) and row["proved"] for row in rows)
    lines = summary(rows)
    _, *shown = table(lines)
    assert [line["changes"] for line in lines] == [1, 1, 4, 4]
    assert lines[-1]["paper"] > lines[-1]["minimal"] == lines[-1]["bound"]
    assert all(text.startswith(line["group"]) for text, line in zip(shown, lines, strict=True))


def test_a_worse_plan_of_minimal_would_show() -> None:
    row = measured(Case("a and b", *two_resources()))
    assert is_least(row)
    assert (row["proved"], row["checked"], row["bound"]) == (True, "holds", row["minimal"])
    assert row["minimal"] > 0.0
    for name in set(STRATEGIES) - {"minimal"}:
        assert not is_least(row | {name: 0.0})

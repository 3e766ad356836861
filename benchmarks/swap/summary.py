"""The figures of a cell with their intervals, and as tables."""

from __future__ import annotations

import csv
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO

from .cells import Condition
from .intervals import bootstrap, clopper_pearson
from .judging import Figures
from .measure import Measured

COUNTS = ("missed", "lost", "twice", "overlapping", "reordered")


@dataclass(frozen=True)
class Summary:
    """All swaps of a cell: gaps in periods, their median with its interval, and how many swaps miss a message.

    ``share``: the interval of the probability that a swap misses one. ``counts``: the sum of each of COUNTS.
    ``taken_back``: how many swaps replaced nothing.
    """

    gaps: tuple[float, ...]
    median: float
    interval: tuple[float, float]
    missing_swaps: int
    share: tuple[float, float]
    counts: Mapping[str, int]
    taken_back: int


def summary(figures: Sequence[Figures], period: float, taken_back: int = 0, seed: int = 0) -> Summary:
    """The summary of the figures of some swaps. Needs one."""
    gaps = tuple(each.gap / period for each in figures)
    missing = sum(each.missed > 0 for each in figures)
    return Summary(
        gaps,
        statistics.median(gaps),
        bootstrap(gaps, seed=seed),
        missing,
        clopper_pearson(missing, len(figures)),
        {name: sum(getattr(each, name) for each in figures) for name in COUNTS},
        taken_back,
    )


def of_cell(measured: Measured) -> Summary:
    """The summary of a cell."""
    back = sum(each.taken_back is not None for each in measured.windows)
    return summary(measured.figures(), measured.cell.condition.stream.period, back)


HEADER = (
    "| way | swaps | gap in periods, median [95 %] | longest | swaps that miss a message [95 %] "
    "| missed | lost | twice | overlapping | reordered | taken back |\n" + "|---" * 11 + "|\n"
)


def table(cells: Iterable[Measured], titles: Mapping[str, str]) -> str:
    """A table in Markdown of cells of one condition, least gap first; ``titles``: what each way is called."""
    rows = sorted(((of_cell(each), each) for each in cells), key=lambda pair: pair[0].median)
    return HEADER + "".join(_line(titles.get(each.cell.way, each.cell.way), found) for found, each in rows)


def _line(title: str, found: Summary) -> str:
    swaps, (low, high), (least, most) = len(found.gaps), found.interval, found.share
    cells = [
        title,
        str(swaps),
        f"{found.median:.3g} [{low:.3g}, {high:.3g}]",
        f"{max(found.gaps):.3g}",
        f"{100 * found.missing_swaps / swaps:.0f} % [{100 * least:.0f}, {100 * most:.0f}]",
        *(str(found.counts[name]) for name in COUNTS),
        str(found.taken_back),
    ]
    return f"| {' | '.join(cells)} |\n"


def said_load(cells: Sequence[Measured]) -> str:
    """Under which load the cells were measured, in a sentence."""
    busy = {int(each.about["busy_processes"]) for each in cells}
    averages = [value for each in cells for value in each.about["load_average"]]
    idle = [each.about["idle_share"] for each in cells]
    of_the_program = "none" if busy == {0} else " or ".join(map(str, sorted(busy)))
    return (
        f"Processes that only compute, started for this: {of_the_program}. Load average {min(averages):.1f} to "
        f"{max(averages):.1f}; processors idle for {100 * min(idle):.0f} to {100 * max(idle):.0f} % of the time."
    )


def as_csv(cells: Iterable[Measured]) -> str:
    """A line for each swap of each cell."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("way", "rate_hz", "size", "load", "swap", "gap_periods", *COUNTS, "taken_back"))
    for each in cells:
        condition = each.cell.condition
        for number, (window, found) in enumerate(zip(each.windows, each.figures(), strict=True), 1):
            gap = round(found.gap / condition.stream.period, 4)
            where = (each.cell.way, condition.stream.rate, condition.stream.size, condition.load, number)
            counts = (getattr(found, name) for name in COUNTS)
            writer.writerow((*where, gap, *counts, window.taken_back or ""))
    return text.getvalue()


def by_condition(cells: Iterable[Measured]) -> dict[Condition, list[Measured]]:
    """The cells of each condition."""
    found: dict[Condition, list[Measured]] = {}
    for each in cells:
        found.setdefault(each.cell.condition, []).append(each)
    return found

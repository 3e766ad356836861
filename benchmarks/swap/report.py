"""What has been measured: tables on the screen or in a page, plots, and a line for each swap in swaps.csv."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from .cells import LOADS, RATES, SIZES, Condition, size_in_words
from .measure import Measured
from .pictures import strips
from .streams import Stream
from .summary import Summary, as_csv, by_condition, of_cell, said_load, table
from .ways import Way

# Between these lines of a page the figures stand.
BEGIN, END = "<!-- figures: written by `python benchmarks/swap --page` -->", "<!-- end of the figures -->"


def read(folder: Path) -> list[Measured]:
    """All that has been measured in a folder. Raises SystemExit for a file that cannot be read."""
    found = []
    for path in sorted(folder.glob("*.jsonl")):
        try:
            found.append(Measured.read(path))
        except (KeyError, TypeError, ValueError) as error:
            raise SystemExit(f"{path} is not a file of this program: {error!r}; move it away") from error
    return found


def write(folder: Path, ways: Sequence[Way], pictures: Path | None = None, page: Path | None = None) -> None:
    """Report what the folder has; plots and swaps.csv go there and to ``pictures``, the tables to the screen.

    ``page`` gets the plots and the table of the base condition.
    """
    measured = read(folder)
    if not measured:
        print(f"nothing has been measured in {folder}")
        return
    titles = {way.name: way.title for way in ways}
    print(tables(measured, titles))
    drawn = plots(measured, titles)
    for place in filter(None, (folder, pictures)):
        (place / "swaps.csv").write_text(as_csv(measured), encoding="utf-8")
        for name, (_, plot) in drawn.items():
            (place / name).write_text(plot, encoding="utf-8")
    if page is not None:
        where = os.path.relpath(pictures or folder, page.parent)
        images = [f"![{title}]({where}/{name})" for name, (title, _) in drawn.items()]
        base = min(by_condition(measured), key=_place)
        shown = tables([each for each in measured if each.cell.condition == base], titles)
        every = f"Each swap of all conditions is a line of [swaps.csv]({where}/swaps.csv).\n"
        put("\n\n".join([*images, shown.rstrip(), every]), page)


def tables(measured: Sequence[Measured], titles: Mapping[str, str]) -> str:
    """For each condition, a headline, under which load it was measured, and a table."""
    parts = [said_machine(measured)]
    groups = by_condition(measured)
    for condition in sorted(groups, key=_place):
        cells = groups[condition]
        parts += [f"### {condition}", said_load(cells), table(cells, titles).rstrip()]
    return "\n\n".join(parts) + "\n"


def said_machine(measured: Sequence[Measured]) -> str:
    """The machines and versions of the cells, and when they were measured."""
    lines = []
    for machine in {str(each.about["machine"]): each.about["machine"] for each in measured}.values():
        own = [each.about["started"] for each in measured if each.about["machine"] == machine]
        cells = f"{len(own)} cell{'s' if len(own) > 1 else ''}"
        ros = ", ".join(str(value) for value in machine["ros"].values() if value)
        hardware = f"{machine['processors']} processors ({machine['processor']}), {machine['memory_gib']} GiB"
        software = f"Linux {machine['kernel']}, Python {machine['python']}, Midstride {machine['midstride']}"
        days = f"{min(own)[:10]} to {max(own)[:10]}"
        lines.append(f"{cells}, {days}: {hardware}, {software} ({machine['commit']}), {ros}.")
    return "\n".join(lines)


def plots(measured: Sequence[Measured], titles: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Title and plot by the name of its file: of the rates, and of sizes and loads where there are several."""
    groups = by_condition(measured)
    rates, sizes, loads = _seen(groups)
    rate, size, load = (50.0 if 50.0 in rates else rates[0]), sizes[0], loads[0]
    wanted = {
        "swap-rates.svg": (
            f"Gap of a replacement by rate: {size_in_words(size)}, {load}",
            {f"{each:g} Hz": Condition(Stream(each, size), load) for each in rates},
        ),
        "swap-sizes.svg": (
            f"Gap of a replacement by size: {rate:g} Hz, {load}",
            {size_in_words(each): Condition(Stream(rate, each), load) for each in sizes},
        ),
        "swap-loads.svg": (
            f"Gap of a replacement by load: {rate:g} Hz, {size_in_words(size)}",
            {each: Condition(Stream(rate, size), each) for each in loads},
        ),
    }
    found: dict[str, tuple[str, str]] = {}
    for name, (title, conditions) in wanted.items():
        columns: dict[str, dict[str, Summary]] = {
            column: {each.cell.way: of_cell(each) for each in groups[condition]}
            for column, condition in conditions.items()
            if condition in groups
        }
        if len(columns) > 1 or (columns and not found):
            found[name] = title, strips(title, columns, titles)
    return found


def _seen(groups: Mapping[Condition, object]) -> tuple[list[float], list[int], list[str]]:
    return (
        sorted({each.stream.rate for each in groups}),
        sorted({each.stream.size for each in groups}),
        sorted({each.load for each in groups}, key=LOADS.index),
    )


def _place(condition: Condition) -> tuple[bool, bool, bool, int, float, int]:
    """The order of conditions on a page: the base first, then rates, sizes and loads."""
    stream, load = condition.stream, LOADS.index(condition.load)
    return load > 0, stream.size != SIZES[0], stream.rate != RATES[1], stream.size, stream.rate, load


def put(text: str, page: Path) -> None:
    """Replace what stands between BEGIN and END in a page. Raises SystemExit where it has no such lines."""
    whole = page.read_text(encoding="utf-8")
    before, found, rest = whole.partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (found and closed):
        raise SystemExit(f"{page} has no lines {BEGIN} and {END}: add both, and the tables will be between them")
    page.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{after}", encoding="utf-8")

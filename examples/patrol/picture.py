"""The hall as a picture of characters, and what a run came to as a table: for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import hall
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

# Metres per character.
ACROSS, UP = 0.5, 1.0
ARROWS = "→↗↑↖←↙↓↘"
STYLES = {"full": "green", "slow": "yellow", "creep": "dark_orange", "stop": "red"}


def hall_map(state: Mapping[str, Any], mode: str) -> Text:
    """The hall from above: the robot as an arrow in the colour of its mode, people as ``o``."""
    columns, rows = round(hall.OUTER[2] / ACROSS), round(hall.OUTER[3] / UP)
    cells = [["·" if row % 2 and column % 4 == 2 else " " for column in range(columns)] for row in range(rows)]
    for row in range(rows):
        for column in range(columns):
            if hall.is_wall((column + 0.5) * ACROSS, (row + 0.5) * UP):
                cells[row][column] = "▒"
    for x, y in state["people"]:
        cells[_at(y, UP, rows)][_at(x, ACROSS, columns)] = "o"
    text = Text("┌" + "─" * columns + "┐\n", "dim")
    robot = _at(state["y"], UP, rows), _at(state["x"], ACROSS, columns)
    for row in reversed(range(rows)):
        text.append("│", "dim")
        for column in range(columns):
            if (row, column) == robot:
                text.append(ARROWS[round(state["heading"] / (math.pi / 4)) % 8], f"bold {STYLES.get(mode, 'white')}")
            else:
                text.append(cells[row][column], "magenta" if cells[row][column] == "o" else "dim")
        text.append("│\n", "dim")
    return text.append("└" + "─" * columns + "┘", "dim")


def panel(state: Mapping[str, Any] | None, modes: Mapping[str, str], words: str) -> RenderableType:
    """What is shown while the robot runs."""
    if state is None:
        return Text(words)
    mode = modes.get("controller.drive", "full")
    line = Text.assemble(("controller ", "dim"), (f"{mode:<6}", STYLES.get(mode, "white")))
    line.append(f"  {state['speed']:.1f} m/s  {state['progress']:6.1f} m along the route", "dim")
    line.append(f"  collisions {state['collisions']}", "red" if state["collisions"] else "dim")
    others = ", ".join(f"{name} {mode}" for name, mode in modes.items() if name != "controller.drive")
    return Group(
        Text(words, "bold"), hall_map(state, mode), line, Text(f"degraded: {others}" if others else "", "yellow")
    )


def result(rows: Sequence[Mapping[str, Any]]) -> Table:
    """What was seen during each event."""
    table = Table(box=None, header_style="bold")
    with_bag = any("bag" in row for row in rows)
    from_bag = ("commands missed", "interleaved", "moved blind") if with_bag else ()
    for column in (
        "event",
        "came to",
        "slowest mode",
        "degraded for",
        "missed",
        "no commands",
        "near misses",
        "collisions",
        *from_bag,
    ):
        table.add_column(column)
    for row in rows:
        mode = str(row["slowest"])
        table.add_row(
            str(row["name"]),
            str(row["came_to"]),
            Text(mode, STYLES.get(mode, "white")),
            f"{row['degraded']:.1f} s",
            "–" if row["missed"] is None else str(row["missed"]),
            f"{row['uncommanded']:.1f} s",
            str(row["near_misses"]),
            str(row["collisions"]),
            *_from_bag(row, with_bag),
        )
    return table


def _from_bag(row: Mapping[str, Any], shown: bool) -> Sequence[str]:
    if not shown:
        return ()
    found = row["bag"]
    return str(found["lost"]), str(found["interleaved"]), f"{found['moved_blind']:.1f} s"


def _at(metres: float, scale: float, most: int) -> int:
    return max(0, min(most - 1, int(metres / scale)))

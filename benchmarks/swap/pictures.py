"""Plots of the gaps, as SVG: a row for each way, a column for each condition, a dot for each swap."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from html import escape

from .summary import Summary

LEFT, TOP, ROW, BOTTOM, RIGHT = 350, 58, 26, 44, 16
_STYLE = (
    'text { font: 13px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: #1f2328; } '
    ".small { font-size: 11px; fill: #59636e; } .grid { stroke: #d1d9e0; } .dot { fill: #2f6fb5; fill-opacity: 0.45; } "
    ".interval { stroke: #c0392b; stroke-width: 2; } .median { fill: #c0392b; }"
)


def strips(title: str, columns: Mapping[str, Mapping[str, Summary]], titles: Mapping[str, str]) -> str:
    """A plot of the gaps, in periods on a logarithmic axis, which all columns share.

    ``columns``: what each is called, with the summary of each way; ``titles``: what each way is called, in the order of
    the rows. A dot is a swap; the red line is the interval of the median, with the median on it.
    """
    ways = [way for way in titles if any(way in column for column in columns.values())]
    gaps = [gap for column in columns.values() for found in column.values() for gap in found.gaps]
    if not gaps:
        raise ValueError(f"{title}: nothing has been measured")
    low, high = math.floor(math.log10(min(gaps)) * 2) / 2, math.ceil(math.log10(max(gaps)) * 2) / 2
    high = max(high, low + 1)
    wide = max(150, 520 // len(columns))
    width, height = LEFT + len(columns) * (wide + RIGHT), TOP + len(ways) * ROW + BOTTOM
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">',
        f"<title>{escape(title)}</title>",
        f"<style>{_STYLE}</style>",
        f'<rect width="{width}" height="{height}" rx="8" fill="#ffffff"/>',
        f'<text x="16" y="22">{escape(title)}</text>',
    ]
    bottom = TOP + len(ways) * ROW
    for row, way in enumerate(ways):
        name = escape(titles[way].replace("`", ""))
        lines.append(f'<text x="16" y="{TOP + ROW * row + 17}">{name}</text>')
    for place, (name, column) in enumerate(columns.items()):
        left = LEFT + place * (wide + RIGHT)

        def x(value: float, left: int = left) -> float:
            return round(left + (math.log10(value) - low) / (high - low) * wide, 1)

        lines.append(f'<text x="{left}" y="{TOP - 12}">{escape(name)}</text>')
        for power in range(math.ceil(low), math.floor(high) + 1):
            at = x(10.0**power)
            lines.append(f'<line class="grid" x1="{at}" x2="{at}" y1="{TOP}" y2="{bottom}"/>')
            lines.append(f'<text class="small" x="{at}" y="{bottom + 15}" text-anchor="middle">{10.0**power:g}</text>')
        for row, way in enumerate(ways):
            if way in column:
                lines += _strip(column[way], TOP + ROW * row + ROW / 2, x)
    lines.append(f'<text class="small" x="{LEFT}" y="{bottom + 34}">longest gap of a swap, in periods</text>')
    return "\n".join([*lines, "</svg>", ""])


def _strip(found: Summary, y: float, x: Callable[[float], float]) -> Sequence[str]:
    dots = [f'<circle class="dot" cx="{x(gap)}" cy="{y}" r="3.5"/>' for gap in found.gaps]
    low, high = found.interval
    return [
        *dots,
        f'<line class="interval" x1="{x(low)}" x2="{x(high)}" y1="{y}" y2="{y}"/>',
        f'<circle class="median" cx="{x(found.median)}" cy="{y}" r="3"/>',
    ]

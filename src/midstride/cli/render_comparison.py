"""Plans of several strategies side by side, for people: what each costs, and what degrades when, on one time axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from midstride.cli.render import planned_seconds, seconds, table
from midstride.codec.form import Document

# How many characters the longest plan takes.
WIDTH: Final = 60
# They differ without colour as well.
AT_LEVEL, DEGRADED, UNSERVED = "─", "▒", "█"
LEGEND: Final = (
    f"one step after another: {AT_LEVEL} at its level or above   {DEGRADED} degraded   {UNSERVED} no instance serves it"
)


@dataclass(frozen=True, slots=True)
class Stretch:
    """When a functionality is below its level (s since the plan began), and from when on no instance serves it."""

    begin: float
    end: float
    unserved: float | None


def comparison(documents: Mapping[str, Document], title: str) -> RenderableType:
    """A row for each strategy and, for each functionality that degrades in any of them, its time axes."""
    rows = table(["strategy"], ["disruption", "degrade", "takes about", "critical path", "steps"])
    for strategy, document in documents.items():
        if "refused" in document:
            rows.add_row(strategy, Text("refused", style="red"), *[""] * 4)
        else:
            rows.add_row(strategy, *_figures(document))
    refused = [
        Text(f"{strategy}: {document['refused']}", style="red")
        for strategy, document in documents.items()
        if "refused" in document
    ]
    plans = {strategy: document for strategy, document in documents.items() if document.get("steps")}
    return Group(Text(title, style="bold"), rows, *refused, *_axes(plans))


def _figures(document: Document) -> Iterable[str]:
    bound = " (minimal)" if document["proved_minimal"] else ""
    yield f"{document['disruption']:.3g}{bound}"
    yield str(len(document["degraded"]))
    yield seconds(planned_seconds(document))
    yield seconds(document["makespan"])
    yield str(len(document["steps"]))


def _axes(plans: Mapping[str, Document]) -> Iterable[RenderableType]:
    names = sorted({fall["functionality"] for document in plans.values() for fall in document["degradations"]})
    if not names:
        yield Text("Nothing degrades with any of them.", style="green")
        return
    longest = max(document["seconds"] for document in plans.values())
    scale = WIDTH / longest if longest else 0.0
    width = max(map(len, plans))
    yield Text()
    yield Text(f"{'':{width + 2}}0 s{seconds(longest):>{WIDTH - 3}}", style="dim")
    for name in names:
        yield Text(name)
        for strategy, document in plans.items():
            yield Text(f"  {strategy:{width}}").append(_bar(stretches(document, name), document["seconds"], scale))
    yield Text(LEGEND, style="dim")


def stretches(document: Document, functionality: str) -> list[Stretch]:
    """When a functionality is below its level, if the steps run one after another."""
    begins: list[float] = [0.0, *accumulate(step["seconds"] for step in document["steps"])]

    def begin(step: int) -> float:
        return begins[max(step - 1, 0)]

    return [
        Stretch(
            begin(fall["from_step"]),
            begins[-1] if fall["to_step"] is None else begins[fall["to_step"]],
            None if fall["unserved_from_step"] is None else begin(fall["unserved_from_step"]),
        )
        for fall in document["degradations"]
        if fall["functionality"] == functionality
    ]


def _bar(found: Iterable[Stretch], total: float, scale: float) -> Text:
    """One character for each part of the plan; a stretch has at least one, so that none is hidden."""
    bar = [AT_LEVEL] * max(round(total * scale), 1)
    for stretch in found:
        first = min(int(stretch.begin * scale), len(bar) - 1)
        last = max(first + 1, round(stretch.end * scale))
        for place in range(first, min(last, len(bar))):
            gone = stretch.unserved is not None and place >= int(stretch.unserved * scale)
            bar[place] = UNSERVED if gone else DEGRADED
    text = Text(" ")
    for mark in bar:
        text.append(mark, style={DEGRADED: "yellow", UNSERVED: "red"}.get(mark, "dim"))
    return text

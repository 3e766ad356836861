"""Plans of several strategies side by side, for people: what each costs, and what degrades when, on one time axis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import accumulate
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from midstride.cli.render import planned_seconds, seconds, table
from midstride.plan.forms.plan_forms import PlanForm

# How many characters the longest plan takes.
WIDTH: Final = 60
# They differ without colour as well.
AT_LEVEL, DEGRADED, UNSERVED = "─", "▒", "█"
LEGEND: Final = (
    f"one step after another: {AT_LEVEL} at its level or above   {DEGRADED} degraded   {UNSERVED} no instance serves it"
)


def comparison(found: Mapping[str, PlanForm | str], title: str) -> RenderableType:
    """A row for each strategy and, for each functionality that degrades in any of them, its time axes.

    ``found``: the plan of each strategy, or why it is refused.
    """
    rows = table(["strategy"], ["disruption", "degrade", "takes about", "critical path", "steps"])
    for strategy, plan in found.items():
        if isinstance(plan, str):
            rows.add_row(strategy, Text("refused", style="red"), *[""] * 4)
        else:
            bound = " (minimal)" if plan.proved_minimal else ""
            times = map(seconds, (planned_seconds(plan), plan.makespan))
            disruption = f"{plan.disruption:.3g}{bound}"
            rows.add_row(strategy, disruption, str(len(plan.degraded)), *times, str(len(plan.steps)))
    refused = [Text(f"{strategy}: {why}", style="red") for strategy, why in found.items() if isinstance(why, str)]
    plans = {strategy: plan for strategy, plan in found.items() if not isinstance(plan, str) and plan.steps}
    return Group(Text(title, style="bold"), rows, *refused, *_axes(plans))


def _axes(plans: Mapping[str, PlanForm]) -> Iterable[RenderableType]:
    names = sorted({fall.functionality for plan in plans.values() for fall in plan.degradations})
    if not names:
        yield Text("Nothing degrades with any of them.", style="green")
        return
    longest = max(plan.seconds for plan in plans.values())
    scale = WIDTH / longest if longest else 0.0
    width = max(map(len, plans))
    yield Text()
    yield Text(f"{'':{width + 2}}0 s{seconds(longest):>{WIDTH - 3}}", style="dim")
    for name in names:
        yield Text(name)
        for strategy, plan in plans.items():
            yield Text(f"  {strategy:{width}}").append(_bar(plan, name, scale))
    yield Text(LEGEND, style="dim")


def _bar(plan: PlanForm, functionality: str, scale: float) -> Text:
    """One character for each part of the plan, if its steps run one after another.

    Each time for which the functionality is below its level has at least one character, so that none is hidden.
    """
    begins: list[float] = [0.0, *accumulate(step.seconds for step in plan.steps)]
    bar = [AT_LEVEL] * max(round(plan.seconds * scale), 1)
    for fall in plan.degradations:
        if fall.functionality == functionality:
            end = begins[-1] if fall.until is None else begins[fall.until]
            first = min(int(begins[max(fall.since - 1, 0)] * scale), len(bar) - 1)
            last = max(first + 1, round(end * scale))
            for place in range(first, min(last, len(bar))):
                gone = fall.unserved is not None and place >= int(begins[max(fall.unserved - 1, 0)] * scale)
                bar[place] = UNSERVED if gone else DEGRADED
    text = Text(" ")
    for mark in bar:
        text.append(mark, style={DEGRADED: "yellow", UNSERVED: "red"}.get(mark, "dim"))
    return text

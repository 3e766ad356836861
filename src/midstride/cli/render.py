"""Plans, outcomes, history and events for people: Rich tables and text, from the forms of the API."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from midstride.cli.console import PrintableTable
from midstride.codec.parameter import from_json
from midstride.model import wording
from midstride.model.instance_names import is_named_after
from midstride.verdicts import assessment

if TYPE_CHECKING:  # most commands show none of them
    from msgspec import UnsetType

    from midstride.plan.alternatives import Alternative
    from midstride.plan.explain import Degradation, LevelShift
    from midstride.plan.forms.plan_forms import PlanForm, PlanPreview
    from midstride.plan.forms.step_forms import AnyStep
    from midstride.runtime.records.change_history import ChangeRecord, History
    from midstride.runtime.records.measure import SwapReport
    from midstride.runtime.records.reports import DegradedFunctionality, Event, Outcome
    from midstride.verdicts.assessment import Assessments

    AnyPlan: TypeAlias = PlanForm | PlanPreview

UNKNOWN: Final = "unknown"
_COUNTS: Final = ("missed", "lost", "duplicates")
# Measured durations that differ by less (s) are shown as one.
SPREAD: Final = 0.1
MEASUREMENTS: Final = ("longest gap", "in periods", *_COUNTS)
_STYLES: Final = {
    "step_failed": "red",
    "up_failed": "red",
    "exited": "red",
    "silence": "red",
    "silence_ended": "yellow",
    "host": "yellow",
    "fenced": "red",
    "killed": "red",
    "degraded": "yellow",
    "rollback": "yellow",
    "restore": "yellow",
    "restore_ended": "red",
    "respawn": "yellow",
    "respawn_ended": "red",
    "lock": "yellow",
    "unlock": "yellow",
    "forbidden": "red",
    "override": "red",
    "finished_despite": "red",
    "half_done": "yellow",
}


def table(left: Iterable[str], right: Iterable[str] = ()) -> Table:
    """An empty table with these columns, the last ones aligned to the right."""
    made = PrintableTable(box=None, pad_edge=False, header_style="dim")
    for name in left:
        made.add_column(name)
    for name in right:
        made.add_column(name, justify="right")
    return made


def seconds(value: float | None) -> str:
    """A duration with three significant digits or so."""
    return UNKNOWN if value is None else assessment.seconds_in_words(value)


def hertz(rate: float | None) -> str:
    """A rate with three significant digits."""
    return UNKNOWN if rate is None else f"{rate:.3g} Hz"


def step_text(step: AnyStep) -> str:
    """One step of a plan in a few words."""
    from midstride.plan.forms import step_forms as forms

    match step:
        case forms.CreateStep():
            return wording.existence("create", step.instance, step.component, step.host or "")
        case forms.RemoveStep():
            return wording.existence("remove", step.instance, "")
        case forms.AttachStep() | forms.DetachStep():
            return wording.attachment(step.action, step.port, step.topic)
        case forms.DegradeStep() | forms.UpgradeStep():
            return wording.mode_changes(step.action, ((name, m.before, m.after) for name, m in step.modes.items()))
        case forms.HandoverStep():
            return wording.handover((swap.topic, swap.old, swap.new) for swap in step.swaps)
        case forms.SetStep():
            return wording.parameters(
                step.instance, {name: from_json(value) for name, value in step.parameters.items()}
            )


def plan(plan: AnyPlan, title: str) -> RenderableType:
    """The steps, the functionalities that degrade, how far and for how long, and the cost."""
    remarks = [Text(remark, style="yellow") for remark in plan.remarks or ()]
    if not plan.steps:
        return Group(Text(title, style="bold"), Text("Nothing to do: the system already matches the target."), *remarks)
    steps = table(["#", "step"], ["takes about"])
    steps.columns[0].justify = "right"
    for number, step in enumerate(plan.steps, 1):
        steps.add_row(Text(str(number), style="dim"), Text(step_text(step)), _about(step))
    if forbidden := getattr(plan, "forbidden", None):
        remarks.insert(0, Text(f"It may not be carried out now: {forbidden}", style="red"))
    parts = [*remarks, Text.from_markup(falls(plan)), *_runtime_values(plan)]
    parts += _requirements(plan)
    for name, because in (plan.own_state or {}).items():
        parts.append(Text(f"{name} starts with its own state: {because}.", style="yellow"))
    parts.append(Text(cost(plan), style="dim"))
    return Group(Text(title, style="bold"), steps, *parts)


def _requirements(plan: AnyPlan) -> Iterable[Text]:
    """Yield what changes require of the specification that runs, and whether it holds now."""
    if (judged := getattr(plan, "requires", None)) is not None:
        for each in judged or ():
            yield Text(f"Required: {each.words}.", style="default" if each.holds else "red")
        return
    if (start := getattr(plan, "start", None)) is not None:
        for form in start.changes_require:
            yield Text(f"Required when it is carried out: {form.requirement()}.")


def _about(step: AnyStep) -> str:
    """The time that a step takes, with the shortest and the longest that was measured where they differ much."""
    return _with_remarks(step.seconds, _spread(step.between))


def _spread(between: tuple[float, float] | UnsetType) -> list[str]:
    shortest, longest = between or (0.0, 0.0)
    return [] if longest - shortest < SPREAD else [f"{seconds(shortest)} to {seconds(longest)}"]


def _with_remarks(planned: float | None, remarks: list[str]) -> str:
    return seconds(planned) + (f" ({'; '.join(remarks)})" if remarks else "")


def planned_seconds(plan: AnyPlan) -> float:
    """The time that a plan takes as it is carried out (s)."""
    return plan.duration or plan.seconds


def _about_plan(plan: AnyPlan) -> str:
    """The time that a plan takes as it is carried out, with its range; and the sum of its steps where they overlap."""
    planned, total = planned_seconds(plan), plan.seconds
    in_sequence = [] if seconds(planned) == seconds(total) else [f"{seconds(total)} one step after another"]
    return _with_remarks(planned, [*_spread(plan.between), *in_sequence])


def _runtime_values(found: AnyPlan | Outcome) -> Iterable[Text]:
    """The fates of parameter values that were set at run time."""
    for value in found.parameters or ():
        yield Text(value.words, style="default" if value.fate in ("kept", "set") else "yellow")


def falls(plan: AnyPlan) -> str:
    """Say what degrades on the way, how far, for how long and why; and what is lower or higher afterwards."""
    lines = [_fall(plan, fall) for fall in plan.degradations]
    lower = _lower_afterwards(plan)
    higher = [shift for shift in plan.level_shifts if shift.levels <= 0]
    lines += _expected(plan)
    lines += [f"[yellow]Afterwards:[/yellow] {escape(_lowered(shift))}." for shift in lower]
    for shift in higher:
        levels = f"from {shift.before or 'unserved'} to {shift.after or 'unserved'}"
        lines.append(f"[green]Improves:[/green] {escape(f'{shift.functionality}, {levels}')}")
    return "\n".join(lines)


def _expected(plan: AnyPlan) -> Iterator[str]:
    """Yield what a plan keeps, and what it loses beside what degrades, which other lines have."""
    if not (found := plan.continuity):
        return
    if found.verdict != "lost":
        head, colon, rest = found.headline.partition(":" if found.verdict == "kept" else ".")
        yield f"[{'green' if found.verdict == 'kept' else 'yellow'}]{escape(head + colon)}[/]{escape(rest)}"
        return
    shown = {each.functionality for each in plan.degradations} | {each.functionality for each in plan.level_shifts}
    for each in found.found:
        if each.subject not in shown:
            kind = "Lost" if each.verdict == "lost" else "Not measurable here"
            yield f"[yellow]{kind}:[/yellow] {escape(each.words)}."


def _fall(plan: AnyPlan, fall: Degradation) -> str:
    """The degradation of a functionality, for how long and why; or how long it remains if it is degraded already."""
    name, since, until, unserved = fall.functionality, fall.since, fall.until, fall.unserved
    if since == 0:
        mark, reasons = "Degraded already:", []
        where = "throughout" if until is None else f"until step {until}"
        where += f", unserved from step {unserved} on" if unserved else ""
        head = f"{name} for about {seconds(fall.seconds)} more ({where})"
    else:
        mark, reasons = "Degrades:", [fall.because]
        where = f"steps {since} to {until}" if until is not None else f"from step {since} on"
        mode = _mode_entered(plan.steps[since - 1], name)
        depth = f" to {mode}" if mode else ""
        if mode and unserved is not None:
            depth += f", unserved from step {unserved} on,"
        head = f"{name}{depth} for about {seconds(fall.seconds)} ({where})"
    found: Sequence[Alternative] = getattr(plan, "alternatives", None) or ()
    instead = [_alternative(each) for each in found if each.functionality == name]
    lines = "\n  ".join([head, *reasons, *fall.forced_by, *instead])
    return f"[yellow]{mark}[/yellow] {escape(lines)}"


def _alternative(alternative: Alternative) -> str:
    """The cost of keeping a functionality."""
    mode = alternative.kept_at
    if alternative.impossible is not None:
        return f"It cannot be kept at {mode}: {alternative.impossible}"
    instead = assessment.listed(alternative.degraded) if alternative.degraded else "nothing"
    cost = f"the disruption would be {alternative.disruption:.3g}"
    return f"To keep it at {mode}, {cost}: {instead} would degrade instead"


def _mode_entered(step: AnyStep, functionality: str) -> str | None:
    """The mode that a role's functionality enters in a step; None if the step does not change it."""
    role, _, name = functionality.rpartition(".")
    for ref, modes in getattr(step, "modes", {}).items():
        instance, _, functionality_name = ref.rpartition(".")
        if functionality_name == name and is_named_after(instance, role):
            return str(modes.after)
    return None


def _lower_afterwards(plan: AnyPlan) -> list[LevelShift]:
    """The functionalities that the plan lowers for good."""
    return [shift for shift in plan.level_shifts if shift.levels > 0]


def _lowered(shift: LevelShift | DegradedFunctionality) -> str:
    return wording.lowered(shift.functionality, shift.after, shift.before)


def cost(plan: AnyPlan) -> str:
    """The cost of a plan, and whether its disruption is proved minimal."""
    bound = "proved minimal" if plan.proved_minimal else f"at least {plan.lower_bound:.3g}"
    if plan.proof_space == "detours":
        bound += ", with detours"
    disruption = f"Disruption {plan.disruption:.3g} weighted functionality-seconds"
    # It counts what happens on the way: what is lost for good does not show in it.
    if lower := _lower_afterwards(plan):
        disruption += f" on the way ({bound}), and afterwards {', '.join(map(_lowered, lower))}"
    else:
        disruption += f" ({bound})"
    return f"{disruption}; takes about {_about_plan(plan)}; strategy {plan.strategy}."


def measurements(swap: SwapReport) -> list[RenderableType]:
    """The figures of one subscriber, in the order of ``MEASUREMENTS``; unknown values are marked."""
    periods = swap.gap_periods
    counts = [_count(getattr(swap, name)) for name in _COUNTS]
    return [seconds(swap.gap), UNKNOWN if periods is None else f"{periods:.2f}", *counts]


def _count(count: int | None) -> Text:
    if count is None:
        return Text(UNKNOWN, style="dim")
    return Text(str(count), style="green" if count == 0 else "yellow")


def outcome(outcome: Outcome) -> RenderableType:
    """The outcome of a change: how it ended, what degraded and what was measured."""
    kind, because = outcome.outcome, outcome.because
    headline = {
        "done": f"[green]Done[/green] in {seconds(outcome.seconds)}",
        "refused": "[red]Refused[/red], nothing was changed",
        "incomplete": f"[yellow]In part[/yellow], in {seconds(outcome.seconds)}",
        "rolled_back": f"[red]Rolled back[/red] in {seconds(outcome.seconds)}, every step undone",
        "failed": f"[red bold]Failed[/red bold] in {seconds(outcome.seconds)}",
    }[kind]
    lines: list[RenderableType] = [Text.from_markup(headline + (f": {escape(str(because))}" if because else "."))]
    if kind != "refused":
        skews = (
            f"{skew.kind.capitalize()} of {assessment.listed(skew.functionalities)}: "
            f"within {skew.seconds * 1000:.1f} ms."
            for skew in outcome.skews
        )
        lines += map(Text, [*_times(outcome), *skews])
        lines += _continuity(outcome.continuity)
    lines += _runtime_values(outcome)
    if outcome.swaps:
        swaps = table(["topic", "subscriber"], MEASUREMENTS)
        for swap in outcome.swaps:
            swaps.add_row(swap.topic, swap.subscriber, *measurements(swap))
        lines.append(swaps)
    lines += [Text(f"{words}.", style="yellow") for words in outcome.own_state.values()]
    counted = [*(each.words for each in outcome.moved.values()), *(each.words for each in outcome.goals.values())]
    lines += [Text(f"{words[0].upper()}{words[1:]}.") for words in counted]
    late = sorted(outcome.late.items())
    lines += [
        Text(f"The first slot of {name} was {seconds(spent)} late; its state moved before.") for name, spent in late
    ]
    return Group(*lines)


def _times(outcome: Outcome) -> list[str]:
    """The planned duration beside the measured one. A plan that is verified is carried out without overlap."""
    plan, steps = outcome.plan, outcome.steps
    if outcome.outcome != "done" or plan is None or not steps or outcome.verdict:
        return []
    ended = max(step.began + step.seconds for step in steps)
    together = sum(step.seconds for step in steps)
    in_all = "" if seconds(ended) == seconds(together) else f", for steps of {seconds(together)} in all"
    return [f"Planned: {_about_plan(plan)}. Measured: {seconds(ended)}{in_all}."]


def _continuity(found: Assessments | None) -> Iterable[Text]:
    """Yield what was kept, what was lost for how long, and what is not measurable, in the manager's words."""
    if found is None:  # it was recorded by an earlier version
        return
    yield from (Text(line, style="default" if found.verdict == "kept" else "yellow") for line in found.lines)


def degraded_line(degraded: DegradedFunctionality) -> str:
    """A functionality that is in a worse mode than before or than normal, and why, on one line."""
    because = f": {degraded.because.splitlines()[0]}" if degraded.because else ""
    return f"{_lowered(degraded)}{because}."


def fallen_line(outcome: Outcome) -> str:
    """Say what was degraded and what is lower now, on one line, for a table."""
    below = sorted(outcome.below_baseline_seconds.items())
    fallen = [f"{name} {seconds(spent)}" for name, spent in below if spent]
    fallen += [f"{each.functionality} permanently" for each in outcome.remaining_degradations]
    kept = outcome.continuity is not None and outcome.continuity.verdict == "kept"
    return ", ".join(fallen) or ("nothing" if kept else UNKNOWN if outcome.continuity is None else "see the report")


def time_of_day(at: float) -> str:
    """A Unix time (s) as the local time, to the millisecond."""
    whole, millis = divmod(round(at * 1000), 1000)
    return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{millis:03d}"


def history(history: History, *, in_progress: bool = True) -> RenderableType:
    """The changes and the incidents, oldest first. ``in_progress``: a manager continues what has no outcome yet."""
    from midstride.runtime.records.change_history import Incident

    left, right = ("", "when", "what", "outcome", "levels", "version"), ("steps", "missed", "gap", "took")
    rows = table(left, right)
    entries: list[ChangeRecord | Incident] = [*history.changes, *history.incidents]
    for each in sorted(entries, key=lambda entry: entry.at):
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(each.at))
        if isinstance(each, Incident):
            rows.add_row("", when, Text(each.words.splitlines()[0], style="dim"), *[""] * 7)
            continue
        done = sum(step.outcome == "done" for step in each.steps)
        outcome = (each.outcome or ("in progress" if in_progress else "interrupted")).replace("_", " ")
        figures: list[RenderableType] = [_count(each.missed), seconds(each.gap), seconds(each.seconds)]
        style = "green" if each.outcome == "done" else "yellow"
        number, what, version = str(each.number), each.by or each.command, f"v{each.version}"
        levels = "" if each.continuity is None else each.continuity.in_short
        rows.add_row(number, when, what, Text(outcome, style=style), levels, version, f"{done}/{each.total}", *figures)
        if each.because:
            rows.add_row("", "", Text(each.because.splitlines()[0], style="dim"), *[""] * 7)
    damaged = [Text(history.damaged, style="red")] if history.damaged else []
    return Group(rows, *damaged)


def event(event: Event) -> Text:
    """One event on one line."""
    words = f"outcome: {event.words}" if event.outcome else event.words
    line = Text(f"{time_of_day(event.at)} ", style="dim")
    return line.append(words, style=_STYLES.get(event.kind, "default"))

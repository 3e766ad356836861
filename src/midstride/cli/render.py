"""Plans, outcomes, history and events for people: Rich tables and text, from the JSON documents."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Final

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from midstride.cli.console import PrintableTable
from midstride.codec.form import Document
from midstride.model import wording
from midstride.model.instance_names import is_named_after

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
    "fenced": "red",
    "degraded": "yellow",
    "rollback": "yellow",
    "restore": "yellow",
    "restore_ended": "red",
    "respawn": "yellow",
    "respawn_ended": "red",
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
    if value is None:
        return UNKNOWN
    if value >= 10:
        return f"{value:.1f} s"
    if value >= 1:
        return f"{value:.2f} s"
    return f"{value * 1000:.0f} ms"


def hertz(rate: float | None) -> str:
    """A rate with three significant digits."""
    return UNKNOWN if rate is None else f"{rate:.3g} Hz"


def silence(words: str, since: float | None) -> str:
    """What is silent, and for how long (s)."""
    return words if since is None else f"{words} (for {seconds(since)})"


def step_text(step: Document) -> str:
    """One step of a plan in a few words."""
    match step["action"]:
        case "create" | "remove" as kind:
            return wording.existence(kind, step["instance"], step.get("component", ""))
        case "attach" | "detach" as kind:
            return wording.attachment(kind, step["port"], step["topic"])
        case "degrade" | "upgrade" as kind:
            return wording.mode_changes(kind, ((name, m["from"], m["to"]) for name, m in step["modes"].items()))
        case "handover":
            return wording.handover((swap["topic"], swap["old"], swap["new"]) for swap in step["swaps"])
        case "set":
            return wording.parameters(step["instance"], step.get("parameters", {}))
        case other:
            return str(other)


def plan(document: Document, title: str) -> RenderableType:
    """The steps, the functionalities that degrade, how far and for how long, and the cost."""
    if not document["steps"]:
        return Group(Text(title, style="bold"), Text("Nothing to do: the system already matches the target."))
    steps = table(["#", "step"], ["takes about"])
    steps.columns[0].justify = "right"
    for number, step in enumerate(document["steps"], 1):
        steps.add_row(Text(str(number), style="dim"), Text(step_text(step)), _about(step))
    remarks = [Text(remark, style="yellow") for remark in document.get("remarks") or ()]
    parts = [*remarks, Text.from_markup(falls(document)), *_runtime_values(document)]
    for name, because in (document.get("own_state") or {}).items():
        parts.append(Text(f"{name} starts with its own state: {because}.", style="yellow"))
    parts.append(Text(cost(document), style="dim"))
    return Group(Text(title, style="bold"), steps, *parts)


def _about(document: Document) -> str:
    """How long a step takes, and the shortest and the longest that was measured where they differ much."""
    return _with_remarks(document.get("seconds"), _spread(document))


def _spread(document: Document) -> list[str]:
    shortest, longest = document.get("between") or (0.0, 0.0)
    return [] if longest - shortest < SPREAD else [f"{seconds(shortest)} to {seconds(longest)}"]


def _with_remarks(taken: float | None, remarks: list[str]) -> str:
    return seconds(taken) + (f" ({'; '.join(remarks)})" if remarks else "")


def planned_seconds(document: Document) -> float:
    """How long a plan takes as it is carried out (s). Reports of earlier versions only have the sum of its steps."""
    found = document.get("duration")
    return float(document["seconds"] if found is None else found)


def _about_plan(document: Document) -> str:
    """How long a plan takes as it is carried out, with its range; beside it the sum of its steps where they overlap."""
    taken, total = planned_seconds(document), document["seconds"]
    in_turn = [] if seconds(taken) == seconds(total) else [f"{seconds(total)} one step after another"]
    return _with_remarks(taken, [*_spread(document), *in_turn])


def _runtime_values(document: Document) -> Iterable[Text]:
    """What becomes of parameter values that were set at run time."""
    for value in document.get("parameters") or ():
        yield Text(value["words"], style="default" if value["fate"] == "kept" else "yellow")


def falls(document: Document) -> str:
    """What degrades on the way, how far, for how long and why; and what is lower or higher afterwards."""
    lines = [_marked_fall(document, fall) for fall in document["degradations"]]
    lower = _lower_afterwards(document)
    higher = [shift for shift in document["level_shifts"] if shift["levels"] <= 0]
    if not lines and not lower:
        lines = ["[green]Nothing degrades:[/green] every functionality that remains keeps its level throughout."]
    lines += [f"[yellow]Afterwards:[/yellow] {escape(_lowered(shift))}." for shift in lower]
    lines += [f"[green]Improves:[/green] {escape(_shift(shift))}" for shift in higher]
    return "\n".join(lines)


def _marked_fall(document: Document, fall: Document) -> str:
    if fall["from_step"] == 0:
        return f"[yellow]Degraded already:[/yellow] {escape(_already(document, fall))}"
    return f"[yellow]Degrades:[/yellow] {escape(_fall(document, fall))}"


def _fall(document: Document, fall: Document) -> str:
    steps: list[Document] = document["steps"]
    name = fall["functionality"]
    since, until = fall["from_step"], fall["to_step"]
    where = f"steps {since} to {until}" if until is not None else f"from step {since} on"
    mode = _mode_entered(steps[since - 1], name)
    depth = f" to {mode}" if mode else ""
    unserved = fall.get("unserved_from_step")
    if mode and unserved is not None:
        depth += f", unserved from step {unserved} on,"
    head = f"{name}{depth} for about {seconds(fall['seconds'])} ({where})"
    return "\n  ".join([head, fall["because"], *fall.get("forced_by", ()), *_alternatives(document, name)])


def _already(document: Document, fall: Document) -> str:
    """How long a functionality remains below that is below before the first step."""
    until, unserved = fall["to_step"], fall.get("unserved_from_step")
    where = "throughout" if until is None else f"until step {until}"
    where += f", unserved from step {unserved} on" if unserved else ""
    name = fall["functionality"]
    head = f"{name} for about {seconds(fall['seconds'])} more ({where})"
    return "\n  ".join([head, *fall.get("forced_by", ()), *_alternatives(document, name)])


def _alternatives(document: Document, functionality: str) -> Iterable[str]:
    found = document.get("alternatives") or ()
    return (_alternative(each) for each in found if each["functionality"] == functionality)


def _alternative(alternative: Document) -> str:
    """What it would cost to keep a functionality."""
    mode = alternative["kept_at"]
    if alternative["impossible"] is not None:
        return f"It cannot be kept at {mode}: {alternative['impossible']}"
    instead = _listed(alternative["degraded"]) if alternative["degraded"] else "nothing"
    cost = f"the disruption would be {alternative['disruption']:.3g}"
    return f"To keep it at {mode}, {cost}: {instead} would degrade instead"


def _mode_entered(step: Document, functionality: str) -> str | None:
    """The mode that a role's functionality enters in a step; None if the step does not change it."""
    role, _, name = functionality.rpartition(".")
    for ref, modes in step.get("modes", {}).items():
        instance, _, functionality_name = ref.rpartition(".")
        if functionality_name == name and is_named_after(instance, role):
            return str(modes["to"])
    return None


def _lower_afterwards(document: Document) -> list[Document]:
    """What the plan lowers for good."""
    return [shift for shift in document["level_shifts"] if shift["levels"] > 0]


def _lowered(shift: Document) -> str:
    return wording.lowered(shift["functionality"], shift["to"], shift["from"])


def _shift(shift: Document) -> str:
    before, after = (shift[end] or "unserved" for end in ("from", "to"))
    return f"{shift['functionality']}, from {before} to {after}"


def cost(document: Document) -> str:
    """The cost of a plan, and whether its disruption is proved minimal."""
    bound = "proved minimal" if document.get("proved_minimal") else f"at least {document.get('lower_bound', 0):.3g}"
    if document.get("proof_space") == "detours":
        bound += ", with detours"
    disruption = f"Disruption {document['disruption']:.3g} weighted functionality-seconds"
    # It counts what happens on the way: what is lost for good does not show in it.
    if lower := _lower_afterwards(document):
        disruption += f" on the way ({bound}), and afterwards {', '.join(map(_lowered, lower))}"
    else:
        disruption += f" ({bound})"
    return f"{disruption}; takes about {_about_plan(document)}; strategy {document['strategy']}."


def measurements(swap: Document) -> list[RenderableType]:
    """What was measured at one subscriber, in the order of ``MEASUREMENTS``; unknown values are marked."""
    periods = swap.get("gap_periods")
    counts = [_count(swap.get(name)) for name in _COUNTS]
    return [seconds(swap.get("gap")), UNKNOWN if periods is None else f"{periods:.2f}", *counts]


def _count(count: int | None) -> Text:
    if count is None:
        return Text(UNKNOWN, style="dim")
    return Text(str(count), style="green" if count == 0 else "yellow")


def outcome(document: Document) -> RenderableType:
    """How a change ended, what degraded and what was measured."""
    kind, because = document["outcome"], document.get("because")
    headline = {
        "done": f"[green]Done[/green] in {seconds(document['seconds'])}",
        "refused": "[red]Refused[/red], nothing was changed",
        "rolled_back": f"[red]Rolled back[/red] in {seconds(document['seconds'])}, every step undone",
        "failed": f"[red bold]Failed[/red bold] in {seconds(document['seconds'])}",
    }[kind]
    lines: list[RenderableType] = [Text.from_markup(headline + (f": {escape(str(because))}" if because else "."))]
    if kind != "refused":
        lines += map(Text, [*_times(document), *_skews(document), *_fallen_lines(document)])
    lines += _runtime_values(document)
    if document.get("swaps"):
        swaps = table(["topic", "subscriber"], MEASUREMENTS)
        for swap in document["swaps"]:
            swaps.add_row(swap["topic"], swap["subscriber"], *measurements(swap))
        lines.append(swaps)
    lines += [Text(f"{words}.", style="yellow") for words in (document.get("own_state") or {}).values()]
    late = sorted((document.get("late") or {}).items())
    lines += [
        Text(f"The first slot of {name} was {seconds(spent)} late; its state moved before.") for name, spent in late
    ]
    return Group(*lines)


def _times(document: Document) -> list[str]:
    """The planned duration beside the measured one. A plan that is verified is carried out without overlap."""
    plan, steps = document.get("plan"), document.get("steps")
    if document["outcome"] != "done" or not (plan and steps) or document.get("verdict"):
        return []
    ended = max(step["began"] + step["seconds"] for step in steps)
    together = sum(step["seconds"] for step in steps)
    in_all = "" if seconds(ended) == seconds(together) else f", for steps of {seconds(together)} in all"
    return [f"Planned: {_about_plan(plan)}. Measured: {seconds(ended)}{in_all}."]


def _skews(document: Document) -> list[str]:
    return [
        f"{skew['kind'].capitalize()} of {_listed(skew['functionalities'])}: within {skew['seconds'] * 1000:.1f} ms."
        for skew in document.get("skews") or ()
    ]


def _fallen_lines(document: Document) -> list[str]:
    """What was degraded and for how long, what is lower now, and what else went wrong, as measured."""
    fallen = sorted((document.get("below_baseline_seconds") or {}).items())
    lines = [f"{name} was below its level for {seconds(spent)}." for name, spent in fallen]
    lines += [f"Afterwards: {lowered_line(each)}" for each in document.get("remaining_degradations") or ()]
    if exits := document.get("unexpected_exits"):
        lines.append(f"Exited unexpectedly meanwhile: {', '.join(exits)}; see `midstride log`.")
    if degraded := document.get("unexpected_degradations"):
        lines.append(f"Degraded unexpectedly meanwhile: {', '.join(degraded)}; see `midstride why {degraded[0]}`.")
    lines += [f"Fenced: {each['words']}." for each in document.get("fenced") or ()]
    lines += [silence(each["words"], each["seconds"]) for each in document.get("silences") or ()]
    swaps = document.get("swaps") or ()
    lines += [line for swap in swaps if (line := _faults(swap))]
    if lines:
        return lines
    unknown = [
        f"{_listed(names)} at {swap['subscriber']} on {swap['topic']}" for swap in swaps if (names := _unknown(swap))
    ]
    if unknown:
        return [f"Nothing is known to have fallen below its level. Not known: {'; '.join(unknown)}."]
    return ["Nothing fell below its level."]


def lowered_line(lowered: Document) -> str:
    """A functionality that is in a worse mode than before or than normal, and why, on one line."""
    because = f": {str(lowered['because']).splitlines()[0]}" if lowered["because"] else ""
    return f"{_lowered(lowered)}{because}."


def _faults(swap: Document) -> str:
    """What was missed, lost or received twice at one subscriber; empty if nothing is known to have been."""
    counts = [
        f"{swap[name]} {name.removesuffix('s') if swap[name] == 1 else name}" for name in _COUNTS if swap.get(name)
    ]
    return f"Messages on {swap['topic']} at {swap['subscriber']}: {_listed(counts)}." if counts else ""


def _unknown(swap: Document) -> list[str]:
    return [name for name in _COUNTS if swap.get(name) is None]


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def fallen_line(document: Document) -> str:
    """What was degraded and what is lower now, on one line, for a table."""
    fallen = [
        f"{name} {seconds(spent)}"
        for name, spent in sorted((document.get("below_baseline_seconds") or {}).items())
        if spent
    ]
    fallen += [f"{each['functionality']} permanently" for each in document.get("remaining_degradations") or ()]
    return ", ".join(fallen) or "nothing"


def time_of_day(at: float) -> str:
    """A Unix time (s) as the local time, to the millisecond."""
    whole, millis = divmod(round(at * 1000), 1000)
    return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{millis:03d}"


def history(document: Document, *, in_progress: bool = True) -> RenderableType:
    """The changes and the incidents, oldest first. ``in_progress``: a manager goes on with what has no outcome yet."""
    left, right = ("", "when", "what", "outcome", "version"), ("steps", "missed", "gap", "took")
    rows = table(left, right)
    entries = [*document["changes"], *document["incidents"]]
    for each in sorted(entries, key=lambda entry: float(entry["at"])):
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(each["at"]))
        if "number" not in each:
            rows.add_row("", when, Text(each["words"].splitlines()[0], style="dim"), *[""] * 6)
            continue
        done = sum(step["outcome"] == "done" for step in each["steps"])
        outcome = (each["outcome"] or ("in progress" if in_progress else "interrupted")).replace("_", " ")
        figures: list[RenderableType] = [_count(each["missed"]), seconds(each["gap"]), seconds(each["seconds"])]
        what = each["by"] or each["command"]
        style = "green" if each["outcome"] == "done" else "yellow"
        version = f"v{each['version']}"
        rows.add_row(
            str(each["number"]), when, what, Text(outcome, style=style), version, f"{done}/{each['total']}", *figures
        )
        if each["because"]:
            rows.add_row("", "", Text(each["because"].splitlines()[0], style="dim"), *[""] * 6)
    damaged = [Text(document["damaged"], style="red")] if document["damaged"] else []
    return Group(rows, *damaged)


def event(document: Document) -> Text:
    """One event on one line."""
    words = f"outcome: {document['words']}" if document.get("outcome") else document["words"]
    line = Text(f"{time_of_day(document['at'])} ", style="dim")
    return line.append(words, style=_STYLES.get(document["kind"], "default"))

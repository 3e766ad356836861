"""Plans, outcomes, status and events for people: Rich tables and text, from the JSON documents."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from midstride.cli.console import PrintableTable
from midstride.cli.files import as_typed_here
from midstride.cli.programs import code_words
from midstride.model import wording

Document = Mapping[str, Any]

UNKNOWN: Final = "unknown"
_COUNTS: Final = ("missed", "lost", "duplicates")
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


def step_text(step: Document) -> str:
    """One step of a plan in a few words."""
    match step["action"]:
        case "create" | "remove" as kind:
            return wording.existence(kind, step["component"], step.get("of", ""))
        case "attach" | "detach" as kind:
            return wording.attachment(kind, step["port"], step["connector"])
        case "degrade" | "upgrade" as kind:
            return wording.mode_changes(kind, ((name, m["from"], m["to"]) for name, m in step["modes"].items()))
        case "handover":
            return wording.handover((swap["connector"], swap["old"], swap["new"]) for swap in step["swaps"])
        case "set":
            return wording.parameters(step["component"], step.get("parameters", {}))
        case other:
            return str(other)


def plan(document: Document, title: str) -> RenderableType:
    """The steps, the functionalities that degrade, how far and for how long, and the cost."""
    if not document["steps"]:
        return Group(Text(title, style="bold"), Text("Nothing to do: the system already matches the target."))
    steps = table(["#", "step"], ["takes about"])
    steps.columns[0].justify = "right"
    for number, step in enumerate(document["steps"], 1):
        steps.add_row(Text(str(number), style="dim"), Text(step_text(step)), seconds(step.get("seconds")))
    remarks = [Text(remark, style="yellow") for remark in document.get("remarks") or ()]
    parts = [*remarks, Text.from_markup(falls(document)), *_runtime_values(document)]
    for name, because in (document.get("own_state") or {}).items():
        parts.append(Text(f"{name} starts with its own state: {because}.", style="yellow"))
    parts.append(Text(cost(document), style="dim"))
    return Group(Text(title, style="bold"), steps, *parts)


def _runtime_values(document: Document) -> Iterable[Text]:
    """What becomes of parameter values that were set at run time."""
    for value in document.get("parameters") or ():
        yield Text(value["words"], style="default" if value["fate"] == "kept" else "yellow")


def falls(document: Document) -> str:
    """What degrades on the way, how far, for how long and why; and what is lower or higher afterwards."""
    lines = [f"[yellow]Degrades:[/yellow] {escape(_fall(document, fall))}" for fall in document["falls"]]
    lower = _lower_afterwards(document)
    higher = [shift for shift in document["afterwards"] if shift["levels"] <= 0]
    if not lines and not lower:
        lines = ["[green]Nothing degrades:[/green] every functionality that remains keeps its level throughout."]
    lines += [f"[yellow]Afterwards:[/yellow] {escape(_lowered(shift))}." for shift in lower]
    lines += [f"[green]Improves:[/green] {escape(_shift(shift))}" for shift in higher]
    return "\n".join(lines)


def _fall(document: Document, fall: Document) -> str:
    steps: list[Document] = document["steps"]
    since, until = fall["from_step"], fall["to_step"]
    where = f"steps {since} to {until}" if until is not None else f"from step {since} on"
    mode = _mode_entered(steps[since - 1], fall["functionality"]) if since else None
    depth = f" to {mode}" if mode else ""
    unserved = fall.get("unserved_from_step")
    if mode and unserved is not None:
        depth += f", unserved from step {unserved} on,"
    return f"{fall['functionality']}{depth} for about {seconds(fall['seconds'])} ({where})\n  {fall['because']}"


def _mode_entered(step: Document, functionality: str) -> str | None:
    """The mode that a role's functionality enters in a step; None if the step does not change it."""
    role, _, name = functionality.rpartition(".")
    for ref, modes in step.get("modes", {}).items():
        instance, _, functionality_name = ref.rpartition(".")
        if functionality_name == name and (instance == role or instance.removeprefix(f"{role}_").isdecimal()):
            return str(modes["to"])
    return None


def _lower_afterwards(document: Document) -> list[Document]:
    """What the plan lowers for good."""
    return [shift for shift in document["afterwards"] if shift["levels"] > 0]


def _lowered(shift: Document) -> str:
    return wording.lowered(shift["functionality"], shift["to"], shift["from"])


def _shift(shift: Document) -> str:
    before, after = (shift[end] or "unserved" for end in ("from", "to"))
    return f"{shift['functionality']}, from {before} to {after}"


def cost(document: Document) -> str:
    """The cost of a plan, and whether its disruption is proved minimal."""
    bound = "proved minimal" if document.get("proved_minimal") else f"at least {document.get('lower_bound', 0):.3g}"
    disruption = f"Disruption {document['disruption']:.3g} weighted functionality-seconds"
    # It counts what happens on the way: what is lost for good does not show in it.
    if lower := _lower_afterwards(document):
        disruption += f" on the way ({bound}), and afterwards {', '.join(map(_lowered, lower))}"
    else:
        disruption += f" ({bound})"
    # The steps run one after another; the critical path is beside it, where that is shorter.
    total, critical = seconds(document["seconds"]), seconds(document["makespan"])
    duration = total if total == critical else f"{total} (critical path {critical})"
    return f"{disruption}; takes about {duration}; strategy {document['strategy']}."


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
        lines += map(Text, _fallen_lines(document))
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


def _fallen_lines(document: Document) -> list[str]:
    """What was degraded and for how long, what is lower now, and what else went wrong, as measured."""
    fallen = sorted((document.get("fallen") or {}).items())
    lines = [f"{name} was below its level for {seconds(spent)}." for name, spent in fallen]
    lines += [f"Afterwards: {lowered_line(each)}" for each in document.get("lowered") or ()]
    if ended := document.get("ended"):
        lines.append(f"Exited unexpectedly meanwhile: {', '.join(ended)}; see `midstride log`.")
    if degraded := document.get("degraded"):
        lines.append(f"Degraded unexpectedly meanwhile: {', '.join(degraded)}; see `midstride why {degraded[0]}`.")
    lines += [f"Fenced: {each['words']}." for each in document.get("fenced") or ()]
    lines += map(_silence, document.get("silences") or ())
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
    fallen = [f"{name} {seconds(spent)}" for name, spent in sorted((document.get("fallen") or {}).items()) if spent]
    fallen += [f"{each['functionality']} permanently" for each in document.get("lowered") or ()]
    return ", ".join(fallen) or "nothing"


def status(document: Document) -> RenderableType:
    """The live components, one line for each functionality."""
    live = table(["node", "component", "process", "functionality", "mode", "why"])
    for component in document["components"]:
        first = [component["name"], component["component"], _process(component)]
        rows: list[Document] = component["functionalities"] or [{}]
        for row in rows:
            live.add_row(*first, *_functionality(row, component))
            first = ["", "", ""]
    lines = [*_topics(document), *_unmet(document), *_programs(document), *_set(document), *_problems(document)]
    return Group(Text.from_markup(_heading(document)), live, *lines)


def _heading(document: Document) -> str:
    running = document.get("running")
    activity = f", carrying out `{escape(running['command'])}` for {seconds(running['since'])}" if running else ""
    state = "[green]valid[/green]" if document["valid"] else "[red]not valid[/red]"
    file = document.get("file")
    origin = f"\n[dim]brought up from {escape(as_typed_here(file))}[/dim]" if file else ""
    return f"[bold]{document['system']}[/bold] on {document['backend']}, {state}{activity}{origin}"


def _process(component: Document) -> Text:
    process = str(component["pid"] or "–")
    if component["ending"]:
        return Text(f"{process}, ending", style="dim")
    if not component["reachable"]:
        return Text(f"{process}, not responding", style="red")
    return Text(process, style="dim")


def _functionality(row: Document, component: Document) -> tuple[Text, Text, Text]:
    """Its name, its mode and why. The mode is unknown while its component does not respond."""
    if not row:
        return Text("none", style="dim"), Text(""), Text("")
    name = Text(row["name"].rpartition(".")[2])
    if not component["reachable"]:
        return name, Text(UNKNOWN, style="red"), Text(f"last known mode: {row['mode']}")
    mode = Text(row["mode"], style="green" if row["normal"] else "yellow")
    why = [] if row["normal"] or not row.get("because") else [str(row["because"]).strip().splitlines()[0]]
    if row.get("restoring"):
        why.append(row["restoring"])
    if component["waiting"]:
        why.append(f"waiting: {component['waiting']}")
    if row.get("busy") is not None:
        why.append(f"busy for {seconds(row['busy'])}")
    return name, mode, Text("; ".join(why))


def _topics(document: Document) -> Iterable[Text]:
    for topic in document["topics"]:
        # A topic that is satisfied without a publisher in scope is served by the environment.
        publishers = ", ".join(topic["publishers"]) or ("the environment" if topic["satisfied"] else "no publisher")
        subscribers = ", ".join(topic["subscribers"]) or "no subscriber"
        style = "dim" if topic["satisfied"] else "yellow"
        remark = "" if topic["satisfied"] else "  (not satisfied)"
        yield Text(f"{topic['name']}: {publishers} → {subscribers}{remark}", style=style)


def _attachments(document: Document) -> Iterable[tuple[Document, Document]]:
    """Each attachment of a component that answers, with what is measured of it."""
    for component in document["components"]:
        for attachment in component.get("attachments") or ():
            if measured := attachment.get("measured"):
                yield attachment, measured


def _unmet(document: Document) -> Iterable[Text]:
    """Where what is measured differs from what is declared. What a closed gate holds back is no promise to anything."""
    for attachment, measured in _attachments(document):
        where = f"{attachment['port']} on {attachment['connector']}"
        if attachment["gate"] == "closed":
            continue
        if measured["met"] is False:
            last = "no message yet" if measured["age"] is None else f"last message {seconds(measured['age'])} ago"
            words = f"{hertz(measured['rate'])} measured, {hertz(measured['declared'])} declared ({last})"
            yield Text(f"{where}: {words}", style="yellow")
        for each in measured["fields"]:
            if each["run"]:
                declared = f"{each['field']} {each['constraint']} declared"
                yield Text(f"{where}: {each['field']} is {each['last']}, {declared}", style="yellow")


def hertz(rate: float | None) -> str:
    """A rate with three significant digits."""
    return UNKNOWN if rate is None else f"{rate:.3g} Hz"


def measured(document: Document) -> RenderableType:
    """Every attachment: what is declared of its messages, and what is measured."""
    rows = table(["port", "topic"], ["declared", "measured", "over", "last", "jitter", "longest gap", "fields"])
    for attachment, each in _attachments(document):
        fields = ", ".join(
            f"{field['field']} {field['constraint']}: {field['violations']} of {field['checked']} violate it"
            + (f", last {field['last']}" if field["violations"] else "")
            for field in each["fields"]
        )
        declared = "–" if each["declared"] is None else hertz(each["declared"])
        times = (seconds(each[name]) for name in ("age", "jitter", "longest"))
        rate = Text(hertz(each["rate"]), style="yellow" if each["met"] is False else "default")
        rows.add_row(
            attachment["port"], attachment["connector"], declared, rate, seconds(each["window"]), *times, fields or "–"
        )
    return Group(Text(""), rows)


def _programs(document: Document) -> Iterable[Text]:
    """The nodes whose code has changed on disk, and what is not known of others."""
    for component in document["components"]:
        unknown = component.get("unknown_files")
        if files := component.get("changed_files"):
            remedy = "" if unknown else f"; `midstride restart {component['role']}` deploys it"
            yield Text(f"{component['name']}: {code_words(files)}{remedy}", style="yellow")
        if unknown and component["reachable"]:
            yield Text(f"{component['name']}: whether its code has changed is not fully known: {unknown}", style="dim")


def _set(document: Document) -> Iterable[Text]:
    """The parameters that have other values than they were started with."""
    for component in document["components"]:
        for each in component.get("parameters") or ():
            if each["set_at_run_time"]:
                words = f"{component['name']}: {each['name']} = {each['value']!r}, set at run time"
                yield Text(f"{words} (started with {each['declared']!r})")


def _problems(document: Document) -> Iterable[Text]:
    problems = [*document["violations"], *(_silence(fault) for fault in document["silences"])]
    for crash in document.get("crashed") or ():
        status = "" if crash["status"] is None else f" (status {crash['status']})"
        respawn = crash.get("respawn")
        next_ = [respawn["words"]] if respawn else []
        if crash.get("remedy") and not (respawn and respawn["restarting"]):
            next_.append(crash["remedy"])
        problems.append("; ".join([f"{crash['name']} exited unexpectedly{status}", *next_]))
    problems += [document[name] for name in ("unwritten", "damaged") if document.get(name)]
    return [Text(problem, style="red") for problem in problems]


def platform(document: Document) -> RenderableType:
    """How each component was started, and what is set for the middleware."""
    starts = table(["node", "ROS node", "started with", "clock", "log"])
    for component in document["components"]:
        clock = "/clock" if component["simulated_time"] else "system"
        run = component["run"] or Text("by hand, or by another system", style="dim")
        starts.add_row(component["name"], component["node"] or "–", run, clock, component["log_file"] or "–")
    middleware = document["middleware"]
    settings = table(["variable", "value", "set by"])
    for owner in ("set", "kept"):
        for name, value in middleware[owner].items():
            settings.add_row(name, value, "Midstride" if owner == "set" else "you: it is left")
    lines: list[RenderableType] = [Text(""), starts, Text(f"\nMiddleware: {middleware['name']}")]
    if middleware["set"] or middleware["kept"]:
        lines.append(settings)
    notes = [*middleware["notes"], *_spares(document["spares"])]
    return Group(*lines, *(Text(note, style="dim") for note in notes))


def _spares(spares: Document) -> list[str]:
    if not spares["kept"]:
        return []
    words = f"Spare processes: {spares['ready']} of {spares['kept']} ready"
    unused_by = f"; not for {', '.join(spares['unused_by'])}, whose commands start as before"
    return [words + (unused_by if spares["unused_by"] else "") + "."]


def _silence(fault: Document) -> str:
    since = "" if fault["seconds"] is None else f" (for {seconds(fault['seconds'])})"
    return f"{fault['words']}{since}"


def time_of_day(at: float) -> str:
    """A Unix time (s) as the local time, to the millisecond."""
    whole, millis = divmod(round(at * 1000), 1000)
    return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{millis:03d}"


def history(document: Document) -> RenderableType:
    """The changes and the incidents, oldest first."""
    left, right = ("", "when", "what", "outcome", "version"), ("steps", "missed", "gap", "took")
    rows = table(left, right)
    entries = [*document["changes"], *document["incidents"]]
    for each in sorted(entries, key=lambda entry: float(entry["at"])):
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(each["at"]))
        if "number" not in each:
            rows.add_row("", when, Text(each["words"].splitlines()[0], style="dim"), *[""] * 6)
            continue
        done = sum(step["outcome"] == "done" for step in each["steps"])
        outcome = (each["outcome"] or "in progress").replace("_", " ")
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
    words = f"outcome: {document['words']}" if document["kind"] == "outcome" else document["words"]
    line = Text(f"{time_of_day(document['at'])} ", style="dim")
    return line.append(words, style=_STYLES.get(document["kind"], "default"))

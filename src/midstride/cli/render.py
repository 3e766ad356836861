"""Plans, reports and states for people: Rich tables, and the words of a step. Reads JSON documents alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

Document = Mapping[str, Any]

UNKNOWN = "unknown"


def seconds(value: float | None) -> str:
    """A duration with the digits that matter."""
    if value is None:
        return UNKNOWN
    if value >= 10:
        return f"{value:.1f} s"
    if value >= 1:
        return f"{value:.2f} s"
    return f"{value * 1000:.0f} ms"


def step_words(step: Document) -> str:
    """One step of a plan in a few words."""
    action = step["action"]
    match action:
        case "create":
            instance, role = step["component"], step.get("role")
            played = f", as {role}" if role and role != instance else ""
            return f"create {instance} ({step['of']}{played})"
        case "remove":
            return f"remove {step['component']}"
        case "attach" | "detach":
            return f"{action} {step['port']} {'to' if action == 'attach' else 'from'} {step['connector']}"
        case "degrade" | "upgrade":
            moves = [f"{name}: {modes['from']} → {modes['to']}" for name, modes in step["modes"].items()]
            return f"{action} {', '.join(moves)}"
        case "handover":
            swaps = [f"{swap['connector']} from {swap['old']} to {swap['new']}" for swap in step["swaps"]]
            return f"hand over {', '.join(swaps)}"
        case "set":
            values = ", ".join(f"{name} = {value!r}" for name, value in step.get("parameters", {}).items())
            return f"set {step['component']}: {values}"
        case _:
            return str(action)


def plan(document: Document, title: str) -> RenderableType:
    """The steps, who falls, how far and for how long, and what it costs."""
    if not document["steps"]:
        return Group(Text(title, style="bold"), Text("There is nothing to do: what is wanted is there."))
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("#", justify="right", style="dim")
    table.add_column("step")
    table.add_column("takes about", justify="right")
    for number, step in enumerate(document["steps"], 1):
        table.add_row(str(number), escape(step_words(step)), seconds(step.get("seconds")))
    return Group(Text(title, style="bold"), table, Text.from_markup(falls(document)), Text(cost(document), style="dim"))


def falls(document: Document) -> str:
    """Who falls on the way, how far, for how long and why; and what stands otherwise afterwards."""
    lines = [f"[yellow]Falls:[/yellow] {escape(_fall(document, fall))}" for fall in document["falls"]]
    lower, higher = _afterwards(document)
    if not lines and not lower:
        lines = ["[green]Nothing falls:[/green] every functionality keeps its level throughout."]
    lines += [f"[yellow]Stays lower:[/yellow] {escape(words)}" for words in lower]
    lines += [f"[green]Rises:[/green] {escape(words)}" for words in higher]
    return "\n".join(lines)


def _fall(document: Document, fall: Document) -> str:
    steps: list[Document] = document["steps"]
    since, until = fall["from_step"], fall["to_step"]
    where = f"steps {since} to {until}" if until is not None else f"from step {since} on"
    far = _mode_entered(steps[since - 1], fall["functionality"]) if since else None
    how_far = f" to {far}" if far else ""
    gone = fall.get("unserved_from_step")
    if far and gone is not None:
        how_far += f", and from step {gone} on to nobody serving it,"
    return f"{fall['functionality']}{how_far} for about {seconds(fall['seconds'])} ({where})\n  {fall['because']}"


def _mode_entered(step: Document, functionality: str) -> str | None:
    """The mode that a role's functionality enters by a step; None where the step is about something else."""
    role, _, name = functionality.rpartition(".")
    for ref, modes in step.get("modes", {}).items():
        instance, _, own = ref.rpartition(".")
        if own == name and (instance == role or instance.removeprefix(f"{role}_").isdecimal()):
            return str(modes["to"])
    return None


def _afterwards(document: Document) -> tuple[list[str], list[str]]:
    """Of what stays: the functionalities that end lower than they began, and those that end higher."""
    lower: list[str] = []
    higher: list[str] = []
    for shift in document["afterwards"]:
        (lower if shift["levels"] > 0 else higher).append(_shift(shift))
    return lower, higher


def _shift(shift: Document) -> str:
    before, after = (shift[end] or "nobody serving it" for end in ("from", "to"))
    return f"{shift['functionality']}, from {before} to {after}"


def cost(document: Document) -> str:
    """The figures of a plan, and whether the least disruption is proved."""
    least = "proved minimal" if document.get("proved_minimal") else f"at least {document.get('lower_bound', 0):.3g}"
    disruption = f"Disruption {document['disruption']:.3g} weighted functionality-seconds ({least})"
    return f"{disruption}; takes about {_duration(document)}; strategy {document['strategy']}."


def _duration(document: Document) -> str:
    """One step after another, as they are carried out; the critical path beside it, where that is shorter."""
    told, least = seconds(document["seconds"]), seconds(document["makespan"])
    return told if told == least else f"{told} (critical path {least})"


def swaps(document: Document) -> RenderableType:
    """What was measured at each subscriber; what cannot be known says so."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("topic", "subscriber"):
        table.add_column(name)
    for name in ("longest gap", "in periods", "missed", "lost", "duplicates"):
        table.add_column(name, justify="right")
    for swap in document["swaps"]:
        periods = swap.get("gap_periods")
        counts = [swap.get(name) for name in ("missed", "lost", "duplicates")]
        table.add_row(
            swap["topic"],
            swap["subscriber"],
            seconds(swap.get("gap")),
            UNKNOWN if periods is None else f"{periods:.2f}",
            *(_count(count) for count in counts),
        )
    return table


def _count(count: int | None) -> Text:
    if count is None:
        return Text(UNKNOWN, style="dim")
    return Text(str(count), style="green" if count == 0 else "yellow")


def outcome(document: Document) -> RenderableType:
    """How it ended, in words, and what was measured."""
    kind, because = document["outcome"], document.get("because")
    words = {
        "done": f"[green]Done[/green] in {seconds(document['seconds'])}",
        "refused": "[red]Refused[/red], nothing was changed",
        "rolled_back": f"[red]Rolled back[/red] in {seconds(document['seconds'])}, every step is undone",
        "failed": f"[red bold]Failed[/red bold] in {seconds(document['seconds'])}",
    }[kind]
    lines: list[RenderableType] = []
    lines.append(Text.from_markup(words + (f": {escape(str(because))}" if because else ".")))
    if kind != "refused":
        lines.extend(Text(line) for line in fallen_words(document))
    if document.get("swaps"):
        lines.append(swaps(document))
    return Group(*lines)


def fallen_words(document: Document) -> list[str]:
    """What really fell, and for how long, as measured; and what was meant to stay lower than it was."""
    lines = [f"{name} was below its level for {seconds(spent)}." for name, spent in _fallen(document)]
    lines += [f"Stays lower: {_shift(shift)}." for shift in _lowered(document)]
    if ended := document.get("ended"):
        lines.append(f"By itself ended meanwhile: {', '.join(ended)}; `midstride status` says what that lowers.")
    if degraded := document.get("degraded"):
        lines.append(f"By itself fell meanwhile: {', '.join(degraded)}; `midstride why {degraded[0]}` says why.")
    return lines or ["Nothing fell below its level."]


def fell(document: Document) -> str:
    """The same on one line, for a table."""
    told = [f"{name} {seconds(spent)}" for name, spent in _fallen(document)]
    told += [f"{shift['functionality']} for good" for shift in _lowered(document)]
    return ", ".join(told) or "nothing"


def _fallen(document: Document) -> list[tuple[str, float]]:
    return sorted((name, spent) for name, spent in (document.get("fallen") or {}).items() if spent)


def _lowered(document: Document) -> list[Document]:
    """What was meant to stay lower than it was, and does."""
    shifts: list[Document] = document["plan"]["afterwards"] if document["outcome"] == "done" else []
    return [shift for shift in shifts if shift["levels"] > 0]


def status(document: Document) -> RenderableType:
    """What is live, each functionality on its line."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("node", "component", "process", "functionality", "mode", "why"):
        table.add_column(name)
    for component in document["components"]:
        first = [component["name"], component["component"], _process(component)]
        rows: list[Document] = component["functionalities"] or [{}]
        for row in rows:
            table.add_row(*first, *_functionality(row, component["reachable"]))
            first = ["", "", ""]
    return Group(Text.from_markup(_heading(document)), table, *_topics(document), *_faults(document))


def _heading(document: Document) -> str:
    running = document.get("running")
    doing = f", carrying out `{escape(running['command'])}` since {seconds(running['since'])}" if running else ""
    state = "[green]valid[/green]" if document["valid"] else "[red]not valid[/red]"
    return f"[bold]{document['system']}[/bold] on {document['backend']}, {state}{doing}"


def _process(component: Document) -> Text:
    process = str(component["pid"] or "–")
    if not component["reachable"]:
        return Text(f"{process}, no answer", style="red")
    return Text(process, style="dim")


def _functionality(row: Document, reachable: bool) -> tuple[Text, Text, Text]:
    """Its name, its mode and why. Of one that does not answer the mode is not known, only what it was told."""
    if not row:
        return Text("none", style="dim"), Text(""), Text("")
    name = Text(row["name"].rpartition(".")[2])
    if not reachable:
        return name, Text(UNKNOWN, style="red"), Text(f"it was in mode {row['mode']}")
    mode = Text(row["mode"], style="green" if row["normal"] else "yellow")
    why = [] if row["normal"] or not row.get("because") else [str(row["because"]).strip().splitlines()[0]]
    if row.get("busy") is not None:
        why.append(f"busy for {seconds(row['busy'])}")
    return name, mode, Text("; ".join(why))


def _topics(document: Document) -> list[RenderableType]:
    lines = []
    for topic in document["topics"]:
        # What is satisfied without a publisher in scope is so by one out of scope.
        publishers = ", ".join(topic["publishers"]) or ("the environment" if topic["satisfied"] else "nobody")
        subscribers = ", ".join(topic["subscribers"]) or "nobody"
        style = "dim" if topic["satisfied"] else "yellow"
        lacking = "" if topic["satisfied"] else "  (not satisfied)"
        lines.append(Text(f"{topic['name']}: {publishers} → {subscribers}{lacking}", style=style))
    return list(lines)


def _faults(document: Document) -> list[RenderableType]:
    faults = [Text(str(violation), style="red") for violation in document["violations"]]
    for gone in document.get("crashed") or ():
        faults.append(Text(f"{gone['name']} exited unexpectedly (status {gone['status']})", style="red"))
    if document.get("unwritten"):
        faults.append(Text(str(document["unwritten"]), style="red"))
    return list(faults)


def event(document: Document) -> Text:
    """One event on one line."""
    import time

    whole, millis = divmod(round(document["at"] * 1000), 1000)
    at = time.strftime("%H:%M:%S", time.localtime(whole))
    styles = {"step_failed": "red", "up_failed": "red", "exited": "red", "degraded": "yellow", "rollback": "yellow"}
    words = str(document["words"])
    if document["kind"] == "outcome":
        words = f"outcome: {words}"
    line = Text(f"{at}.{millis:03d} ", style="dim")
    return line.append(words, style=styles.get(document["kind"], "default"))

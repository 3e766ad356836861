"""Status for people: the live components, what is measured, and the platform, from the JSON documents."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.text import Text

from midstride.cli.files import as_typed_here
from midstride.cli.programs import code_words
from midstride.cli.render import UNKNOWN, Document, hertz, seconds, silence, table


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
    why += component.get("differences", [])
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
    not_known: dict[str, list[str]] = {}
    for component in document["components"]:
        unknown = component.get("unknown_files")
        if files := component.get("changed_files"):
            remedy = "" if unknown else f"; `midstride restart {component['role']}` deploys it"
            yield Text(f"{component['name']}: {code_words(files)}{remedy}", style="yellow")
        if unknown and component["reachable"]:
            not_known.setdefault(unknown, []).append(component["name"])
    for reason, names in not_known.items():
        each = ", ".join(names) + (" (each)" if len(names) > 1 else "")
        yield Text(f"{each}: whether its code has changed is not fully known: {reason}", style="dim")


def _set(document: Document) -> Iterable[Text]:
    """The parameters that have other values than they were started with."""
    for component in document["components"]:
        for each in component.get("parameters") or ():
            if each["set_at_run_time"]:
                words = f"{component['name']}: {each['name']} = {each['value']!r}, set at run time"
                yield Text(f"{words} (started with {each['declared']!r})")


def _problems(document: Document) -> Iterable[Text]:
    problems = [*document["violations"], *(silence(fault) for fault in document["silences"])]
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
    undeclared = [
        f"{component['name']} {words}: no port states that, so it has no gate and no contract"
        for component in document["components"]
        for words in component.get("undeclared", ())
    ]
    notes = [*undeclared, *middleware["notes"], *_spares(document["spares"])]
    return Group(*lines, *(Text(note, style="dim") for note in notes))


def _spares(spares: Document) -> list[str]:
    if not spares["kept"]:
        return []
    words = f"Spare processes: {spares['ready']} of {spares['kept']} ready"
    unused_by = f"; not for {', '.join(spares['unused_by'])}, whose commands start as before"
    return [words + (unused_by if spares["unused_by"] else "") + "."]

"""Status for people: the live components, what is measured, and the platform."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.text import Text

from midstride.cli.changed_programs import code_words, other_overlay
from midstride.cli.input_files import as_typed_here
from midstride.cli.render import UNKNOWN, hertz, seconds, table
from midstride.codec.parameter import from_json
from midstride.model.contract import connector_kind
from midstride.model.wording import KIND_WORDS
from midstride.plan.runtime_values import time_of
from midstride.runtime.backend_protocol import NAMES_ALL
from midstride.runtime.records.status_forms import (
    ChangeLock,
    FunctionalityStatus,
    InstanceStatus,
    OtherEndpoints,
    PortStatus,
    SpareStatus,
    Status,
)
from midstride.verdicts.assessment import silence_in_words


def status(status: Status) -> RenderableType:
    """The live components, one line for each functionality."""
    live = table(["node", "component", "process", "functionality", "mode", "why"])
    for component in status.instances:
        first: list[str | Text] = [component.name, component.component, _process(component)]
        rows = [_functionality(each, component) for each in component.functionalities]
        for row in rows or [(Text("none", style="dim"), Text(""), Text(""))]:
            live.add_row(*first, *row)
            first = ["", "", ""]
        for line in _others(component):
            live.add_row("", "", "", *line)
    lines = [*_hosts(status), *_topics(status), *_unmet(status), *_programs(status), *_set(status), *_problems(status)]
    return Group(Text.from_markup(_heading(status)), live, *_containers(status), *lines)


def _heading(status: Status) -> str:
    running, file = status.running, status.file
    activity = f", carrying out `{escape(running.command)}` for {seconds(running.seconds or None)}" if running else ""
    style = {"up": "green", "degraded": "yellow", "down": "red"}[status.condition.state]
    state = f"[{style}]{escape(status.condition.headline)}[/]"
    since = ", changed since (`midstride history`)" if status.changed_since else ""
    origin = f"\n[dim]specification: {escape(as_typed_here(file))}{since}[/dim]" if file else ""
    lock = f"\n[yellow]{escape(lock_line(status.lock))}[/yellow]" if status.lock else ""
    unmet = "".join(
        f"\n[yellow]{escape(f'Changes are refused: {each.words}')}[/yellow]"
        for each in status.requirements
        if not each.holds
    )
    return f"[bold]{status.system}[/bold] on {status.backend}: {state}{activity}{lock}{unmet}{origin}"


def lock_line(lock: ChangeLock) -> str:
    """The holder of the system's lock, until when and why, and what the lock holds back."""
    held = "commands, restarts and restoring" if lock.holds_recovery else "commands"
    words = f"{lock.words[0].upper()}{lock.words[1:]}"
    return f"{words} (it holds back {held}; `midstride unlock` ends it)"


def _process(component: InstanceStatus) -> Text:
    process = str(component.pid or "–") + (f" {component.process}" if component.process else "")
    process += f" on {component.host}" if component.host else ""
    if component.ending:
        return Text(f"{process}, ending", style="dim")
    if component.done:
        return Text("done", style="dim")
    if not component.reachable:
        return Text(f"{process}, {'unreachable' if component.unreachable else 'not responding'}", style="red")
    return Text(process, style="dim")


def _functionality(row: FunctionalityStatus, component: InstanceStatus) -> tuple[Text, Text, Text]:
    """The name, the mode and why; the mode is unknown while its component does not respond."""
    name = Text(row.name)
    if not component.reachable:
        return name, Text(UNKNOWN, style="red"), Text(f"last known mode: {row.mode}")
    mode = Text(row.mode, style="green" if row.normal else "yellow")
    why = [] if row.normal or not row.because else [row.because.strip().splitlines()[0]]
    if row.restoring:
        why.append(row.restoring)
    if component.waiting:
        why.append(f"waiting: {component.waiting}")
    why += component.differences
    if row.busy:
        why.append(f"busy for {seconds(row.busy)}")
    return name, mode, Text("; ".join(why))


def _others(component: InstanceStatus) -> Iterable[tuple[Text, Text, Text]]:
    """The other nodes that end with it, one line each; a second one of the same name is explained."""
    for each in component.other_nodes:
        why = "of the same process"
        if each.namesake:
            why = f"a second node of this name, as {NAMES_ALL}"
        yield Text(f"also node {each.name}"), Text(""), Text(why, style="dim")
    if component.other_nodes_unknown:
        words = f"other nodes of its process are not known: {component.other_nodes_unknown}"
        yield Text(""), Text(""), Text(words, style="dim")


def _containers(status: Status) -> Iterable[Text]:
    """The containers of which some nodes have a process for themselves by now."""
    for container in sorted({each.container for each in status.instances if each.container is not None}):
        own = [each for each in status.instances if each.container == container]
        if alone := [each.name for each in own if each.process is None]:
            words = f"container {container}: {', '.join(alone)} left it for a process for itself, as it was replaced"
            yield Text(f"{words}; `midstride restart {container}` brings all together", style="dim")


def _hosts(status: Status) -> Iterable[Text]:
    """The link to each other host."""
    for host in status.hosts:
        where = f"host {host.name} ({host.destination})"
        nodes = ", ".join(host.instances) or "no node"
        if host.connected:
            clock = ""
            if host.clock_ahead is not None and host.clock_uncertainty is not None:
                clock = (
                    f"; its clock is {host.clock_ahead * 1e3:+.1f} ± {host.clock_uncertainty * 1e3:.1f} ms from here"
                )
            yield Text(f"{where}: connected since {time_of(host.since)}; {nodes}{clock}", style="dim")
            continue
        words = ""
        if host.instances:
            started = "; ".join((*host.fallbacks, "nothing else")) if host.fallbacks else "nothing"
            words = f"nothing is known of {nodes}, and {started} is started elsewhere: "
        yield Text(f"{where}: unreachable since {time_of(host.since)}; {words}{host.because}", style="red")


def _topics(status: Status) -> Iterable[Text]:
    for topic in status.topics:
        # A topic that is satisfied without a publisher in scope is served by the environment.
        others = topic.others or OtherEndpoints(publishers=[], subscribers=[])
        kind = connector_kind(topic.type)
        words = KIND_WORDS[kind]
        served = "the environment" if topic.satisfied else _outside(others.publishers) or f"no {words.provider}"
        providers = ", ".join(topic.publishers) or served
        users = ", ".join(topic.subscribers) or _outside(others.subscribers) or f"no {words.user}"
        style = "dim" if topic.satisfied else "yellow"
        remark = "" if topic.satisfied else "  (not satisfied)"
        # Messages go to subscribers, requests to the server.
        line = f"{topic.name}: {providers} → {users}"
        if kind != "topic":
            line = f"{words.connector} {topic.name}: {users} → {providers}"
        yield Text(f"{line}{remark}", style=style)


def _outside(nodes: Sequence[str]) -> str:
    """The nodes whose endpoints are no ports: of other systems, or undeclared; empty where there is none."""
    return f"{', '.join(nodes)} (not in the specification)" if nodes else ""


def _attached(status: Status) -> Iterable[tuple[str, PortStatus]]:
    """Each port on a topic of which something is measured, and both in words."""
    for instance in status.instances:
        for port in instance.ports:
            if port.window:
                yield f"{instance.name}.{port.name}", port


def _unmet(status: Status) -> Iterable[Text]:
    """The differences between measured and declared. What a closed gate holds back breaks no promise."""
    for name, port in _attached(status):
        where = f"{name} on {port.topic}"
        if port.gate == "closed":
            continue
        if port.met is False:
            last = "no message yet" if port.age is None else f"last message {seconds(port.age)} ago"
            words = f"{hertz(port.rate)} measured, {hertz(port.declared)} declared ({last})"
            yield Text(f"{where}: {words}", style="yellow")
        for each in port.fields or ():
            if each.run:
                declared = f"{each.field} {each.constraint} declared"
                yield Text(f"{where}: {each.field} is {each.last}, {declared}", style="yellow")


def measured(status: Status) -> RenderableType:
    """Every attachment: what is declared of its messages, and what is measured."""
    rows = table(["port", "topic"], ["declared", "measured", "over", "last", "jitter", "longest gap", "fields"])
    for name, port in _attached(status):
        fields = ", ".join(
            f"{field.field} {field.constraint}: {field.violations} of {field.checked} violate it"
            + (f", last {field.last}" if field.violations else "")
            for field in port.fields or ()
        )
        declared = "–" if port.declared is None else hertz(port.declared)
        times = map(seconds, (port.window or None, port.age, port.jitter, port.longest))
        rate = Text(hertz(port.rate), style="yellow" if port.met is False else "default")
        rows.add_row(name, port.topic or "–", declared, rate, *times, fields or "–")
    return Group(Text(""), rows)


def _programs(status: Status) -> Iterable[Text]:
    """The nodes whose code has changed on disk, and what is not known of others."""
    not_known: dict[str, list[str]] = {}
    for component in status.instances:
        unknown = component.unknown_files
        if component.changed_files:
            remedy = "" if unknown else f"; `midstride restart {component.role}` deploys it"
            yield Text(f"{component.name}: {code_words(component.changed_files)}{remedy}", style="yellow")
        if unknown and component.reachable:
            not_known.setdefault(unknown, []).append(component.name)
    yield from (Text(line, style="yellow") for line in other_overlay(status.instances))
    for reason, names in not_known.items():
        each = ", ".join(names) + (" (each)" if len(names) > 1 else "")
        yield Text(f"{each}: whether its code has changed is not fully known: {reason}", style="dim")


def _set(status: Status) -> Iterable[Text]:
    """The parameters that have other values than they were started with."""
    for component in status.instances:
        for each in component.parameters:
            if each.set_at_run_time:
                words = f"{component.name}: {each.name} = {from_json(each.value)!r}, set at run time"
                yield Text(f"{words} (started with {from_json(each.declared)!r})")


def _problems(status: Status) -> Iterable[Text]:
    problems = [
        *status.violations,
        *(
            silence_in_words(fault.words, fault.seconds or None)
            for fault in status.silences
            if fault.kind != "unreachable"  # the line of its host says so
        ),
    ]
    for crash in status.crashed:
        next_ = [] if crash.respawn is None else [crash.respawn.words]
        if crash.remedy and not (crash.respawn and crash.respawn.restarting):
            next_.append(crash.remedy)
        if crash.words not in status.condition.headline:
            problems.append("; ".join([crash.words, *next_]))
        elif next_:  # the heading has the reason
            problems.append(f"{crash.name}: {'; '.join(next_)}")
    problems += [words for words in (status.unwritten, status.damaged) if words]
    return [Text(problem, style="red") for problem in problems]


def platform(status: Status) -> RenderableType:
    """The way in which each component was started, and what is set for the middleware."""
    starts = table(["node", "ROS node", "started with", "clock", "log"])
    for component in status.instances:
        clock = "/clock" if component.simulated_time else "system"
        run = component.run or Text("by hand, or by another system", style="dim")
        starts.add_row(component.name, component.node or "–", run, clock, component.log_file or "–")
    middleware = status.middleware
    settings = table(["variable", "value", "set by"])
    for variables, owner in ((middleware.set, "Midstride"), (middleware.kept, "you: it is left")):
        for name, value in variables.items():
            settings.add_row(name, value, owner)
    model = f"The configuration in the manager's model is {'' if status.valid else 'not '}valid."
    lines: list[RenderableType] = [
        Text(""),
        starts,
        Text(f"\n{model}\nMiddleware: {middleware.where or middleware.name}"),
    ]
    if middleware.set or middleware.kept:
        lines.append(settings)
    undeclared = [
        f"{component.name} {words}: no port states that, so it has no contract"
        for component in status.instances
        for words in component.undeclared
    ]
    kept_out = [
        f"{component.name}: {port.topic} does not take part in intra-process communication, so that the gate sees it"
        for component in status.instances
        for port in component.ports
        if port.kept_out
    ]
    notes = [*undeclared, *kept_out, *filter(None, [middleware.problem]), *middleware.notes, *_spares(status.spares)]
    return Group(*lines, *(Text(note, style="dim") for note in notes))


def _spares(spares: SpareStatus) -> list[str]:
    if not spares.kept:
        return []
    words = f"Spare processes: {spares.ready} of {spares.kept} ready"
    unused_by = f"; not for {', '.join(spares.unused_by)}, whose commands start as before"
    return [words + (unused_by if spares.unused_by else "") + "."]

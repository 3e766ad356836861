"""``replace``, ``restart``, ``add``, ``remove``, ``apply``: change the running system, with the plan shown first."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midstride.cli import change_options, shell_completion
from midstride.cli.client import Client
from midstride.cli.output import console, is_interactive, json_option, print_json, wants_json
from midstride.cli.running_systems import find, in_file, system_option
from midstride.cli.specification_argument import SpecificationPath, absolute, specification_argument
from midstride.cli.user_name import user_name
from midstride.codec.form import Document
from midstride.errors import ChangeForbidden, PlanRefused
from midstride.model.hosts import host_of_word

if TYPE_CHECKING:  # completion must not wait for it
    from midstride.cli.follow import Sending
    from midstride.model.component import ComponentSpec
    from midstride.runtime.records.reports import Outcome


@dataclass(frozen=True, slots=True)
class RequestOptions:
    """The options of all commands that change the running system."""

    system: str | None
    strategy: str
    detours: bool
    wait: float
    verify: bool
    yes: bool
    despite_lock: bool
    despite_requirements: bool
    with_other_nodes: bool


def request_options(function: Any) -> Any:
    """Calls ``function`` with :class:`RequestOptions` as its argument ``options``."""

    @wraps(function)
    def with_options(
        system: str | None,
        strategy: str,
        detours: bool,
        wait: float,
        verify: bool,
        yes: bool,
        despite_lock: bool,
        despite_requirements: bool,
        with_other_nodes: bool,
        **arguments: Any,
    ) -> int:
        despite = (despite_lock, despite_requirements)
        options = RequestOptions(system, strategy, detours, wait, verify, yes, *despite, with_other_nodes)
        return int(function(options=options, **arguments))

    yes = click.option("--yes", "-y", is_flag=True, help="Do not ask for confirmation.")
    summary = "Verify the plan with Alloy before it starts, and the running system after each step."
    verify = click.option("--verify", is_flag=True, help=summary)
    decorated = change_options.despite_options(verify(yes(with_options)))
    decorated = change_options.with_other_nodes_option(change_options.wait_option(decorated))
    decorated = change_options.strategy_options(decorated)
    return json_option(system_option(decorated))


def _components_option(function: Any) -> Any:
    return click.option(
        "--from",
        "file",
        type=SpecificationPath(),
        metavar="FILE",
        help="Another specification to take COMPONENT from.",
    )(function)


@click.command("replace")
@click.argument("node", shell_complete=shell_completion.nodes)
@click.argument("component", required=False, shell_complete=shell_completion.components)
@change_options.on_host_option
@_components_option
@change_options.declared_parameters_option
@change_options.same_process_option
@request_options
def replace_command(
    node: str,
    component: str | None,
    host: str | None,
    file: Path | None,
    declared_parameters: bool,
    same_process: bool,
    options: RequestOptions,
) -> int:
    """Replace the component of NODE with COMPONENT, on the same topics; with --on HOST, on that host.

    Without COMPONENT, --on HOST moves the node as it is: another process of the same program takes over there.
    """
    if component is None and (host is None or file is not None):
        raise click.UsageError("name the COMPONENT that replaces it, or the host that it moves to: --on HOST")
    request = {
        "replace": [] if component is None else [[node, component]],
        "on": {} if host is None else {node: host},
        "components": [] if component is None else _encoded(_component_of(file, component)),
        "declared_parameters": declared_parameters,
        "same_process": same_process,
    }
    if component is None:
        return change(options, request, f"move {node} to {host}")
    return change(options, request, f"replace {node} with {component}{'' if host is None else f' on {host}'}")


@click.command("restart")
@click.argument(
    "nodes", nargs=-1, required=True, metavar="NODE...", shell_complete=shell_completion.nodes_and_containers
)
@change_options.declared_parameters_option
@change_options.same_process_option
@request_options
def restart_command(
    nodes: tuple[str, ...],
    declared_parameters: bool,
    same_process: bool,
    options: RequestOptions,
) -> int:
    """Restart nodes with the code now on disk: each is handed over to a new instance.

    The name of a container stands for all of its nodes, which move to a new process together. The plan says what is
    lost on the way, and of which nodes nothing is measured, as of one without ports.
    """
    request = {
        "restart": list(nodes),
        "declared_parameters": declared_parameters,
        "same_process": same_process,
    }
    return change(options, request, f"restart {', '.join(nodes)}")


@click.command("add")
@click.argument("node")
@click.argument("component", shell_complete=shell_completion.components)
@click.argument("attachments", nargs=-1, metavar="[PORT=TOPIC]...", shell_complete=shell_completion.attachments)
@click.option(
    "--param",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    help="Set a parameter of the node (repeatable); VALUE is read as by `midstride param set`.",
)
@change_options.on_host_option
@_components_option
@request_options
def add_command(
    node: str,
    component: str,
    attachments: tuple[str, ...],
    parameters: tuple[str, ...],
    host: str | None,
    file: Path | None,
    options: RequestOptions,
) -> int:
    """Add NODE, with COMPONENT, and attach its ports to topics.

    The VALUE of a parameter is read as YAML, as by `midstride param set`: 0.5, [1, 2], true, '"on"'.
    """
    new = change_options.new_node(node, component, attachments, parameters)
    declared = _component_of(file, component)

    def request(client: Client) -> Document:
        if parameters:
            known = declared or client.specification().components.get(component)
            _check_values(parameters, known)
        return {"add": [new], "components": _encoded(declared)}

    if host is not None:
        new["host"] = host_of_word(host)
    return change(options, request, f"add {node} ({component}){'' if host is None else f' on {host}'}")


def _check_values(parameters: tuple[str, ...], component: ComponentSpec | None) -> None:
    """Raises PlanRefused, with what to write, for a value that YAML reads as another type than is declared."""
    declared = {} if component is None else {name: each.value for name, each in component.parameters.items()}
    for name, text in map(change_options.parse_parameter, parameters):
        if (hint := change_options.misread(name, text, declared)) is not None:
            raise PlanRefused(f"--param {name}: {hint}")


@click.command("remove")
@click.argument(
    "nodes", nargs=-1, required=True, metavar="NODE...", shell_complete=shell_completion.nodes_and_containers
)
@request_options
def remove_command(
    nodes: tuple[str, ...],
    options: RequestOptions,
) -> int:
    """Remove nodes. The functionalities that rely on them degrade only as far as they must.

    The name of a container stands for all of its nodes.
    """
    return change(options, {"remove": list(nodes)}, f"remove {', '.join(nodes)}")


@click.command("apply")
@specification_argument("new", metavar="[PACKAGE] NEW")
@click.option("--dry-run", is_flag=True, help="Show the plan, and change nothing.")
@click.option("--keep-code", is_flag=True, help="Do not replace nodes only because their code has changed on disk.")
@change_options.declared_parameters_option
@change_options.same_process_option
@request_options
def apply_command(
    new: Path,
    dry_run: bool,
    keep_code: bool,
    declared_parameters: bool,
    same_process: bool,
    options: RequestOptions,
) -> int:
    """Change the running system to the specification NEW, and to the code that its programs have now."""
    from midstride.cli.changed_programs import changed_code, code_words, other_overlay
    from midstride.cli.input_files import load
    from midstride.codec.specification_form import encode_specification
    from midstride.plan.specification_diff import renamed_components

    target = load(new)

    def request(client: Client) -> Document:
        programs = client.programs()
        changed = {} if keep_code else changed_code(programs, target.nodes)
        running = client.specification()
        if target.name != running.name:
            raise PlanRefused(
                f"{new} is the specification of another system, {target.name}, and {running.name} is running: "
                f"`midstride up {new}` starts it beside this one"
            )
        out = console(stderr=wants_json())
        for before, after in renamed_components(running.components, target.components):
            out.print(f"component {before} is renamed {after}; its nodes keep running", markup=False)
        for node, files in sorted(changed.items()):
            out.print(f"{node}: {code_words(files)}", markup=False)
        for line in other_overlay(programs):
            out.print(line, markup=False)
        return {
            "to": encode_specification(target),
            "restart": sorted(changed),
            "declared_parameters": declared_parameters,
            "same_process": same_process,
        }

    return change(options, request, f"apply {new.name}", dry_run, file=str(absolute(new)))


def _component_of(file: Path | None, name: str) -> ComponentSpec | None:
    """The component ``name`` of ``file``, if it has one; the rest of the file does not concern the request."""
    if file is None:
        return None
    from midstride.cli.input_files import load

    return load(file).components.get(name)


def _encoded(component: ComponentSpec | None) -> list[Document]:
    from midstride.codec.component_form import encode_component

    return [] if component is None else [encode_component(component)]


def change(
    options: RequestOptions,
    asked: Document | Callable[[Client], Document],
    title: str,
    dry_run: bool = False,
    file: str | None = None,
) -> int:
    """Show the plan, ask for confirmation, make the change and report it. The exit status.

    ``asked``: the request without the strategy, or what makes it with the help of the system's manager. ``dry_run``:
    only show the plan. ``file``: the one that is applied.
    """
    if not (options.yes or dry_run or is_interactive()):
        raise click.UsageError("not a terminal; pass --yes")
    client, _ = find(options.system)
    from midstride.cli.follow import Sending, explained_when_interrupted

    sending = Sending()
    with nullcontext() if dry_run else explained_when_interrupted(lambda: sending.interrupted(client)):
        request = asked(client) if callable(asked) else asked
        request = {**request, "strategy": options.strategy, "detours": options.detours}
        request["with_other_nodes"] = options.with_other_nodes
        try:
            return _change(options, client, request, title, sending, dry_run, file)
        except PlanRefused as error:
            hint = _in_changed_file(client, request)
            raise PlanRefused(f"{error}; {hint}" if hint else str(error)) from None


def _in_changed_file(client: Client, request: Document) -> str | None:
    """Advise what to write for the names in a refused request that the system lacks, and its file declares by now."""
    running = client.specification()
    replaced, added = request.get("replace", []), request.get("add", [])
    given = {each["name"] for each in request.get("components", [])}
    components = [name for _, name in replaced] + [each["component"] for each in added]
    nodes = [*request.get("restart", []), *request.get("remove", []), *(node for node, _ in replaced)]
    components = [name for name in components if name not in running.components and name not in given]
    nodes = [name for name in nodes if name not in running.nodes]
    if not (components or nodes):
        return None
    if hint := in_file(client.status().file, components=components, nodes=nodes):
        return hint
    unknown = ", ".join(f"`{name}`" for name in components)
    return f"`--from FILE` takes {unknown} from the specification that declares it" if components else None


def _change(
    options: RequestOptions,
    client: Client,
    request: Document,
    title: str,
    sending: Sending,
    dry_run: bool,
    file: str | None,
) -> int:
    """Carry out :func:`change` with the manager's ``client``."""
    expected = None
    if dry_run or not options.yes:
        from midstride.cli import render

        preview = client.plan(request)
        if dry_run and wants_json():
            print_json(preview)
            return 0
        console(stderr=wants_json()).print(render.plan(preview, title))
        if dry_run:
            return 0
        if preview.forbidden and not (options.despite_lock or options.despite_requirements):
            raise ChangeForbidden(preview.forbidden)
        if preview.steps and not click.confirm("Proceed?", err=True):
            click.echo("Nothing was changed.", err=True)
            return 1
        expected = preview.revision
    document = {"request": request, "expected": expected, "verify": options.verify, "wait": options.wait, "file": file}
    document |= {"by": asked_by(title), "despite_lock": options.despite_lock, "id": sending.id}
    document["despite_requirements"] = options.despite_requirements
    outcome = _carry_out(client, document, title, sending, show_plan=options.yes)
    if wants_json():
        print_json(outcome)
    return 0 if outcome.outcome == "done" and outcome.continuity is not None and not outcome.continuity.lasting else 1


def asked_by(title: str) -> str:
    """The user, and what was asked for, for the history."""
    return f"{user_name()}: {title}"[:200]


def _carry_out(client: Client, change: Document, title: str, sending: Sending, *, show_plan: bool) -> Outcome:
    """Ask the manager for the change and show its progress. The outcome."""
    from midstride.cli.follow import FollowedRequest, last_event_number

    def ask() -> Outcome:
        from msgspec import structs

        outcome = client.change(change, sending.begin)
        hint = _in_changed_file(client, change["request"]) if outcome.outcome == "refused" else None
        return structs.replace(outcome, because=f"{outcome.because}; {hint}") if hint else outcome

    if wants_json():
        return ask()
    from midstride.cli import render
    from midstride.cli.progress import Progress

    followed = FollowedRequest(
        client,
        ask,
        since=last_event_number(client),
        until="outcome",
        id=sending.id,
    )
    out = console()
    with Progress(out) as progress:
        for event in followed:
            if event.plan and show_plan:
                out.print(render.plan(event.plan, title))
            progress.show(event)
    outcome = followed.answer()
    out.print(render.outcome(outcome))
    return outcome

"""``up --dry-run``: what would be started, with which arguments, files and environment, in which order."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

from msgspec import Meta

from midstride.cli.platforms import make_backend
from midstride.codec.form import Report
from midstride.errors import BackendError
from midstride.model.action import Create
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Specification
from midstride.plan.change_builder import change_between
from midstride.plan.strategies.registry import planner
from midstride.runtime.backend_protocol import NAMES_ALL, Backend, DescribedProcess
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.launches import launch_of
from midstride.runtime.process.reached_hosts import out_of_reach
from midstride.runtime.workspace import Workspace
from midstride.wire.environment import ENV_START, ENV_TOKEN
from midstride.wire.folders import workspace_root

# What is known only when the system starts.
_TOKEN: Final = "(made at the start)"


class _NotCreated(Workspace):
    """The workspace as `up` would create it."""

    __slots__ = ()

    @property
    def logs(self) -> Path:
        return self.path / "logs"


class DescribedStart(Report, frozen=True, kw_only=True):
    """A process that would be started; `because`: why it could not be."""

    node: str
    component: str
    host: Annotated[str | None, Meta(description="null: that of the manager; else, the environment is not known here")]
    gate: str | None
    once: Annotated[bool, Meta(description="it is to end, and is waited for, after the steps of the others")]
    command: list[str]
    directory: str
    environment: Annotated[
        dict[str, str | None],
        Meta(description="what differs from the environment of this command; null: not inherited"),
    ]
    files: Annotated[dict[str, str], Meta(description="that would be written for it, with their texts")]
    load: Annotated[list[str], Meta(description="the command that loads a composable node into it, as Midstride does")]
    because: str | None
    names_all: Annotated[bool, Meta(description="all nodes of the process would get its name, if it has several")]


class DryRun(Report, frozen=True, kw_only=True):
    """The processes that `up` would start, in this order; then its steps in theirs."""

    system: str
    backend: str
    processes: list[DescribedStart]
    by_hand: Annotated[list[str], Meta(description="nodes without a `run` command: they are waited for")]
    steps: Annotated[list[str], Meta(description="in words")]


def dry_run(specification: Specification, backend: str, directory: Path, options: SystemOptions) -> DryRun:
    """Return what `up` would start where nothing runs. Starts and writes nothing.

    Raises PlanRefused where there is no plan, BackendError where the platform cannot be had here.
    """
    workspace = _NotCreated(workspace_root() / specification.name)
    platform = make_backend(backend, workspace, middleware_settings=options.middleware_settings)
    if (because := out_of_reach(platform, specification)) is not None:
        raise BackendError(because)
    nothing = Configuration(context=specification.context)
    plan = planner("minimal")(change_between(nothing, specification, specification))
    created = [step.action.instance for step in plan.steps if isinstance(step.action, Create)]
    return DryRun(
        system=specification.name,
        backend=backend,
        processes=[
            _described(each, specification, platform, directory, options)
            for each in created
            if each.component.run is not None
        ],
        by_hand=[each.name for each in created if each.component.run is None],
        steps=[step.describe() for step in plan.steps],
    )


def _described(
    instance: Instance, specification: Specification, platform: Backend, directory: Path, options: SystemOptions
) -> DescribedStart:
    topics = {}
    if instance.component.gate is not None:
        attachments = specification.attachments_of(instance.role)
        topics = {port.port: specification.connectors[connector].topic for port, connector in attachments}
    command, because = shlex.split(instance.component.run or "", posix=False), None
    environment: dict[str, str | None] = {}
    files: dict[str, str] = {}
    load: tuple[str, ...] = ()
    host = specification.hosts.get(instance.host)
    folder = str(directory) if host is None else host.folder or "~"
    try:
        launch = launch_of(instance, platform.name, token=_TOKEN, directory=directory, options=options, topics=topics)
        found = DescribedProcess(launch.arguments) if host is not None else platform.describe(launch)
        command, environment, files, load = list(found.command), found.environment, found.files, found.load
    except BackendError as error:
        because = str(error)
    environment |= dict.fromkeys({ENV_TOKEN, ENV_START} & environment.keys(), _TOKEN)
    return DescribedStart(
        node=instance.name,
        component=instance.component.name,
        host=None if host is None else host.name,
        gate=instance.component.gate,
        once=instance.component.once,
        command=command,
        directory=folder,
        environment=environment,
        files=files,
        load=list(load),
        because=because,
        names_all=not instance.component.loads_library and any(word.startswith("__node:=") for word in command),
    )


def lines(found: DryRun) -> Iterator[str]:
    """The dry run in words."""
    yield f"{found.system} on {found.backend}: `up` would start these processes, in this order."
    for number, each in enumerate(found.processes, start=1):
        yield ""
        kind = ", until it has ended" if each.once else "" if each.gate is None else f", gate {each.gate}"
        yield f"{number}. {each.node} ({each.component}{kind})"
        if each.because is not None:
            yield f"   cannot be started: {each.because}"
            continue
        yield f"   {shlex.join(each.command)}"
        if each.names_all:
            yield f"   where {NAMES_ALL}, if it has several"
        yield f"   in {each.directory}" + (f" on {each.host}, with its environment" if each.host else "")
        for name, value in each.environment.items():
            yield f"   without {name}" if value is None else f"   with {name}={shlex.quote(value)}"
        if each.load:
            yield f"   then loaded, as by: {shlex.join(each.load)}"
        for path, text in each.files.items():
            yield f"   and the file {path}:"
            yield from (f"     {line}" for line in text.splitlines())
    for name in found.by_hand:
        yield f"{name} is started by hand: it is waited for."
    yield ""
    yield "Then these steps:"
    yield from (f"{number:3}  {step}" for number, step in enumerate(found.steps, start=1))
    yield "Nothing was started, and nothing was written."

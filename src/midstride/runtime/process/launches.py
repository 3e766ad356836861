"""The start of an instance's process, as a value that a back end carries out, or only describes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from immutables import Map

from midstride.errors import StartFailed
from midstride.model.component import GATES, Gate, ParameterSection
from midstride.model.configuration import Instance
from midstride.model.load_words import LoadWords
from midstride.runtime.backend_protocol import RELAY_SUFFIX, Launch
from midstride.runtime.options import SystemOptions

# The gates that each back end has.
GATES_OF: Final[Mapping[str, tuple[Gate, ...]]] = {"ros2": GATES, "ros1": ("relay",)}


def launch_of(
    instance: Instance,
    backend: str,
    *,
    token: str,
    directory: Path,
    options: SystemOptions,
    set_values: Mapping[str, Any] = Map(),
    standby: bool = False,
    topics: Mapping[str, str] = Map(),
    predecessor: str = "",
    returns: bool = False,
) -> Launch:
    """The start of ``instance``, whose component has a `run` command, on ``backend``.

    The other arguments are those of :meth:`.launcher.Launcher.start`. Raises StartFailed for what that platform lacks,
    and for a command that cannot be split.
    """
    name, component = instance.name, instance.started
    command, gate, package = component.run or "", component.gate, component.package
    known = GATES_OF.get(backend, ())
    if gate is not None and not component.once and gate not in known:
        instead = " or ".join(f"`gate {kind}` only" for kind in known) or "none"
        raise StartFailed(f"{name} has a gate (`gate {gate}`), and the back end {backend} has {instead}")
    if (component.unnamed or component.renames) and not component.once and backend != "ros2":
        word = "unnamed" if component.unnamed else "renames"
        raise StartFailed(
            f"{name} has `{word}`, and the back end {backend} passes each program the name of its node: omit `{word}`"
        )
    load = None
    if component.container is not None:
        if backend != "ros2":
            raise StartFailed(f"{name} is a composable node, and the back end {backend} has no component containers")
        try:
            load = LoadWords.of(command)
        except ValueError as error:
            raise StartFailed(f"{name}: `{command}` cannot be loaded into a container: {error}") from None
        command, package = component.container.run, component.container.package
    if package is not None and backend != "ros2":
        raise StartFailed(f"{name} is in package {package}, which the back end {backend} cannot look up")
    try:
        arguments, prefix = tuple(shlex.split(command)), tuple(shlex.split(component.prefix or ""))
    except ValueError as error:
        raise StartFailed(f"{name}: the `run` command {command!r} cannot be split: {error}") from None
    if not arguments:
        raise StartFailed(f"{name}: component {component.name} has an empty `run` command")
    parameters: dict[str, object] = {"use_sim_time": True} if options.use_sim_time else {}
    # Of all nodes in a process, unless a file or the specification states another value.
    sections: tuple[ParameterSection, ...] = ()
    is_ros = package is not None or bool(instance.parameters or instance.sections)
    if component.once and not is_ros:
        parameters.clear()  # it takes no arguments of ROS
    elif options.use_sim_time:
        sections = (ParameterSection("/**", Map(use_sim_time=True)),)
    parameters.update(instance.parameters)
    shared = instance.sections if instance.container is None else instance.container.sections
    # A program without Midstride's API has the instance's name: nothing in it could answer for the role.
    node, foreign = (instance.role, None) if gate is None else (name, component)
    if gate == "relay":  # whose process has a node as well, beside that of the program
        node = f"{name}{RELAY_SUFFIX}"
    return Launch(
        name,
        instance.role.rpartition("/")[0],
        arguments,
        token,
        directory,
        parameters,
        {**set_values},
        node,
        standby,
        component.stop_times.patience,
        foreign,
        {**topics},
        package,
        prefix,
        dict(component.environment),
        (*sections, *shared),
        predecessor,
        instance.role,
        load,
        instance.process,
        returns,
        instance.host,
    )

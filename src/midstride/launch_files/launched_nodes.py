"""The processes that launch files start, as far as the launch files state them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from midstride.lang.source import Span
from midstride.launch_files.context import ParametersGiven, Stated
from midstride.model.component import ContainerProgram
from midstride.model.hosts import HostSpec


@dataclass(frozen=True, slots=True)
class LaunchedRespawn:
    """The restarts of a process by launch: the delay (s) and their number; without end if that is negative."""

    delay: float
    retries: int


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A process with one node. ``namespace`` has no outer slashes; ``command`` is without ROS's arguments.

    The first word of ``command`` is an executable of ``package``, if there is one; ``prefix`` stands before it.
    ``stop``: what of the language's `stop` is stated. ``environment`` has None for a variable that the process does not
    inherit. ``later``: what it waits for, if it is started after others, and ``at`` how long after the first ones (s),
    infinite if it follows the end of a process. ``state``: to which state the launch file takes a lifecycle node; empty
    for any other node. ``container``: the program that loads a composable node, whose class is the first word of
    ``command``, and ``extra`` what only containers take (``NAME:=VALUE``). ``shares``: the name of the container
    that it is in with others, with its namespaces; empty where it has one for itself. ``launched_role``: its role in
    launch, where it has another one here, by which sections of parameter files are for it; else empty. ``host``: where
    it runs; empty for the host of the manager.
    """

    name: str
    namespace: str
    program: str
    command: tuple[str, ...]
    span: Span
    remaps: tuple[tuple[str, str], ...] = ()
    settings: tuple[ParametersGiven, ...] = ()
    environment: Mapping[str, str | None] = field(default_factory=dict)
    ros_arguments: tuple[str, ...] = ()
    respawn: LaunchedRespawn | None = None
    stop: tuple[str, ...] = ()
    package: str = ""
    prefix: tuple[str, ...] = ()
    gate: str = "preload"
    unnamed: bool = False
    later: str = ""
    at: float = 0.0
    state: str = ""
    container: ContainerProgram | None = None
    extra: tuple[str, ...] = ()
    shares: str = ""
    launched_role: str = ""
    host: str = ""

    @property
    def role(self) -> str:
        return f"{self.namespace}/{self.name}" if self.namespace else self.name

    def run(self, more: Sequence[str] = ()) -> str:
        """The command, with ``more`` arguments for ROS; of a composable node, its class and how it is loaded."""
        remaps = [word for old, new in self.remaps for word in ("-r", f"{old}:={new}")]
        if self.container is not None:
            return shlex.join([*self.command, *remaps, *(word for each in self.extra for word in ("-e", each))])
        arguments = [*self.ros_arguments, *remaps, *more]
        return shlex.join([*self.command, *(["--ros-args", *arguments] if arguments else [])])


@dataclass(frozen=True, slots=True)
class LoadedNode:
    """A composable node, still without its container, which the launch file names: ``target`` is a full name."""

    node: LaunchedNode
    target: str


@dataclass(frozen=True, slots=True)
class LaunchedContainer:
    """A container that several nodes share: its program, and its process where the launch file starts it."""

    program: ContainerProgram
    process: LaunchedNode | None = None


@dataclass(slots=True)
class LaunchedSystem:
    """The system that a launch file starts: processes, and the nodes that are ``loaded`` into containers.

    ``files``: how many launch files were read. A loaded node that is taken over is among the ``nodes``. ``containers``:
    those that several nodes share, by name; ``hosts`` likewise. ``server``: what of the parameter server of ROS 1 no
    node has, or the language cannot state, by full name.
    """

    nodes: list[LaunchedNode] = field(default_factory=list)
    loaded: list[LoadedNode] = field(default_factory=list)
    files: int = 0
    containers: dict[str, LaunchedContainer] = field(default_factory=dict)
    hosts: dict[str, HostSpec] = field(default_factory=dict)
    server: dict[str, Stated] = field(default_factory=dict)

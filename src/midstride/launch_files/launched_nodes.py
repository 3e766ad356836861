"""The nodes that launch files start, as far as the launch files state them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from midstride.lang.source import Span
from midstride.launch_files.context import Setting
from midstride.launch_files.packages import PACKAGE_NAME


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A process with one node. ``namespace`` has no outer slashes; ``command`` is without ROS's arguments.

    The first word of ``command`` is an executable of ``package``, if there is one; ``prefix`` stands before it.
    ``environment`` has None for a variable that the process does not inherit.
    """

    name: str
    namespace: str
    program: str
    command: tuple[str, ...]
    span: Span
    remaps: tuple[tuple[str, str], ...] = ()
    settings: tuple[Setting, ...] = ()
    environment: Mapping[str, str | None] = field(default_factory=dict)
    ros_arguments: tuple[str, ...] = ()
    respawn: tuple[str, ...] = ()
    stop: tuple[str, ...] = ()
    package: str = ""
    prefix: tuple[str, ...] = ()
    gate: str = "preload"

    @property
    def role(self) -> str:
        return f"{self.namespace}/{self.name}" if self.namespace else self.name

    def run(self, more: Sequence[str] = ()) -> tuple[str, str]:
        """The whole command, with ``more`` arguments for ROS, and the package that it is looked up in, or ""."""
        before = [word for name, value in self.environment.items() if value is None for word in ("-u", name)]
        before += [f"{name}={value}" for name, value in self.environment.items() if value is not None]
        before = [*(["env", *before] if before else []), *self.prefix]
        looked_up = PACKAGE_NAME.fullmatch(self.package) and "/" not in self.command[0]
        if self.package and (before or not looked_up):  # what is looked up is the first word
            before += ["ros2", "run", self.package]
        remaps = [word for old, new in self.remaps for word in ("-r", f"{old}:={new}")]
        arguments = [*self.ros_arguments, *remaps, *more]
        words = [*before, *self.command, *(["--ros-args", *arguments] if arguments else [])]
        return shlex.join(words), "" if before else self.package


@dataclass(slots=True)
class LaunchedSystem:
    """What a launch file starts. ``files``: how many launch files were read."""

    nodes: list[LaunchedNode] = field(default_factory=list)
    files: int = 0

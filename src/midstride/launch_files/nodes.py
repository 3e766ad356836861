"""The nodes that launch files start, as far as the launch files state them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from midstride.lang.source import Span
from midstride.launch_files.context import Setting


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A process with one node. ``namespace`` has no outer slashes; ``command`` is without ROS's arguments."""

    name: str
    namespace: str
    program: str
    command: tuple[str, ...]
    span: Span
    remaps: tuple[tuple[str, str], ...] = ()
    settings: tuple[Setting, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    ros_arguments: tuple[str, ...] = ()
    respawn: tuple[str, ...] = ()

    @property
    def role(self) -> str:
        return f"{self.namespace}/{self.name}" if self.namespace else self.name

    def words(self, more: Sequence[str] = ()) -> list[str]:
        """The whole command, with ``more`` arguments for ROS."""
        variables = [f"{name}={value}" for name, value in self.environment.items()]
        remaps = [word for old, new in self.remaps for word in ("-r", f"{old}:={new}")]
        arguments = [*self.ros_arguments, *remaps, *more]
        return [
            *(["env", *variables] if variables else []),
            *self.command,
            *(["--ros-args", *arguments] if arguments else []),
        ]


@dataclass(slots=True)
class LaunchedSystem:
    """What a launch file starts. ``files``: how many launch files were read."""

    nodes: list[LaunchedNode] = field(default_factory=list)
    files: int = 0

"""ROS's own `launch` without its effects: it starts no process, and joins no ROS.

It is changed for the whole process, which is there for one launch file alone.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable
from typing import Any, Protocol


class LeftOut(Exception):
    """A part of the launch file cannot be carried out. ``kind`` is that of the finding."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class LaunchVisitor(Protocol):
    """Receives what a launch file would start while it is carried out."""

    def started(self, action: Any) -> None:
        """Record what launch would start now."""

    def note_package(self, name: str) -> None:
        """A package is not here."""

    def text(self, value: Any) -> str:
        """Return what launch makes of a text with substitutions."""


def with_places(own: Iterable[str], runner: str) -> None:
    """From now on, an action knows the line of the file in Python that has made it.

    ``own``: the folders of launch; ``runner``: the file that carries it out.
    """
    import launch

    folders = tuple(f"{folder}{os.sep}" for folder in own)
    action: Any = launch.Action
    initialize: Callable[..., None] = action.__init__

    def with_place(self: Any, *arguments: Any, **named: Any) -> None:
        frame: Any = sys._getframe(1)
        while frame is not None and frame.f_code.co_filename.startswith(folders):
            frame = frame.f_back
        if frame is not None and frame.f_code.co_filename != runner:
            self._midstride_place = (frame.f_code.co_filename, frame.f_lineno)
        initialize(self, *arguments, **named)

    action.__init__ = with_place


def without_effect(visitor: LaunchVisitor) -> None:
    """From now on, launch starts no process and joins no ROS, and goes on where a package is not here."""
    import ament_index_python.packages as index
    import launch.actions
    import launch_ros.substitutions as substitutions

    async def nothing() -> None:
        pass

    def start(action: Any, _: Any) -> Any:
        visitor.started(action)
        return nothing()

    def no_node(_: Any) -> Any:
        raise LeftOut("unsupported", "an action that needs a ROS node of launch's own is left out")

    local: Any = launch.actions.ExecuteLocal
    local._ExecuteLocal__execute_process = start
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "launch_ros" and hasattr(module, "get_ros_node"):
            module.get_ros_node = no_node  # type: ignore[attr-defined]

    def known(look_up: Callable[[str], str]) -> Callable[..., str]:
        def found(package: str, *arguments: Any, **named: Any) -> str:
            try:
                return look_up(package, *arguments, **named)
            except LookupError:
                visitor.note_package(package)
                return os.path.join(os.sep, f"package {package} is not here")

        return found

    for name in ("get_package_share_directory", "get_package_prefix"):
        replacement = known(getattr(index, name))
        for module in [index, sys.modules["ament_index_python"], *sys.modules.values()]:
            if getattr(module, name, None) is not None and module.__name__.partition(".")[0] in {
                "ament_index_python",
                "launch_ros",
            }:
                setattr(module, name, replacement)
    executable: Any = substitutions.ExecutableInPackage
    perform = executable.perform

    def performed(substitution: Any, context: Any) -> str:
        try:
            return str(perform(substitution, context))
        except Exception:  # who is to start it says that it is not here
            return visitor.text(substitution.executable)

    executable.perform = performed

"""Carries out a launch file in Python by ROS's own `launch`, in a process for it alone, and starts nothing.

Its arguments are the file, and a file that has the variables and the namespace as JSON, and is replaced by what was
found: the nodes, and what was left out. Exit status 3 means that `launch` or `launch_ros` cannot be imported.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

NO_LAUNCH: Final = 3
_DICTIONARY: Final = "launch_params_"  # how launch_ros names the files that it writes for parameters
# What launch has for `sigterm_timeout` and `sigkill_timeout` (s).
_UNSTATED: Final = 5.0
_HARMLESS: Final = frozenset({"LogInfo"})


class _Visitor:
    def __init__(self, variables: dict[str, str], namespace: str) -> None:
        import launch
        import launch_ros.actions

        self._process: Any = launch.actions.ExecuteProcess
        self._node: Any = launch_ros.actions.Node
        self._later: Any = launch.actions.RegisterEventHandler, launch.actions.TimerAction, launch.actions.EmitEvent
        self._components: Any = launch_ros.actions.LoadComposableNodes
        self._context: Any = launch.LaunchContext()
        self._context._set_asyncio_loop(asyncio.new_event_loop())
        self._context.launch_configurations.update(variables)
        self._environment = dict(self._context.environment)
        if namespace:
            self._context.launch_configurations["ros_namespace"] = f"/{namespace}"
        self.nodes: list[dict[str, Any]] = []
        self.left: list[tuple[str, str]] = []

    def visit(self, entity: Any) -> None:
        name = type(entity).__name__
        if isinstance(entity, self._node):
            if self._applies(entity):
                self._note(entity)
        elif isinstance(entity, self._components):
            if self._applies(entity):
                self.left.append(("composable", f"`{name}` is left out: components share the process of a container"))
        elif isinstance(entity, (self._process, *self._later)):
            if self._applies(entity):
                self.left.append(("unsupported", f"`{name}` in Python is left out"))
        elif name not in _HARMLESS:
            for each in entity.visit(self._context) or ():
                self.visit(each)

    def _applies(self, entity: Any) -> bool:
        return entity.condition is None or bool(entity.condition.evaluate(self._context))

    def _note(self, node: Any) -> None:
        node._perform_substitutions(self._context)
        full = node.node_name.replace(node.UNSPECIFIED_NODE_NAMESPACE, "").strip("/")
        namespace, _, name = full.rpartition("/")
        parameters: list[tuple[str, str | None]] = []
        for value, is_file in node._Node__expanded_parameter_arguments or ():
            if not is_file:
                self.left.append(("parameters", f"a parameter of `{full}` is left out: it is stated by a description"))
            elif os.path.basename(value).startswith(_DICTIONARY):
                parameters.append((value, Path(value).read_text(encoding="utf-8")))
                os.unlink(value)
            else:
                parameters.append((str(value), None))
        for option in self._options(node):
            self.left.append(("unsupported", f"`{option}` of `{full}` is left out"))
        for variable in self._changed_variables():
            self.left.append(("unsupported", f"the environment variable `{variable}` of `{full}` is left out"))
        if type(node).__name__ == "ComposableNodeContainer":
            self.left.append(("composable", f"the components of `{full}` are left out: they would share its process"))
        self.nodes.append(
            {
                "name": "" if name == node.UNSPECIFIED_NODE_NAME else name,
                "namespace": namespace,
                "package": self._text(node.node_package),
                "executable": self._text(node.node_executable),
                "arguments": [self._text(each) for each in node._Node__arguments or ()],
                "remaps": node.expanded_remapping_rules or [],
                "parameters": parameters,
                "lifecycle": type(node).__name__ == "LifecycleNode",
                "stop": dict(self._stop(node)),
            }
        )

    def _options(self, node: Any) -> Iterator[str]:
        """What is stated of a node's process, and not taken over."""
        process = node.process_description
        stated = {
            "prefix": self._text(process.prefix),
            "env": process.env,
            "additional_env": process.additional_env,
            "ros_arguments": getattr(node, "_Node__ros_arguments", None),
            "respawn": getattr(node, "_ExecuteLocal__respawn", None),
        }
        return (name for name, value in stated.items() if value)

    def _stop(self, node: Any) -> Iterator[tuple[str, float]]:
        """How long it may take to end, by the signal that then comes (s), where that is not launch's default."""
        for name in ("sigterm", "sigkill"):
            seconds = self._seconds(getattr(node, f"_ExecuteLocal__{name}_timeout", None))
            if seconds is not None and seconds != _UNSTATED:
                yield name, seconds

    def _seconds(self, value: Any) -> float | None:
        """None where it is not stated, or no number from 0."""
        try:
            seconds = float(self._text(value))
        except ValueError:
            return None
        return seconds if 0 <= seconds < float("inf") else None

    def _changed_variables(self) -> list[str]:
        """The variables that actions of the launch file have set or taken away by now."""
        before, now = self._environment, self._context.environment
        return sorted(name for name in {*before, *now} if before.get(name) != now.get(name))

    def _text(self, value: Any) -> str:
        if value is None or isinstance(value, (str, os.PathLike)):
            return "" if value is None else str(value)
        parts: Iterable[Any] = value if isinstance(value, (list, tuple)) else [value]
        return "".join(
            self._context.perform_substitution(part) if not isinstance(part, str) else part for part in parts
        )


def main(file: str, exchange: str) -> int:
    """The exit status."""
    try:
        import launch_ros  # noqa: F401
        from launch.launch_description_sources import PythonLaunchDescriptionSource
    except ImportError as error:
        print(error, file=sys.stderr)
        return NO_LAUNCH
    given = json.loads(Path(exchange).read_text(encoding="utf-8"))
    visitor = _Visitor(given["variables"], given["namespace"])
    source = PythonLaunchDescriptionSource(file)
    from launch.actions import IncludeLaunchDescription

    visitor.visit(IncludeLaunchDescription(source))
    Path(exchange).write_text(json.dumps({"nodes": visitor.nodes, "left": visitor.left}), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

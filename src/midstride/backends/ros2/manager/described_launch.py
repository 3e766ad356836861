"""The processes and composable nodes that launch would start, described as JSON: command, environment, parameters."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

# What launch has for `sigterm_timeout` and `sigkill_timeout` (s).
_UNSTATED: Final = 5.0
# Variables of a process that launch itself and this process set.
_OWN_VARIABLES: Final = frozenset({"ROS_LOG_DIR", "TMPDIR"})


class DescribedLaunch:
    """Describes by a ``context`` of launch; ``node``: the class of launch_ros for nodes.

    The environment is compared with that of this process when the object is made.
    """

    def __init__(self, context: Any, node: type) -> None:
        self._context, self._node = context, node
        self._before = dict(os.environ)

    def process(self, action: Any) -> dict[str, Any]:
        """Describe the process of an action of launch, which is about to be started."""
        is_node = isinstance(action, self._node)
        details, described = action.process_details, action.process_description
        words = [str(word) for word in details["cmd"]]
        before = len(words) - len(described.cmd)
        found: dict[str, Any] = {
            "type": type(action).__name__ if is_node else "",
            "prefix": words[:before],
            "words": words[before:],
            "package": self.text(action.node_package) if is_node else "",
            "executable": self.text(action.node_executable) if is_node else "",
            "environment": self.changes(details["env"]),
            "cleared": described.env is not None,
            "folder": details["cwd"] and str(details["cwd"]),
            "shell": bool(action.shell),
            "respawn": None,
            "texts": {},
            "stop": dict(self._stop(action)),
        }
        label = found["executable"] or os.path.basename(words[before]) if len(words) > before else ""
        found["label"] = label if described.name is None else self.text(described.name)
        if action._ExecuteLocal__respawn:
            delay = action._ExecuteLocal__respawn_delay
            retries = getattr(action, "_ExecuteLocal__respawn_max_retries", -1)  # Humble starts it again without end
            found["respawn"] = {"delay": delay or 0.0, "retries": retries}
        for option, value in pairwise(words):
            if option == "--params-file":
                found["texts"] |= _passing_text(value)
        return found

    def component(self, description: Any, container: str) -> dict[str, Any]:
        """Describe a composable node that the ``container`` would load."""
        from launch_ros.parameter_descriptions import ParameterFile
        from launch_ros.utilities import evaluate_parameters
        from launch_ros.utilities.normalize_parameters import normalize_parameter_dict

        configurations = self._context.launch_configurations
        base, own = configurations.get("ros_namespace") or "", self.text(description.node_namespace)
        stated: list[Any] = [
            ParameterFile(each) if isinstance(each, str) else normalize_parameter_dict({each[0]: each[1]})
            for each in configurations.get("global_params") or ()
        ]
        given = evaluate_parameters(self._context, [*stated, *(description.parameters or [])])
        parameters: list[tuple[str, Any]] = []
        texts: dict[str, str] = {}
        for each in given:
            if isinstance(each, (str, os.PathLike)):
                path = os.fspath(each)
                parameters.append(("path", path))
                texts |= _passing_text(path)
            elif isinstance(each, dict):
                parameters.append(("values", each))
            else:  # the value of one parameter
                parameters.append(("values", {each.name: each.value}))
        extra: dict[str, Any] = {}
        for each in evaluate_parameters(self._context, description.extra_arguments or []):
            extra |= each if isinstance(each, dict) else {}
        remaps = [*configurations.get("ros_remaps", ())]
        remaps += [(self.text(old), self.text(new)) for old, new in description.remappings or ()]
        return {
            "plugin": self.text(description.node_plugin),
            "package": self.text(description.package),
            "name": self.text(description.node_name),
            "namespace": own if own.startswith("/") or not base else f"{base.rstrip('/')}/{own}".rstrip("/"),
            "target": container,
            "remaps": remaps,
            "parameters": parameters,
            "texts": texts,
            "extra": extra,
        }

    def _stop(self, action: Any) -> Iterator[tuple[str, float]]:
        """The longest time until it ends by the signal that then comes (s), where that is not launch's default."""
        for name in ("sigterm", "sigkill"):
            try:
                seconds = float(self.text(getattr(action, f"_ExecuteLocal__{name}_timeout")))
            except ValueError:
                continue
            if 0 <= seconds < float("inf") and seconds != _UNSTATED:
                yield name, seconds

    def changes(self, after: Any) -> dict[str, str | None]:
        """The variables that are other than at the beginning; None for one that is not there."""
        names = sorted({*self._before, *after} - _OWN_VARIABLES)
        return {name: after.get(name) for name in names if self._before.get(name) != after.get(name)}

    def text(self, value: Any) -> str:
        """Perform the substitutions of a text of launch."""
        if value is None or isinstance(value, (str, os.PathLike)):
            return "" if value is None else str(value)
        parts: Iterable[Any] = value if isinstance(value, (list, tuple)) else [value]
        return "".join(
            self._context.perform_substitution(part) if not isinstance(part, str) else part for part in parts
        )


def role_of(node: Any) -> str:
    """The full name of a node that is started, without the outer slash."""
    return str(node.node_name).strip("/")


def _passing_text(path: str) -> dict[str, str]:
    """Return, by path, the text of a parameter file of launch_ros, whose folder ends with this process."""
    return {path: Path(path).read_text(encoding="utf-8")} if os.path.dirname(path) == os.environ.get("TMPDIR") else {}

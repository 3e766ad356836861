"""Component containers: a composable node is loaded into the process of one by the services of composition_interfaces.

The node does not see the arguments of that process, so all that concerns it is in the request: its name, its
remappings and its parameters.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import NOT_OF_TAG, StartFailed
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import Launch

# What the program of rclcpp_components calls its node, which has the services.
MANAGER_NODE: Final = "ComponentManager"
_SUFFIX: Final = "_container"


def container_name(launch: Launch) -> str:
    """The full name of the node of an instance's container, which no other process has."""
    if launch.process:
        return full_name(launch.process)
    return f"{full_name(launch.instance, launch.namespace)}{_SUFFIX}"


def container_arguments(container: str) -> list[str]:
    """The arguments for ROS that name the node of a container, and no other one in its process."""
    name, namespace = split_name(container)
    rules = [f"{MANAGER_NODE}:__node:={name}"]
    if namespace != "/":
        rules += [f"{node}:__ns:={namespace}" for node in (MANAGER_NODE, name)]
    return [word for rule in rules for word in ("-r", rule)]


@dataclass(frozen=True, slots=True)
class LoadRequest:
    """A request to ``container``, a full name, to load the class ``plugin`` of ``package`` as ``node``, a full name."""

    container: str
    package: str
    plugin: str
    node: str
    remaps: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def command(self) -> tuple[str, ...]:
        """Return the `ros2 component load` command for this request."""
        name, namespace = split_name(self.node)
        words = ["ros2", "component", "load", self.container, self.package, self.plugin, "-n", name]
        words += ["--node-namespace", namespace] if namespace != "/" else []
        words += [word for rule in self.remaps for word in ("-r", rule)]
        for option, values in (("-p", self.parameters), ("-e", self.extra)):
            words += [word for key, value in values.items() for word in (option, f"{key}:={_text(value)}")]
        return tuple(words)


def _text(value: Any) -> str:
    """A value in YAML, in which `ros2 component load` reads it: a text that would be something else there is quoted."""
    return value if isinstance(value, str) and _in_yaml(value) == value else json.dumps(value)


def _in_yaml(text: str) -> object:
    """Return the value that ``text`` is in YAML; None where it is no YAML."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, *NOT_OF_TAG):
        return None


def require_interfaces() -> None:
    """Raises StartFailed where the services of containers cannot be called."""
    if importlib.util.find_spec("composition_interfaces") is None:
        raise StartFailed(
            "composable nodes cannot be loaded here: there is no package composition_interfaces; source the ROS 2 "
            "that has rclcpp_components"
        )

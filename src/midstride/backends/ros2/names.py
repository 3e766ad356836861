"""Names of nodes and of the control plane's services."""

from __future__ import annotations

from typing import Final

STANDARD: Final = (
    "describe_parameters",
    "get_parameters",
    "get_parameter_types",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
PREFIX: Final = "midstride."
COMMAND: Final = PREFIX + "command"
ANNOUNCEMENT: Final = PREFIX + "announcement"
STATE: Final = PREFIX + "state"


def split(instance: str, namespace: str = "") -> tuple[str, str]:
    """The name and the namespace of an instance's node: ``front/camera`` is node ``camera`` in ``/front``.

    ``namespace`` counts where ``instance`` names none of its own.
    """
    own, _, name = instance.strip("/").rpartition("/")
    inside = (own or namespace).strip("/")
    return name, f"/{inside}" if inside else "/"


def full(instance: str, namespace: str = "") -> str:
    """The full name of an instance's node: ``/front/camera``."""
    name, inside = split(instance, namespace)
    return f"{inside.rstrip('/')}/{name}"


def control(name: str) -> str:
    """The hidden node that answers for the node ``name``."""
    return f"_{name}_control"


def is_hidden(full_name: str) -> bool:
    """Whether ROS's tools pass the node over: a part of its name starts with an underscore."""
    return "/_" in full_name

"""Names that are the same on either ROS."""

from __future__ import annotations

from typing import Final

# Where ROS's tools expect diagnostics.
DIAGNOSTICS: Final = "/diagnostics"


def split(instance: str, namespace: str = "") -> tuple[str, str]:
    """The name and the namespace of an instance's node; ``namespace`` counts where ``instance`` states none."""
    own, _, name = instance.strip("/").rpartition("/")
    inside = (own or namespace).strip("/")
    return name, f"/{inside}" if inside else "/"


def full(instance: str, namespace: str = "") -> str:
    """The full name of an instance's node: ``/front/camera``."""
    name, inside = split(instance, namespace)
    return f"{inside.rstrip('/')}/{name}"

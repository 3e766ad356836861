"""The names of instances, and of what is named after them: a node in ROS's graph, a log file.

A node of a specification is a *role*, what runs is an *instance* of it. The first instance has the role's name, a
replacement that name and a number: ``camera``, ``camera_2``, ``camera_3`` (docs/semantics.md section 6). An
:class:`~midstride.model.configuration.Instance` states its role; :func:`is_named_after` is for where only a name is
left, as of the log file of one that has ended.
"""

from __future__ import annotations

from collections.abc import Container
from itertools import count
from typing import Final

# How the names of topics and services begin that are Midstride's own: hidden from ROS 2's tools by the first character.
PRIVATE_NAMES: Final = "/_midstride/"


def fresh_name(role: str, *used: Container[str]) -> str:
    """A name for a further instance of ``role``: the first of ``camera_2``, ``camera_3``, … that is not ``used``."""
    names = (f"{role}_{number}" for number in count(2))
    return next(name for name in names if not any(name in some for some in used))


def is_named_after(instance: str, role: str) -> bool:
    """Return whether an instance of ``role`` may have the name ``instance``: ``camera`` and ``camera_2`` for
    ``camera``.
    """
    return instance == role or (instance.startswith(f"{role}_") and instance[len(role) + 1 :].isdecimal())


def split_name(name: str, namespace: str = "") -> tuple[str, str]:
    """The base name and the namespace of a node: ``("camera", "/front")``.

    ``namespace`` counts where ``name`` states none.
    """
    own, _, base = name.strip("/").rpartition("/")
    inside = (own or namespace).strip("/")
    return base, f"/{inside}" if inside else "/"


def full_name(name: str, namespace: str = "") -> str:
    """The full name of a node, an instance's or any other: ``/front/camera``.

    ``namespace`` counts where ``name`` states none. On ROS 2, the node of an instance has its role's name.
    """
    base, inside = split_name(name, namespace)
    return f"{inside.rstrip('/')}/{base}"


def dotted_name(name: str) -> str:
    """``front.camera``: so ROS names the logger of a node, and Midstride its log file."""
    return name.strip("/").replace("/", ".")


def log_file_name(name: str) -> str:
    """The name of the file with the output of an instance: ``front.camera.log``."""
    return f"{dotted_name(name)}.log"

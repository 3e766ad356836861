"""The message packages that most programs import: a fork server imports them once for all."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from midstride.errors import NodeError

# What a type is called, by its folder.
_KINDS: Final = {"msg": "message type", "srv": "type of a service", "action": "type of a ROS action"}
COMMON: Final = {"std_msgs": "String", "geometry_msgs": "Twist", "sensor_msgs": "Image", "nav_msgs": "Odometry"}


def types(library: str) -> Iterator[Any]:
    """One type of each package that is installed beside ``library``: a user's own package may be built again."""
    for package, name in COMMON.items():
        if _folder(package) == _folder(library):
            with suppress(ImportError, AttributeError):
                yield getattr(import_module(f"{package}.msg"), name)


def message_class(name: str) -> type:
    """The class of a type, such as `std_msgs/msg/String`, also of a service or ROS action.

    Raises NodeError where it is not installed.
    """
    package, *folder, kind = name.split("/")
    where = folder[0] if folder else "msg"
    try:
        found: type = getattr(import_module(f"{package}.{where}"), kind)
    except (ImportError, AttributeError):
        what = _KINDS.get(where, "type")
        raise NodeError(f"the {what} {name} is not installed for {sys.executable}") from None
    return found


def _folder(package: str) -> Path | None:
    found = find_spec(package)
    return None if found is None or found.origin is None else Path(found.origin).parents[1]

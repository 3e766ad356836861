"""An import hook: after every real finder, it serves ``from std_msgs.msg import String`` while a simulator is open."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Final

from midstride.backends.simulator.messages import message_class, message_names
from midstride.backends.simulator.service_types import SERVICE_TYPES, service_class


@cache
def _names() -> dict[str, list[str]]:
    """The full names of the types of each module, such as ``std_msgs.msg``."""
    modules: dict[str, list[str]] = {}
    for name in (*message_names(), *SERVICE_TYPES):
        package, folder, _ = name.split("/")
        modules.setdefault(f"{package}.{folder}", []).append(name)
    return modules


def _class(name: str) -> type:
    return service_class(name) if name in SERVICE_TYPES else message_class(name)


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds ``pkg``, ``pkg.msg``, ``pkg.srv`` and ``pkg.action`` of what is known, where no other finder does."""

    def __init__(self) -> None:
        self.served: list[str] = []

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        known = _names()
        is_package = any(name.startswith(f"{fullname}.") for name in known)
        if not is_package and fullname not in known:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=is_package)

    def exec_module(self, module: ModuleType) -> None:
        self.served.append(module.__name__)
        for name in _names().get(module.__name__, ()):
            setattr(module, name.rpartition("/")[2], _class(name))


_finder: Final = _Finder()
_open = 0


@contextmanager
def served() -> Iterator[None]:
    """While open, packages of messages, services and ROS actions can be imported without ROS."""
    global _open
    _open += 1
    if _finder not in sys.meta_path:
        sys.meta_path.append(_finder)
    try:
        yield
    finally:
        _open -= 1
        if not _open:
            sys.meta_path.remove(_finder)
            while _finder.served:
                sys.modules.pop(_finder.served.pop(), None)

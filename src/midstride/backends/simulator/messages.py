"""Message classes where no ROS is installed, from the ``rosbags`` package's type store.

An import hook, after every real finder, serves ``from std_msgs.msg import String`` while a
simulator is open. Fields not given have ROS's defaults.
"""

from __future__ import annotations

import array
import importlib.abc
import importlib.machinery
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

# The type store has no default values; these are the ones that are not zero.
DEFAULTS: Final[dict[str, dict[str, Any]]] = {
    "geometry_msgs/msg/Quaternion": {"w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}

_CODES: Final = {
    "int8": "b",
    "uint8": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_EMPTY: Final = {"bool": False, "string": "", "wstring": "", "octet": b"\x00", "byte": b"\x00"}

Default = Callable[[], Any]


class SimulatedMessage:
    """A message: its fields as attributes, given by name, else as ROS defaults them."""

    __msgtype__ = ""
    _defaults: dict[str, Default]
    _types: dict[str, str]

    def __init__(self, **fields: Any) -> None:
        for name, default in self._defaults.items():
            setattr(self, name, fields.pop(name) if name in fields else default())
        if fields:
            known = ", ".join(self._defaults) or "none"
            raise TypeError(f"{self.__msgtype__} has no field {', '.join(fields)}; its fields are: {known}")

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        return dict(cls._types)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(_same(getattr(self, n), getattr(other, n)) for n in self._defaults)

    __hash__ = None  # type: ignore[assignment]  # mutable, as ROS's own are

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={getattr(self, name)!r}" for name in self._defaults)
        return f"{self.__msgtype__.replace('/', '.')}({fields})"


def _same(one: Any, other: Any) -> bool:
    result = one == other
    return bool(result.all()) if hasattr(result, "all") else bool(result)


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


@cache
def _packages() -> dict[str, list[str]]:
    """The names of the messages of each package."""
    packages: dict[str, list[str]] = {}
    for name in _store().fielddefs:
        package, _, short = name.split("/")
        packages.setdefault(package, []).append(short)
    return packages


@cache
def message_class(name: str) -> type[SimulatedMessage]:
    """The class of ``pkg/msg/Name``. Raises KeyError for one that the type store does not have."""
    constants, fields = _store().fielddefs[name]
    package, _, short = name.split("/")
    given = DEFAULTS.get(name, {})
    defaults = {field: _constant(given[field]) if field in given else _default(kind) for field, kind in fields}
    attributes: dict[str, Any] = {
        "__msgtype__": name,
        "__module__": f"{package}.msg",
        "_defaults": defaults,
        "_types": {field: _type_name(kind) for field, kind in fields},
        **{constant: value for constant, _, value in constants},
    }
    return type(short, (SimulatedMessage,), attributes)


def _constant(value: Any) -> Default:
    return lambda: value


def _default(kind: Any) -> Default:
    """The value of a field that is not given. ``kind`` is the type store's description."""
    node, detail = kind
    match node.name:
        case "BASE":
            base = detail[0]
            return _constant(_EMPTY.get(base, 0.0 if base.startswith("float") else 0))
        case "NAME":
            return lambda: message_class(detail)()
        case "ARRAY":
            element, length = detail
            return _fixed_array(element, length)
        case "SEQUENCE":
            code = _CODES.get(detail[0][1][0]) if detail[0][0].name == "BASE" else None
            return list if code is None else lambda: array.array(code)
        case other:
            raise KeyError(f"a field of kind {other}")


def _fixed_array(element: Any, length: int) -> Default:
    code = _CODES.get(element[1][0]) if element[0].name == "BASE" else None
    if code is None:
        one = _default(element)
        return lambda: [one() for _ in range(length)]

    def zeros() -> Any:
        import numpy

        return numpy.zeros(length, dtype=code)

    return zeros


def _type_name(kind: Any) -> str:
    node, detail = kind
    if node.name == "BASE":
        return str(detail[0])
    if node.name == "NAME":
        return str(detail).replace("/msg/", "/")
    element = _type_name(detail[0])
    return f"{element}[{detail[1]}]" if node.name == "ARRAY" else f"sequence<{element}>"


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds ``pkg`` and ``pkg.msg`` for the packages of the type store, where no other finder does."""

    def __init__(self) -> None:
        self.served: list[str] = []

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        package, _, rest = fullname.partition(".")
        if rest not in ("", "msg") or package not in _packages():
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=not rest)

    def exec_module(self, module: ModuleType) -> None:
        package, _, rest = module.__name__.partition(".")
        self.served.append(module.__name__)
        if rest:
            for short in _packages()[package]:
                setattr(module, short, message_class(f"{package}/msg/{short}"))


_finder: Final = _Finder()
_open = 0


@contextmanager
def served() -> Iterator[None]:
    """While open, packages of messages can be imported without ROS."""
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

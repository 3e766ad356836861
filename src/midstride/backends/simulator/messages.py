"""Message classes where no ROS is installed, from the ``rosbags`` package's type store.

Fields not given have ROS's defaults.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
from functools import cache
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


def message_names() -> list[str]:
    """The messages of the type store, as ``pkg/msg/Name``."""
    return list(_store().fielddefs)


@cache
def message_class(name: str) -> type[SimulatedMessage]:
    """The class of ``pkg/msg/Name``. Raises KeyError for one that the type store does not have."""
    return fields_class(name, *_store().fielddefs[name])


def fields_class(name: str, constants: Sequence[Any], fields: Sequence[Any]) -> type[SimulatedMessage]:
    """A class of that name with these constants and fields, as the type store describes them."""
    package, folder, short = name.split("/")
    given = DEFAULTS.get(name, {})
    defaults = {field: _constant(given[field]) if field in given else _default(kind) for field, kind in fields}
    attributes: dict[str, Any] = {
        "__msgtype__": name,
        "__module__": f"{package}.{folder}",
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

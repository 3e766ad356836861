"""Message types for tests: a few, the same on every machine."""

from __future__ import annotations

from collections.abc import Iterable

from midstride.lang.message_types import MessageDefinition, parse_fields

TEXTS = {
    "std_msgs/msg/String": "string data",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "sensor_msgs/msg/LaserScan": "std_msgs/Header header\nfloat32 angle_min # start\nfloat32[] ranges",
    "sensor_msgs/msg/Range": "uint8 ULTRASOUND=0\nstd_msgs/Header header\nfloat32 range\nbool valid",
}


class Known:
    """Knows the types above, and no other package."""

    def message(self, name: str) -> MessageDefinition | None:
        return MessageDefinition(name, parse_fields(TEXTS[name], name.partition("/")[0])) if name in TEXTS else None

    def types(self, package: str, folder: str = "msg") -> Iterable[str]:
        return [name.rpartition("/")[2] for name in TEXTS if name.startswith(f"{package}/{folder}/")]
